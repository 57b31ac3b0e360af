"""A table with a row for each of many eyes, which is written while a command works through them."""

import csv
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from irisjax import io
from irisjax.cli.options import notice
from irisjax.io.tables import csv_of

EyeRow = dict[str, str]
Beside = Callable[[], Mapping[Path, bytes]]
OK, DOUBTFUL, FAILED = "ok", "doubtful", "failed"
"""Status of an eye: a doubtful one has a result with warnings, a failed one has none."""
_SHARE = 10  # time between two writings of a table, relative to the time that writing takes


@dataclass
class EyeTable:
    """Rows of eyes by name.

    Attributes:
        eyes: Names of the eyes of this run, in their order.
        first: The first columns of every row, including `status`; the first is the name, the last
            the reason why an eye is doubtful or failed.
        unit: Word for an eye in messages.
        target: The file, or `None` to print the table.
        rows: Rows of the eyes that are done, by name.
        beside: Function that makes the files to be written together with the table.
        order: Names of all eyes in the order of the table, those of earlier runs too.
    """

    eyes: tuple[str, ...]
    first: tuple[str, ...]
    unit: str
    target: Path | None
    rows: dict[str, EyeRow] = field(default_factory=dict)
    beside: Beside = dict
    order: Sequence[str] = ()
    _due: float = 0.0

    def begin(self, resume: bool, overwrite: bool) -> None:
        """Read the table of a stopped run if it is continued: rows that did not fail, and all rows
        of eyes that are not in this run, which stay where they were between the others.

        Raises:
            ValueError: There is a table, and neither `resume` nor `overwrite`.
        """
        self.order = self.eyes
        if self.target is None or not self.target.exists():
            return
        if not (resume or overwrite):
            advice = "--resume continues it, --overwrite starts again"
            raise ValueError(f"{self.target}: exists; {advice}")
        if resume:
            table = csv.DictReader(self.target.read_text(encoding="utf-8").splitlines())
            if tuple(table.fieldnames or ())[: len(self.first)] != self.first:
                raise ValueError(f"{self.target}: is no table of --batch; --overwrite starts again")
            places, before = {name: (i, 0) for i, name in enumerate(self.eyes)}, -1
            for line, row in enumerate(table, 1):
                name = row[self.first[0]]
                before, nth = places.setdefault(name, (before, line))
                if nth or row["status"] != FAILED:
                    self.rows[name] = row
            self.order = sorted(places, key=places.__getitem__)

    def redo(self, is_done: Callable[[EyeRow], bool]) -> None:
        """Drop the rows of this run's eyes that are not done."""
        for name in self.eyes:
            if name in self.rows and not is_done(self.rows[name]):
                del self.rows[name]

    def left(self) -> list[str]:
        """Return the names of the eyes that have no row."""
        return [name for name in self.eyes if name not in self.rows]

    @contextmanager
    def progress(self) -> Iterator[Any]:
        """Show a progress bar on a terminal; however the work ends, the table is written."""
        from tqdm import tqdm

        counts: dict[str, Any] = {"total": len(self.eyes)}
        counts["initial"] = counts["total"] - len(self.left())
        try:
            with tqdm(unit=self.unit, desc="compiling", disable=None, **counts) as bar:
                yield bar
        finally:
            self._write()

    def add(self, rows: Mapping[str, EyeRow]) -> None:
        """Add rows, and write the table so rarely that writing takes a tenth of the time. A killed
        run loses the rows since the last time.
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
        rows = [self.rows[name] for name in self.order if name in self.rows]
        longest = sorted(rows, key=len, reverse=True)
        columns = list(dict.fromkeys(column for row in longest for column in row))
        return csv_of([columns, *([row.get(n, "") for n in columns] for row in rows)])

    def conclude(self) -> int:
        """Print the table if it has no file, and on standard error which eyes failed or are
        doubtful; return the exit status, 3 where one failed.
        """
        if self.target is None:
            sys.stdout.write(self.text())
        for status, verb in ((FAILED, "failed"), (DOUBTFUL, "are doubtful")):
            names = [name for name in self.eyes if self.rows[name]["status"] == status]
            if names:
                examples = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
                counted = f"{len(names)} of {len(self.eyes)} {self.unit}s"
                notice(f"{counted} {verb}: {examples}; the column {self.first[-1]} says why")
        return 3 if any(self.rows[name]["status"] == FAILED for name in self.eyes) else 0
