"""Compressed tables of Chebyshev polynomials."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.radiative_table import compressed, grid_points
from irisjax.numerics.interpolation import chebyshev_nodes, chebyshev_series

NODES = 14, 12, 10


def function(points):
    x, y, z = points.T
    return np.stack([np.exp(x * y) / (3 + z), np.cos(2 * x) * np.exp(y) * (1 + z)], -1)


@jax.jit
def _read(table, points):
    u, v, w = (table.basis(i, x) for i, x in enumerate(points.T))
    return jnp.einsum("abcf,ap,bp,cp->pf", table.core, u, v, w)


def read(table, points):
    return np.asarray(_read(table, jnp.asarray(points)))


def made(tolerance):
    points = grid_points([chebyshev_nodes(n) for n in NODES])
    return compressed(function(points).reshape(*NODES, 2), tolerance, jnp.float64)


def test_holds_smooth_functions_between_the_nodes():
    points = np.random.default_rng(0).uniform(-1, 1, (200, 3))
    np.testing.assert_allclose(read(made(1e-12), points), function(points), atol=1e-8)


def test_ranks_are_no_larger_than_the_tolerance_asks_for():
    # Along the last axis there are two functions, 1/(3 + z) and 1 + z.
    fine, coarse = made(1e-10), made(1e-2)
    assert fine.core.shape[2] == 2
    assert all(a <= b for a, b in zip(coarse.core.shape, fine.core.shape, strict=True))
    points = np.random.default_rng(1).uniform(-1, 1, (200, 3))
    error = np.abs(read(coarse, points) - function(points)).max()
    assert 1e-6 < error < 0.1 * np.abs(function(points)).max()


@pytest.mark.parametrize("count", [1, 2, 3, 24, 50])
def test_series_are_those_of_numpy(count):
    """Ends of the interval too, where T_k and its slope k² are largest."""
    rng = np.random.default_rng(count)
    weights = rng.normal(size=(count, 3))
    t = np.concatenate([[-1.0, 0.0, 1.0], rng.uniform(-1, 1, 200)])
    expected = np.polynomial.chebyshev.chebval(t, weights)

    @jax.jit
    def both(weights, t):
        slope = jax.grad(lambda t: chebyshev_series(weights, t).sum())
        return chebyshev_series(weights, t), slope(t)

    found, slope = both(jnp.asarray(weights), jnp.asarray(t))
    np.testing.assert_allclose(found, expected, atol=1e-14 * count**2)
    slopes = np.polynomial.chebyshev.chebder(weights.sum(1)) if count > 1 else np.zeros(1)
    expected = np.polynomial.chebyshev.chebval(t, slopes)
    np.testing.assert_allclose(slope, expected, atol=1e-13 * count**3)
