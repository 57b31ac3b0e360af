"""TOML files of sections: every entry checked, and what is wrong told with its line."""

import math
import re
import tomllib
from collections.abc import Callable, Mapping
from typing import Any

from irisjax.numerics.checks import Range

EntryCheck = Callable[[Any], Any]
"""Gives an entry's value as it is used; raises `ValueError` that tells what it must be."""
Keys = Mapping[str, EntryCheck] | Callable[[str], EntryCheck]
"""Checks of a section's entries: by their names, or made for any name."""
Where = Callable[..., str]
"""`where(section, key, nth)`: file and line of an entry of a section's nth table, as far as the
line can be found."""


def check_sections(
    written: str, name: str, keys: Mapping[str, Keys], repeated: str
) -> tuple[dict[str, Any], Where]:
    """Sections of a TOML text with their entries as their checks give them, and where they are
    written.

    Args:
        written: The text.
        name: Of the file, for what is said of it.
        keys: Checks of each section's entries.
        repeated: The section that is written `[[section]]`, once for each of its tables.

    Raises:
        ValueError: naming file, line, what is wrong and what is allowed.
    """
    try:
        sections = tomllib.loads(written)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{name}: {error}") from None
    except RecursionError:
        raise ValueError(f"{name}: nested too deeply") from None

    def where(section: str, key: str | None = None, nth: int = 0) -> str:
        line = _line_of(written, section, key, nth)
        return f"{name}, line {line}" if line else name

    out: dict[str, Any] = {}
    for section, given in sections.items():
        if section not in keys:
            known = ", ".join(keys)
            raise ValueError(f"{where(section)}: unknown section [{section}]; known: {known}")
        tables = given if section == repeated else [given]
        if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
            form = f"[[{section}]]" if section == repeated else f"[{section}]"
            raise ValueError(f"{where(section)}: {section} must be written {form}")
        done = [
            _table(table, keys[section], where, section, nth) for nth, table in enumerate(tables)
        ]
        out[section] = done if section == repeated else done[0]
    return out, where


def _table(
    table: Mapping[str, Any], keys: Keys, where: Where, section: str, nth: int
) -> dict[str, Any]:
    done = {}
    for key, value in table.items():
        at = where(section, key, nth)
        if isinstance(keys, Mapping):
            if key not in keys:
                known = ", ".join(keys)
                raise ValueError(f"{at}: unknown {key!r} in {section}; known: {known}")
            check = keys[key]
        else:
            check = keys(key)
        try:
            done[key] = check(value)
        except ValueError as error:
            raise ValueError(f"{at}: {section}.{key} = {value!r} {error}") from None
    return done


def number_within(allowed: Range) -> Callable[[Any], float]:
    """A check that gives numbers within a range, and else raises `ValueError`."""

    def check(value):
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not allowed.holds(value)
        ):
            span = "" if allowed.low == -math.inf else f" in {allowed}"
            raise ValueError(f"must be a number{span}")
        return float(value)

    return check


def whole_number(low: int, high: int) -> Callable[[Any], int]:
    """The same for whole numbers."""
    allowed = Range(low, high)

    def check(value):
        if isinstance(value, bool) or not isinstance(value, int) or not allowed.holds(value):
            raise ValueError(f"must be a whole number in {allowed}")
        return value

    return check


def one_name(*names: str) -> Callable[[Any], str]:
    """The same for one of some names."""

    def check(value):
        if value not in names:
            raise ValueError(f"must be one of {', '.join(names)}")
        return value

    return check


def boolean(value: Any) -> bool:
    """True or false as they are; `ValueError` for anything else."""
    if not isinstance(value, bool):
        raise ValueError("must be true or false")
    return value


def text(value: Any) -> str:
    """Text as it is; `ValueError` for anything else."""
    if not isinstance(value, str):
        raise ValueError("must be text")
    return value


def _line_of(text: str, section: str, key: str | None, nth: int) -> int | None:
    """Where a key of the nth table of a section is written (1 is the first line)."""
    current, count, header = "", -1, None
    entry = None if key is None else re.compile(rf"\s*[\"']?{re.escape(key)}[\"']?\s*=")
    for number, line in enumerate(text.splitlines(), 1):
        if found := re.match(r"\s*\[\[?\s*([\w-]+)\s*\]?\]", line):
            current = found[1]
            if current == section:
                count += 1
                header = number if count == nth else header
        elif entry is not None and current == section and count == nth and entry.match(line):
            return number
    return header
