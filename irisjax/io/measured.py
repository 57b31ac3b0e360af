"""Measured spectra from files of instruments: a table with roles, its quantity, a spectrum.

`irisjax.io.columns` reads the table and chooses the columns; here their numbers become wavelengths
in nm and reflectances as fractions (or radiances).
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from irisjax.infer.observation import RADIANCE, REFLECTANCE, mean_of_scans
from irisjax.io.columns import (
    ABSORBANCE,
    KUBELKA_MUNK,
    QUANTITIES,
    Selection,
    SpectralTable,
    read_spectral_table,
    select,
)
from irisjax.optics.kubelka_munk import thick_layer
from irisjax.tissue.pigments import common_range

REFLECTANCE_UNITS = ("fraction", "percent")
WAVELENGTH_UNITS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "nm": lambda x: x,
    "um": lambda x: 1e3 * x,
    "1/cm": lambda x: 1e7 / x,
}
"""Units of a first column, and its conversion to nm."""

_MICRO = re.compile(r"µm|μm|\bum\b|micro|_um\b", re.I)
_PER_CM = re.compile(r"1/cm\b|\bcm\s*\^?\s*[-−–]\s*1|cm⁻¹|wave\s?number", re.I)
_NANO = re.compile(r"nm\b|nano", re.I)
_PERCENT = re.compile(r"%|per\s?cent", re.I)
# The largest reflectance of any iris lies between these: ILIT gives 0.12 without any pigment, and
# 0.0024, the first surface's alone, under 8 µg/mm² of melanin.
_BRIGHT, _DARK = 0.4, 0.002


class Measured(NamedTuple):
    """A spectrum from a file.

    Attributes:
        wavelengths: nm, increasing.
        values: Reflectances as fractions; radiances in the file's unit.
        sd: Their standard deviations, or `None`.
        notes: What was detected, assumed and done (units, repeated scans, values left out).
        header: Lines `# key: value` of the file.
        doubts: Values that no iris has.
    """

    wavelengths: Float[np.ndarray, " wavelengths"]
    values: Float[np.ndarray, " wavelengths"]
    sd: Float[np.ndarray, " wavelengths"] | None
    notes: tuple[str, ...]
    header: dict[str, str]
    doubts: tuple[str, ...] = ()


class ReadOptions(NamedTuple):
    """How to read a file; `None` means as the file says, or by its numbers.

    Attributes:
        quantity: One of `QUANTITIES`.
        unit: Of reflectances, one of `REFLECTANCE_UNITS`.
        wavelength_unit: One of `WAVELENGTH_UNITS`.
        wavelengths: The least and the largest wavelength to keep, nm.
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
    SpectraSuite, AvaSoft, or ViewSpec (ASD); with a spectrum a row as by SpectraMagic; and
    JCAMP-DX, recognised by its first line `##TITLE`. The first column is the wavelength unless
    another's name says so. One further column is the spectrum, a column named sd (or sigma,
    uncertainty, ...) its standard deviation. Several further columns are repeated scans: their mean
    is used, and their scatter gives its standard deviation.

    Absorbances log₁₀(1/R) and Kubelka–Munk's K/S become reflectances where the file says so or
    `quantity` does. Wavelengths that the pigment tables do not cover, or outside `wavelengths`, are
    left out, and so are those without a value.

    Raises:
        ValueError: naming the file, the row and the problem, such as numbers that are no
            reflectances, or could be fractions as well as per cent.
    """
    how = ReadOptions(quantity, unit, wavelength_unit, wavelengths)
    try:
        table = read_spectral_table(path)
        return _spectrum(table, how, select(table, how.quantity))
    except ValueError as error:
        raise ValueError(_naming(path, error)) from None


def read_eyes(path: str | Path, how: ReadOptions | None = None) -> dict[str, Measured | ValueError]:
    """Read the spectra of many eyes in one text table, a column each.

    Returns:
        The spectra by name, or the error of a column that is none.

    Raises:
        ValueError: naming the file and a problem of the whole table.
    """
    try:
        table = read_spectral_table(path)
    except ValueError as error:
        raise ValueError(_naming(path, error)) from None
    how = ReadOptions() if how is None else how
    found: dict[str, Measured | ValueError] = {}
    for j, name in enumerate(table.names[1:], 1):
        name = name or f"column {j + 1}"
        if name in found:
            raise ValueError(f"{path}: column {name!r} appears twice")
        try:
            found[name] = _spectrum(table, how, select(table, how.quantity, [j]))
        except ValueError as error:
            found[name] = error
    return found


def _naming(path: str | Path, error: ValueError) -> str:
    return str(error) if str(error).startswith(str(path)) else f"{path}: {error}"


def _spectrum(table: SpectralTable, how: ReadOptions, chosen: Selection) -> Measured:
    for name, allowed in (
        ("quantity", QUANTITIES),
        ("unit", REFLECTANCE_UNITS),
        ("wavelength_unit", WAVELENGTH_UNITS),
    ):
        if getattr(how, name) not in (None, *allowed):
            raise ValueError(
                f"{name} must be one of {', '.join(allowed)}, got {getattr(how, name)!r}"
            )
    notes: list[str] = []
    table = _with_values(table, chosen, notes)
    table = _in_range(_in_nm(table, how, notes), how, notes)
    x = table.values[:, 0]
    order = np.argsort(x, kind="stable")
    for i in np.flatnonzero(np.diff(x[order]) == 0)[:1]:
        raise ValueError(f"{table.where[order[i + 1]]}: {x[order[i]]:g} nm appears twice")
    quantity = how.quantity or chosen.role or REFLECTANCE
    scans, sd = _as_fractions(table, how, chosen, quantity, notes)
    doubts = () if quantity == RADIANCE else _doubts(scans)
    y, scatter = mean_of_scans(scans)
    if len(chosen.spectra) > 1:
        notes.append(f"mean of {len(chosen.spectra)} scans; their scatter is the noise")
        if scatter is None:
            notes.append("the scans are equal: their scatter says nothing about the noise")
    sd = scatter if sd is None else sd
    if sd is not None:
        for i in np.flatnonzero(~(sd > 0))[:1]:
            raise ValueError(f"{table.where[i]}: standard deviation {sd[i]:g}; it must be > 0")
        sd = sd[order]
    return Measured(x[order], y[order], sd, tuple(notes), table.header, doubts)


def _rows(table: SpectralTable, kept: np.ndarray) -> SpectralTable:
    where = [w for w, keep in zip(table.where, kept, strict=True) if keep]
    return table._replace(values=table.values[kept], where=where)


def _with_values(table: SpectralTable, chosen: Selection, notes: list[str]) -> SpectralTable:
    """Rows in which every chosen column has a number."""
    used = [0, *chosen.spectra, *([] if chosen.sd is None else [chosen.sd])]
    values = table.values[:, used]
    for i, j in np.argwhere(np.isinf(values))[:1]:
        raise ValueError(f"{table.where[i]}: {values[i, j]} is not a finite number")
    missing = np.asarray(np.isnan(values).any(axis=1))
    if missing.all():
        raise ValueError("no wavelength has a value")
    if missing.any():
        notes.append(f"{missing.sum()} of {missing.size} wavelengths without a value skipped")
    return _rows(table, ~missing)


def _in_nm(table: SpectralTable, how: ReadOptions, notes: list[str]) -> SpectralTable:
    """The table with its first column in nm."""
    x, name, unit = table.values[:, 0], table.names[0], how.wavelength_unit
    if unit is None and _PER_CM.search(name):
        unit = "1/cm"
    elif unit is None and _MICRO.search(name):
        unit = "um"
    elif unit is None and not _NANO.search(name) and x.min() > 0.1 and x.max() < 10:
        unit = "um"
        notes.append("wavelengths read as µm (the file does not say; --wavelength-unit otherwise)")
    if unit == "1/cm" and not (x > 0).all():
        raise ValueError(f"{table.where[int(np.argmin(x))]}: a wavenumber of {x.min():g} 1/cm")
    first = WAVELENGTH_UNITS[unit or "nm"](x)
    return table._replace(values=np.column_stack([first, table.values[:, 1:]]))


def _in_range(table: SpectralTable, how: ReadOptions, notes: list[str]) -> SpectralTable:
    """Rows whose wavelengths are asked for and covered by the pigment tables."""
    x, (low, high) = table.values[:, 0], common_range()
    why = "which the pigment tables cover"
    if how.wavelengths is not None:
        asked, why = how.wavelengths, "as asked"
        if max(low, asked[0]) > min(high, asked[1]):
            raise ValueError(
                f"{asked[0]:g} to {asked[1]:g} nm are asked for; the pigment tables have "
                f"{low:g} to {high:g} nm"
            )
        low, high = max(low, asked[0]), min(high, asked[1])
    inside = (x >= low) & (x <= high)
    if not inside.any():
        raise ValueError(
            f"wavelengths {x.min():g} to {x.max():g} nm; none is within {low:g} to {high:g} nm"
        )
    if not inside.all():
        notes.append(
            f"{(~inside).sum()} of {inside.size} wavelengths left out: only {low:g} to {high:g} nm,"
            f" {why}"
        )
    return _rows(table, inside)


def _as_fractions(
    table: SpectralTable, how: ReadOptions, chosen: Selection, quantity: str, notes: list[str]
) -> tuple[np.ndarray, np.ndarray | None]:
    """Scans (rows, scans) and standard deviations, as fractions where they are reflectances."""
    scans = table.values[:, chosen.spectra]
    sd = None if chosen.sd is None else table.values[:, chosen.sd]
    if quantity == RADIANCE:
        return scans, sd
    if quantity in (ABSORBANCE, KUBELKA_MUNK):
        form = "log10(1/R)" if quantity == ABSORBANCE else "(1 - R)²/2R"
        notes.append(f"{quantity} {form} converted to reflectance")
        reflectance, slope = _reflectance_of(scans, quantity)
        return reflectance, None if sd is None else slope[:, 0] * sd
    if not np.median(scans) > 0:
        raise ValueError("half of the values or more are zero or negative: no reflectance")
    unit = how.unit
    if unit is None:
        # Files that irisjax wrote hold fractions.
        said = "fraction" if "irisjax" in table.header else table.header.get("unit", "")
        if _PERCENT.search(f"{chosen.label} {said}"):
            unit = "percent"
        elif re.search("fraction|^1$", said):
            unit = "fraction"
        else:
            unit = _unit_by_size(float(np.max(scans)), notes)
    scale = 100 if unit == "percent" else 1
    return scans / scale, None if sd is None else sd / scale


def _reflectance_of(values: np.ndarray, quantity: str) -> tuple[np.ndarray, np.ndarray]:
    """Reflectances of absorbances log₁₀(1/R) or of Kubelka and Munk's K/S = (1 − R)²/2R, and the
    sizes of their derivatives  [Kubelka & Munk 1931].
    """
    if quantity == ABSORBANCE:
        with np.errstate(over="ignore"):
            found = 10.0**-values
        return found, np.log(10) * found
    found = thick_layer(values, 1.0, xp=np)
    root = np.sqrt(np.maximum(values * (values + 2), 0))
    return found, found / np.where(root > 0, root, np.inf)


def _unit_by_size(top: float, notes: list[str]) -> str:
    """The unit that the largest value of a file implies, where the file does not say it."""
    if top > 100:
        raise ValueError(
            f"values up to {top:,.6g} are no reflectances, neither fractions nor per cent; are "
            f"they counts?"
        )
    if top > 2:
        notes.append("values read as per cent (the file does not say; --unit fraction otherwise)")
        return "percent"
    if top > _BRIGHT:
        raise ValueError(
            f"values up to {top:.3g} may be fractions (brighter than any iris) or per cent (a dark "
            f"iris): give --unit percent or --unit fraction"
        )
    notes.append("values read as fractions (the file does not say; --unit percent otherwise)")
    return "fraction"


def _doubts(reflectance: np.ndarray) -> tuple[str, ...]:
    """A doubt where the largest reflectance is not that of an iris."""
    top = float(np.max(reflectance))
    if top > _BRIGHT:
        return (f"reflectances up to {100 * top:.3g} %: brighter than any iris",)
    if top < _DARK:
        return (f"reflectances of at most {100 * top:.2g} %: darker than any iris",)
    return ()
