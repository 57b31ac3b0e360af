"""The table of radiative transfer that comes with the package: LB06's indices, Rayleigh's law.

Writes irisjax/transport/radiative/tables/radiative.npz (made in double precision; its error is
measured in both).
"""

from pathlib import Path

import jax
import numpy as np

import irisjax as ij
from irisjax.transport.radiative.tabulated import RadiativeTabulated


def main() -> None:
    """Make the table again; nothing in it is random."""
    with jax.enable_x64(False):
        single = RadiativeTabulated.build(ij.Iris().indices())
    with jax.enable_x64(True):
        table = RadiativeTabulated.build(ij.Iris().indices())
    arrays = {}
    for name in ("out", "ends", "multiple"):
        part = getattr(table, name)
        arrays[f"{name}_core"] = np.asarray(part.core)
        arrays |= {f"{name}_{i}": np.asarray(x) for i, x in enumerate(part.factors)}
    path = Path(ij.__file__).parent / "transport" / "radiative" / "tables" / "radiative.npz"
    np.savez_compressed(
        path,
        pole=np.asarray(table.pole),
        indices=[float(n) for n in jax.tree.leaves(table.indices)],
        error_float64=table.error,
        error_float32=single.error,
        **arrays,
    )
    print(f"relative errors: {table.error:.1e}, in single precision {single.error:.1e}")


if __name__ == "__main__":
    main()
