"""Measured spectra from files of instruments: the columns that `irisjax.io.columns` chooses become
wavelengths in nm and reflectances as fractions (or radiances).
"""

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple, TypedDict, Unpack

import numpy as np
import scipy.ndimage
from jaxtyping import Float

from irisjax.infer.observation import RADIANCE, REFLECTANCE, mean_of_scans
from irisjax.io.columns import ABSORBANCE, KUBELKA_MUNK, QUANTITIES, Selection, eyes_of, select
from irisjax.io.formats import BOXCAR, ELSE, UNITS, read_spectral_table
from irisjax.io.tables import naming
from irisjax.io.text import Columns
from irisjax.measure.passbands import BANDWIDTH
from irisjax.numerics.checks import check_range
from irisjax.optics.kubelka_munk import thick_layer
from irisjax.tissue.pigments import common_range

REFLECTANCE_UNITS = ("fraction", "percent")
WAVELENGTH_UNITS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "nm": lambda x: x,
    "um": lambda x: 1e3 * x,
    "1/cm": lambda x: 1e7 / x,
}
"""Units of a first column, and its conversion to nm."""

_NO_WAVELENGTH = re.compile(
    r"hz\b|frequen|\beV\b|energ|Å|angstr|\(m\)|pixel|index|channel|shift|"
    r"^(band|time|date|year|no)\b",
    re.I,
)
_PERCENT = re.compile(r"%|per\s?cent|prozent|pour\s?cent", re.I)
_FRACTION = re.compile(r"fraction|^1$|\[1(\.0)?\]|0\s*(-|–|to)\s*1\b", re.I)
# Headers of standard deviations that are relative to each value, or k times as large (expanded).
_RELATIVE = re.compile(r"(?<![^\W_])rel(ative)?(?![^\W_])", re.I)
_EXPANDED = re.compile(r"k\s*=\s*(\d(?:\.\d+)?)|^\W*(\d)\W*(?:sd|σ|sigma)", re.I)
# The largest reflectance of any iris lies between these: ILIT gives 0.12 without any pigment, and
# 0.0024, the first surface's alone, under 8 µg/mm² of melanin.
_BRIGHT, _DARK = 0.4, 0.002
_NEGATIVE = 0.05  # share of negative values that is doubted
_IMPOSSIBLE = 1.2  # as a fraction, calibration aside
_NEIGHBOURS = 5  # wavelengths whose median tells a wild value
_WILD = 10.0  # times the median distance of values from their neighbours


class Measured(NamedTuple):
    """A spectrum from a file, its wavelengths in nm and increasing.

    Attributes:
        values: Reflectances as fractions; radiances in the file's unit.
        sd: Their standard deviations, or `None`.
        notes: What was detected, assumed and done (units, repeated scans, values left out).
        header: Lines `# key: value` of the file.
        doubts: Values that no iris has.
        correlated: Width of the moving average over which errors are correlated, nm, where the file
            states a boxcar.
        bandwidth: Full width at half maximum of the instrument's slit, nm, where the file states
            it.
        rows: Places of the values among all in the file, and how many these are; `None` for those
            that no file holds.
    """

    wavelengths: Float[np.ndarray, " wavelengths"]
    values: Float[np.ndarray, " wavelengths"]
    sd: Float[np.ndarray, " wavelengths"] | None
    notes: tuple[str, ...]
    header: dict[str, str]
    doubts: tuple[str, ...] = ()
    correlated: float | None = None
    bandwidth: float | None = None
    rows: tuple[tuple[int, ...], int] | None = None

    def select(self, covariance: np.ndarray) -> np.ndarray:
        """Select the rows and columns of these values from a covariance in the file's order.

        Raises:
            ValueError: The covariance has another size than the file.
        """
        places, count = self.rows or (range(len(self.values)), len(self.values))
        if covariance.shape != (count, count):
            size = " by ".join(map(str, covariance.shape))
            raise ValueError(
                f"the covariance is {size}; it must be {count} by {count}, a row for each "
                "wavelength of the file, in its order"
            )
        return covariance[np.ix_(places, places)]


class ReadOptions(TypedDict, total=False):
    """How to read a file; what is absent or `None` is as the file says, or by its numbers.

    Attributes:
        quantity: One of `QUANTITIES`.
        unit: Of reflectances, one of `REFLECTANCE_UNITS`.
        wavelength_unit: One of `WAVELENGTH_UNITS`.
        wavelengths: The least and the largest wavelength to keep, nm.
        column: Name of the column that holds the spectrum, or a part of it that no other has.
        sd: The same of its standard deviation.
    """

    quantity: str | None
    unit: str | None
    wavelength_unit: str | None
    wavelengths: tuple[float, float] | None
    column: str | None
    sd: str | None


