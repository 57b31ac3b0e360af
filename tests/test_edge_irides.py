"""Irides at the edges of the physics: values, energy, status."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import GRID, PROCESSES, exact, quick_jit, stack
from edges import COSINES, EDGES, SAME_MEDIA, TINY, as_vector, reflectance_of

pytestmark = pytest.mark.peer


@pytest.mark.parametrize(
    ("name", "bits"), [("lb06", 64), ("rayleigh-retest", 32), ("depth-resolved", 64)]
)
def test_edge_irides(name, bits):
    vectors = jnp.asarray(np.stack([as_vector(e) for e in EDGES]), jnp.result_type(float))
    # Traced irides do not tell how many panels they take.
    panelled = ij.RadiativeExact(12, n_panels=5)
    solver = panelled if name == "depth-resolved" else exact(PROCESSES[name], 12)
    run = quick_jit(jax.vmap(lambda v, c: reflectance_of(v, solver, c), in_axes=(0, None)))
    for cosine in COSINES:
        r = run(vectors, jnp.asarray(cosine, float))
        values = np.asarray(r.values)
        assert np.isfinite(values).all()
        total = sum(
            np.asarray(x).astype(np.float64) for x in jax.tree.leaves((r.values, r.absorbed))
        )
        np.testing.assert_allclose(total, 1, rtol=0, atol=TINY[bits])
        fine = np.asarray(r.status == ij.RESULTS.successful)
        for i, e in enumerate(EDGES):
            assert fine[i], e
            assert values[i].min() >= 0, e
            assert values[i].max() <= 1, e


def test_edge_irides_tabulated(tabulated):
    irides = stack([ij.Iris.of_level("low").replace(**EDGES[e]) for e in SAME_MEDIA])

    def run(solver):
        f = jax.vmap(lambda iris: ij.reflectance(iris, GRID, solver=solver, throw=False))
        return quick_jit(f)(irides)

    found, true = run(tabulated), run(ij.IlitExact(n_angles=64))
    assert bool((found.status == ij.RESULTS.successful).all())
    np.testing.assert_allclose(found.values, true.values, rtol=0, atol=8 * tabulated.error)
    total = sum(np.asarray(x) for x in jax.tree.leaves((found.values, found.absorbed)))
    np.testing.assert_allclose(total, 1, rtol=0, atol=1e-12)
