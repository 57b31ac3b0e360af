"""Formats of spectrometers' files, each read into a table whose first column is the wavelength and
whose other columns are named by what they hold.
"""

import contextlib
import io
import re
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from irisjax.io.columns import SD, role_of
from irisjax.io.text import (
    HEADER,
    LABEL,
    CellUnits,
    Columns,
    cells_of,
    counts,
    decoded,
    number_of,
    read_columns,
    units_of,
    with_units,
)  # fmt: skip

WAVELENGTH = re.compile(
    r"wave|wvl|wellenl|longueurs? d.onde|longitud|lunghezza d.onda|波長|^\W*(λ|lambda|nm\W*\d*$)",
    re.I,
)
"""What headers call wavelengths and wavenumbers."""

UNITS = {
    "1/cm": re.compile(r"1/cm\b|\bcm\s*\^?\s*[-−–]\s*1|cm⁻¹|wave\s?number", re.I),
    "um": re.compile(r"µm|μm|\bum\b|micro|mikro|_um\b", re.I),
    "nm": re.compile(r"nm\b|nano", re.I),
}
"""Units of wavelengths and wavenumbers that headers name, the first that matches."""

# Binary formats: what a file begins with, or the end of its name, and how to come to a text. Of two
# with one beginning the name decides, or else the last.
_BINARY = (
    (rb"ASD|as[5-9]", ".asd", "ASD's binary format", "ViewSpec Pro: Process > ASCII Export"),
    (rb".[\x4b\x4c\x4d\xcf]", ".spc", "the binary format SPC", "export as ASCII or JCAMP-DX"),
    (rb"PEPE", "", "PerkinElmer's binary format", "save as ASCII (.asc) or JCAMP-DX"),
    (rb"\xd0\xcf\x11\xe0", ".jws", "JASCO's binary format", "Spectra Manager: export as text"),
    (rb"\xd0\xcf\x11\xe0", "", "Excel's old format", "save it as .xlsx or .csv"),
    (rb"PK", ".procspec", "Ocean Insight's ProcSpec", "SpectraSuite: save as tab-delimited text"),
    (rb"PK.{28}mimetypeapplication/vnd.oasis", "", "OpenDocument", "save it as .xlsx or .csv"),
    (rb"PK.{28}\w+\.npy|\x93NUMPY", "", "NumPy's binary format", "numpy.savetxt writes a text"),
    (rb"\x89HDF", "", "HDF5", "write the spectrum as CSV"),
    (rb"MATLAB \d", "", "MATLAB's binary format", "writematrix writes a CSV"),
    (rb"\x0a\x0a\xfe\xfe", "", "Bruker's binary format", "OPUS: save as data point table or JCAMP"),
    (rb"", ".dsw", "Cary's binary format", "Cary WinUV: save as ASCII (.csv)"),
    (rb"", ".roh", "AvaSoft's binary format", "AvaSoft: File > Convert > to ASCII"),
)
_JCAMP_LABELS = {"DATATYPE": "DATA TYPE", "JCAMPDX": "JCAMP-DX", "PEAKTABLE": "PEAK TABLE"}
BOXCAR = "boxcar"
"""Key under which a header has the number of pixels on each side of a moving average."""
ELSE = "quantity of the preamble"
"""Key under which a header has the word for another quantity that the file's preamble has."""
_NO_REFLECTANCE = re.compile(r"absorbance|extin[ck]tion|kubelka|transmi(ss|tt)\w*|\.abs$", re.I)
_BOXCAR = re.compile(r"^\W*boxcar(?: width| smoothing)?\W*[:=\t ]\s*(\d+)\s*$", re.I | re.M)
_REPEATED = re.compile(r"([@%A-Ra-r+-]\d*)([S-Zs])(\d*)")
_JAZ = {"W": "nm", "D": "dark", "R": "reference", "S": "sample counts", "P": "Processed"}
_SVC = ("wavelength (nm)", "radiance of the reference", "radiance", "reflectance (%)")
# Titles of columns that number the measurements of one sample.
_REPEAT = re.compile(r"scan|\brep(eat\w*|licate|etition)?\b|measurement|\brun\b|wiederholung", re.I)
# Inverse adding-doubling: the columns that a number of them stands for, and those that are read.
_IAD_ORDER, _IAD_PARAMETERS = "rtuwWRT", 17
_IAD = {"L": "wavelength (nm)", "r": "M_R", "t": "M_T", "u": "M_U (unscattered transmittance)"}


