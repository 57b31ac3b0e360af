"""Checks of values and names, once: what is wrong, where, and what is allowed."""

import difflib
from collections.abc import Collection, Iterable
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.core import Tracer


class Range(NamedTuple):
    """Allowed values of a number, its unit and its meaning."""

    low: float
    high: float
    unit: str = ""
    meaning: str = ""
    above: bool = False  # `low` itself is not allowed

    def __str__(self) -> str:
        low = f"{'(' if self.above else '['}{_format_number(self.low)}"
        high = "inf)" if np.isinf(self.high) else f"{_format_number(self.high)}]"
        return f"{low}, {high}{' ' + self.unit if self.unit else ''}"

    def holds(self, value: Any) -> Any:
        """Whether each number is finite and in the range."""
        enough = value > self.low if self.above else value >= self.low
        return np.isfinite(value) & enough & (value <= self.high)


def is_known(*values: object) -> bool:
    """Whether no array in these trees is traced: their numbers can be looked at."""
    return not any(isinstance(x, Tracer) for x in jax.tree.leaves(values))


def check_range(name: str, value: object, allowed: Range) -> None:
    """Raise `ValueError` naming the first concrete value that is not finite or not in range.

    Traced values pass: nothing can be known of them. `None` is an absent part and passes too.
    """
    if value is None or isinstance(value, Tracer):
        return
    v = np.asarray(value)
    in_range = allowed.holds(v)
    if not in_range.all():
        unit = f" {allowed.unit}" if allowed.unit else ""
        number = _format_number(v[~in_range].flat[0])
        raise ValueError(f"{name} = {number}{unit} is outside {allowed}")


def check_number(name: str, value: Any, allowed: Range) -> None:
    """`check_range` of one number; raise `ValueError` for an array of several."""
    _check_one(name, value)
    check_range(name, value, allowed)


def _check_one(name: str, value: Any) -> None:
    if shape := np.shape(value):
        message = "it must be one number: use jax.vmap for several"
        raise ValueError(f"{name} has shape {shape}; {message}")


def check_whole(name: str, value: object, low: int, high: float = np.inf) -> None:
    """Raise `ValueError` unless a setting is a whole number in [low, high]."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise ValueError(f"{name} = {value!r} is not a whole number")
    check_range(name, value, Range(low, high))


def check_shape(name: str, value: Any, shape: tuple[int | str, ...]) -> None:
    """Raise `ValueError` unless an array has this shape, whose words stand for any number. `None`
    is an absent part and passes.
    """
    if value is None:
        return
    got = np.shape(value)
    fits = [isinstance(n, str) or n == m for n, m in zip(shape, got, strict=False)]
    if len(got) != len(shape) or not all(fits):
        need = str(shape).replace("'", "")
        raise ValueError(f"{name} has shape {got}; it must be {need}")


def check_known(category: str, name: str, known: Collection[str]) -> None:
    """Raise `ValueError` with the known names, and the nearest of them, unless `name` is one."""
    if name not in known:
        matches = difflib.get_close_matches(name, known, 1)
        hint = f"; did you mean {matches[0]!r}?" if matches else ";"
        raise ValueError(f"unknown {category} {name!r}{hint} known: {', '.join(known) or 'none'}")


def check_fields(module: object, ranges: dict[str, Range]) -> None:
    """`check_range` of every field of a module that has a range."""
    for name, allowed in ranges.items():
        if hasattr(module, name):
            check_range(name, getattr(module, name), allowed)


def check_scalars(module: object, names: Iterable[str]) -> None:
    """Raise `ValueError` naming the first of these fields that is an array, not one number."""
    for name in names:
        _check_one(f"{type(module).__name__}.{name}", getattr(module, name))


def _format_number(number) -> str:
    """Whole numbers in full: limits are exact."""
    return str(number) if isinstance(number, int | np.integer) else f"{number:g}"
