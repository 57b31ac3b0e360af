"""Kept programs are read before they are asked for.

To read a program takes XLA 50 ms, in which Python is free: threads read what a command used last
time while it imports modules and reads its input.
"""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

_MOST_THREADS = 4


class Ahead:
    """Reads files by a function of their paths, on threads, or when they are asked for."""

    def __init__(self, read: Callable[[Path], Any]):
        self._read = read
        self._begun: dict[Path, Future[Any]] = {}
        self._used: dict[Path, None] = {}

    def __call__(self, path: Path) -> Any:
        """What the file holds. **Raises:** What reading it raises."""
        self._used[path] = None
        begun = self._begun.pop(path, None)
        # Who asks for what no thread has begun need not wait for those before it.
        return self._read(path) if begun is None or begun.cancel() else begun.result()

    @contextmanager
    def reading(self, notes: Path) -> Iterator[None]:
        """While this is entered, the files that `notes` names, one a line, are read; in the end it
        names those that were asked for. Nothing where a file was asked for before: of a process's
        later work most is there.
        """
        if self._used:
            yield
            return
        folder = notes.parent.parent
        try:
            last = [folder / name for name in notes.read_text(encoding="utf-8").split()]
        except OSError:
            last = []
        threads = ThreadPoolExecutor(max(1, min(_MOST_THREADS, (os.cpu_count() or 1) - 1)))
        try:
            self._begun |= {path: threads.submit(self._read, path) for path in last}
            yield
        finally:
            threads.shutdown(cancel_futures=True)
            self._begun.clear()
        # What was broken off would have used more.
        if self._used and set(self._used) != set(last):
            _note(notes, [path.name for path in self._used])


def _note(notes: Path, names: list[str]) -> None:
    """Whole or not at all."""
    try:
        notes.parent.mkdir(parents=True, exist_ok=True)
        temporary = notes.with_suffix(f".{os.getpid()}")
        temporary.write_text("\n".join(names), encoding="utf-8")
        temporary.replace(notes)
    except OSError:  # it costs only time
        pass
