"""Spectra as spectrometers write them: text tables of many kinds, and JCAMP-DX."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from irisjax.infer.observation import mean_of_scans
from irisjax.io import quantities
from irisjax.io.quantities import ABSORBANCE, KUBELKA_MUNK, QUANTITIES, RADIANCE, REFLECTANCE
from irisjax.io.text import Columns, read_columns, read_text
from irisjax.tissue.pigments import common_range

UNITS = ("fraction", "percent")
WAVELENGTH_UNITS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "nm": lambda x: x,
    "um": lambda x: 1e3 * x,
    "1/cm": lambda x: 1e7 / x,
}
"""What a first column may be in, and its wavelengths in nm."""
_MICRO = re.compile(r"µm|μm|\bum\b|micro|_um\b", re.I)
_PER_CM = re.compile(r"1/cm\b|\bcm\s*\^?\s*[-−–]\s*1|cm⁻¹|wave\s?number", re.I)
_NANO = re.compile(r"nm\b|nano", re.I)
_WAVE = re.compile(r"wave|wellenl|λ|lambda|^\W*nm\W*$", re.I)


class Measured(NamedTuple):
    """A spectrum from a file.

    `wavelengths` (nm, increasing) and `values` (reflectances as fractions; radiances as they are),
    `sd` their standard deviations or `None`; `notes` say what was detected, assumed and done
    (units, repeated scans, what was left out); `doubts`, what no iris does; `header` holds
    `# key: value` lines.
    """

    wavelengths: np.ndarray
    values: np.ndarray
    sd: np.ndarray | None
    notes: tuple[str, ...]
    header: dict[str, str]
    doubts: tuple[str, ...] = ()


class ReadOptions(NamedTuple):
    """What a reader knows that the file may not say; `None`: as the file says, or by its numbers.

    `quantity`: one of `QUANTITIES`; `unit`: of reflectances, "fraction" or "percent";
    `wavelength_unit`: one of `WAVELENGTH_UNITS`; `wavelengths`: the least and the largest that are
    kept, nm.
    """

    quantity: str | None = None
    unit: str | None = None
    wavelength_unit: str | None = None
    wavelengths: tuple[float, float] | None = None


def read_measured(
    path: str | Path,
    *,
    quantity: str | None = None,
    unit: str | None = None,
    wavelength_unit: str | None = None,
    wavelengths: tuple[float, float] | None = None,
) -> Measured:
    """Read a measured spectrum; see `ReadOptions` for the arguments.

    Text tables in UTF-8, UTF-16 or cp1252, separated by tabs, semicolons, commas or blanks, with
    decimal points or commas, below any preamble: as written by hand, by Excel, OceanView and
    SpectraSuite, AvaSoft, or ViewSpec (ASD); with a spectrum a row as by SpectraMagic. The first
    column is the wavelength unless another's name says so; one further column is the spectrum, a
    column named sd (or sigma, uncertainty, ...) its standard deviation, several further columns are
    repeated scans: their mean is used, and their scatter is its standard deviation. JCAMP-DX by its
    first line `##TITLE`.

    Absorbances log₁₀(1/R) and Kubelka–Munk's K/S become reflectances where the file says so or
    `quantity` does. Wavelengths that the pigment tables do not cover, or outside `wavelengths`, are
    left out, and so are those without a value.

    **Raises:** `ValueError` naming the file, the row and the problem: above all where the numbers
    are no reflectances, or could be fractions as well as per cent.
    """
    how = ReadOptions(quantity, unit, wavelength_unit, wavelengths)
    try:
        table = _read(path)
        return _finished(table, how, quantities.choose(table.names, how.quantity))
    except ValueError as error:
        raise ValueError(_named(path, error)) from None


def read_eyes(path: str | Path, how: ReadOptions | None = None) -> dict[str, Measured | ValueError]:
    """Spectra of many eyes in one text table, a column each, by name; or what is wrong with one.

    **Raises:** `ValueError` naming the file and the problem of the whole table.
    """
    try:
        table = _read(path)
    except ValueError as error:
        raise ValueError(_named(path, error)) from None
    how = ReadOptions() if how is None else how
    found: dict[str, Measured | ValueError] = {}
    for j, name in enumerate(table.names[1:], 1):
        name = name or f"column {j + 1}"
        if name in found:
            raise ValueError(f"{path}: column {name!r} stands twice")
        try:
            chosen = quantities.choose([table.names[0], name], how.quantity)
            found[name] = _finished(table, how, chosen._replace(spectra=[j]))
        except ValueError as error:
            found[name] = error
    return found


def _named(path, error: ValueError) -> str:
    return str(error) if str(error).startswith(str(path)) else f"{path}: {error}"


def _read(path) -> Columns:
    text = read_text(path)
    table = _jcamp(path) if text.lstrip().startswith("##") else read_columns(path, text)
    order = sorted(range(len(table.names)), key=lambda j: not _WAVE.search(table.names[j]))
    if _WAVE.search(table.names[order[0]]) and order[0]:
        return table._replace(values=table.values[:, order], names=[table.names[j] for j in order])
    return table


def _jcamp(path) -> Columns:
    import jcamp

    try:
        found = jcamp.readfile(str(path))
        x, y = np.asarray(found["x"], float), np.asarray(found["y"], float)
    except Exception as error:
        raise ValueError(f"not readable as JCAMP-DX ({error})") from None
    if x.size == 0 or x.shape != y.shape:
        raise ValueError("JCAMP-DX without a spectrum")
    unit = str(found.get("xunits", "")).strip().upper()
    if unit in ("NANOMETERS", "NANOMETRES", "NM"):
        name = "wavelength (nm)"
    elif unit in ("MICROMETERS", "MICROMETRES"):
        name = "wavelength (um)"
    elif unit == "1/CM":
        name, x = "wavelength (nm)", 1e7 / x
    else:
        raise ValueError(f"XUNITS = {unit or 'nothing'}; need nanometers, micrometers or 1/cm")
    label = str(found.get("yunits", "")).strip()
    where = [f"point {i + 1}" for i in range(x.size)]
    return Columns(np.stack([x, y], 1), [name, label], where, {})


def _finished(table: Columns, how: ReadOptions, columns: quantities.Chosen) -> Measured:
    if how.quantity not in (None, *QUANTITIES):
        raise ValueError(f"quantity must be one of {', '.join(QUANTITIES)}, got {how.quantity!r}")
    if how.unit not in (None, *UNITS):
        raise ValueError(f"unit must be one of {', '.join(UNITS)}, got {how.unit!r}")
    notes: list[str] = []
    table = _kept(table, how, columns, notes)
    x, order = table.values[:, 0], np.argsort(table.values[:, 0], kind="stable")
    same = np.flatnonzero(np.diff(x[order]) == 0)
    if same.size:
        raise ValueError(
            f"{table.where[order[same[0] + 1]]}: {x[order[same[0]]]:g} nm stands twice"
        )
    scans = table.values[:, columns.spectra]
    sd = None if columns.sd is None else table.values[:, columns.sd]
    quantity = how.quantity or columns.kind or REFLECTANCE
    doubt = ""
    if quantity in (ABSORBANCE, KUBELKA_MUNK):
        scans, sd = quantities.as_reflectance(scans, sd, quantity)
        form = "log10(1/R)" if quantity == ABSORBANCE else "(1 - R)²/2R"
        notes.append(f"{quantity} {form} converted to reflectance")
    elif quantity != RADIANCE:
        if not np.median(scans) > 0:
            raise ValueError("half of the values or more are zero or negative: no reflectance")
        said = "fraction" if "irisjax" in table.header else table.header.get("unit", "")
        hundredths, word = quantities.percent(scans, how.unit, columns.label, said)
        if hundredths:
            scans, sd = scans / 100, None if sd is None else sd / 100
        notes += [word] if word else []
    if quantity != RADIANCE:
        doubt = quantities.doubt(scans)
    y, scatter = mean_of_scans(scans)
    if len(columns.spectra) > 1:
        notes.append(f"mean of {len(columns.spectra)} scans; their scatter is the noise")
        if scatter is None:
            notes.append("the scans are equal: their scatter says nothing about the noise")
    sd = scatter if sd is None else sd
    if sd is not None:
        for i in np.flatnonzero(~(sd > 0))[:1]:
            raise ValueError(f"{table.where[i]}: standard deviation {sd[i]:g}; it must be > 0")
        sd = sd[order]
    doubts = (doubt,) if doubt else ()
    return Measured(x[order], y[order], sd, tuple(notes), table.header, doubts)


def _kept(table: Columns, how: ReadOptions, columns, notes: list[str]) -> Columns:
    """Rows whose numbers are there and whose wavelengths, now in nm, are wanted."""
    values, where = table.values.copy(), table.where
    used = [0, *columns.spectra, *([] if columns.sd is None else [columns.sd])]
    for i, j in np.argwhere(np.isinf(values[:, used]))[:1]:
        raise ValueError(f"{where[i]}: {values[i, used[j]]} is not a finite number")
    missing = np.isnan(values[:, used]).any(axis=1)
    if missing.any():
        notes.append(f"{missing.sum()} of {missing.size} wavelengths without a value skipped")
    values, where = values[~missing], [where[i] for i in np.flatnonzero(~missing)]
    if not where:
        raise ValueError("no wavelength has a value")
    x, unit = values[:, 0], how.wavelength_unit
    if unit not in (None, *WAVELENGTH_UNITS):
        raise ValueError(
            f"wavelength_unit must be one of {', '.join(WAVELENGTH_UNITS)}, got {unit!r}"
        )
    if unit is None and _PER_CM.search(table.names[0]):
        unit = "1/cm"
    if unit is None and _MICRO.search(table.names[0]):
        unit = "um"
    if unit is None and not _NANO.search(table.names[0]) and x.min() > 0.1 and x.max() < 10:
        unit = "um"
        notes.append("wavelengths read as µm (the file does not say; --wavelength-unit otherwise)")
    if unit == "1/cm" and not (x > 0).all():
        raise ValueError(f"{where[int(np.argmin(x))]}: a wavenumber of {x.min():g} 1/cm")
    values[:, 0] = x = WAVELENGTH_UNITS[unit or "nm"](x)
    low, high = common_range()
    if how.wavelengths is not None:
        low, high = max(low, how.wavelengths[0]), min(high, how.wavelengths[1])
        if low > high:
            asked, there = how.wavelengths, common_range()
            raise ValueError(
                f"{asked[0]:g} to {asked[1]:g} nm are asked for; the pigment tables have "
                f"{there[0]:g} to {there[1]:g} nm"
            )
    inside = (x >= low) & (x <= high)
    if not inside.any():
        raise ValueError(
            f"wavelengths {x.min():g} to {x.max():g} nm; none is within {low:g} to {high:g} nm"
        )
    if not inside.all():
        why = "as asked" if how.wavelengths is not None else "which the pigment tables cover"
        notes.append(
            f"{(~inside).sum()} of {inside.size} wavelengths left out: only {low:g} to {high:g} nm,"
            f" {why}"
        )
    where = [w for w, i in zip(where, inside, strict=True) if i]
    return table._replace(values=values[inside], where=where)
