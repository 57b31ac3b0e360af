"""What the columns of a spectrometer's file hold, and their way to reflectances."""

import re
from typing import Any, NamedTuple

import numpy as np

from irisjax.optics.kubelka_munk import thick_layer

REFLECTANCE, RADIANCE, ABSORBANCE, KUBELKA_MUNK = (
    "reflectance",
    "radiance",
    "absorbance",
    "kubelka-munk",
)
QUANTITIES = (REFLECTANCE, RADIANCE, ABSORBANCE, KUBELKA_MUNK)
"""What a file may hold."""

_SD = "standard deviation"
_FORMS = {
    _SD: r"^(sd|std|stdev|sigma|standard[ _](deviation|error)|uncertainty)\b",
    ABSORBANCE: r"absorb|extinction|optical density|\bOD\b|\bA\.?U\b|log\W*1\s*/\s*[RT]\b",
    KUBELKA_MUNK: r"kubelka|munk|\bk\s*/\s*s\b|\bf\(r",
    "transmittance": r"transmi|%\s*T\b|\bT\s*\(?%",
    "irradiance": r"irradian|[µμu]W",
    REFLECTANCE: r"reflect|reflex|remission|albedo|^R\b|%\s*R\b",
    RADIANCE: r"radiance",
    "counts": r"count|scope|intensity|\braw\b|\badu\b|\bdn\b|\bdark\b|\bwhite\b|^ref(erence)?\b",
    "arbitrary units": r"arbitrary",
}
_KINDS = {kind: re.compile(form, re.I) for kind, form in _FORMS.items()}
_PERCENT = re.compile(r"%|per\s?cent", re.I)
_BRIGHT, _DARK = 0.4, 0.002
"""Between these lies the largest reflectance of any iris: ILIT gives 0.12 without any pigment, and
0.0024, the first surface's alone, under 8 µg/mm² of melanin."""


class Chosen(NamedTuple):
    """Which columns are spectra (scans of one), which their standard deviation; the kind of them,
    "" where no name says it, and how it reads."""

    spectra: list[int]
    sd: int | None
    kind: str
    label: str


def kind_of(label: str) -> str:
    """What a label says that its numbers are, "" for nothing."""
    return next((kind for kind, form in _KINDS.items() if form.search(label)), "")


def choose_columns(names: list[str], wanted: str | None) -> Chosen:
    """The columns behind the first one that are to be read.

    Beside a reflectance (or what becomes one) counts and references are left out.

    Raises:
        ValueError: Where none is what is wanted, or more than one kind is.
    """
    kinds = {j: kind_of(name) for j, name in enumerate(names) if j}
    stated = [j for j, kind in kinds.items() if kind == _SD]
    others = {j: kind for j, kind in kinds.items() if kind != _SD}
    first = (wanted,) if wanted else (REFLECTANCE, ABSORBANCE, KUBELKA_MUNK)
    for kind in (*first, ""):
        spectra = [j for j, k in others.items() if k == kind]
        if spectra:
            break
    else:
        spectra = list(others)
        kind = others[spectra[0]] if spectra else ""
        if spectra and not wanted:
            raise ValueError(_refusal(names[spectra[0]], kind))
    if not spectra or len(stated) > 1 or (stated and len(spectra) > 1):
        raise ValueError(f"columns {names[1:]}: need one spectrum (with its sd) or repeated scans")
    return Chosen(spectra, stated[0] if stated else None, kind, names[spectra[0]])


def _refusal(name: str, kind: str) -> str:
    if kind == RADIANCE:
        return f"column {name!r} holds a radiance; give --quantity radiance"
    if kind == "transmittance":
        return (
            f"column {name!r} holds a transmittance; where it is the light sent back, give "
            f"--quantity reflectance"
        )
    return (
        f"column {name!r} holds {kind}, not a reflectance: divide the light of the eye by that of "
        f"a white reference, both less the dark signal"
    )


def as_reflectance(y: np.ndarray, sd: Any, quantity: str) -> tuple[np.ndarray, np.ndarray | None]:
    """Reflectances (and their standard deviations) of absorbances log₁₀(1/R) or of Kubelka and
    Munk's K/S = (1 − R)²/2R  [Kubelka & Munk 1931].
    """
    if quantity == ABSORBANCE:
        with np.errstate(over="ignore"):
            found = 10.0**-y
        slope = np.log(10) * found
    else:
        found = thick_layer(y, 1.0, xp=np)
        root = np.sqrt(np.maximum(y * (y + 2), 0))
        slope = found / np.where(root > 0, root, np.inf)
    return found, None if sd is None else slope * sd


def percent(y: np.ndarray, unit: str | None, label: str, said: str = "") -> tuple[bool, str]:
    """Whether reflectances are per cent, and a word on what was assumed, "" where nothing was.

    `unit`: "percent" or "fraction" if it is known; `said`: a unit that the file's header gives.

    Raises:
        ValueError: Where numbers are no reflectances, or could be either.
    """
    top = float(np.max(y))
    if unit is None and _PERCENT.search(f"{label} {said}"):
        unit = "percent"
    elif unit is None and re.search("fraction|^1$", said):
        unit = "fraction"
    if unit is not None:
        return unit == "percent", ""
    if top > 100:
        raise ValueError(
            f"values up to {top:,.6g} are no reflectances, neither fractions nor per cent; are "
            f"they counts?"
        )
    if top > 2:
        return True, "values read as per cent (the file does not say; --unit fraction otherwise)"
    if top > _BRIGHT:
        raise ValueError(
            f"values up to {top:.3g} may be fractions (brighter than any iris) or per cent (a dark "
            f"iris): give --unit percent or --unit fraction"
        )
    return False, "values read as fractions (the file does not say; --unit percent otherwise)"


def doubt(y: np.ndarray) -> str:
    """A word where the largest of some reflectances is none of an iris, else ""."""
    top = float(np.max(y))
    if top > _BRIGHT:
        return f"reflectances up to {100 * top:.3g} %: brighter than any iris"
    if top < _DARK:
        return f"reflectances of at most {100 * top:.2g} %: darker than any iris"
    return ""
