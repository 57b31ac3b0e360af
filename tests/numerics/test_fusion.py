"""Results that are computed once in a compiled program."""

import jax
import jax.numpy as jnp
import numpy as np

from irisjax.numerics.fusion import materialise


def test_shared_results_are_computed_once():
    """A polynomial that four outputs use, which XLA would copy into each of them."""

    def powers(x, shared):
        y = x
        for _ in range(6):
            y = y * y + x
        y = shared(y)
        return y + 1, y * y, y - x, 2 * y

    def products(shared):
        x = jnp.ones(256)
        return jax.jit(lambda x: powers(x, shared)).lower(x).compile().as_text().count(" multiply(")

    if jax.default_backend() == "cpu":
        assert products(materialise) < 10 < products(lambda y: y)
    x = jnp.linspace(-1.0, 1.0, 9)
    for plain, stored in zip(powers(x, lambda y: y), powers(x, materialise), strict=True):
        np.testing.assert_array_equal(plain, stored)
    slope = jax.grad(lambda x: (materialise({"x": x * x})["x"]).sum())(x)
    np.testing.assert_array_equal(slope, 2 * x)
