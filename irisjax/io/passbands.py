"""Instruments in files: bands of a camera or of filters, and covariances of what was measured."""

import re
from pathlib import Path

import numpy as np

from irisjax.io.columns import SPECTRAL_ROLES, role_of
from irisjax.io.formats import read_spectral_table
from irisjax.io.tables import naming
from irisjax.io.text import read_columns, read_text
from irisjax.measure.passbands import Passbands
from irisjax.tissue.pigments import common_range

_CENTRE = re.compile(r"cent(re|er)|peak|middle|mitte", re.I)
_WIDTH = re.compile(r"fwhm|width|breite|largeur|hbw", re.I)
_WANTED = "need rows of centre and fwhm, nm, or a column with the sensitivity of each band"
_MOST_OUTSIDE = 0.02  # share of a band's light that the pigment tables do not cover


def read_passbands(path: str | Path, illuminant: str | None = None) -> Passbands:
    """Read the bands of an instrument.

    The table has either a row for each band, in columns named `centre` and `fwhm` (nm; Gaussian),
    or the wavelengths (nm) and a column with the sensitivity of each band, in any unit. Its layout
    may be any that `read_measured` reads.

    Args:
        path: The table.
        illuminant: See `Passbands.of`; not for centres and widths.

    Raises:
        ValueError: Naming the file and the problem, such as a band beyond the pigment tables.
    """
    with naming(path):
        table = read_spectral_table(path)
        named = [
            [j for j, n in enumerate(table.names) if form.search(n)] for form in (_CENTRE, _WIDTH)
        ]
        if all(named):
            centre, width = (table.values[:, columns[0]] for columns in named)
            if illuminant is not None:
                raise ValueError("centres and widths take no illuminant; give sensitivities")
            order = np.argsort(centre)
            return Passbands.slit(centre[order], width[order])
        if any(named) and len(table.names) == 2:
            known = ("centres", "widths") if named[0] else ("widths", "centres")
            raise ValueError(f"the file has {known[0]} of bands and no {known[1]}; {_WANTED}")
        roles = [role_of(name) for name in table.names[1:]]
        if roles and all(role in SPECTRAL_ROLES for role in roles):
            reason = f"column {table.names[1]!r} ({roles[0]}) is of a spectrum, not of bands"
            raise ValueError(f"{reason}; {_WANTED}")
        grid, sensitivities = table.values[:, 0], table.values[:, 1:]
        order = np.argsort(grid)
        grid, sensitivities = grid[order], sensitivities[order]
        for i, j in np.argwhere(~np.isfinite(table.values))[:1]:
            raise ValueError(f"{table.where[i]}: no finite number for {table.names[j]!r}")
        low, high = common_range()
        inside = (grid >= low) & (grid <= high)
        for name, column in zip(table.names[1:], sensitivities.T, strict=True):
            lost = column[~inside].sum() / max(column.sum(), 1e-300)
            if lost > _MOST_OUTSIDE:
                span = f"{low:g} to {high:g} nm, which the pigment tables cover"
                raise ValueError(f"{100 * lost:.0f} % of the band {name!r} is outside {span}")
        return Passbands.of(grid[inside], sensitivities[inside], illuminant)


def read_square(path: str | Path) -> np.ndarray:
    """Read a covariance, a square table of numbers (text) or an array (`.npy`)."""
    with naming(path):
        if Path(path).suffix.lower() == ".npy":
            array = np.load(path, allow_pickle=False)
        else:
            array = read_columns(read_text(path)).values
        if array.ndim != 2 or array.shape[0] != array.shape[1] or not np.isfinite(array).all():
            raise ValueError(f"need a square table of finite numbers, found shape {array.shape}")
    return array
