"""Derivatives of the weighted estimator: unbiased, and alike in both modes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import heavily, quick_jit, slowly

GRID = (430.0, 500.0, 570.0, 640.0)
KEY = jax.random.key(0)
LOW = ij.Iris.of_level("low")


def _moved(solver, process, x, key):
    """Shares of light as functions of all that ILIT depends on: depths, indices and incidence."""
    depths, indices, cosine = x
    layers = ij.Layers(*depths, ij.RefractiveIndices(*indices), type(LOW.order)())
    s = solver.solve(layers, process, cosine, key=key)
    return jnp.stack([s.reflectance, s.absorbed.abl, s.absorbed.stroma, s.absorbed.ipe])


@pytest.mark.slow
@pytest.mark.parametrize("quasi", [False, True])
@pytest.mark.parametrize(
    "process", [ij.ILIT_2006, ij.Ilit("rayleigh", "retest")], ids=["printed", "retest"]
)
def test_derivatives_are_unbiased(process, quasi):
    made = LOW.layers(ij.extinction(np.asarray(GRID)))
    depths = (made.abl_absorption, made.stroma_absorption, made.stroma_scattering)
    x = depths, tuple(jax.tree.leaves(made.indices)), jnp.asarray(0.7)
    flat = jax.tree.leaves(x)
    directions = [
        jax.tree.unflatten(
            jax.tree.structure(x), [jnp.full_like(v, i == k) for i, v in enumerate(flat)]
        )
        for k in range(len(flat))
    ]
    directions = jax.tree.map(lambda *d: jnp.stack(d), *directions)

    def slopes(solver, key):
        def along(d):
            return jax.jvp(lambda x: _moved(solver, process, x, key), (x,), (d,))[1]

        return jax.vmap(along)(directions)

    exact = jax.jit(lambda: slopes(ij.IlitExact(), KEY))()
    solver = ij.IlitWeighted(2048, quasi=quasi)
    run = jax.jit(lambda key: slopes(solver, key))
    runs = np.stack([run(k) for k in jax.random.split(jax.random.key(3), 96)])
    error = runs.std(0, ddof=1) / np.sqrt(len(runs))
    # 8 directions, 4 shares, 4 wavelengths each: |z| < 4.5 by Student's law.
    z = np.abs(runs.mean(0) - exact) / np.where(error > 0, error, 1e-6)
    # The indices of ABL and stroma nearly agree and move the critical angle between them, where
    # Fresnel's slopes are unbounded: runs with a kurtosis of 20 to 50 obey no such law.
    near = [4, 5]
    assert np.delete(z, near, axis=0).max() < 4.5
    assert z[near].max() < 8
    assert (error[:3].max((1, 2)) < 0.02 * np.abs(exact[:3]).max((1, 2))).all()


@pytest.mark.parametrize("quasi", [heavily(True), slowly(False)])
def test_reverse_mode_is_forward_mode(quasi):
    solver = ij.IlitWeighted(64, quasi=quasi)
    names = ("eumelanin", "stroma_thickness", "fibril_radius", "ipe_index", "abl_fraction")

    def value(x):
        iris = LOW.replace(**dict(zip(names, x, strict=True)))
        m = ij.reflectance(iris, GRID, solver=solver, key=KEY)
        return m.values @ jnp.arange(1.0, 5.0)

    x = tuple(getattr(LOW, name) for name in names)
    reverse = quick_jit(jax.grad(value))(x)
    forward = quick_jit(jax.jacfwd(value))(x)
    np.testing.assert_allclose(reverse, forward, rtol=1e-6)
    each = quick_jit(jax.vmap(jax.grad(value)))(jax.tree.map(lambda v: jnp.stack([v, v]), x))
    np.testing.assert_allclose(np.asarray(each)[:, 1], reverse, rtol=1e-5)
