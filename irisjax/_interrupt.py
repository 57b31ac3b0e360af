"""Ctrl-C of a command: one line, nothing half written, and gone within two seconds.

Python tells nobody of an interrupt while XLA compiles, and JAX's callbacks may swallow the
exception. So a thread waits for the signal itself: what runs gets a moment to end as it does for
any exception; if it does not, unfinished files are removed and the process ends. Nothing here
imports JAX: the first second of a command is spent on that.
"""

import contextlib
import os
import select
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NoReturn

STATUS = 130
_PATIENCE = 1.2  # seconds
_UNFINISHED: set[Path] = set()
_said = threading.Event()
_signalled = threading.Event()
_expected = threading.Event()
_line = threading.Lock()


@contextlib.contextmanager
def unfinished(path: Path) -> Iterator[Path]:
    """A file or folder that is nothing by itself: an interrupt removes it, should it be there."""
    _UNFINISHED.add(path)
    try:
        yield path
    finally:
        _UNFINISHED.discard(path)


def say() -> None:
    """Say it once, whoever comes first."""
    with _line:
        if not (_said.is_set() or _expected.is_set()):
            _said.set()
            print("irisjax: interrupted", file=sys.stderr, flush=True)


def begin() -> None:
    """A command begins, and nothing has been said of it."""
    if not _signalled.is_set():
        _said.clear()
        _expected.clear()


def expect() -> None:
    """From here on Ctrl-C is the command's usual end: nothing is said of it, the status is 0."""
    _expected.set()


def guarded(work: Callable[[], int]) -> NoReturn:
    """Do a command's work and leave the process with the status that it returns, or with 130."""
    begin()
    with _watched():
        try:
            status = work()
        except KeyboardInterrupt:
            say()
            status = STATUS
        if _signalled.is_set():
            _leave()
    sys.exit(status)


def done(status: int) -> None:
    """Leave at once with a command's status, all threads at their end: to take Python and XLA apart
    would take another half second. After Ctrl-C it leaves that to `guarded`.
    """
    for thread in threading.enumerate():
        if not (thread.daemon or thread is threading.main_thread()):
            thread.join()
    if not _signalled.is_set():
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError):  # nobody reads it any more
                stream.flush()
        os._exit(status)


@contextlib.contextmanager
def _watched() -> Iterator[None]:
    if os.name == "nt" or threading.current_thread() is not threading.main_thread():
        yield  # there Python alone tells of it
        return
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    before = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    threading.Thread(target=_watch, args=(reader,), daemon=True).start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        os.close(writer)  # ends the thread


def _watch(reader: int) -> None:
    while codes := os.read(reader, 64):
        if signal.SIGINT in codes:
            _signalled.set()
            _quiet()
            select.select([reader], [], [], _PATIENCE)  # or until somebody insists
            _leave()


def _quiet() -> None:
    """The line, and then no more: traces of what is torn down say nothing to anybody."""
    if sys.stderr.isatty():
        sys.stderr.write("\r\x1b[K")  # a progress bar's line
    say()
    with contextlib.suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


def _leave() -> NoReturn:
    """End now: threads of XLA that still work would end the process with a fault."""
    for path in list(_UNFINISHED):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)
    os._exit(0 if _expected.is_set() else STATUS)
