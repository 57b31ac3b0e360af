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

_FORTRAN = re.compile(r"([+-]?\d*\.\d*)[dD]([+-]?\d{1,3})")  # of double precision
_MISSING = {"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "---"}
_DELETED = 1e30  # spectral libraries write a larger number where a value is missing
# Separators (`None`: blanks), and whether a comma is the decimal sign.
_LAYOUTS = (
    *(("\t", False), ("\t", True), (";", False), (";", True), (",", False), (",", True)),
    *((None, False), (None, True)),
)
# Ocean Insight: what stands between these lines is the spectrum.
_BEGIN, _END = re.compile(r"^>+\s*Begin\b", re.I), re.compile(r"^>+\s*End\b", re.I)
_WAVELENGTH = re.compile(
    r"^(?P<of>.*?)\s*[\[(]?(?P<nm>\d{3,4}(?:\.\d+)?)\s*[\[(]?(?:nm)?[\])]*"
    r"(?:[\s_(\[]+(?P<kind>SC[IE])[\])]*)?$",
    re.I,
)
_BLANKS = r"[^\S\n]*"
HEADER = re.compile(
    rf"^#{_BLANKS}([^:\n]+?){_BLANKS}:{_BLANKS}(.*?)(?:{_BLANKS}\[[^\[\]\n]*\])?{_BLANKS}$", re.M
)
"""Lines `# key: value [remark]`."""
_FEWEST = 5  # wavelengths in a line that names columns by them
LABEL = re.compile(
    r"name|sample|title|label|\bid\b|eye|subject|patient|probe|auge|muestra|échantillon", re.I
)
"""Matches titles of columns that name samples."""
_UNIT_OF_CELL = re.compile(r"(?<=[\d.,])\s*(%|nm)$")  # some programs write it beside each number
# Preambles that state the units of two unnamed columns, as JASCO and spectral libraries do.
_UNITS = re.compile(
    r"^\W*([XY])[- _]*(?:axis[- _]*)?(?:units?|(?<=axis))\s*[:=\t;, ]\s*([^\d\s].*?)[\s,;]*$",
    re.I | re.M,
)
# PerkinElmer: a line of the preamble that is nothing but the unit of the second column.
_LONE_UNIT = re.compile(r"^(%\s*[RT]|A|ABS|Abs)$")

_Lines = list[tuple[int, str]]  # with their numbers
CellUnits = list[str | None]
"""Units that stand beside the numbers of each column; `None` of a column without a number."""
_Rows = tuple[np.ndarray, list[str], list[str], tuple[str, ...]]  # as in `Columns`


class Columns(NamedTuple):
    """Numbers of a text table.

    Attributes:
        values: Shape (rows, columns), NaN where a cell is empty.
        names: Of the columns, empty where the file has none.
        where: Where each row stands, for messages.
        header: Lines `# key: value`.
        notes: What was left out.
        samples: Where columns of different names are of different samples, as the file says, the
            end that it gives their names.
    """

    values: np.ndarray
    names: list[str]
    where: list[str]
    header: dict[str, str]
    notes: tuple[str, ...] = ()
    samples: str | None = None


def decoded(data: bytes) -> str | None:
    """Text in UTF-8, UTF-16, Windows' western code page or Shift-JIS; `None` if it is no text.

    NULs that pad the lines of some instruments are left out.
    """
    wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    bare = len(data) > 1 and not any(data[1:64:2])  # Latin letters without the mark
    encodings = (
        ("utf-16",) if wide else ("utf-16-le",) if bare else ("utf-8-sig", "cp1252", "cp932")
    )
    for encoding in encodings:
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError:
            continue
        text = re.sub(r"\0+(?=[\r\n]|$)", "", text)
        if not re.search(r"[\0-\x08\x0e-\x19\x1b-\x1f]", text):
            return text
    return None


def read_text(path: str | Path) -> str:
    """Return a file's text; see `decoded` for its encodings."""
    text = decoded(Path(path).read_bytes())
    if text is None:
        raise ValueError(f"{path}: not a text file")
    return text


def read_columns(text: str) -> Columns:
    """Read the table in a text, or raise `ValueError` that names the line and the problem.

    Lines below the table that hold no row of numbers are left out and counted in `notes`.
    """
    header = dict(HEADER.findall(text))
    every = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    every = every[next((i + 1 for i, (_, line) in enumerate(every) if _BEGIN.match(line)), 0) :]
    every = every[: next((i for i, (_, line) in enumerate(every) if _END.match(line)), None)]
    lines = [(number, line) for number, line in every if not line.lstrip().startswith("#")]
    values, names, where, notes = _rows_of_spectra(lines) or _rows_of_numbers(lines)
    if not any(names) or "Column 1:" in text:
        names = _stated_names(text, every, where, len(names)) or names
    return Columns(values, names, where, header, notes)


def _rows_of_numbers(lines: _Lines) -> _Rows:
    def widths(separator: str | None, comma: bool) -> dict[int, int]:
        rows = (_numbers(cells_of(line, separator), comma) for _, line in lines)
        return {i: len(row) for i, row in enumerate(rows) if row is not None and len(row) > 1}

    separator, comma = max(_LAYOUTS, key=lambda layout: len(widths(*layout)))
    sizes = widths(separator, comma)
    if not sizes:
        raise ValueError(_without_numbers(lines))
    # The table is the rows of the commonest width; numbers of a preamble have another.
    width = max(sizes.values(), key=list(sizes.values()).count)
    first, last = next(i for i, n in sizes.items() if n == width), max(sizes)
    for number, line in lines[max(first - 1, 0) : first]:  # a faulty row, no names
        cells = cells_of(line, separator)
        if len(cells) == width and np.isfinite(number_of(cells[0], comma) or np.nan):
            wrong = next(c for c in cells if number_of(c, comma) is None)
            raise ValueError(f"line {number}: {wrong!r} is not a number")
    values, where, below = [], [], lines[last + 1 :]
    units: CellUnits = [None] * width
    for number, line in lines[first:]:
        cells = cells_of(line, separator)
        if number > lines[last][0] and number_of(cells[0], comma) is None:
            continue  # below the table, a row that begins with a number is a faulty one
        row = _numbers(cells, comma)
        if len(cells) != width and (row is not None or number > lines[last][0]):
            raise ValueError(f"line {number}: {len(cells)} values, {width} in the lines before")
        if row is None:
            wrong = next((c for c in cells if number_of(c, comma) is None), cells[0])
            raise ValueError(f"line {number}: {wrong!r} is not a number")
        units = units_of(cells, units, f"line {number}")
        values.append(row)
        where.append(f"line {number}")
    table, above = np.array(values), [cells_of(line, separator) for _, line in lines[:first]]
    if above and len(above[-1]) == width - 1 and counts(table[:, 0]):
        above[-1].insert(0, "")  # R's names of rows have no title
    names = with_units(_names(above, width), units)
    columns = [j for j in range(width) if names[j] or np.isfinite(table[:, j]).any()]
    return table[:, columns], [names[j] for j in columns], where, _note_of(below)


def _note_of(below: _Lines) -> tuple[str, ...]:
    if not below:
        return ()
    amount = "one line" if len(below) == 1 else f"{len(below)} lines"
    return (f"{amount} below the table left out, from line {below[0][0]}",)


def _without_numbers(lines: _Lines) -> str:
    for number, line in lines:
        if _numbers([line.strip()], True) is not None:
            return f"line {number}: one column; need wavelength and reflectance"
        first, *others = re.split(r"[\t;, ]+", line.strip())
        if others and _numbers([first], False) is not None:
            return f"line {number}: {others[0]!r} is not a number"
    return (
        "no rows of numbers in it: the first cell of each is a number, and tabs, semicolons, "
        "commas or blanks separate them"
    )


def _names(above: list[list[str]], width: int) -> list[str]:
    """Of the line above the numbers, or of two: names, and their units or quantities below."""
    rows: list[list[str]] = []
    for cells in reversed(above[-2:]):
        if not any(cells[width:]):  # separators at the end of a line say nothing
            cells = cells[:width]
        if rows and _pairs(rows[0]):
            # A name over each pair of wavelengths and values stands over the wavelengths.
            cells = cells + [""] * (width - len(cells))
            cells = [cells[j] or cells[j - 1] if j % 2 else "" for j in range(len(cells))]
        if len(cells) != width or not any(cells):
            break
        rows.insert(0, cells)
    if (
        len(rows) == 2
        and not _pairs(rows[1])
        and not any(c.startswith(("[", "(")) for c in rows[1])
    ):
        rows = rows[1:]  # of a preamble that is as wide as the table the nearer line is the names
    rows = rows or [[""] * width]
    nearest = rows[-1][1:]
    if len(rows) == 1 and any(nearest) and len(set(nearest)) < width - 1 and not _pairs(rows[0]):
        # Columns of one name are told apart by a line further up.
        further = (cells for cells in reversed(above[:-1]) if len(cells) == width)
        named = next((cells for cells in further if len(set(cells)) == width), None)
        rows = [["", *named[1:]], *rows] if named else rows
    return [" ".join(part for part in column if part) for column in zip(*rows, strict=True)]


def _pairs(names: list[str]) -> bool:
    """Whether every second column has the same name, as wavelengths beside each sample have."""
    while names and not names[-1]:
        names = names[:-1]
    return len(names) > 3 and len(names) % 2 == 0 and len(set(names[::2])) == 1


def _stated_names(text: str, rows: _Lines, where: list[str], width: int) -> list[str] | None:
    """Names of unnamed columns: those of a comment right above the numbers, or units stated in the
    preamble.
    """
    start = next((i for i, (number, _) in enumerate(rows) if where[0] == f"line {number}"), 0)
    above = rows[start - 1][1].strip() if start else ""
    if above.startswith("#"):
        for separator in ("\t", ";", ",", None):
            names = cells_of(above.lstrip("# "), separator)
            if len(names) == width:
                return names
    # ENVI: "Column 2: name~~1##255,0,0"; USGS: "wavelength   reflectance   standard deviation".
    numbered = re.findall(r"^Column \d+: *(.*?) *(?:~~.*)?$", text, re.M)
    listed = [re.split(r"\t|\s{2,}", line.strip()) for _, line in rows[:start]]
    for names in (numbered, *reversed(listed)):
        if len(names) == width and re.match("wavel", names[0], re.I):
            return names
    units = {axis.upper(): unit for axis, unit in _UNITS.findall(text)}
    lone = [line.strip() for _, line in rows[:start] if _LONE_UNIT.match(line.strip())]
    if width == 2 and ("Y" in units or lone):
        return [f"wavelength ({units['X']})" if "X" in units else "", units.get("Y", *lone[-1:])]
    return None


def _rows_of_spectra(lines: _Lines) -> _Rows | None:
    """A spectrum a row, its columns named by wavelengths; `None` if no line names such columns.

    The spectra are named by the cell of their row that holds a name, and by what stands before the
    wavelengths where the line names several kinds (specular in- and excluded, for one).
    """
    for i, separator in itertools.product(range(min(len(lines), 60)), ("\t", ";", ",")):
        titles = cells_of(lines[i][1], separator)
        groups = _by_wavelength(titles)
        if not groups:
            continue
        rows = [(number, cells_of(line, separator)) for number, line in lines[i + 1 :]]
        end = next((k for k, row in enumerate(rows) if not _has_spectra(row[1], groups)), None)
        rows, below = rows[:end], [] if end is None else lines[i + 1 + end :]
        if not rows:
            continue
        for number, line in below:
            if len(cells_of(line, separator)) >= len(titles):
                raise ValueError(f"line {number}: not a number for each wavelength")
        return (*_spectra_of(titles, groups, rows), _note_of(below))
    return None


def _spectra_of(
    titles: list[str], groups: dict[str, dict[float, int]], rows: list[tuple[int, list[str]]]
) -> tuple[np.ndarray, list[str], list[str]]:
    """Columns and their names of the spectra in these rows."""
    keys = sorted(set().union(*groups.values()))
    first = min(min(places.values()) for places in groups.values())
    columns, names = [np.array(keys)], ["wavelength (nm)"]
    labels = [_label(titles[:first], cells[:first]) for _, cells in rows]
    for j in range(first):  # rows of one name may differ in a word, such as SCI and SCE
        words = [cells[j] if not re.search(r"\d", cells[j]) else "" for _, cells in rows]
        twins = [{w for w, other in zip(words, labels, strict=True) if other == n} for n in labels]
        labels = [
            f"{name} {word}" if len(own) > 1 else name
            for name, word, own in zip(labels, words, twins, strict=True)
        ]
    for name, places in groups.items():
        for label, (_, cells) in zip(labels, rows, strict=True):
            numbers = _numbers([cells[j] for j in places.values()], True) or []
            values = dict(zip(places, numbers, strict=True))
            columns.append(np.array([values.get(x, np.nan) for x in keys]))
            kind = name if len(groups) > 1 or not label else ""
            units: CellUnits = [None]
            for j in places.values():
                units = units_of([cells[j]], units, f"column {titles[j]}")
            title = " ".join(part for part in (label, kind) if part)
            names += with_units([title], units)
    return np.stack(columns, 1), names, [f"column {x:g} nm" for x in keys]


def _has_spectra(cells: list[str], groups: dict[str, dict[float, int]]) -> bool:
    """Whether a row has a number for each wavelength."""
    places = [j for group in groups.values() for j in group.values()]
    if max(places) >= len(cells):
        return False
    return _numbers([cells[j] for j in places], True) is not None


def _label(titles: list[str], cells: list[str]) -> str:
    """The name that a row's first cells give its spectrum, empty if there is none."""
    text = [(t, c) for t, c in zip(titles, cells, strict=False) if c and number_of(c, True) is None]
    named = [c for t, c in text if LABEL.search(t)]
    return named[-1] if named else text[0][1] if text else ""


def _by_wavelength(cells: list[str]) -> dict[str, dict[float, int]]:
    """Places of rising wavelengths, by what stands before the number."""
    groups: dict[str, dict[float, int]] = {}
    for j, cell in enumerate(cells):
        match = _WAVELENGTH.match(cell)
        if match and 200 <= float(match["nm"]) <= 2600:
            name = match["of"].strip(" ([_-") or match["kind"] or ""
            groups.setdefault(name, {})[float(match["nm"])] = j
    return {
        name: places
        for name, places in groups.items()
        if len(places) >= _FEWEST and list(places) == sorted(places)
    }


def cells_of(line: str, separator: str | None) -> list[str]:
    """Split a line at its separators (`None`: blanks), except in quotes."""
    if separator is None:
        if '"' not in line[1:-1]:  # nor round the whole line, as StellarNet writes names
            return line.strip('"').split()
        return [quoted or bare for quoted, bare in re.findall(r'"([^"]*)"|(\S+)', line)]
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]


