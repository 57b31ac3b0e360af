"""The absorption and scattering of the paints that come with the package, constructed from their
colours.

Writes irisjax/ocularist/tables/paints.csv.
"""

from pathlib import Path

import numpy as np

import irisjax as ij
from irisjax.io.tables import format_table
from irisjax.ocularist.kubelka_munk import constructed_absorption
from irisjax.ocularist.mixing import FURTHER_PAINTS, PAINTS, linear_colour

# Round numbers of the order of artists' oils [Okumura 2005]: earths and blacks scatter little, so
# that a white takes much of them; a blue with the scattering of a white would swallow any yellow.
PAINT_SCATTERING = {
    "ivory black": 0.005,
    "titanium white": 1.0,
    "yellow ochre": 0.1,
    "burnt sienna": 0.06,
    "burnt umber": 0.03,
    "ultramarine": 0.03,
    "phthalo blue": 0.03,
    "cadmium yellow": 0.2,
    "cadmium red": 0.1,
    "raw sienna": 0.08,
    "raw umber": 0.03,
}
"""S of the paints that come with the package, relative to titanium white's."""

WAVELENGTHS = np.arange(400.0, 701.0, 10.0)
HEADER = {
    "paints": "absorption K and scattering S, S of titanium white = 1 (irisjax.ocularist)",
    "source": "CONSTRUCTED, not measured, by experiments/paint_table.py. The masstone's reflectance"
    " is the smoothest with the paint's sRGB colour (Burns 2020, least hyperbolic tangent slope"
    " squared), S is grey and given, K = S (1 - R)^2/2R (Kubelka & Munk 1931).",
}


def main() -> None:
    """Construct each paint's K to six digits."""
    columns = {"wavelength_nm": WAVELENGTHS}
    for name, colour in {**PAINTS, **FURTHER_PAINTS}.items():
        scattering = np.full_like(WAVELENGTHS, PAINT_SCATTERING[name])
        linear = linear_colour(name, colour)
        absorption = constructed_absorption(linear, WAVELENGTHS, scattering)
        columns[f"{name}_K"] = np.array([float(f"{k:.6g}") for k in absorption])
        columns[f"{name}_S"] = scattering
    path = Path(ij.__file__).parent / "ocularist" / "tables" / "paints.csv"
    path.write_text(format_table(HEADER, columns), encoding="utf-8")


if __name__ == "__main__":
    main()
