"""The table of radiative transfer in LB06's iris, which comes with the package.

`python -m experiments.radiative_table` makes it; tests/transport/test_radiative_tabulated.py makes
it again.
"""

import functools
from importlib import resources

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from irisjax.numerics.tucker import Tucker
from irisjax.tissue.indices import RefractiveIndices
from irisjax.transport.radiative.tabulated import RadiativeTabulated


def table(indices: RefractiveIndices) -> RadiativeTabulated:
    """`RadiativeTabulated.build(indices)`, read from the package for the indices of LB06's iris."""
    found = ready(indices)
    return _built(*_key(indices)) if found is None else found


def ready(indices: RefractiveIndices) -> RadiativeTabulated | None:
    """The table that comes with the package, `None` for indices that are others or traced."""
    if any(isinstance(n, Tracer) for n in jax.tree.leaves(indices)):
        return None
    return _read(*_key(indices))


def _key(indices: RefractiveIndices) -> tuple[tuple[float, ...], str]:
    return tuple(float(n) for n in jax.tree.leaves(indices)), str(jnp.result_type(float))


@functools.lru_cache(maxsize=8)
def _built(indices: tuple[float, ...], dtype: str) -> RadiativeTabulated:
    return RadiativeTabulated.build(RefractiveIndices(*(jnp.asarray(n, dtype) for n in indices)))


@functools.lru_cache(maxsize=8)
def _read(indices: tuple[float, ...], dtype: str) -> RadiativeTabulated | None:
    # Kept for other callers: nothing of a trace that may be going on here.
    with jax.ensure_compile_time_eval():
        wanted = RefractiveIndices(*(jnp.asarray(n, dtype) for n in indices))
        stored = _stored()
        # Rounding of one library or another, or of single precision: not other tissue.
        rounding = 1e-14 if dtype == "float64" else 4 * float(jnp.finfo(dtype).eps)
        if not np.allclose(stored["indices"], indices, rtol=rounding, atol=0):
            return None

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
