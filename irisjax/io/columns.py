"""Files of spectrometers as tables whose columns have roles by their headers."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from irisjax.infer.observation import RADIANCE, REFLECTANCE
from irisjax.io.text import Columns, read_columns, read_text

ABSORBANCE, KUBELKA_MUNK = "absorbance", "kubelka-munk"
QUANTITIES = (REFLECTANCE, RADIANCE, ABSORBANCE, KUBELKA_MUNK)
"""Roles whose columns can become a spectrum."""

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
_JCAMP_UNITS = {
    **dict.fromkeys(("NANOMETERS", "NANOMETRES", "NM"), "nm"),
    **dict.fromkeys(("MICROMETERS", "MICROMETRES"), "um"),
    "1/CM": "1/cm",
}


class Selection(NamedTuple):
    """Columns of one spectrum, by their index.

    Attributes:
        spectra: Scans of it, all of one role.
        sd: Its standard deviation, or `None`.
        role: Of the scans; empty where no header gives it.
        label: Header of the first scan.
    """

    spectra: list[int]
    sd: int | None
    role: str
    label: str


def read_spectral_table(path: str | Path) -> Columns:
    """Read the table of a text file or of JCAMP-DX, which begins with `##TITLE`.

    The first column becomes the wavelength or wavenumber: that of the file, unless the header of
    another says that it is.
    """
    text = read_text(path)
    table = _jcamp(path) if text.lstrip().startswith("##") else read_columns(text)
    first = next((j for j, name in enumerate(table.names) if _WAVELENGTH.search(name)), 0)
    order = [first, *(j for j in range(len(table.names)) if j != first)]
    return table._replace(values=table.values[:, order], names=[table.names[j] for j in order])


def select(table: Columns, wanted: str | None, among: list[int] | None = None) -> Selection:
    """Choose the columns of one spectrum.

    Columns of reflectance come first, then those of absorbance and of K/S, then those without a
    role; others, such as counts and references beside a reflectance, are left out.

    Args:
        table: The table.
        wanted: The role to take; by default the first one there is.
        among: Columns to choose from, by their index; by default all but the first.
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
    return Selection(spectra, stated[0] if stated else None, role or "", table.names[spectra[0]])


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
    if given not in _JCAMP_UNITS:
        raise ValueError(f"XUNITS = {given or 'nothing'}; need nanometers, micrometers or 1/cm")
    names = [f"wavelength ({_JCAMP_UNITS[given]})", str(found.get("yunits", "")).strip()]
    return Columns(np.stack([x, y], 1), names, [f"point {i + 1}" for i in range(x.size)], {})
