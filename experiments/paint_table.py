"""The absorption and scattering of the paints that come with the package, constructed from their
colours.

Writes irisjax/ocularist/tables/paints.csv.
"""

from pathlib import Path

import numpy as np

import irisjax as ij
from irisjax.io.tables import format_table
from irisjax.ocularist.kubelka_munk import PAINT_SCATTERING, constructed_absorption
from irisjax.ocularist.mixing import FURTHER_PAINTS, PAINTS, linear_colour

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
    for name, paint in {**PAINTS, **FURTHER_PAINTS}.items():
        scattering = np.full_like(WAVELENGTHS, PAINT_SCATTERING[name])
        absorption = constructed_absorption(
            linear_colour(name, paint.srgb), WAVELENGTHS, scattering
        )
        columns[f"{name}_K"] = np.array([float(f"{k:.6g}") for k in absorption])
        columns[f"{name}_S"] = scattering
    path = Path(ij.__file__).parent / "ocularist" / "tables" / "paints.csv"
    path.write_text(format_table(HEADER, columns), encoding="utf-8")


if __name__ == "__main__":
    main()
