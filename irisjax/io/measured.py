"""Spectra as spectrometers write them: CSV or TSV with or without header, and JCAMP-DX."""

import csv
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from irisjax.infer.observation import mean_of_scans

_SD = re.compile(
    r"^(sd|std|stdev|sigma|standard[ _]deviation|standard[ _]error|uncertainty)\b", re.I
)
_MICRO = re.compile(r"µm|μm|\bum\b|micro|_um\b", re.I)
_NANO = re.compile(r"nm\b|nano", re.I)


class Measured(NamedTuple):
    """A spectrum from a file.

    `wavelengths` (nm, increasing) and `values` (fractions), `sd` their standard deviations or
    `None`; `notes` say what was detected and done (units, per cent, repeated scans); `header` holds
    `# key: value` lines.
    """

    wavelengths: np.ndarray
    values: np.ndarray
    sd: np.ndarray | None
    notes: tuple[str, ...]
    header: dict[str, str]


def read_measured(path: str | Path) -> Measured:
    """Read a measured spectrum.

    Text tables: lines with `#` are comments, the first line without numbers names the columns. The
    first column is the wavelength, in nm or µm; one further column is the reflectance, a column
    named sd (or sigma, uncertainty, ...) its standard deviation, several further columns are
    repeated scans: their mean is used, and their scatter is its standard deviation. Values above 2
    are per cent. JCAMP-DX by its first line `##TITLE`.

    **Raises:** `ValueError` naming the file, the row and the problem.
    """
    try:
        text = Path(path).read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{path}: not a text file (UTF-8)") from None
    if text.lstrip().startswith("##"):
        return _finished(path, *_jcamp(path), {})
    header = dict(
        re.findall(r"^#\s*([^:\n]+?)\s*:[ \t]*(.*?)(?:\s*\[[^\[\]\n]*\])?\s*$", text, flags=re.M)
    )
    return _finished(path, *_table(path, text), header)


def _table(path, text: str):
    rows, names = [], None
    lines = text.splitlines()
    body = [line for line in lines if line.strip() and not line.lstrip().startswith("#")]
    if not body:
        raise ValueError(f"{path}: no numbers in it")
    # The one that most lines have; of tab, semicolon and comma in this order, as commas may be
    # decimal.
    found = {d: sum(d in line for line in body) for d in ("\t", ";", ",")}
    delimiter = next((d for d, n in found.items() if 2 * n > len(body)), None)
    decimal_comma = (
        delimiter in ("\t", ";") and found[","] and not any("." in line for line in body[1:])
    )
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells = next(csv.reader([line], delimiter=delimiter)) if delimiter else line.split()
        cells = [c.strip() for c in cells]
        while cells and not cells[-1]:
            cells.pop()
        try:
            rows.append((number, [_number(c, bool(decimal_comma)) for c in cells]))
        except ValueError as error:
            if rows or names is not None:
                raise ValueError(f"{path}, line {number}: {error}") from None
            names = cells
    if not rows:
        raise ValueError(f"{path}: no numbers in it")
    width = len(rows[0][1])
    if width < 2:
        raise ValueError(f"{path}, line {rows[0][0]}: one column; need wavelength and reflectance")
    for number, row in rows:
        if len(row) != width:
            raise ValueError(
                f"{path}, line {number}: {len(row)} values, {width} in the lines before"
            )
    values = np.array([row for _, row in rows])
    where = [f"line {number}" for number, _ in rows]
    names = (
        [n.strip() for n in names] if names is not None and len(names) == width else [""] * width
    )
    return values, names, where


def _number(cell: str, decimal_comma: bool) -> float:
    try:
        return float(cell.replace(",", ".") if decimal_comma else cell)
    except ValueError:
        raise ValueError(f"{cell!r} is not a number") from None


def _jcamp(path):
    import jcamp

    try:
        found = jcamp.readfile(str(path))
        x, y = np.asarray(found["x"], float), np.asarray(found["y"], float)
    except Exception as error:
        raise ValueError(f"{path}: not readable as JCAMP-DX ({error})") from None
    if x.size == 0 or x.shape != y.shape:
        raise ValueError(f"{path}: JCAMP-DX without a spectrum")
    unit = str(found.get("xunits", "")).strip().upper()
    known = {
        "NANOMETERS": "nm",
        "NANOMETRES": "nm",
        "NM": "nm",
        "MICROMETERS": "um",
        "MICROMETRES": "um",
        "1/CM": "1/cm",
    }
    if unit not in known:
        raise ValueError(
            f"{path}: XUNITS = {unit or 'nothing'}; need nanometers, micrometers or 1/cm"
        )
    if known[unit] == "1/cm":
        x = 1e7 / x
    name = "wavelength_um" if known[unit] == "um" else "wavelength_nm"
    label = (
        "percent"
        if "%" in str(found.get("yunits", "")) or "PERCENT" in str(found.get("yunits", "")).upper()
        else ""
    )
    return np.stack([x, y], 1), [name, label], [f"point {i + 1}" for i in range(x.size)]


def _finished(path, values, names, where, header) -> Measured:
    notes = []
    for i, j in np.argwhere(~np.isfinite(values))[:1]:
        column = f" in column {names[j]!r}" if names[j] else f" in column {j + 1}"
        raise ValueError(f"{path}, {where[i]}: {values[i, j]} is not a finite number{column}")
    x = values[:, 0]
    if _MICRO.search(names[0]) or (not _NANO.search(names[0]) and x.min() > 0.1 and x.max() < 10):
        x = 1e3 * x
        notes.append("wavelengths read as µm")
    order = np.argsort(x, kind="stable")
    same = np.flatnonzero(np.diff(x[order]) == 0)
    if same.size:
        raise ValueError(
            f"{path}, {where[order[same[0] + 1]]}: {x[order[same[0]]]:g} nm stands twice"
        )
    scans = [j for j in range(1, values.shape[1]) if not _SD.match(names[j])]
    stated = [j for j in range(1, values.shape[1]) if _SD.match(names[j])]
    if not scans or len(stated) > 1 or (stated and len(scans) > 1):
        raise ValueError(
            f"{path}: columns {names[1:]}: need one spectrum (with its sd) or repeated scans"
        )
    y, sd = mean_of_scans(values[:, scans])
    if stated:
        sd = values[:, stated[0]]
    if len(scans) > 1:
        notes.append(f"mean of {len(scans)} scans; their scatter is the noise")
        if sd is None:
            notes.append("the scans are equal: their scatter says nothing about the noise")
    label = names[scans[0]].lower()
    if "%" in label or "percent" in label or "per cent" in label or np.abs(y).max() > 2:
        y, sd = y / 100, None if sd is None else sd / 100
        notes.append("values read as per cent")
    if sd is not None:
        for i in np.flatnonzero(~(sd > 0))[:1]:
            raise ValueError(f"{path}, {where[i]}: standard deviation {sd[i]:g}; it must be > 0")
    return Measured(x[order], y[order], None if sd is None else sd[order], tuple(notes), header)
