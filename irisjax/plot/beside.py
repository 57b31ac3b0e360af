"""Figures drawn by another process while the caller's continues.

Importing matplotlib and drawing hold Python's lock, so threads would gain nothing.
"""

import contextlib
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

import irisjax.plot

Later = Callable[[], bytes]
"""Waits for a picture's bytes."""


def here(name: str, *args: Any) -> Later:
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
    try:
        process = subprocess.Popen(
            [sys.executable, "-m", __name__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is for this one, which closes the other's input
        )
    except OSError:
        yield here
        return
    waiting = ThreadPoolExecutor(1)

    def draw(name: str, *args: Any) -> Later:
        picture = waiting.submit(_exchange, process, name, args)
        return lambda: picture.result() or here(name, *args)()

    try:
        yield draw
    finally:
        process.kill()
        waiting.shutdown(cancel_futures=True)
        process.communicate()


def _exchange(process: subprocess.Popen[bytes], name: str, args: Any) -> bytes:
    """A picture, or nothing if the other process could not draw it."""
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        pickle.dump((name, args), process.stdin, protocol=5)
        process.stdin.flush()
        return pickle.load(process.stdout)
    except (EOFError, OSError, pickle.UnpicklingError):
        return b""


def _draw_from_input() -> None:
    """Draw the figures that arrive on standard input until it ends."""
    # corner would load ArviZ where it is installed, for two seconds, and not need it for arrays.
    sys.modules.setdefault("arviz", None)  # pyright: ignore[reportArgumentType]
    # The first figure would wait for imports, fonts and what else is made at first use.
    here("corner_figure", {"": np.arange(9.0)})()
    pictures = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    while True:
        try:
            name, args = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        try:
            drawn = here(name, *args)()
        except Exception:  # the caller draws it again and says what is wrong
            drawn = b""
        pickle.dump(drawn, pictures, protocol=5)
        pictures.flush()


if __name__ == "__main__":
    _draw_from_input()
