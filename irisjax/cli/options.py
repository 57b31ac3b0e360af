"""An option: its place in the help, its text, and the parser that turns text into a value."""

import inspect
import math
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer

import irisjax as ij

_MOST_WAVELENGTHS = 1_000_000


class Setting(NamedTuple):
    """An option of the command line and a key of the header.

    `parse` turns text into a value and raises `ValueError`; a `flag` has `--name/--no-name`.
    """

    name: str
    panel: str
    help: str
    parse: Callable[[str], Any] = str
    default: str | None = None
    metavar: str = "TEXT"
    flag: bool = False
    option: str | None = None

    def typed(self) -> str:
        """The option as the user types it."""
        return (self.option or _dashed(self.name)).split()[-1]

    def parameter(self) -> inspect.Parameter:
        """The option as typer reads it.

        Its default is `None` and the true one only told in the help: it matters to `--from` whether
        an option was given.
        """
        names = (self.option or _dashed(self.name)).split()
        default = self.default
        if self.flag:
            names = [f"{names[0]}/--no-{names[0].removeprefix('--')}"]
            default = None if default is None else names[0].split("/")[default == "no"]
        info = typer.Option(
            *names,
            help=self.help if default is None else f"{self.help}; default {default}",
            rich_help_panel=self.panel,
            metavar=None if self.flag else self.metavar,
            show_default=False,
        )
        kind = (bool if self.flag else str) | None
        return inspect.Parameter(
            self.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=None,
            annotation=Annotated[kind, info],
        )


def _dashed(name: str) -> str:
    return f"--{name.replace('_', '-')}"


class Grid(NamedTuple):
    """Wavelengths (nm) and how they were written."""

    text: str
    values: np.ndarray

    def __str__(self):
        return self.text


def number(low: float = -math.inf, high: float = math.inf) -> Callable[[str], float]:
    """Parser of numbers, in [low, high] if either is given."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            raise ValueError(f"{text!r} is not a number") from None
        if not low <= value <= high and (low > -math.inf or high < math.inf):
            raise ValueError(f"{text} is outside {low:g} to {high:g}")
        return value

    return parse


def whole(low: int, high: int) -> Callable[[str], int]:
    """Parser of whole numbers in [low, high]; 1e6 is one."""

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            real = number()(text)  # 1e6 is a whole number too
            if not real.is_integer():
                raise ValueError(f"{text} is not a whole number") from None
            value = int(real)
        if not low <= value <= high:
            raise ValueError(f"{text} is outside {low} to {high}")
        return value

    return parse


def one_of(*names: str) -> Callable[[str], str]:
    """Parser of names."""

    def parse(text: str) -> str:
        if text not in names:
            raise ValueError(f"unknown {text!r}; known: {', '.join(names)}")
        return text

    return parse


def flag(text: str) -> bool:
    """Parse yes or no."""
    return one_of("yes", "no")(text) == "yes"


def cosine(text: str) -> float | str:
    """Parse a cosine of incidence, or the word for light from everywhere."""
    return text if text == ij.DIFFUSE else number(0, 1)(text)


def grid(text: str) -> Grid:
    """Parse start:stop:step or a comma-separated list of wavelengths, nm."""
    text = "".join(text.split())
    form = "give start:stop:step or a list 450,550,650, in nm"
    try:
        numbers = [float(part) for part in text.replace(":", ",").split(",")]
    except ValueError:
        raise ValueError(f"{text!r} is not a grid; {form}") from None
    if ":" not in text:
        return Grid(text, np.array(numbers))
    if "," in text or len(numbers) != 3:
        raise ValueError(f"{text!r} is not a grid; {form}")
    start, stop, step = numbers
    if step > 0 and (stop - start) / step >= _MOST_WAVELENGTHS:
        raise ValueError(f"{text!r} has more than {_MOST_WAVELENGTHS} wavelengths")
    return Grid(text, ij.wavelengths(start, stop, step))
