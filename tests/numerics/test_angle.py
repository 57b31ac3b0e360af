"""Angles: against numpy's, in both precisions, with their derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from irisjax.numerics.angle import arctan2

LINE = np.concatenate([-np.geomspace(1e-6, 1e6, 25), [0.0], np.geomspace(1e-6, 1e6, 25)])


@pytest.mark.parametrize(("dtype", "error"), [(np.float32, 3e-7), (np.float64, 1e-15)])
def test_as_numpy(dtype, error):
    y, x = (v.astype(dtype) for v in np.meshgrid(LINE, LINE))
    found = jax.jit(arctan2)(jnp.asarray(y), jnp.asarray(x))
    assert found.dtype == dtype
    np.testing.assert_allclose(
        found, np.arctan2(y.astype(float), x.astype(float)), rtol=0, atol=error
    )


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_gradient_of_the_angle(dtype):
    """Of the definition, x = r cos a and y = r sin a; on the diagonals too, where the polynomial
    changes branch.
    """
    angle = [*np.linspace(-3, 3, 25), np.pi / 4, -np.pi / 4, 3 * np.pi / 4, np.pi / 2]
    cosine, sine = np.cos(angle), np.sin(angle)
    slopes = jax.jit(jax.vmap(jax.grad(arctan2, (0, 1))))
    at = (jnp.asarray(np.r_[2 * v, 0.0], dtype) for v in (sine, cosine))
    y, x = slopes(*at)
    np.testing.assert_allclose(y[:-1], cosine / 2, rtol=0, atol=1e-6)
    np.testing.assert_allclose(x[:-1], -sine / 2, rtol=0, atol=1e-6)
    assert y[-1] == 0