def read_spectral_table(path: str | Path) -> Columns:
    """Read the table of an instrument's file: text, Excel, JCAMP-DX, CGATS, SVC or IAD.

    Where the columns or blocks of a file have wavelengths of their own, the table has all of them
    and NaN where a column has no value.

    Raises:
        ValueError: Naming the line and the problem, or a binary format and its way out.
    """
    path = Path(path)
    data = path.read_bytes()
    for first, suffix, kind, way in _BINARY:
        if path.suffix.lower().endswith(suffix) and re.match(first, data, re.S):
            message = f"{kind} is not read; export a text from the program that wrote it"
            raise ValueError(f"{message} ({way})")
    if data.startswith(b"PK"):
        return _with_wavelengths_first(_excel(data))
    text = decoded(data)
    if text is None:
        raise ValueError("not a text file; export the spectrum as text, CSV, JCAMP-DX or .xlsx")
    if re.match(r"\s*<(\?xml|\w*:?CxF)\b", text):
        raise ValueError("XML, such as CxF, is not read; export the spectrum as CGATS or CSV")
    if re.match(r"\s*##\s*TITLE", text, re.I):
        return _jcamp(text)
    if re.match(r"/\*+ Spectra Vista", text):
        return _with_wavelengths_first(_svc(text))
    if text.startswith("IAD1"):
        return _iad(text)
    if re.search(r"^BEGIN_DATA_FORMAT", text, re.M):
        text = _cgats(text)
    table = _table(text)
    location = re.match(r"line (\d+)", table.where[0])
    above = text.splitlines()[: int(location[1]) - 1] if location else []
    if not re.search("refle", " ".join(above), re.I):
        for match in filter(None, map(_NO_REFLECTANCE.search, (*above, path.name))):
            table.header[ELSE] = match[0]
    if smoothed := _BOXCAR.search(text):
        table.header[BOXCAR] = smoothed[1]
    return _with_wavelengths_first(table)


def _table(text: str) -> Columns:
    """The table of a text: a spectrum a column or a row, or a line for each of its values."""
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    for separator in ("\t", ";", ",", None):
        titles = cells_of(lines[0][1], separator) if lines else []
        if len(titles) < 2 or sum(bool(WAVELENGTH.search(t)) for t in titles) != 1:
            continue
        rows = [(number, cells_of(line, separator)) for number, line in lines[1:]]
        if table := _long(titles, rows):
            return table._replace(header=dict(HEADER.findall(text)))
    return read_columns(text)


def _long(titles: list[str], rows: list[tuple[int, list[str]]]) -> Columns | None:
    """A table with a line for each wavelength of each sample; `None` for one of another kind.

    Columns of text, and numbers that a title calls those of samples or scans, tell the spectra
    apart. All but the numbers of scans name them, so that scans of a sample have one name.
    """
    if rows and all(len(cells) == len(titles) + 1 for _, cells in rows):
        titles = ["", *titles]  # R's names of rows have no title
    if not rows or any(len(cells) != len(titles) for _, cells in rows):
        return None
    wave = next(j for j, title in enumerate(titles) if WAVELENGTH.search(title))
    repeats = len({cells[wave] for _, cells in rows}) < len(rows)
    called = [repeats and bool(LABEL.search(t) or _REPEAT.search(t)) for t in titles]
    first = [number_of(cell, True) is None for cell in rows[0][1]]
    if not any(t and (a or b) for t, a, b in zip(titles, called, first, strict=True)):
        return None
    columns = {j: [cells[j] for _, cells in rows] for j, title in enumerate(titles) if title}
    labels, numbers, errors = [], {}, []
    for j, column in columns.items():
        numbers[j] = np.array([number_of(cell, True) for cell in column], float)
        text = [number_of(cell, True) is None for cell in column]
        if j != wave and (called[j] or sum(text) > np.isfinite(numbers[j]).sum()):
            labels.append(j)
        elif any(text):
            errors.append((rows[text.index(True)][0], column[text.index(True)]))
    used = [wave, *(j for j in columns if j not in (wave, *labels))]
    if not labels or len(used) < 2:
        return None
    for number, cell in errors:
        raise ValueError(f"line {number}: {cell!r} is not a number")
    units: CellUnits = [None] * len(used)
    for number, cells in rows:
        units = units_of([cells[j] for j in used], units, f"line {number}")
    names = with_units([titles[j] for j in used], units)
    if not repeats:  # other texts are remarks or times
        named = [j for j in labels if LABEL.search(titles[j]) or any(map(role_of, columns[j]))]
        labels = named or [j for j in labels if len(set(columns[j])) == 1]
    parts = [j for j in labels if not _REPEAT.search(titles[j])]
    parts = [j for j in parts if len(set(columns[j])) > 1 or _is_role(columns[j][0])] or parts[:1]
    groups: dict[tuple[str, ...], list[int]] = {}
    for i, (_, cells) in enumerate(rows):
        groups.setdefault(tuple(cells[j] for j in labels), []).append(i)
    spectra = []
    for own in groups.values():
        of = " ".join(columns[j][own[0]] for j in parts)
        for j, name in zip(used[1:], names[1:], strict=True):
            # A deviation belongs to the first values.
            value = f"{names[1]} " if j != used[1] and role_of(name) == SD else ""
            spectra.append((f"{of} {value}{name}".strip(), numbers[wave][own], numbers[j][own]))
    return _join(names[0], spectra)._replace(samples=names[1])


