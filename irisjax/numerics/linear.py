"""Small dense linear systems, many at a time.

Why by hand: on a CPU `jnp.linalg.solve` hands each matrix of a batch to LAPACK, 2 µs for a 16×16.
Worse, its kernel may wait for ever for the pool of threads that it runs on itself (jax 0.10.2, two
cores; the same fault as in github.com/PyAutoLabs/PyAutoFit/issues/1530). So on a CPU all systems of
a batch are eliminated together in plain JAX, the batch along the vector units; the same goes for
`numerics.cholesky`. On any other platform a loop over rows would be a chain of tiny kernels: there
the libraries' batched routines serve.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float

from irisjax.numerics.sharding import vary_alike

_LARGEST = 32


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
    rest = jnp.concatenate([a[:, half:, half:], b[:, half:]], axis=-1) - a[:, half:, :half] @ left
    below = _solve_blocks(rest[..., : n - half], rest[..., n - half :])
    return jnp.concatenate([left[..., n - half :] - left[..., : n - half] @ below, below], axis=1)


def _gauss_jordan(m: Float[Array, "n width many"]) -> Float[Array, "n rest many"]:
    n = m.shape[0]
    rows = jnp.arange(n)[:, None, None]

    def step(k, m):
        pivot_row = (m[k] / m[k, k][None])[None]
        return jnp.where(rows == k, pivot_row, m - m[:, k, None] * pivot_row)

    return jax.lax.fori_loop(0, n, step, m)[:, n:]


def leading_subspace(
    matrix: Float[Array, "n n"], count: int, turns: int = 16
) -> Float[Array, "n count"]:
    """Orthonormal vectors that span what a symmetric, positive semidefinite matrix stretches most.

    Orthogonal iteration, each turn's vectors made orthogonal twice: small matrices, no LAPACK.
    """
    size = matrix.shape[0]
    tiny = jnp.finfo(matrix.dtype).tiny ** 0.5

    def orthonormal(vectors):
        rows = []
        for k in range(count):
            v = vectors[:, k]
            for _ in range(2):
                for row in rows:
                    v = v - row * (row @ v)
            rows.append(v / jnp.maximum(jnp.sqrt(v @ v), tiny))
        return jnp.stack(rows, 1)

    # Never blind to a direction: every vector has something of every coordinate.
    start = np.cos(np.outer(np.arange(size) + 0.5, np.arange(count)) * np.pi / size)
    # Where the matrix has a lower rank the vectors beyond it are any others.
    lifted = matrix + jnp.finfo(matrix.dtype).eps * jnp.eye(size, dtype=matrix.dtype)
    return jax.lax.fori_loop(
        0,
        turns,
        lambda _, v: orthonormal(lifted @ v),
        orthonormal(jnp.asarray(start, matrix.dtype)),
    )
