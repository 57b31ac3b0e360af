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
    found = arctan2(jnp.asarray(y), jnp.asarray(x))
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
    for a in angle:
        x, y = dtype(2 * np.cos(a)), dtype(2 * np.sin(a))
        found = jax.grad(arctan2, (0, 1))(jnp.asarray(y), jnp.asarray(x))
        np.testing.assert_allclose(found, (np.cos(a) / 2, -np.sin(a) / 2), rtol=0, atol=1e-6)
    assert jax.grad(arctan2)(jnp.zeros((), dtype), jnp.zeros((), dtype)) == 0
