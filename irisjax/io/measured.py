"""Measured spectra from files of instruments: columns that have roles by their headers become
wavelengths in nm and reflectances as fractions (or radiances).
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from irisjax.infer.observation import RADIANCE, REFLECTANCE, mean_of_scans
from irisjax.io.tables import naming
from irisjax.io.text import Columns, read_columns, read_text
from irisjax.optics.kubelka_munk import thick_layer
from irisjax.tissue.pigments import common_range

ABSORBANCE, KUBELKA_MUNK = "absorbance", "kubelka-munk"
QUANTITIES = (REFLECTANCE, RADIANCE, ABSORBANCE, KUBELKA_MUNK)
"""Roles whose columns can become a spectrum."""
REFLECTANCE_UNITS = ("fraction", "percent")
WAVELENGTH_UNITS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "nm": lambda x: x,
    "um": lambda x: 1e3 * x,
    "1/cm": lambda x: 1e7 / x,
}
"""Units of a first column, and its conversion to nm."""

_STANDARD_DEVIATION = "standard deviation"
# The first form that a header matches gives its role.
_FORMS = {
    _STANDARD_DEVIATION: r"^(sd|std|stdev|sigma|standard[ _](deviation|error)|uncertainty)\b",
    ABSORBANCE: r"absorb|extinction|optical density|\bOD\b|\bA\.?U\b|log\W*1\s*/\s*[RT]\b",
    KUBELKA_MUNK: r"kubelka|munk|\bk\s*/\s*s\b|\bf\(r",
    "transmittance": r"transmi|%\s*T\b|\bT\s*\(?%",
    "irradiance": r"irradian|[µμu]W",
    REFLECTANCE: r"reflect|reflex|remission|albedo|^R\b|%\s*R\b",
    RADIANCE: r"radiance",
    "counts": r"count|scope|intensity|\braw\b|\badu\b|\bdn\b|\bdark\b|\bwhite\b|^ref(erence)?\b",
    "arbitrary units": r"arbitrary",
}
_WAVELENGTH = re.compile(r"wave|wellenl|λ|lambda|^\W*nm\W*$", re.I)
_REFUSALS = {
    RADIANCE: "a radiance; give --quantity radiance",
    "transmittance": "a transmittance; where it is the light sent back, give "
    "--quantity reflectance",
}
_TO_DO = "divide the light of the eye by that of a white reference, both less the dark signal"
# Units that headers name, the first that matches.
_UNITS = {
    "1/cm": re.compile(r"1/cm\b|\bcm\s*\^?\s*[-−–]\s*1|cm⁻¹|wave\s?number", re.I),
    "um": re.compile(r"µm|μm|\bum\b|micro|_um\b", re.I),
    "nm": re.compile(r"nm\b|nano", re.I),
}
_PERCENT = re.compile(r"%|per\s?cent", re.I)
# The largest reflectance of any iris lies between these: ILIT gives 0.12 without any pigment, and
# 0.0024, the first surface's alone, under 8 µg/mm² of melanin.
_BRIGHT, _DARK = 0.4, 0.002


class Measured(NamedTuple):
    """A spectrum from a file, its wavelengths in nm and increasing.

    Attributes:
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
    """How to read a file; `None` means as the file says, or by its numbers: one of `QUANTITIES`,
    `REFLECTANCE_UNITS` and `WAVELENGTH_UNITS`, and the wavelengths (nm) to keep, from and to.
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
    with naming(path):
        return _spectrum(_table(path), how)


def read_eyes(path: str | Path, how: ReadOptions | None = None) -> dict[str, Measured | ValueError]:
    """Read the spectra of many eyes in one text table, a column each, or the error of a column that
    is none; `ValueError` for a problem of the whole table.
    """
    with naming(path):
        table = _table(path)
    found: dict[str, Measured | ValueError] = {}
    for j, name in enumerate(table.names[1:], 1):
        name = name or f"column {j + 1}"
        if name in found:
            raise ValueError(f"{path}: column {name!r} appears twice")
        try:
            found[name] = _spectrum(table, how or ReadOptions(), [j])
        except ValueError as error:
            found[name] = error
    return found


def _spectrum(table: Columns, how: ReadOptions, among: list[int] | None = None) -> Measured:
    known = QUANTITIES, REFLECTANCE_UNITS, tuple(WAVELENGTH_UNITS)
    for name, given, allowed in zip(how._fields, how, known, strict=False):
        if given not in (None, *allowed):
            raise ValueError(f"{name} must be one of {', '.join(allowed)}, got {given!r}")
    spectra, stated, role = _chosen(table, how.quantity, among)
    notes: list[str] = []
    used = [0, *spectra, *stated]
    values, where = table.values[:, used], np.array(table.where)
    for i, j in np.argwhere(np.isinf(values))[:1]:
        raise ValueError(f"{where[i]}: {values[i, j]} is not a finite number")
    kept = ~np.isnan(values).any(axis=1)
    if not kept.any():
        raise ValueError("no wavelength has a value")
    if not kept.all():
        notes.append(f"{(~kept).sum()} of {kept.size} wavelengths without a value skipped")
    values, where = values[kept], where[kept]
    x = _in_nm(values[:, 0], where, table.names[0], how.wavelength_unit, notes)
    kept = _in_range(x, how.wavelengths, notes)
    order = np.flatnonzero(kept)[np.argsort(x[kept], kind="stable")]
    x, where = x[order], where[order]
    for i in np.flatnonzero(np.diff(x) == 0)[:1]:
        raise ValueError(f"{where[i + 1]}: {x[i]:g} nm appears twice")
    count = len(spectra)
    scans, sd = values[order, 1 : count + 1], values[order, count + 1 :]
    quantity = how.quantity or role or REFLECTANCE
    if quantity in (ABSORBANCE, KUBELKA_MUNK):
        form = "log10(1/R)" if quantity == ABSORBANCE else "(1 - R)²/2R"
        notes.append(f"{quantity} {form} converted to reflectance")
        scans, slope = _reflectance_of(scans, quantity)
        sd = slope[:, :1] * sd
    elif quantity == REFLECTANCE:
        label = table.names[spectra[0]]
        scale = 100 if _unit(scans, how.unit, label, table.header, notes) == "percent" else 1
        scans, sd = scans / scale, sd / scale
    doubts = () if quantity == RADIANCE else _doubts(scans)
    y, scatter = mean_of_scans(scans)
    if count > 1:
        notes.append(f"mean of {count} scans; their scatter is the noise")
        if scatter is None:
            notes.append("the scans are equal: their scatter says nothing about the noise")
    noise = sd[:, 0] if stated else scatter
    if noise is not None and not (noise > 0).all():
        i = np.flatnonzero(~(noise > 0))[0]
        raise ValueError(f"{where[i]}: standard deviation {noise[i]:g}; it must be > 0")
    return Measured(x, y, noise, tuple(notes), table.header, doubts)


def _table(path: str | Path) -> Columns:
    """The table of a text file or of JCAMP-DX, which begins with `##TITLE`; its first column, or
    the one whose header says so, becomes the first: the wavelength or wavenumber.
    """
    text = read_text(path)
    table = _jcamp(path) if text.lstrip().startswith("##") else read_columns(text)
    first = next((j for j, name in enumerate(table.names) if _WAVELENGTH.search(name)), 0)
    order = [first, *(j for j in range(len(table.names)) if j != first)]
    return table._replace(values=table.values[:, order], names=[table.names[j] for j in order])


def _chosen(
    table: Columns, wanted: str | None, among: list[int] | None
) -> tuple[list[int], list[int], str]:
    """Indices of the columns of scans, all of one role, and of their standard deviation if there is
    one; and the role, empty where no header gives it.

    Reflectances come first, then absorbances and K/S, then columns without a role; others, such as
    counts and references beside a reflectance, are left out.
    """
    roles = {j: _role_of(table.names[j]) for j in among or range(1, len(table.names))}
    stated = [j for j, role in roles.items() if role == _STANDARD_DEVIATION]
    others = {j: role for j, role in roles.items() if j not in stated}
    first = (wanted,) if wanted else (REFLECTANCE, ABSORBANCE, KUBELKA_MUNK)
    role = next((role for role in (*first, "") if role in others.values()), None)
    spectra = [j for j in others if role is None or others[j] == role]
    if spectra and role is None and not wanted:
        refused = others[spectra[0]]
        said = _REFUSALS.get(refused, f"{refused}, not a reflectance: {_TO_DO}")
        raise ValueError(f"column {table.names[spectra[0]]!r} holds {said}")
    if not spectra or len(stated) > 1 or (stated and len(spectra) > 1):
        names = [table.names[j] for j in roles]
        raise ValueError(f"columns {names}: need one spectrum (with its sd) or repeated scans")
    return spectra, stated, role or ""


def _role_of(header: str) -> str:
    """The role that a column's header gives it, or an empty text."""
    return next((role for role, form in _FORMS.items() if re.search(form, header, re.I)), "")


