"""Absorption and scattering of a user's paints, in text tables."""

from pathlib import Path

import numpy as np

from irisjax.io.text import read_columns, read_text
from irisjax.ocularist.kubelka_munk import COEFFICIENT, KubelkaMunkMixer, paired

WAVELENGTH = "wavelength_nm"
"""Name of the first column."""
SURFACE = "saunderson"
"""Key of the header's line that gives k₁ and k₂."""


def read_paints(path: str | Path) -> KubelkaMunkMixer:
    """A mixer of the paints in a text table, as the package's own `ocularist/tables/paints.csv`.

    The first column is `wavelength_nm`, increasing; then each paint has a column `PAINT_K` and one
    `PAINT_S`, absorption and scattering, in one unit for all paints. Separators and encodings are
    as instruments and offices write them (`irisjax.io.text`). A line `# saunderson: 0.04 0.6` gives
    k₁ and k₂ of the paint's surface where K and S are without it.

    **Raises:** `ValueError` naming the file, the line where there is one, and the problem.
    """
    try:
        table = read_columns(path, read_text(path))
        if table.names[0] != WAVELENGTH:
            raise ValueError(f"the first column must be {WAVELENGTH}, not {table.names[0]!r}")
        pairs = paired(table.names[1:])
        if not pairs:
            raise ValueError("no paint beside the wavelengths")
        for row, where in zip(table.values, table.where, strict=True):
            for name, value in zip(table.names, row, strict=True):
                if not COEFFICIENT.holds(value):
                    raise ValueError(f"{where}: {name} = {value:g} is outside {COEFFICIENT}")
        coefficients = table.values[:, 1:].T
        k, s = (coefficients[[pair[i] for pair in pairs.values()]] for i in (0, 1))
        for p, i in np.argwhere(k + s == 0)[:1]:
            raise ValueError(f"{table.where[i]}: K and S of {list(pairs)[p]} are both 0")
        surface = _surface(table.header.get(SURFACE))
        return KubelkaMunkMixer(tuple(pairs), tuple(table.values[:, 0].tolist()), k, s, surface)
    except ValueError as error:
        said = str(error)
        raise ValueError(said if said.startswith(str(path)) else f"{path}: {said}") from None


def _surface(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        outside, inside = (float(part) for part in text.replace(",", " ").split())
    except ValueError:
        raise ValueError(f"{SURFACE}: {text!r} is not two numbers") from None
    return outside, inside
