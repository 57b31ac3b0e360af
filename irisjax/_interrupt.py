"""Ctrl-C of a command: one line, nothing half written, and gone within two seconds.

Python raises no KeyboardInterrupt while XLA compiles, and JAX's callbacks may swallow it. A thread
therefore waits for the signal itself: the command gets a moment to end as for any exception; if it
does not, unfinished files are removed and the process ends. Nothing here imports JAX, which takes
the first second of a command.
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
_signalled = threading.Event()
_expected = threading.Event()
_said = threading.Event()
_printing = threading.Lock()


@contextlib.contextmanager
def unfinished(path: Path) -> Iterator[Path]:
    """Have an interrupt remove a file or folder that is useless by itself, should it be there."""
    _UNFINISHED.add(path)
    try:
        yield path
    finally:
        _UNFINISHED.discard(path)


def say() -> None:
    """Print the line, once for all threads; it is printed whole when any of them returns."""
    with _printing:
        if not (_expected.is_set() or _said.is_set()):
            _said.set()
            sys.stderr.write("irisjax: interrupted\n")
            sys.stderr.flush()


def begin() -> None:
    """Start a command, of which nothing is printed yet."""
    if not _signalled.is_set():
        _expected.clear()
        _said.clear()


def expect() -> None:
    """Take Ctrl-C as the command's usual end from here on: no line, and the status 0."""
    _expected.set()


def guarded(work: Callable[[], int]) -> NoReturn:
    """Do a command's work and leave the process with the status that it returns, or with 130."""
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
    """Leave with a command's status once all threads have ended, half a second faster than Python.

    After Ctrl-C it leaves that to `guarded`.
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
            if sys.stderr.isatty():
                sys.stderr.write("\r\x1b[K")  # a progress bar's line
            say()
            # Then no more: what is torn down would print its traces.
            with contextlib.suppress(OSError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            select.select([reader], [], [], _PATIENCE)  # or until the next Ctrl-C
            _leave()


def _leave() -> NoReturn:
    """End now: threads of XLA that still work would end the process with a fault."""
    for path in list(_UNFINISHED):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)
    os._exit(0 if _expected.is_set() else STATUS)