def _jcamp(path: str | Path) -> Columns:
    import jcamp

    try:
        found = jcamp.readfile(str(path))
        x, y = np.asarray(found["x"], float), np.asarray(found["y"], float)
    except Exception as error:  # of whatever kind its parser meets
        raise ValueError(f"not readable as JCAMP-DX ({error})") from None
    if x.size == 0 or x.shape != y.shape:
        raise ValueError("JCAMP-DX without a spectrum")
    given = str(found.get("xunits", "")).strip().upper()
    if not any(form.search(given) for form in _UNITS.values()):
        raise ValueError(f"XUNITS = {given or 'nothing'}; need nanometers, micrometers or 1/cm")
    names = [f"wavelength ({given})", str(found.get("yunits", "")).strip()]
    return Columns(np.stack([x, y], 1), names, [f"point {i + 1}" for i in range(x.size)], {})


def _in_nm(
    x: np.ndarray, where: np.ndarray, name: str, unit: str | None, notes: list[str]
) -> np.ndarray:
    for unit_named, form in _UNITS.items():
        unit = unit or (unit_named if form.search(name) else None)
    if unit is None and x.min() > 0.1 and x.max() < 10:
        unit = "um"
        notes.append("wavelengths read as µm (the file does not say; --wavelength-unit otherwise)")
    if unit == "1/cm" and not (x > 0).all():
        raise ValueError(f"{where[np.argmin(x)]}: a wavenumber of {x.min():g} 1/cm")
    return WAVELENGTH_UNITS[unit or "nm"](x)


