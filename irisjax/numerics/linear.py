"""Small dense linear systems and roots of covariance matrices, many at a time.

On a CPU `jnp.linalg.solve` hands each matrix of a batch to LAPACK, 2 µs for a 16×16. Worse, its
kernel may wait for ever for the pool of threads that it runs on itself (jax 0.10.2, two cores; the
same fault as in github.com/PyAutoLabs/PyAutoFit/issues/1530). On a CPU all systems of a batch are
therefore eliminated together in plain JAX, the batch along the vector units. On any other platform
a loop over rows would be a chain of tiny kernels: there the libraries' batched routines serve.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float

from irisjax.numerics.sharding import vary_alike

_LARGEST = 32  # system that is eliminated as a whole
# Cholesky's method goes in blocks, so that most of the work is products of matrices (a twentieth of
# the time at 300 wavelengths); blocks in a loop, so that it compiles fast.
_BLOCK = 16


def solve(a: Float[Array, "n n"], b: Float[Array, "n *m"]) -> Float[Array, "n *m"]:
    """x with a x = b, without pivoting: every leading block of `a` must be well conditioned.

    So it is for transport, I − ωK with K a contraction that light's reciprocity makes symmetric.
    `b` is a vector or the columns of a matrix.
    """
    a, b = vary_alike((a, b))
    return jax.lax.custom_linear_solve(
        lambda x: a @ x,
        b,
        lambda _, y: _by_platform(a, y),
        transpose_solve=lambda _, y: _by_platform(a.T, y),
    )


def cholesky(a: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Lower root of a positive definite matrix."""
    return jax.lax.platform_dependent(a, cpu=_cholesky, default=jnp.linalg.cholesky)


def whiten(
    root: Float[Array, "n n"], residual: Float[Array, " n"]
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Root⁻¹ residual, and the logarithms of the diagonal."""
    white = jax.lax.platform_dependent(root, residual, cpu=_forward, default=_library_forward)
    return white, jnp.log(jnp.diag(root))


def _by_platform(a, b):
    return jax.lax.platform_dependent(a, b, cpu=_eliminate, default=jnp.linalg.solve)


@custom_vmap
def _eliminate(a, b):
    return _solve_blocks(a[None], b.reshape(1, b.shape[0], -1))[0].reshape(b.shape)


@_eliminate.def_vmap
def _eliminate_many(axis_size, in_batched, a, b):
    a, b = (
        x if batched else jnp.broadcast_to(x, (axis_size, *x.shape))
        for x, batched in zip((a, b), in_batched, strict=True)
    )
    return _solve_blocks(a, b.reshape(*b.shape[:2], -1)).reshape(b.shape), True


def _solve_blocks(
    a: Float[Array, "many n n"], b: Float[Array, "many n m"]
) -> Float[Array, "many n m"]:
    """Large systems by halves, so that most of the work is products of matrices."""
    n = a.shape[-1]
    if n <= _LARGEST:
        m = jnp.moveaxis(jnp.concatenate([a, b], axis=-1), 0, -1)
        return jnp.moveaxis(_gauss_jordan(m), -1, 0)
    half = n // 2
    left = _solve_blocks(
        a[:, :half, :half], jnp.concatenate([a[:, :half, half:], b[:, :half]], axis=-1)
    )
    schur = jnp.concatenate([a[:, half:, half:], b[:, half:]], axis=-1) - a[:, half:, :half] @ left
    lower = _solve_blocks(schur[..., : n - half], schur[..., n - half :])
    return jnp.concatenate([left[..., n - half :] - left[..., : n - half] @ lower, lower], axis=1)


def _gauss_jordan(m: Float[Array, "n width many"]) -> Float[Array, "n rest many"]:
    n = m.shape[0]
    rows = jnp.arange(n)[:, None, None]

    def step(k, m):
        pivot_row = (m[k] / m[k, k][None])[None]
        return jnp.where(rows == k, pivot_row, m - m[:, k, None] * pivot_row)

    return jax.lax.fori_loop(0, n, step, m)[:, n:]


_library_forward = partial(solve_triangular, lower=True)


def _cholesky(a):
    n = a.shape[0]
    # Whole blocks, with ones on the diagonal.
    padded = jnp.eye(-(-n // _BLOCK) * _BLOCK, dtype=a.dtype).at[:n, :n].set(a)
    row_numbers = jnp.arange(padded.shape[0])[:, None]

    def step(k, root):
        rows = jax.lax.dynamic_slice_in_dim(root, k * _BLOCK, _BLOCK)
        columns = jax.lax.dynamic_slice_in_dim(padded, k * _BLOCK, _BLOCK, 1) - root @ rows.T
        corner = _small_cholesky(jax.lax.dynamic_slice_in_dim(columns, k * _BLOCK, _BLOCK))
        columns = jnp.where(row_numbers < k * _BLOCK, 0.0, _forward(corner, columns.T).T)
        return jax.lax.dynamic_update_slice_in_dim(root, columns, k * _BLOCK, 1)

    root = jax.lax.fori_loop(0, row_numbers.size // _BLOCK, step, jnp.zeros_like(padded))
    return jnp.tril(root)[:n, :n]


def _forward(root, b):
    """Root⁻¹ b, row by row."""

    def step(i, x):
        return x.at[i].set((b[i] - root[i] @ x) / root[i, i])

    return jax.lax.fori_loop(0, b.shape[0], step, jnp.zeros_like(b))


def _small_cholesky(a):
    """Cholesky's method, column by column."""
    rows = jnp.arange(a.shape[0])

    def step(k, carry):
        rest, root = carry
        column = jnp.where(rows >= k, rest[:, k], 0.0) / jnp.sqrt(rest[k, k])
        return rest - jnp.outer(column, column), root.at[:, k].set(column)

    return jax.lax.fori_loop(0, a.shape[0], step, (a, jnp.zeros_like(a)))[1]