def _is_role(cell: str) -> bool:
    """Whether a text says what the values are."""
    return bool(role_of(cell)) or "%" in cell


def _with_wavelengths_first(table: Columns) -> Columns:
    """The column of wavelengths, named so or else the first, in front of the others. Several such
    columns are those of the columns that follow each.
    """
    if sorted(table.names) == sorted(_JAZ):
        table = _jaz(table)
    named = [j for j, name in enumerate(table.names) if WAVELENGTH.search(name)] or [0]
    unnamed = [j for j, name in enumerate(table.names) if not name and counts(table.values[:, j])]
    others = [j for j in range(len(table.names)) if j not in (*named, *unnamed)]
    by_number = [j for j in named if UNITS["1/cm"].search(table.names[j])]
    if len(by_number) < len(named):  # the same once more
        named = [j for j in named if j not in by_number]
    if len(named) == 1:
        order = [*named, *others]
        return table._replace(values=table.values[:, order], names=[table.names[j] for j in order])
    own = {j: max((k for k in named if k < j), default=named[0]) for j in others}
    spectra = [(table.names[j], table.values[:, own[j]], table.values[:, j]) for j in others]
    return _join(table.names[named[0]], spectra)._replace(header=table.header, notes=table.notes)


def _jaz(table: Columns) -> Columns:
    """Ocean Insight's JAZ: letters name the columns; the last one may be any quantity."""
    dark, white, light, reflectance = (table.values[:, table.names.index(n)] for n in "DRSP")
    share = np.median(reflectance * (white - dark)) / np.median(100 * (light - dark))
    names = _JAZ | ({"P": "reflectance (%)"} if 0.8 < share < 1.25 else {})
    return table._replace(names=[names[name] for name in table.names])


def _join(name: str, spectra: list[tuple[str, np.ndarray, np.ndarray]]) -> Columns:
    """One table of spectra that each have their wavelengths."""
    present = [np.isfinite(x) for _, x, _ in spectra]
    grid = np.unique(np.concatenate([x[k] for (_, x, _), k in zip(spectra, present, strict=True)]))
    values = np.full((grid.size, 1 + len(spectra)), np.nan)
    values[:, 0] = grid
    for j, ((_, x, y), mask) in enumerate(zip(spectra, present, strict=True), 1):
        if np.unique(x[mask]).size < mask.sum():
            raise ValueError(f"a wavelength of {spectra[j - 1][0]!r} appears twice")
        values[np.searchsorted(grid, x[mask]), j] = y[mask]
    where = [f"at {x:g}" for x in grid]
    return Columns(values, [name, *(name for name, _, _ in spectra)], where, {})


def _excel(data: bytes) -> Columns:
    """The one sheet of a workbook that holds a table."""
    try:
        import openpyxl
    except ImportError:
        raise ValueError(
            "an Excel file needs openpyxl: pip install 'irisjax[instruments]', or save it as CSV"
        ) from None
    try:
        book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
        sheets = {sheet.title: list(sheet.iter_rows(values_only=True)) for sheet in book}
    except (KeyError, OSError, zipfile.BadZipFile) as error:
        raise ValueError(f"not readable as an Excel file ({error})") from None
    tables: dict[str, Columns] = {}
    errors: list[str] = []
    for title, rows in sheets.items():
        lines = ["\t".join("" if v is None else str(v).strip() for v in row) for row in rows]
        try:
            tables[title] = _table("\n".join(lines))
        except ValueError as error:
            errors.append(f"sheet {title!r}, {error}")
    if len(tables) > 1:
        raise ValueError(f"tables in {len(tables)} sheets ({', '.join(tables)}); keep one of them")
    if not tables:
        raise ValueError("; ".join(errors) or "no sheet in it")
    return next(iter(tables.values()))