def read_measured(path: str | Path, **how: Unpack[ReadOptions]) -> Measured:
    """Read a measured spectrum, as `ReadOptions` say, such as `quantity="absorbance"`.

    Text tables in UTF-8, UTF-16, cp1252 or Shift-JIS, separated by tabs, semicolons, commas or
    blanks, with decimal points or commas, below any preamble; a spectrum a row or a column; Excel,
    JCAMP-DX, CGATS and SVC. The documentation lists the instruments. The first column is the
    wavelength unless another's name says so. The names of the others give them their roles: a
    reflectance, an absorbance log₁₀(1/R) or Kubelka–Munk's K/S is the spectrum, and a standard
    deviation belongs to the spectrum that its name names. Several spectra are repeated scans where
    their names differ in a number only, or their values by no more than noise: their mean is used,
    and their scatter gives its standard deviation.

    Wavelengths that the pigment tables do not cover, or outside `wavelengths`, are left out, and so
    are those without a value.

    Raises:
        ValueError: naming the file, the row and the problem, such as numbers that are no
            reflectances, or could be fractions as well as per cent.
    """
    options = (how.get(name) for name in ("quantity", "column", "sd"))
    with naming(path):
        _check(how)
        table = read_spectral_table(path)
        return _spectrum(table, how, select(table, *options))


def read_eyes(path: str | Path, **how: Unpack[ReadOptions]) -> dict[str, Measured | ValueError]:
    """Read the spectra of many eyes in one table, a column or a row each.

    A standard deviation belongs to the eye that its name names, and columns or rows of one name are
    scans of one eye.

    Returns:
        The spectra by name, or the error of a column that is none.

    Raises:
        ValueError: naming the file and a problem of the whole table.
    """
    eyes: dict[str, Measured | ValueError] = {}
    with naming(path):
        _check(how)
        if how.get("column") or how.get("sd"):
            raise ValueError("each column is an eye: no column can be chosen")
        table = read_spectral_table(path)
    for name, columns in eyes_of(table).items():
        try:
            eyes[name] = _spectrum(table, how, select(table, how.get("quantity"), among=columns))
        except ValueError as error:
            eyes[name] = error
    return eyes


def _check(how: ReadOptions) -> None:
    known = {"quantity": QUANTITIES, "unit": REFLECTANCE_UNITS, "wavelength_unit": WAVELENGTH_UNITS}
    for name, allowed in known.items():
        if (value := how.get(name)) not in (None, *allowed):
            raise ValueError(f"{name} must be one of {', '.join(allowed)}, got {value!r}")


def _spectrum(table: Columns, how: ReadOptions, selection: Selection) -> Measured:
    notes = [*table.notes, *selection.notes]
    columns = [0, *selection.spectra, *([] if selection.sd is None else [selection.sd])]
    values, where = table.values[:, columns], np.array(table.where)
    for i, j in np.argwhere(np.isinf(values))[:1]:
        raise ValueError(f"{where[i]}: {values[i, j]} is not a finite number")
    valid = ~np.isnan(values).any(axis=1)
    if not valid.any():
        raise ValueError("no wavelength has a value")
    if not valid.all():
        notes.append(f"{(~valid).sum()} of {valid.size} wavelengths without a value skipped")
    given, values, where = np.flatnonzero(valid), values[valid], where[valid]
    x = _in_nm(values[:, 0], where, table.names[0], how.get("wavelength_unit"), notes)
    valid = within_range(x, how.get("wavelengths"), notes)
    order = np.flatnonzero(valid)[np.argsort(x[valid], kind="stable")]
    x, where = x[order], where[order]
    for i in np.flatnonzero(np.diff(x) == 0)[:1]:
        raise ValueError(f"{where[i + 1]}: {x[i]:g} nm appears twice")
    count = len(selection.spectra)
    scans, sd = values[order, 1 : count + 1], values[order, count + 1 :]
    if sd.size and not sd.any():
        notes.append("standard deviations of zero are none")
        sd, selection = sd[:, :0], selection._replace(sd=None)
    elif sd.size:
        sd = sd * _factor_of_sd(table.names[columns[-1]], scans)
    if ELSE in table.header and not (how.get("quantity") or selection.role):
        message = f"the preamble or the name of the file says {table.header[ELSE]!r}"
        raise ValueError(f"{message}: give --quantity, {', '.join(QUANTITIES)}")
    quantity = how.get("quantity") or selection.role or REFLECTANCE
    if quantity in (ABSORBANCE, KUBELKA_MUNK):
        form = "log10(1/R)" if quantity == ABSORBANCE else "(1 - R)²/2R"
        notes.append(f"{quantity} {form} converted to reflectance")
        scans, slope = _reflectance_of(scans, quantity)
        sd = slope[:, :1] * sd
    elif quantity == REFLECTANCE:
        unit = reflectance_unit(scans, how.get("unit"), selection.label, table.header, notes)
        if selection.sd is not None:
            _check_unit_of_sd(table.names[columns[-1]], unit, notes)
        scale = 100 if unit == "percent" else 1
        scans, sd = scans / scale, sd / scale
    doubts = () if quantity == RADIANCE else _doubts(x, scans)
    y, scatter = mean_of_scans(scans)
    if count > 1:
        notes.append(f"mean of {count} scans; their scatter is the noise")
        if scatter is None:
            notes.append("the scans are equal: their scatter says nothing about the noise")
    noise = scatter if selection.sd is None else sd[:, 0]
    if noise is not None:
        for i in np.flatnonzero(~(noise > 0))[:1]:
            raise ValueError(f"{where[i]}: standard deviation {noise[i]:g}; it must be > 0")
    correlated, bandwidth = _resolution(table, x, notes)
    rows = tuple(given[order].tolist()), len(table.values)
    return Measured(x, y, noise, tuple(notes), table.header, doubts, correlated, bandwidth, rows)


