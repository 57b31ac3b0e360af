"""Reflectance of thick layers, alone and under a surface."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from irisjax.optics.kubelka_munk import absorption_of, thick_layer, under_surface, without_surface

thick = jax.jit(thick_layer)
slopes = jax.jit(jax.grad(lambda k, s: thick_layer(k, s).sum(), (0, 1)))


@pytest.mark.parametrize("ratio", [1e-12, 0.01, 2.0, 1e8])
def test_thick_layer_to_the_last_digit(ratio):
    """1 + K/S − √((K/S)² + 2K/S), the steady state of dR/dx = S − 2(S + K)R + S R²."""
    with mpmath.workdps(50):
        q = mpmath.mpf(ratio)
        exact = float(1 + q - mpmath.sqrt(q * q + 2 * q))
    for s in (1.0, 0.25):
        assert float(thick(ratio * s, s)) == pytest.approx(exact, rel=1e-15)
        assert thick_layer(ratio * s, s, xp=np) == pytest.approx(exact, rel=1e-15)


def test_ends():
    k, s = jnp.asarray([0.0, 3.0, 0.0]), jnp.asarray([2.0, 0.0, 0.0])
    assert thick(k, s).tolist() == [1.0, 0.0, 0.0]
    assert all(np.isfinite(slope).all() for slope in slopes(k, s))


def test_derivatives_are_those_of_differences():
    point = np.array([0.3, 0.8])
    for slope, step in zip(slopes(*point), 1e-6 * np.eye(2), strict=True):
        there, back = (thick(*(point + sign * step)) for sign in (1, -1))
        assert float(slope) == pytest.approx(float(there - back) / 2e-6, rel=1e-8)


def test_absorption_gives_the_reflectance_back():
    r, s = np.linspace(0.01, 0.99, 21), 0.2
    np.testing.assert_allclose(thick(absorption_of(r, s), s), r, rtol=1e-14)


def test_surface():
    """(1 − k₁)(1 − k₂)R/(1 − k₂R) by the light's own way: in, and out again after any number of
    returns.
    """
    k1, k2, r = 0.04, 0.6, 0.5
    passes = sum((1 - k1) * r * (k2 * r) ** n * (1 - k2) for n in range(60))
    assert under_surface(r, k1, k2) == pytest.approx(passes, rel=1e-12)
    assert under_surface(1.0, k1, k2) == pytest.approx(1 - k1)
    assert without_surface(under_surface(r, k1, k2), k1, k2) == pytest.approx(r, rel=1e-14)