def _svc(text: str) -> Columns:
    """Spectra Vista: wavelength, radiance of reference and target, and reflectance in per cent."""
    table = read_columns(text.partition("data=")[2])
    if len(table.names) != len(_SVC):
        raise ValueError(f"{len(table.names)} columns below data=; an SVC file has four")
    return table._replace(names=list(_SVC))


def _iad(text: str) -> Columns:
    """Input of S. Prahl's inverse adding-doubling: parameters of sample and spheres, the number or
    the letters of the columns, and the rows. Notes say what the parameters mean for M_R.
    """
    lines = [line.partition("#")[0].replace(",", " ").strip() for line in text[4:].splitlines()]
    numbers: list[str] = []
    row = 0
    while row < len(lines) and not (lines[row] and len(numbers) >= _IAD_PARAMETERS):
        numbers += lines[row].split()
        row += 1
    try:
        header = [float(word) for word in numbers]
    except ValueError as error:
        raise ValueError(f"IAD: {error} among the parameters of sample and spheres") from None
    if row == len(lines) or len(header) != _IAD_PARAMETERS:
        number = f"{len(header)} numbers of {_IAD_PARAMETERS}"
        raise ValueError(f"IAD: {number} above the line that says what the columns hold")
    code = re.sub(r"[\s-]", "", lines[row])
    letters = f"L{_IAD_ORDER[: int(code)]}" if code.isdigit() else code
    if "L" not in letters or not {"r", "t"} & set(letters):
        raise ValueError(f"IAD: columns {code!r}, need wavelengths (L) and a reflectance (r)")
    rows = ["\t".join(line.split()) for line in lines[row + 1 :]]
    table = read_columns("\n".join(["\n" * row + "\t".join(letters), *rows]))
    if len(table.names) != len(letters):
        message = f"{len(letters)} stated, the wavelength among them"
        raise ValueError(f"{table.where[0]}: {len(table.names)} columns, {message}")
    columns = [letters.index(c) for c in _IAD if c in letters]
    notes = _iad_notes(header, {c: table.values[:, j] for j, c in enumerate(letters)})
    names, header = [_IAD[letters[j]] for j in columns], {"unit": "fraction"}
    return Columns(table.values[:, columns], names, table.where, header, (*table.notes, *notes))


def _iad_notes(header: list[float], columns: dict[str, np.ndarray]) -> Iterator[str]:
    """Yield what sample and spheres mean for M_R  [Prahl, van Gemert & Welch 1993]."""
    index, slide, spheres = header[1], header[3], header[6]
    if slide > 0 and index > 1:
        yield f"behind a slide ({slide:g} mm, index {index:g}), whose reflections are not modelled"
    if "c" in columns and not columns["c"].any():
        yield "M_R is without the unscattered reflection: give --no-first-surface"
    if spheres and "r" in columns:
        # Light in a baffled sphere grows by 1/(1 - its mean reflectance).
        (sphere, *ports), medians = header[7:11], {c: np.median(columns[c]) for c in columns}
        sample, third, detector = (np.square(port / (2 * sphere)) for port in ports)
        wall = medians.get("w", header[11])
        white, signal = (
            1 - wall * (1 - sample - third - detector + (1 - third) * sample * r)
            for r in (medians.get("R", header[5]), medians["r"])
        )
        yield (
            f"a sphere with a single beam dims M_R to {white / signal:.3f} of the reflectance (the "
            f"standard brightens it more): --fix gain={white / signal:.3f}; not with two beams"
        )


