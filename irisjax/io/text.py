"""Text tables in any of the encodings, separators and layouts that instruments and offices write:
rows of numbers below any preamble, and the one or two lines above them as the names of columns.
"""

import codecs
import csv
import itertools
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

_MISSING = {"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "---"}
# Separators (`None`: blanks), and whether a comma is the decimal sign.
_LAYOUTS = (
    *(("\t", False), ("\t", True), (";", False), (";", True), (",", False)),
    *((None, False), (None, True)),
)
# Ocean Insight: what stands between these lines is the spectrum.
_BEGIN, _END = re.compile(r"^>+\s*Begin\b", re.I), re.compile(r"^>+\s*End\b", re.I)
_WAVELENGTH = re.compile(r"^(?P<of>.*?)\s*[\[(]?(?P<nm>\d{3,4}(?:\.\d+)?)\s*(?:nm)?[\])]*$", re.I)
_HEADER = re.compile(r"^#\s*([^:\n]+?)\s*:[ \t]*(.*?)(?:\s*\[[^\[\]\n]*\])?\s*$", re.M)
_FEWEST = 5  # wavelengths in a line that names columns by them

_Lines = list[tuple[int, str]]  # with their numbers


class Columns(NamedTuple):
    """Numbers of a text table: `values` (rows, columns), NaN where a cell is empty; `names` of the
    columns, empty where the file has none; `where` each row stands; `header`, its lines
    `# key: value`.
    """

    values: np.ndarray
    names: list[str]
    where: list[str]
    header: dict[str, str]


def read_text(path: str | Path) -> str:
    """Text in UTF-8, UTF-16 (with its mark) or Windows' western code page."""
    data = Path(path).read_bytes()
    wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    for encoding in ("utf-16",) if wide else ("utf-8-sig", "cp1252"):
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text
    raise ValueError(f"{path}: not a text file")


def read_columns(text: str) -> Columns:
    """Read the table in a text, or raise `ValueError` that names the line and the problem."""
    header = dict(_HEADER.findall(text))
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    lines = lines[next((i + 1 for i, (_, line) in enumerate(lines) if _BEGIN.match(line)), 0) :]
    lines = lines[: next((i for i, (_, line) in enumerate(lines) if _END.match(line)), None)]
    return Columns(*(_rows_of_spectra(lines) or _rows_of_numbers(lines)), header)


def _rows_of_numbers(lines: _Lines) -> tuple[np.ndarray, list[str], list[str]]:
    def widths(separator: str | None, comma: bool) -> dict[int, int]:
        rows = (_numbers(_cells(line, separator), comma) for _, line in lines)
        return {i: len(row) for i, row in enumerate(rows) if row is not None and len(row) > 1}

    separator, comma = max(_LAYOUTS, key=lambda layout: len(widths(*layout)))
    found = widths(separator, comma)
    if not found:
        raise ValueError(_without_numbers(lines))
    first, width = next(iter(found.items()))
    values, where = [], []
    for number, line in lines[first:]:
        cells = _cells(line, separator)
        row = _numbers(cells, comma)
        if row is None:
            wrong = next((c for c in cells if _number(c, comma) is None), cells[0])
            raise ValueError(f"line {number}: {wrong!r} is not a number")
        if len(row) != width:
            raise ValueError(f"line {number}: {len(row)} values, {width} in the lines before")
        values.append(row)
        where.append(f"line {number}")
    names = _names([_cells(line, separator) for _, line in lines[:first]], width)
    table = np.array(values)
    kept = [j for j in range(width) if names[j] or np.isfinite(table[:, j]).any()]
    return table[:, kept], [names[j] for j in kept], where


def _without_numbers(lines: _Lines) -> str:
    for number, line in lines:
        if _numbers([line.strip()], True) is not None:
            return f"line {number}: one column; need wavelength and reflectance"
        first, *others = re.split(r"[\t;, ]+", line.strip())
        if others and _numbers([first], False) is not None:
            return f"line {number}: {others[0]!r} is not a number"
    return "no numbers in it"


def _names(above: list[list[str]], width: int) -> list[str]:
    """Of the line above the numbers, or of two: names, and their units below."""
    rows = []
    for cells in reversed(above[-2:]):
        if len(cells) != width or not any(cells):
            break
        rows.insert(0, cells)
    # Of a preamble that is as wide as the table the nearer line is the names.
    if len(rows) == 2 and not any(c.startswith(("[", "(")) for c in rows[1]):
        rows = rows[1:]
    rows = rows or [[""] * width]
    return [" ".join(part for part in column if part) for column in zip(*rows, strict=True)]


def _rows_of_spectra(lines: _Lines) -> tuple[np.ndarray, list[str], list[str]] | None:
    """A spectrum a row, its columns named by wavelengths; `None` if no line names such columns."""
    for i, separator in itertools.product(range(min(len(lines), 60)), ("\t", ";", ",")):
        groups = _by_wavelength(_cells(lines[i][1], separator))
        if len(groups) > 1:
            kinds = ", ".join(repr(name) for name in groups)
            raise ValueError(f"spectra of several kinds ({kinds}); keep one of them")
        for name, places in groups.items():
            rows = []
            for number, later in lines[i + 1 :]:
                cells = _cells(later, separator)
                row = _numbers([cells[j] for j in places.values() if j < len(cells)], True)
                if row is None or len(row) != len(places):
                    if not rows:
                        break
                    raise ValueError(f"line {number}: not a number for each wavelength")
                rows.append(row)
            if rows:
                values = np.column_stack([list(places), np.array(rows).T])
                where = [f"column {w:g} nm" for w in places]
                return values, ["wavelength_nm", *[name] * len(rows)], where
    return None


def _by_wavelength(cells: list[str]) -> dict[str, dict[float, int]]:
    """Places of rising wavelengths, by what stands before the number."""
    groups: dict[str, dict[float, int]] = {}
    for j, cell in enumerate(cells):
        match = _WAVELENGTH.match(cell)
        if match and 200 <= float(match["nm"]) <= 2600:
            groups.setdefault(match["of"].strip(" ([_-"), {})[float(match["nm"])] = j
    return {
        name: places
        for name, places in groups.items()
        if len(places) >= _FEWEST and list(places) == sorted(places)
    }


def _cells(line: str, separator: str | None) -> list[str]:
    cells = line.split() if separator is None else next(csv.reader([line], delimiter=separator))
    return [cell.strip() for cell in cells]


def _numbers(cells: list[str], comma: bool) -> list[float] | None:
    """Numbers of a row, NaN for what is missing beside the first; `None` if it is no such row."""
    found = [_number(cell, comma) for cell in cells]
    row = [value for value in found if value is not None]
    return row if row and len(row) == len(found) and not np.isnan(row[0]) else None


def _number(cell: str, comma: bool) -> float | None:
    """NaN for a missing number, `None` for what is none."""
    if cell.lower() in _MISSING:
        return np.nan
    try:
        return float(cell.replace(",", ".") if comma else cell)
    except ValueError:
        return None
