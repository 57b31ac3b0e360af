"""TOML files of sections, whose entries are checked, and JSON of results."""

import json
import math
import re
import tomllib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import tomlkit

from irisjax.numerics.checks import Range

EntryCheck = Range | range | tuple[str, ...] | type | Callable[[Any], Any]
"""The check of an entry: a `Range` of numbers, a `range` of whole numbers, a tuple of names, one of
the types `bool`, `str` and `dict`, or a function. The function returns the entry as it is used, or
raises `ValueError` with what is allowed.
"""
Keys = Mapping[str, EntryCheck] | Callable[[str], EntryCheck]
"""Checks of a section's entries: by their names, or made for any name."""
Where = Callable[..., str]
"""`where(section, key, nth)`: file and line of an entry of a section's nth table, as far as the
line can be found."""

_TYPES = {bool: "true or false", str: "text", dict: "a table, { name = value }"}


def check_sections(
    written: str, name: str, keys: Mapping[str, Keys], repeated: str
) -> tuple[dict[str, Any], Where]:
    """Parse a TOML text and check the entries of its sections.

    Args:
        written: The text.
        name: Name of the file, for messages.
        keys: Checks of the entries by section.
        repeated: Section that is written `[[section]]`, once for each of its tables.

    Returns:
        The checked sections, and a function that finds the line of an entry.

    Raises:
        ValueError: With file, line, what is wrong and what is allowed.
    """
    try:
        sections = tomllib.loads(written)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        reason = "nested too deeply" if isinstance(error, RecursionError) else str(error)
        if reason.startswith(("Cannot", "Duplicate")):
            at = re.search(r"at line (\d+)", reason)
            line = at[1] if at else written.rstrip().count("\n") + 1
            reason = f"{name}, line {line}: a key or section is written twice; keep one of them"
            raise ValueError(reason) from None
        raise ValueError(f"{name}: {reason}") from None

    def where(section: str, key: str | None = None, nth: int = 0) -> str:
        line = _line_of(written, section, key, nth)
        return f"{name}, line {line}" if line else name

    def checked_table(section: str, nth: int, table: Mapping[str, Any]) -> dict[str, Any]:
        checks, values = keys[section], {}
        for key, value in table.items():
            place = where(section, key, nth)
            if isinstance(checks, Mapping) and key not in checks:
                known = ", ".join(checks)
                raise ValueError(f"{place}: unknown {key!r} in {section}; known: {known}")
            try:
                check = checks[key] if isinstance(checks, Mapping) else checks(key)
                values[key] = checked(value, check)
            except ValueError as error:
                raise ValueError(f"{place}: {section}.{key} = {value!r} {error}") from None
        return values

    out: dict[str, Any] = {}
    for section, given in sections.items():
        if section not in keys:
            known = ", ".join(keys)
            raise ValueError(f"{where(section)}: unknown section [{section}]; known: {known}")
        tables = given if section == repeated else [given]
        if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
            form = f"[[{section}]]" if section == repeated else f"[{section}]"
            raise ValueError(f"{where(section)}: {section} must be written {form}")
        done = [checked_table(section, nth, table) for nth, table in enumerate(tables)]
        out[section] = done if section == repeated else done[0]
    return out, where


def checked(value: Any, allowed: EntryCheck) -> Any:
    """Return an entry as it is used, or raise `ValueError` with what is allowed."""
    if isinstance(allowed, Range):
        if type(value) not in (int, float) or not allowed.holds(value):
            span = "" if allowed.low == -math.inf else f" in {allowed}"
            raise ValueError(f"must be a number{span}")
        return float(value)
    if isinstance(allowed, range):
        if type(value) is not int or value not in allowed:
            raise ValueError(f"must be a whole number in [{allowed[0]}, {allowed[-1]}]")
    elif isinstance(allowed, tuple):
        if value not in allowed:
            raise ValueError(f"must be one of {', '.join(allowed)}")
    elif isinstance(allowed, type):
        if not isinstance(value, allowed):
            raise ValueError(f"must be {_TYPES[allowed]}")
    else:
        return allowed(value)
    return value


def listed(form: str, allowed: EntryCheck) -> Callable[[Any], tuple[Any, ...]]:
    """A check of lists that are written as `form`, such as `[x, y, z]`, of as many entries."""

    def check(value: Any) -> tuple[Any, ...]:
        if not (isinstance(value, list) and len(value) == form.count(",") + 1):
            raise ValueError(f"must be {form}")
        try:
            return tuple(checked(entry, allowed) for entry in value)
        except ValueError as error:
            raise ValueError(f"{error}, for each of the {len(value)} numbers of {form}") from None

    return check


def toml_of(sections: Mapping[str, Any]) -> str:
    """TOML of sections: tables, and lists of tables."""
    document = tomlkit.document()
    document.update(sections)
    return tomlkit.dumps(document)


def plain(value: Any, digits: int | None = None) -> Any:
    """A value in Python's own types; `None` for what is not finite. Numbers have so many digits, by
    default as many as their precision needs.
    """
    if isinstance(value, Mapping):
        return {str(k): plain(v, digits) for k, v in value.items()}
    if hasattr(value, "tolist"):
        array = np.asarray(value)
        if not array.ndim and array.dtype.kind == "f":
            value = float(str(array))  # the fewest digits that are this number in its precision
        else:
            value = list(array) if array.ndim else array.item()
    if isinstance(value, list | tuple):
        return [plain(v, digits) for v in value]
    if isinstance(value, float):
        if not math.isfinite(value):
            return None
        return value if digits is None else float(f"{value:.{digits}g}")
    return value


def json_of(value: Any, digits: int) -> bytes:
    """The bytes of a JSON file with numbers of so many digits."""
    return f"{json.dumps(plain(value, digits), indent=1, allow_nan=False)}\n".encode()


def _line_of(text: str, section: str, key: str | None, nth: int) -> int | None:
    """Return the line of a key in the nth table of a section; 1 is the first line."""
    current, count, header = "", -1, None
    entry = None if key is None else re.compile(rf"\s*[\"']?{re.escape(key)}[\"']?\s*=")
    for number, line in enumerate(text.splitlines(), 1):
        if match := re.match(r"\s*\[\[?\s*([\w-]+)\s*\]?\]", line):
            current = match[1]
            if current == section:
                count += 1
                header = number if count == nth else header
        elif entry is not None and current == section and count == nth and entry.match(line):
            return number
    return header
