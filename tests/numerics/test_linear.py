"""Small dense solves: by hand on a CPU, by the libraries elsewhere; both are numpy's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import export

from common import heavily
from irisjax.numerics import cholesky, linear

RNG = np.random.default_rng(0)


def dominant(n, many):
    """Matrices like transport's: the identity less a contraction."""
    return np.eye(n) - 0.9 * RNG.random((many, n, n)) / n


def positive(n, many):
    a = RNG.normal(size=(many, n, n))
    return a @ np.swapaxes(a, 1, 2) + n * np.eye(n)


@pytest.mark.parametrize("n", [1, 7, heavily(16), 50])
@pytest.mark.parametrize("columns", [None, 3], ids=["vector", "columns"])
def test_systems_are_solved_as_by_numpy(n, columns):
    a = dominant(n, 4)
    b = RNG.normal(size=(4, n) if columns is None else (4, n, columns))
    right = b[..., None] if columns is None else b
    wanted = np.linalg.solve(a, right).reshape(b.shape)
    for solve in (linear.solve, linear._eliminate, jnp.linalg.solve):
        found = jax.jit(jax.vmap(solve))(jnp.asarray(a), jnp.asarray(b))
        np.testing.assert_allclose(found, wanted, rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(
            jax.jit(solve)(jnp.asarray(a[0]), jnp.asarray(b[0])), wanted[0], rtol=1e-10, atol=1e-12
        )


@pytest.mark.parametrize("n", [1, heavily(5), heavily(16), 40])
def test_roots_and_whitened_residuals_are_numpys(n):
    a, residual = positive(n, 3), RNG.normal(size=(3, n))
    root = np.linalg.cholesky(a)
    wanted = np.linalg.solve(root, residual[..., None])[..., 0]
    for rooted in (cholesky.cholesky, cholesky._cholesky, jnp.linalg.cholesky):
        np.testing.assert_allclose(jax.jit(jax.vmap(rooted))(jnp.asarray(a)), root, atol=1e-11)
    for white in (
        lambda r, x: cholesky.whitened(r, x)[0],
        cholesky._whitened,
        cholesky._solve_triangular,
    ):
        found = jax.jit(jax.vmap(white))(jnp.asarray(root), jnp.asarray(residual))
        np.testing.assert_allclose(found, wanted, rtol=1e-10, atol=1e-12)


def test_slopes_of_a_solution():
    a, b = dominant(7, 1)[0], RNG.normal(size=7)
    forward = jax.jacfwd(linear.solve)(jnp.asarray(a), jnp.asarray(b))
    reverse = jax.jacrev(linear.solve)(jnp.asarray(a), jnp.asarray(b))
    x = np.linalg.solve(a, b)
    # ∂x/∂a_ij = −a⁻¹_{·i} x_j
    wanted = -np.einsum("ki,j->kij", np.linalg.inv(a), x)
    np.testing.assert_allclose(forward, wanted, atol=1e-12)
    np.testing.assert_allclose(reverse, wanted, atol=1e-12)


def test_each_platform_has_its_own():
    """Lowered for a GPU, which need not be there: the library's routine, and on a CPU none."""
    a, b = jnp.asarray(dominant(7, 4)), jnp.ones((4, 7))
    calls = {"solve": jax.vmap(linear.solve), "root": jax.vmap(lambda a, _: cholesky.cholesky(a))}
    for run in calls.values():
        text = {
            platform: export.export(jax.jit(run), platforms=[platform])(a, b).mlir_module()
            for platform in ("cpu", "cuda")
        }
        assert "while" in text["cpu"]
        assert "lapack" not in text["cpu"]
        assert "custom_call" in text["cuda"] or "cholesky" in text["cuda"]
