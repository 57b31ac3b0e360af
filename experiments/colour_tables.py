"""The CIE's observers and illuminants that come with the package, from colour-science.

Writes irisjax/measure/tables/cie.npz: importing colour-science would take longer than all else
that a colour needs.
"""

from pathlib import Path

import colour
import numpy as np

import irisjax as ij
from irisjax.measure.colour import OBSERVERS


def main() -> None:
    """Read the tables from the installed colour-science; nothing in them is computed."""
    tables = {}
    for name in OBSERVERS:
        spectra = colour.MSDS_CMFS[name]
        tables[f"observer {name}"] = np.vstack([spectra.wavelengths, spectra.values.T])
    for name, spectrum in colour.SDS_ILLUMINANTS.items():
        tables[f"illuminant {name}"] = np.stack([spectrum.wavelengths, spectrum.values])
    np.savez_compressed(Path(ij.__file__).parent / "measure" / "tables" / "cie.npz", **tables)


if __name__ == "__main__":
    main()
