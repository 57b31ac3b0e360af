"""The table of LB06's iris, which comes with the package: most inversions need no other.

`python -m experiments.ilit_table` makes it; tests/transport/test_shipped.py makes it again.
"""

import functools
from importlib import resources

import jax
import jax.numpy as jnp
import numpy as np

from irisjax.tissue.indices import RefractiveIndices
from irisjax.transport.ilit.tabulated import IlitTabulated
from irisjax.transport.process import ILIT_2006, Ilit


def table(indices: RefractiveIndices, process: Ilit = ILIT_2006) -> IlitTabulated:
    """`IlitTabulated.build(indices, process)`, read from the package for `ILIT_2006` and the
    indices of LB06's iris in double precision.
    """
    numbers = tuple(float(n) for n in jax.tree.leaves(indices))
    return _table(numbers, process, str(jnp.result_type(float)))


@functools.lru_cache(maxsize=8)
def _table(indices: tuple[float, ...], process: Ilit, dtype: str) -> IlitTabulated:
    wanted = RefractiveIndices(*(jnp.asarray(n, dtype) for n in indices))
    if process == ILIT_2006 and dtype == "float64":
        stored = _stored()
        # Rounding of one library or another, not other tissue.
        if np.allclose(stored["indices"], indices, rtol=1e-14, atol=0):
            return IlitTabulated(
                abl=jnp.asarray(stored["abl"]),
                stroma=jnp.asarray(stored["stroma"]),
                indices=wanted,
                process=process,
                error=float(stored["error"]),
            )
    return IlitTabulated.build(wanted, process)


def _stored() -> dict[str, np.ndarray]:
    file = resources.files("irisjax.transport.ilit") / "tables" / "ilit_2006.npz"
    with file.open("rb") as opened, np.load(opened) as arrays:
        return dict(arrays)
