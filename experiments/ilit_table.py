"""The table of layer functions that comes with the package: ILIT as printed, LB06's indices.

Writes irisjax/transport/ilit/tables/ilit_2006.npz (made in double precision).
"""

from pathlib import Path

import jax
import numpy as np

import irisjax as ij


def main() -> None:
    """Make the table again; nothing in it is random."""
    table = ij.IlitTabulated.build(ij.Iris().indices(), ij.ILIT_2006)
    indices = [float(n) for n in jax.tree.leaves(table.indices)]
    path = Path(ij.__file__).parent / "transport" / "ilit" / "tables" / "ilit_2006.npz"
    np.savez_compressed(
        path,
        abl=np.asarray(table.abl),
        stroma=np.asarray(table.stroma),
        indices=indices,
        error=table.error,
    )


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
