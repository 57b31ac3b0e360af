"""The table of radiative transfer in LB06's iris, which comes with the package.

`python -m experiments.radiative_table` makes it; tests/transport/test_radiative_tabulated.py makes
it again.
"""

import functools
from importlib import resources

import jax
import jax.numpy as jnp
import numpy as np

from irisjax.numerics.tucker import Tucker
from irisjax.tissue.indices import RefractiveIndices
from irisjax.transport.radiative.tabulated import RadiativeTabulated


def table(indices: RefractiveIndices) -> RadiativeTabulated:
    """`RadiativeTabulated.build(indices)`, read from the package for the indices of LB06's iris."""
    numbers = tuple(float(n) for n in jax.tree.leaves(indices))
    return _table(numbers, str(jnp.result_type(float)))


@functools.lru_cache(maxsize=8)
def _table(indices: tuple[float, ...], dtype: str) -> RadiativeTabulated:
    wanted = RefractiveIndices(*(jnp.asarray(n, dtype) for n in indices))
    stored = _stored()
    # Rounding of one library or another, or of single precision: not other tissue.
    rounding = 1e-14 if dtype == "float64" else 4 * float(jnp.finfo(dtype).eps)
    if not np.allclose(stored["indices"], indices, rtol=rounding, atol=0):
        return RadiativeTabulated.build(wanted)

    def tucker(name, axes):
        factors = (jnp.asarray(stored[f"{name}_{i}"], dtype) for i in range(axes))
        return Tucker(tuple(factors), jnp.asarray(stored[f"{name}_core"], dtype))

    return RadiativeTabulated(
        out=tucker("out", 4),
        ends=tucker("ends", 4),
        multiple=tucker("multiple", 5),
        pole=jnp.asarray(stored["pole"], dtype),
        indices=wanted,
        error=float(stored[f"error_{dtype}"]),
    )


def _stored() -> dict[str, np.ndarray]:
    file = resources.files("irisjax.transport.radiative") / "tables" / "radiative.npz"
    with file.open("rb") as opened, np.load(opened) as arrays:
        return dict(arrays)
