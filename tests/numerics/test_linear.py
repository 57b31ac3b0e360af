"""Small dense solves: by hand on a CPU, by the libraries elsewhere; both are numpy's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import export

from irisjax.numerics import linear

RNG = np.random.default_rng(0)


def dominant(n, many):
    """Matrices like transport's: the identity less a contraction."""
    return np.eye(n) - 0.9 * RNG.random((many, n, n)) / n


def positive(n, many):
    a = RNG.normal(size=(many, n, n))
    return a @ np.swapaxes(a, 1, 2) + n * np.eye(n)


@pytest.mark.parametrize(("n", "columns"), [(1, None), (50, 3)])
def test_systems_are_solved_as_by_numpy(n, columns):
    a = dominant(n, 4)
    b = RNG.normal(size=(4, n) if columns is None else (4, n, columns))
    right = b[..., None] if columns is None else b
    wanted = np.linalg.solve(a, right).reshape(b.shape)
    solved = jax.jit(lambda a, b: (jax.vmap(linear.solve)(a, b), linear.solve(a[0], b[0])))
    batch, one = solved(a, b)
    np.testing.assert_allclose(batch, wanted, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(one, wanted[0], rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("n", [1, 40])
def test_roots_and_whitened_residuals_are_numpys(n):
    a, residual = positive(n, 3), RNG.normal(size=(3, n))
    root = np.linalg.cholesky(a)
    wanted = np.linalg.solve(root, residual[..., None])[..., 0]

    @jax.jit
    @jax.vmap
    def both(a, root, residual):
        # The library's is that of other platforms.
        white = linear.whiten(root, residual)[0], linear._library_forward(root, residual)
        return linear.cholesky(a), white

    found, whitened = both(a, root, residual)
    np.testing.assert_allclose(found, root, atol=1e-11)
    for white in whitened:
        np.testing.assert_allclose(white, wanted, rtol=1e-10, atol=1e-12)


def test_slopes_of_a_solution():
    a, b = dominant(7, 1)[0], RNG.normal(size=7)
    x = np.linalg.solve(a, b)
    # ∂x/∂a_ij = −a⁻¹_{·i} x_j
    wanted = -np.einsum("ki,j->kij", np.linalg.inv(a), x)
    for derivative in (jax.jacfwd, jax.jacrev):
        found = jax.jit(derivative(linear.solve))(a, b)
        np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_each_platform_has_its_own():
    """Lowered for a GPU, which need not be there: the library's routine, and on a CPU none."""
    a, b = jnp.asarray(dominant(7, 4)), jnp.ones((4, 7))
    calls = {"solve": jax.vmap(linear.solve), "root": jax.vmap(lambda a, _: linear.cholesky(a))}
    for run in calls.values():
        text = {
            platform: export.export(jax.jit(run), platforms=[platform])(a, b).mlir_module()
            for platform in ("cpu", "cuda")
        }
        assert "while" in text["cpu"]
        assert "lapack" not in text["cpu"]
        assert "custom_call" in text["cuda"] or "cholesky" in text["cuda"]
