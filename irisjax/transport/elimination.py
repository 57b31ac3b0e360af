"""Small dense linear systems, many at a time.

`jnp.linalg.solve` hands each matrix of a batch to LAPACK: 2 µs for a 16×16, and on CPUs with two cores large
batches were seen to wait for each other for ever (jax 0.10.2). Here all systems of a batch are eliminated
together, the batch along the vector units.
"""

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float


def solve(a: Float[Array, "n n"], b: Float[Array, " n"]) -> Float[Array, " n"]:
    """x with a x = b, without pivoting: every leading block of `a` must be well conditioned.

    So it is for transport, I − ωK with K a contraction that light's reciprocity makes symmetric.
    """
    return jax.lax.custom_linear_solve(
        lambda x: a @ x, b, lambda _, y: _eliminate(a, y), transpose_solve=lambda _, y: _eliminate(a.T, y)
    )


@custom_vmap
def _eliminate(a, b):
    return _gauss_jordan(a[..., None], b[..., None])[..., 0]


@_eliminate.def_vmap
def _eliminate_many(axis_size, in_batched, a, b):
    a, b = (
        jnp.moveaxis(x, 0, -1) if batched else jnp.broadcast_to(x[..., None], (*x.shape, axis_size))
        for x, batched in zip((a, b), in_batched, strict=True)
    )
    return jnp.moveaxis(_gauss_jordan(a, b), -1, 0), True


def _gauss_jordan(a: Float[Array, "n n many"], b: Float[Array, "n many"]) -> Float[Array, "n many"]:
    n = a.shape[0]
    rows = jnp.arange(n)[:, None, None]

    def step(k, m):
        pivot_row = m[k] / m[k, k]
        return jnp.where(rows == k, pivot_row, m - m[:, k, None] * pivot_row)

    return jax.lax.fori_loop(0, n, step, jnp.concatenate([a, b[:, None]], axis=1))[:, -1]