def _cgats(text: str) -> str:
    """The table of a CGATS or IT8 file as text, a line of names above the rows."""
    parts = [
        re.search(rf"^BEGIN_{part}\s*$(.*?)^END_{part}", text, re.M | re.S)
        for part in ("DATA_FORMAT", "DATA")
    ]
    if None in parts:
        raise ValueError("a CGATS file without BEGIN_DATA ... END_DATA")
    names, rows = (part[1].strip() for part in parts if part)
    lines = [" ".join(names.split()), *rows.splitlines()]
    quoted = r'"[^"]*"|\S+'
    return "\n".join("\t".join(c.strip('"') for c in re.findall(quoted, x)) for x in lines)


def _jcamp(text: str) -> Columns:
    """The blocks of a JCAMP-DX file that hold a spectrum."""
    spectra: list[tuple[str, np.ndarray, np.ndarray]] = []
    units, notes = set(), []
    if re.search(r"^##\s*NTUPLES\s*=", text, re.M | re.I):
        raise ValueError("JCAMP-DX with NTUPLES is not read; export a spectrum alone, or CSV")
    for lines in _blocks(text):
        fields, printed = _jcamp_block(lines)
        x, y = np.asarray(fields.get("x", ()), float), np.asarray(fields.get("y", ()), float)
        if not x.size or x.shape != y.shape:
            if re.search(r"^##(XYDATA|XYPOINTS)", "\n".join(lines), re.M):
                raise ValueError(f"JCAMP-DX: {x.size} wavelengths for {y.size} values")
            continue  # the block that links the others
        word = str(fields.get("xunits", "")).strip()
        unit = next((unit for unit, form in UNITS.items() if form.search(word)), None)
        if unit is None:
            raise ValueError(f"XUNITS = {word or 'nothing'}; need nanometers, micrometers or 1/cm")
        units.add(unit)
        title, quantity = (str(fields.get(key, "")).strip() for key in ("title", "yunits"))
        spectra.append((f"{title}: {quantity}", x, y))
        notes += [f"JCAMP-DX, {title}: {printed}"] if printed else []
    if not spectra:
        raise ValueError("JCAMP-DX without a spectrum")
    if len(units) > 1:
        raise ValueError(f"JCAMP-DX: blocks in {' and '.join(sorted(units))}; keep one of them")
    titles = {name.partition(": ")[0] for name, _, _ in spectra}
    if len(titles) == 1:  # which says nothing, and might be mistaken for a quantity
        spectra = [(name.partition(": ")[2], x, y) for name, x, y in spectra]
    table = _join(f"wavelength ({units.pop()})", spectra)
    return table._replace(notes=tuple(notes))


def _blocks(text: str) -> list[list[str]]:
    """Lines of each block, from one title to the next, with the labels and numbers that the parser
    knows: blanks, hyphens, slashes and underscores of a label do not count [JCAMP-DX 4.24].
    """
    blocks: list[list[str]] = []
    for line in text.splitlines():
        label, equals, value = line.strip().partition("=")
        if label.startswith("##") and equals:
            name = re.sub(r"[\s/_-]", "", label[2:]).upper()
            name, line = _JCAMP_LABELS.get(name, name), value.partition("$$")[0].strip()
            if name == "TITLE":
                blocks.append([])
            line = f"##{name}={line}"
        if blocks and not line.startswith(("##END=", "$$")):
            blocks[-1].append(line.strip())
    for k, block in enumerate(blocks):
        joined = "\n".join(block)
        if re.search(r"^##(FIRSTX|LASTX|XFACTOR|YFACTOR)=-?\d*,\d", joined, re.M):
            blocks[k] = re.sub(r"(?<=\d),(?=\d)", ".", joined).split("\n")
    return blocks


def _jcamp_block(lines: list[str]) -> tuple[dict[str, Any], str]:
    """What the parser finds in a block, and the first line that it prints on the way."""
    import jcamp

    printed = io.StringIO()
    # A value and how often it is there: the parser knows numbers of one digit, after a difference.
    lines = [x if x.startswith("##") else _REPEATED.sub(_repeat, x) for x in lines]
    try:
        with contextlib.redirect_stdout(printed):
            fields = jcamp.read(lines)
    except Exception as error:  # the parser checks nothing: a damaged file may raise anything
        raise ValueError(f"not readable as JCAMP-DX ({error})") from None
    message = printed.getvalue().partition("\n")[0]
    if "Check failed" in message:
        raise ValueError(f"JCAMP-DX, damaged or not of equal steps: {message}")
    return fields, message


def _repeat(match: re.Match[str]) -> str:
    return match[1] * int(f"{'STUVWXYZs'.index(match[2]) + 1}{match[3]}")
