"""A table with a row for each of many eyes, kept on disk while a command works through them."""

import csv
import io as text_io
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from irisjax import io
from irisjax.cli.options import notice

EyeRow = dict[str, str]
Beside = Callable[[], Mapping[Path, bytes]]
OK, DOUBTFUL, FAILED = "ok", "doubtful", "failed"
"""An eye is doubtful where it has a result that the table doubts; it failed where it has none."""


_SHARE = 10  # times as long as writing takes a table waits until it is written again


@dataclass
class EyeTable:
    """Rows of eyes by name.

    Attributes:
        eyes: Names of all, in their order.
        first: The first columns of every row, `status` among them: first the name, last the reason
            why an eye is doubtful or failed.
        unit: Word for an eye in messages.
        target: The file, or `None` to print the table.
        rows: Rows of the eyes that are done, by name.
        beside: Makes the files that are written together with the table.
    """

    eyes: tuple[str, ...]
    first: tuple[str, ...]
    unit: str
    target: Path | None
    rows: dict[str, EyeRow] = field(default_factory=dict)
    beside: Beside = dict
    _due: float = 0.0

    def begin(
        self, resume: bool, overwrite: bool, done: Callable[[EyeRow], bool] = lambda row: True
    ) -> None:
        """Read what a stopped run has left if it is continued: rows that did not fail and are
        `done`. `ValueError` where there is a table and neither `resume` nor `overwrite`.
        """
        if self.target is None or not self.target.exists():
            return
        if not (resume or overwrite):
            ways = "--resume continues it, --overwrite starts again"
            raise ValueError(f"{self.target}: exists; {ways}")
        if resume:
            table = csv.DictReader(self.target.read_text(encoding="utf-8").splitlines())
            if tuple(table.fieldnames or ())[: len(self.first)] != self.first:
                raise ValueError(f"{self.target}: is no table of --batch; --overwrite starts again")
            kept = (row for row in table if row["status"] != FAILED and done(row))
            self.rows.update({row[self.first[0]]: row for row in kept})

    def left(self) -> list[str]:
        """Return the names of the eyes that have no row."""
        return [name for name in self.eyes if name not in self.rows]

    @contextmanager
    def progress(self) -> Iterator[Any]:
        """Count eyes on a terminal with a bar; whatever ends the work, what is done is written."""
        from tqdm import tqdm

        how: dict[str, Any] = {"total": len(self.eyes), "initial": len(self.rows)}
        try:
            with tqdm(unit=self.unit, desc="compiling", disable=None, **how) as bar:
                yield bar
        finally:
            self._write()

    def add(self, rows: Mapping[str, EyeRow]) -> None:
        """Add rows, and write the table, of a million eyes too, in a tenth of the time: a killed
        run loses no more than what came since.
        """
        self.rows.update(rows)
        if (begin := time.monotonic()) >= self._due:
            self._write()
            end = time.monotonic()
            self._due = end + _SHARE * (end - begin)

    def _write(self) -> None:
        if self.target is not None and self.rows:
            self.target.parent.mkdir(parents=True, exist_ok=True)
            io.write_together({self.target: self.text().encode(), **self.beside()})

    def text(self) -> str:
        """Return the table as CSV, with the columns of the longest row first."""
        made = [self.rows[name] for name in self.eyes if name in self.rows]
        longest = sorted(made, key=len, reverse=True)
        columns = list(dict.fromkeys(column for row in longest for column in row))
        return csv_of([columns, *([row.get(n, "") for n in columns] for row in made)])

    def conclude(self) -> int:
        """Print the table if it has no file, and on standard error which eyes failed or are
        doubtful; return the exit status, 3 where one failed.
        """
        if self.target is None:
            sys.stdout.write(self.text())
        for status, verb in ((FAILED, "failed"), (DOUBTFUL, "are doubtful")):
            names = [name for name in self.eyes if self.rows[name]["status"] == status]
            if names:
                some = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
                of = f"{len(names)} of {len(self.eyes)} {self.unit}s"
                notice(f"{of} {verb}: {some}; the column {self.first[-1]} says why")
        return 3 if any(row["status"] == FAILED for row in self.rows.values()) else 0


def csv_of(rows: Iterable[Iterable[object]]) -> str:
    """Return rows of cells as CSV."""
    out = text_io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue()
