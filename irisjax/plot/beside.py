"""Figures drawn by another process while the caller's continues.

Importing matplotlib and drawing hold Python's lock, so threads would gain nothing.
"""

import contextlib
import multiprocessing
import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

import irisjax.plot

Later = Callable[[], bytes]
"""Waits for a picture's bytes."""


def here(name: str, *args: object) -> Later:
    """Return a function that draws `irisjax.plot`'s figure of that name as PNG in this process."""
    return lambda: irisjax.plot.picture(getattr(irisjax.plot, name)(*args), ".png")


@contextlib.contextmanager
def beside() -> Iterator[Callable[..., Later]]:
    """Make a function like `here` that draws in another process, which is ready after a second.

    Pictures come in the order in which they were begun. With a single core it is `here`.
    """
    if (os.cpu_count() or 1) < 2:
        yield here
        return
    spawned = multiprocessing.get_context("spawn")
    ours, theirs = spawned.Pipe()
    process = spawned.Process(target=_draw_from, args=(theirs,), daemon=True)
    try:
        process.start()
    except OSError:
        yield here
        return
    theirs.close()
    waiting = ThreadPoolExecutor(1)

    def exchange(*figure: Any) -> bytes:
        """A picture, or nothing if the other process could not draw it."""
        with contextlib.suppress(EOFError, OSError):
            ours.send(figure)
            return ours.recv()
        return b""

    def draw(name: str, *args: Any) -> Later:
        picture = waiting.submit(exchange, name, *args)
        return lambda: picture.result() or here(name, *args)()

    try:
        yield draw
    finally:
        process.kill()
        waiting.shutdown(cancel_futures=True)


def _draw_from(figures: Connection) -> None:
    """Draw the figures that arrive until there are no more; runs in the other process."""
    if hasattr(os, "setsid"):
        os.setsid()  # Ctrl-C is for the caller, whose end closes the connection
    for stream in (sys.stdout, sys.stderr):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    # corner would load ArviZ where it is installed, for two seconds, and not need it for arrays.
    sys.modules.setdefault("arviz", None)  # pyright: ignore[reportArgumentType]
    # The first figure would wait for imports, fonts and what else is made at first use.
    here("corner_figure", {"": np.arange(9.0)})()
    with contextlib.suppress(EOFError):
        while True:
            name, *args = figures.recv()
            try:
                figures.send(here(name, *args)())
            except Exception:  # the caller draws it again and says what is wrong
                figures.send(b"")
