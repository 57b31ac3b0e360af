"""Text tables in any of the encodings, separators and layouts that instruments and offices write.

Read are rows of numbers below any preamble, with the one or two lines above them as the names of
their columns. Tried by hand on what OceanView and SpectraSuite, AvaSoft, ViewSpec (ASD) and Excel
write; SpectraMagic (Konica Minolta) has a spectrum a row.
"""

import codecs
import csv
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

_MISSING = {"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "---"}
_SEPARATORS = (("\t", False), ("\t", True), (";", False), (";", True), (",", False))
_BLANKS = ((None, False), (None, True))
# Ocean Insight: what stands between these lines is the spectrum.
_BEGIN, _END = re.compile(r"^>+\s*Begin\b", re.I), re.compile(r"^>+\s*End\b", re.I)
_WAVELENGTH = re.compile(r"^(?P<of>.*?)\s*[\[(]?(?P<nm>\d{3,4}(?:\.\d+)?)\s*(?:nm)?[\])]*$", re.I)
_FEWEST = 5  # wavelengths in a line that names columns by them


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
    """Text in UTF-8, UTF-16 (with its mark) or Windows' western code page.

    Raises:
        ValueError: For a file that is no text, which it names.
    """
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


def read_columns(path: str | Path, text: str) -> Columns:
    """Read the table in a text.

    Raises:
        ValueError: For a broken table; it names the file, the line and the problem.
    """
    header = dict(
        re.findall(r"^#\s*([^:\n]+?)\s*:[ \t]*(.*?)(?:\s*\[[^\[\]\n]*\])?\s*$", text, flags=re.M)
    )
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    for i, (_, line) in enumerate(lines):
        if _BEGIN.match(line):
            lines = lines[i + 1 :]
            break
    ends = [i for i, (_, line) in enumerate(lines) if _END.match(line)]
    lines = lines[: ends[0]] if ends else lines
    wide = _rows_of_spectra(path, lines)
    if wide is not None:
        return Columns(*wide, header)
    return Columns(*_rows_of_numbers(path, lines), header)


def _rows_of_numbers(path, lines) -> tuple[np.ndarray, list[str], list[str]]:
    best: list[tuple[int, list[float]]] = []
    cells_of, comma = None, False
    for separator, decimal_comma in (*_SEPARATORS, *_BLANKS):
        split = _splitter(separator)
        rows = [(i, _numbers(split(line), decimal_comma)) for i, (_, line) in enumerate(lines)]
        found = [(i, row) for i, row in rows if row is not None and len(row) > 1]
        if len(found) > len(best):
            best, cells_of, comma = found, split, decimal_comma
    if cells_of is None:
        raise ValueError(_without_numbers(path, lines))
    first, width = best[0][0], len(best[0][1])
    values, where = [], []
    for number, line in lines[first:]:
        cells = cells_of(line)
        row = _numbers(cells, comma)
        if row is None:
            wrong = next((c for c in cells if not _is_number(c, comma, missing=True)), cells[0])
            raise ValueError(f"{path}, line {number}: {wrong!r} is not a number")
        if len(row) != width:
            raise ValueError(
                f"{path}, line {number}: {len(row)} values, {width} in the lines before"
            )
        values.append(row)
        where.append(f"line {number}")
    names = _names([cells_of(line) for _, line in lines[:first]], width)
    table = np.array(values)
    kept = [j for j in range(width) if names[j] or np.isfinite(table[:, j]).any()]
    return table[:, kept], [names[j] for j in kept], where


def _without_numbers(path, lines) -> str:
    for number, line in lines:
        if _numbers([line.strip()], True) is not None:
            return f"{path}, line {number}: one column; need wavelength and reflectance"
        first, *others = re.split(r"[\t;, ]+", line.strip())
        if others and _is_number(first, False, missing=False):
            return f"{path}, line {number}: {others[0]!r} is not a number"
    return f"{path}: no numbers in it"


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
    return [" ".join(part for part in column if part) for column in zip(*rows, strict=True)] or [
        ""
    ] * width


def _rows_of_spectra(path, lines) -> tuple[np.ndarray, list[str], list[str]] | None:
    """A spectrum a row, its columns named by wavelengths; `None` if no line names such columns."""
    for i, (_, line) in enumerate(lines[:60]):
        for separator in ("\t", ";", ","):
            split = _splitter(separator)
            groups = _by_wavelength(split(line))
            if not groups:
                continue
            if len(groups) > 1:
                kinds = ", ".join(repr(name) for name in groups)
                raise ValueError(f"{path}: spectra of several kinds ({kinds}); keep one of them")
            ((name, places),) = groups.items()
            rows, titles = [], []
            for number, later in lines[i + 1 :]:
                cells = split(later)
                found = _numbers([cells[j] for j in places.values() if j < len(cells)], True)
                if found is None or len(found) != len(places):
                    if not rows:
                        break
                    raise ValueError(f"{path}, line {number}: not a number for each wavelength")
                rows.append(found)
                titles.append(name)
            if rows:
                values = np.column_stack([list(places), np.array(rows).T])
                where = [f"column {w:g} nm" for w in places]
                return values, ["wavelength_nm", *titles], where
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


def _splitter(separator: str | None):
    def split(line: str) -> list[str]:
        cells = line.split() if separator is None else next(_csv([line], separator))
        return [cell.strip() for cell in cells]

    return split


def _csv(lines: list[str], separator: str) -> Iterator[list[str]]:
    return csv.reader(lines, delimiter=separator)


def _numbers(cells: list[str], decimal_comma: bool) -> list[float] | None:
    """Numbers of a row, NaN for what is missing beside the first; `None` if it is no such row."""
    if not cells or not _is_number(cells[0], decimal_comma, missing=False):
        return None
    if not all(_is_number(cell, decimal_comma, missing=True) for cell in cells[1:]):
        return None
    return [_number(cell, decimal_comma) for cell in cells]


def _number(cell: str, decimal_comma: bool) -> float:
    if cell.lower() in _MISSING:
        return np.nan
    return float(cell.replace(",", ".") if decimal_comma else cell)


def _is_number(cell: str, decimal_comma: bool, *, missing: bool) -> bool:
    if cell.lower() in _MISSING:
        return missing
    try:
        _number(cell, decimal_comma)
    except ValueError:
        return False
    return True
