"""The table of radiative transfer that comes with the package: LB06's indices, Rayleigh's law.

Writes irisjax/transport/radiative/tables/radiative.npz (made in double precision and
rounded to single; its error is measured in both).
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import irisjax as ij
from irisjax.transport.radiative.tabulated import RadiativeTabulated


def main() -> None:
    """Make the table again; nothing in it is random."""
    with jax.enable_x64(True):
        table = RadiativeTabulated.build(ij.Iris().indices())
    with jax.enable_x64(False):
        single = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), table)._measure()
    arrays = {}
    for name in ("out", "ends", "multiple"):
        part = getattr(table, name)
        # Rounding is a hundredth of the error.
        arrays[f"{name}_core"] = np.asarray(part.core, np.float32)
        arrays |= {f"{name}_{i}": np.asarray(x, np.float32) for i, x in enumerate(part.factors)}
    path = Path(ij.__file__).parent / "transport" / "radiative" / "tables" / "radiative.npz"
    np.savez_compressed(
        path,
        indices=[float(n) for n in jax.tree.leaves(table.indices)],
        error_float64=table.error,
        error_float32=single,
        **arrays,
    )
    print(f"relative errors: {table.error:.1e}, in single precision {single:.1e}")


if __name__ == "__main__":
    main()
