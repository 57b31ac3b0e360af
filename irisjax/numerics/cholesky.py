"""Roots of covariance matrices, many at a time; on a CPU by hand (`numerics.linear` says why)."""

import jax
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float

# In blocks, so that most of the work is products of matrices (a twentieth of the time at 300
# wavelengths); blocks in a loop, so that it compiles fast.
_BLOCK = 16


def cholesky(a: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Lower root of a positive definite matrix."""
    return jax.lax.platform_dependent(a, cpu=_cholesky, default=jnp.linalg.cholesky)


def whitened(
    root: Float[Array, "n n"], residual: Float[Array, " n"]
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Root⁻¹ residual, and the logarithms of the diagonal."""
    white = jax.lax.platform_dependent(root, residual, cpu=_whitened, default=_solve_triangular)
    return white, jnp.log(jnp.diag(root))


def _solve_triangular(root, residual):
    return solve_triangular(root, residual, lower=True)


def _whitened(root, residual):
    n = residual.shape[0]
    if n <= _BLOCK:
        return _forward(root, residual)
    padded = _padded(root)
    right = jnp.zeros(padded.shape[0], residual.dtype).at[:n].set(residual)

    def step(k, white):
        rows = jax.lax.dynamic_slice_in_dim(padded, k * _BLOCK, _BLOCK)
        corner = jax.lax.dynamic_slice_in_dim(rows, k * _BLOCK, _BLOCK, 1)
        rest = jax.lax.dynamic_slice_in_dim(right, k * _BLOCK, _BLOCK) - rows @ white
        return jax.lax.dynamic_update_slice_in_dim(white, _forward(corner, rest), k * _BLOCK, 0)

    white = jax.lax.fori_loop(0, right.size // _BLOCK, step, jnp.zeros_like(right))
    return white[:n]


def _cholesky(a):
    n = a.shape[0]
    if n <= _BLOCK:
        return _small_cholesky(a)
    padded = _padded(a)
    places = jnp.arange(padded.shape[0])[:, None]

    def step(k, root):
        rows = jax.lax.dynamic_slice_in_dim(root, k * _BLOCK, _BLOCK)
        columns = jax.lax.dynamic_slice_in_dim(padded, k * _BLOCK, _BLOCK, 1) - root @ rows.T
        corner = _small_cholesky(jax.lax.dynamic_slice_in_dim(columns, k * _BLOCK, _BLOCK))
        columns = jnp.where(places < k * _BLOCK, 0.0, _forward(corner, columns.T).T)
        return jax.lax.dynamic_update_slice_in_dim(root, columns, k * _BLOCK, 1)

    return jnp.tril(jax.lax.fori_loop(0, places.size // _BLOCK, step, jnp.zeros_like(padded)))[
        :n, :n
    ]


def _padded(a):
    """With ones added to the diagonal, to whole blocks."""
    n = a.shape[0]
    return jnp.eye(-(-n // _BLOCK) * _BLOCK, dtype=a.dtype).at[:n, :n].set(a)


def _forward(root, b):
    """Root⁻¹ b of a small root, row by row."""

    def step(i, x):
        return x.at[i].set((b[i] - root[i] @ x) / root[i, i])

    return jax.lax.fori_loop(0, b.shape[0], step, jnp.zeros_like(b))


def _small_cholesky(a):
    """Column by column."""
    rows = jnp.arange(a.shape[0])

    def step(k, carry):
        rest, root = carry
        column = jnp.where(rows >= k, rest[:, k], 0.0) / jnp.sqrt(rest[k, k])
        return rest - jnp.outer(column, column), root.at[:, k].set(column)

    return jax.lax.fori_loop(0, a.shape[0], step, (a, jnp.zeros_like(a)))[1]
