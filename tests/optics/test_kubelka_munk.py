"""Reflectance of thick layers, alone and under a surface."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from irisjax.optics.kubelka_munk import absorption_of, thick_layer, under_surface, without_surface


@pytest.mark.parametrize("ratio", [1e-12, 0.01, 2.0, 1e8])
def test_thick_layer_to_the_last_digit(ratio):
    """1 + K/S − √((K/S)² + 2K/S) in fifty digits."""
    with mpmath.workdps(50):
        q = mpmath.mpf(ratio)
        exact = float(1 + q - mpmath.sqrt(q * q + 2 * q))
    found = float(thick_layer(jnp.asarray(ratio), jnp.asarray(1.0)))
    assert found == pytest.approx(exact, rel=1e-15)
    assert thick_layer(ratio, 1.0, xp=np) == pytest.approx(exact, rel=1e-15)


def test_thick_layer_is_the_limit_of_deep_ones():
    """Kubelka and Munk's dR/dx = S − 2(S + K)R + S R² from a black ground, by Runge and Kutta."""
    k, s, r, dx = 0.7, 0.4, 0.0, 0.01

    def slope(r):
        return s - 2 * (s + k) * r + s * r * r

    for _ in range(2000):
        a = slope(r)
        b = slope(r + dx * a / 2)
        c = slope(r + dx * b / 2)
        r += dx * (a + 2 * b + 2 * c + slope(r + dx * c)) / 6
    assert float(thick_layer(jnp.asarray(k), jnp.asarray(s))) == pytest.approx(r, rel=1e-12)


def test_ends():
    k, s = jnp.asarray([0.0, 3.0, 0.0]), jnp.asarray([2.0, 0.0, 0.0])
    assert thick_layer(k, s).tolist() == [1.0, 0.0, 0.0]
    for slopes in jax.grad(lambda k, s: thick_layer(k, s).sum(), (0, 1))(k, s):
        assert np.isfinite(slopes).all()


def test_derivatives_are_those_of_differences():
    point = jnp.asarray([0.3, 0.8])
    found = jax.grad(lambda x: thick_layer(x[0], x[1]))(point)
    for i, step in enumerate(1e-6 * np.eye(2)):
        there, back = (thick_layer(*(point + sign * step)) for sign in (1, -1))
        assert float(found[i]) == pytest.approx(float(there - back) / 2e-6, rel=1e-8)


def test_absorption_gives_the_reflectance_back():
    r = jnp.linspace(0.01, 0.99, 21)
    s = jnp.full_like(r, 0.2)
    np.testing.assert_allclose(thick_layer(absorption_of(r, s), s), r, rtol=1e-14)


def test_surface():
    """(1 − k₁)(1 − k₂)R/(1 − k₂R) by the light's own way: in, and out again after any number of
    returns.
    """
    k1, k2, r = 0.04, 0.6, 0.5
    passes = sum((1 - k1) * r * (k2 * r) ** n * (1 - k2) for n in range(60))
    assert under_surface(r, k1, k2) == pytest.approx(passes, rel=1e-12)
    assert under_surface(1.0, k1, k2) == pytest.approx(1 - k1)
    assert without_surface(under_surface(r, k1, k2), k1, k2) == pytest.approx(r, rel=1e-14)