def _in_range(x: np.ndarray, asked: tuple[float, float] | None, notes: list[str]) -> np.ndarray:
    """Which wavelengths are asked for and covered by the pigment tables."""
    (low, high), why = common_range(), "which the pigment tables cover"
    if asked is not None:
        given = f"{asked[0]:g} to {asked[1]:g} nm are asked for"
        if max(low, asked[0]) > min(high, asked[1]):
            raise ValueError(f"{given}; the pigment tables have {low:g} to {high:g} nm")
        low, high, why = max(low, asked[0]), min(high, asked[1]), "as asked"
    inside, span = (x >= low) & (x <= high), f"{low:g} to {high:g} nm"
    if not inside.any():
        raise ValueError(f"wavelengths {x.min():g} to {x.max():g} nm; none is within {span}")
    if not inside.all():
        left = f"{(~inside).sum()} of {inside.size} wavelengths left out"
        notes.append(f"{left}: only {span}, {why}")
    return inside


def _unit(
    scans: np.ndarray, unit: str | None, label: str, header: dict[str, str], notes: list[str]
) -> str:
    """The unit of reflectances, which the caller or the file states, or else their size implies."""
    if not np.median(scans) > 0:
        raise ValueError("half of the values or more are zero or negative: no reflectance")
    if unit is not None:
        return unit
    # Files that irisjax wrote hold fractions.
    said = "fraction" if "irisjax" in header else header.get("unit", "")
    if _PERCENT.search(f"{label} {said}"):
        return "percent"
    if re.search("fraction|^1$", said):
        return "fraction"
    top = float(np.max(scans))
    if top > 100:
        said = "are no reflectances, neither fractions nor per cent; are they counts?"
        raise ValueError(f"values up to {top:,.6g} {said}")
    if top > 2:
        notes.append("values read as per cent (the file does not say; --unit fraction otherwise)")
        return "percent"
    if top > _BRIGHT:
        raise ValueError(
            f"values up to {top:.3g} may be fractions (brighter than any iris) or per cent (a dark "
            "iris): give --unit percent or --unit fraction"
        )
    notes.append("values read as fractions (the file does not say; --unit percent otherwise)")
    return "fraction"


def _reflectance_of(values: np.ndarray, quantity: str) -> tuple[np.ndarray, np.ndarray]:
    """Reflectances of absorbances log₁₀(1/R) or of Kubelka and Munk's K/S = (1 − R)²/2R, and the
    sizes of their derivatives  [Kubelka & Munk 1931].
    """
    if quantity == ABSORBANCE:
        with np.errstate(over="ignore"):
            return 10.0**-values, np.log(10) * 10.0**-values
    found, root = thick_layer(values, 1.0, xp=np), np.sqrt(np.maximum(values * (values + 2), 0))
    return found, found / np.where(root > 0, root, np.inf)


def _doubts(reflectance: np.ndarray) -> tuple[str, ...]:
    """A doubt where the largest reflectance is not that of an iris."""
    top = float(np.max(reflectance))
    if top > _BRIGHT:
        return (f"reflectances up to {100 * top:.3g} %: brighter than any iris",)
    darker = f"reflectances of at most {100 * top:.2g} %: darker than any iris"
    return (darker,) if top < _DARK else ()