def _resolution(
    table: Columns, x: np.ndarray, notes: list[str]
) -> tuple[float | None, float | None]:
    """Widths of a moving average and of a slit, nm, that the file states."""
    correlated, bandwidth = None, None
    boxcar = int(table.header.get(BOXCAR, 0))
    if boxcar and x.size > 1:
        pixels = 2 * boxcar + 1
        correlated = round(pixels * float(np.median(np.diff(x))), 3)
        notes.append(
            f"noise correlated over {correlated:g} nm ({pixels} pixels), as the file's boxcar of "
            f"{boxcar} says; --boxcar {correlated:g} if the spectrum itself is smoothed so much"
        )
    if "bandwidth" in table.header:
        try:
            bandwidth = float(table.header["bandwidth"].split()[0])
            check_range("bandwidth", bandwidth, BANDWIDTH)
        except (ValueError, IndexError):
            width = table.header["bandwidth"]
            raise ValueError(f"bandwidth: {width!r} is no width in nm") from None
        notes.append(f"bandwidth of {bandwidth:g} nm, as the file says; --bandwidth otherwise")
    return correlated, bandwidth


def _in_nm(
    x: np.ndarray, where: np.ndarray, name: str, unit: str | None, notes: list[str]
) -> np.ndarray:
    for unit_named, form in UNITS.items():
        unit = unit or (unit_named if form.search(name) else None)
    if unit is None and _NO_WAVELENGTH.search(name):
        known = ", ".join(WAVELENGTH_UNITS)
        raise ValueError(f"column {name!r} is no wavelength; convert it to one of {known}")
    if unit is None and x.min() > 0.1 and np.median(x) < 20:
        unit = "um"
        notes.append("wavelengths read as µm (the file does not say; --wavelength-unit otherwise)")
    if unit == "1/cm" and not (x > 0).all():
        raise ValueError(f"{where[np.argmin(x)]}: a wavenumber of {x.min():g} 1/cm")
    return WAVELENGTH_UNITS[unit or "nm"](x)


def within_range(x: np.ndarray, limits: tuple[float, float] | None, notes: list[str]) -> np.ndarray:
    """Which wavelengths are asked for and covered by the pigment tables."""
    (low, high), reason = common_range(), "which the pigment tables cover"
    if limits is not None:
        request = f"{limits[0]:g} to {limits[1]:g} nm are asked for"
        if max(low, limits[0]) > min(high, limits[1]):
            raise ValueError(f"{request}; the pigment tables have {low:g} to {high:g} nm")
        low, high, reason = max(low, limits[0]), min(high, limits[1]), "as asked"
    inside, span = (x >= low) & (x <= high), f"{low:g} to {high:g} nm"
    if not inside.any():
        hint = "; --wavelength-unit if they are in another unit" if limits is None else ""
        raise ValueError(f"wavelengths {x.min():g} to {x.max():g} nm; none is within {span}{hint}")
    if not inside.all():
        left = f"{(~inside).sum()} of {inside.size} wavelengths left out"
        notes.append(f"{left}: only {span}, {reason}")
    return inside