def counts(column: np.ndarray) -> bool:
    """Whether numbers are those of rows, from 0 or 1."""
    start = column[0] if len(column) > 2 else np.nan
    return bool(start in (0, 1) and (column == np.arange(start, start + len(column))).all())


def units_of(cells: list[str], before: CellUnits, where: str) -> CellUnits:
    """The unit beside the number of each cell, which must be that of the rows before."""
    units: CellUnits = []
    for cell, other in zip(cells, before, strict=True):
        unit = _UNIT_OF_CELL.search(cell)
        own = None if cell.lower() in _MISSING else unit[1] if unit else ""
        if None not in (own, other) and own != other:
            stated = f"{own or 'no unit'} where the cells before have {other or 'none'}"
            raise ValueError(f"{where}: {cell!r} has {stated}")
        units.append(other if own is None else own)
    return units


def with_units(names: list[str], units: CellUnits) -> list[str]:
    """Names with the units that stand in the cells; a cell without one beside per cent has 1."""
    marks = {"%": " (%)", "nm": " (nm)", "": " [1]" if "%" in units else "", None: ""}
    return [
        name if "%" in name else f"{name}{marks[unit]}".lstrip()
        for name, unit in zip(names, units, strict=True)
    ]


def _numbers(cells: list[str], comma: bool) -> list[float] | None:
    """Numbers of a row, NaN for what is missing beside the first; `None` if it is no such row."""
    numbers = [number_of(cell, comma) for cell in cells]
    row = [value for value in numbers if value is not None]
    return row if row and len(row) == len(numbers) and not np.isnan(row[0]) else None


def number_of(cell: str, comma: bool) -> float | None:
    """NaN for a missing number, `None` for what is none; a unit beside the number is left out."""
    if cell.lower() in _MISSING:
        return np.nan
    if cell[-1] in "%m":
        cell = _UNIT_OF_CELL.sub("", cell)
    if double := _FORTRAN.fullmatch(cell):
        cell = "e".join(double.groups())
    try:
        value = float(cell.replace(",", ".") if comma else cell)
    except ValueError:
        return None
    return np.nan if _DELETED < abs(value) < np.inf else value