def reflectance_unit(
    scans: np.ndarray, unit: str | None, label: str, header: Mapping[str, str], notes: list[str]
) -> str:
    """The unit of reflectances, which the caller or the file states, or else their size implies."""
    if not np.median(scans) > 0:
        raise ValueError("half of the values or more are zero or negative: no reflectance")
    if unit is not None:
        return unit
    # Files that irisjax wrote hold fractions.
    name = "fraction" if "irisjax" in header else header.get("unit", "")
    if _PERCENT.search(f"{label} {name}"):
        return "percent"
    if re.search("‰|per ?mille|promille", label, re.I):
        raise ValueError(f"column {label!r}: give per cent or fractions")
    if _FRACTION.search(name) or _FRACTION.search(label):
        return "fraction"
    # One wild pixel must not decide, so the largest value is that of medians.
    middle, top = float(np.median(scans)), float(np.max(_smooth(scans)))
    if middle > 100:
        reason = "are no reflectances, neither fractions nor per cent; are they counts?"
        raise ValueError(f"values up to {np.max(scans):,.6g} {reason}")
    if top > _IMPOSSIBLE and middle > _BRIGHT / 2:
        notes.append("values read as per cent (the file does not say; --unit fraction otherwise)")
        return "percent"
    if top > _BRIGHT and middle > _BRIGHT / 4:
        raise ValueError(
            f"values up to {top:.3g} may be fractions (brighter than any iris) or per cent (a dark "
            "iris): give --unit percent or --unit fraction"
        )
    notes.append("values read as fractions (the file does not say; --unit percent otherwise)")
    return "fraction"


def _factor_of_sd(name: str, scans: np.ndarray) -> np.ndarray | float:
    """Factor on a standard deviation that is stated relative to the values or k times as large."""
    stated = _EXPANDED.search(name)
    factor = 1 / float(stated[1] or stated[2]) if stated else 1.0
    if not _RELATIVE.search(name):
        return factor
    return factor * np.abs(scans) / (100 if _PERCENT.search(name) else 1)


def _check_unit_of_sd(name: str, unit: str, notes: list[str]) -> None:
    if _RELATIVE.search(name):
        return
    if unit == "percent" and not _PERCENT.search(name):
        notes.append(f"column {name!r} read as per cent, as the values")
    other = _FRACTION if unit == "percent" else _PERCENT
    if other.search(name):
        to_do = "in the unit of the values, or call it 'relative sd' (of each value)"
        raise ValueError(f"column {name!r} is beside a {unit}: give it {to_do}")


def _smooth(scans: np.ndarray) -> np.ndarray:
    """Each value's median with its neighbours in wavelength."""
    size = min(_NEIGHBOURS, len(scans) - (len(scans) + 1) % 2)
    return scipy.ndimage.median_filter(scans, size=(max(size, 1), 1), mode="mirror")


def _reflectance_of(values: np.ndarray, quantity: str) -> tuple[np.ndarray, np.ndarray]:
    """Reflectances of absorbances log₁₀(1/R) or of Kubelka and Munk's K/S = (1 − R)²/2R, and the
    sizes of their derivatives  [Kubelka & Munk 1931].
    """
    if quantity == ABSORBANCE:
        with np.errstate(over="ignore"):
            return 10.0**-values, np.log(10) * 10.0**-values
    thick, root = thick_layer(values, 1.0, xp=np), np.sqrt(np.maximum(values * (values + 2), 0))
    return thick, thick / np.where(root > 0, root, np.inf)


def _doubts(x: np.ndarray, reflectance: np.ndarray) -> tuple[str, ...]:
    """Doubts where a value is far from its neighbours, or the largest is not that of an iris."""
    wild = _outliers(reflectance)
    doubts = []
    if (negative := (reflectance < 0).mean()) > _NEGATIVE:
        doubts.append(f"{100 * negative:.0f} % of the reflectances are negative: dark signal?")
    if 0 < wild.size <= max(1, x.size // 10):
        listing = ", ".join(f"{v:g}" for v in x[wild][:5]) + (", ..." if wild.size > 5 else "")
        doubts.append(
            f"at {listing} nm far from the neighbouring values: a wild pixel? --outliers keeps it "
            "from moving the fit, --wavelengths LOW:HIGH leaves it out"
        )
        reflectance = np.delete(reflectance, wild, axis=0)
    if reflectance.size == 0:
        return tuple(doubts)
    top = float(np.max(reflectance))
    if top > _BRIGHT:
        doubts.append(f"reflectances up to {100 * top:.3g} %: brighter than any iris")
    elif top < _DARK:
        doubts.append(f"reflectances of at most {100 * top:.2g} %: darker than any iris")
    return tuple(doubts)


def _outliers(values: np.ndarray) -> np.ndarray:
    """Rows where a scan is twice the largest or half the smallest of its four neighbours, and much
    further from them than its other values are.
    """
    n = len(values)
    if n < _NEIGHBOURS:
        return np.zeros(0, int)
    rows = np.arange(n)[:, None] + np.array([-2, -1, 1, 2])
    near = np.where(((rows >= 0) & (rows < n))[..., None], values[rows.clip(0, n - 1)], np.nan)
    low, middle, high = (f(near, axis=1) for f in (np.nanmin, np.nanmedian, np.nanmax))
    deviation = np.abs(values - middle)
    lone = (values > 2 * high) | (values < 0.5 * low)
    return np.flatnonzero((lone & (deviation > _WILD * np.median(deviation, axis=0))).any(axis=1))
