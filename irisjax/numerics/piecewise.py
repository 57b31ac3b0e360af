"""Piecewise polynomials read from tables of their coefficients, with derivatives by the places
they are read at.

Values read a table number by number: whole rows would be copied out first, at three times the cost.
Where slopes are wanted too the copy serves all three, and compiles ten times faster than JAX's own
derivative.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from irisjax.numerics.interpolation import chebyshev, horner


@eqx.filter_custom_jvp
def piecewise(
    table: Float[Array, "intervals powers *degrees functions"],
    interval: Int[Array, "*places"],
    x: Float[Array, "*places"],
    s: Float[Array, "*places"] | None,
) -> tuple[Float[Array, "*places"], ...]:
    """Evaluate functions that are polynomials in `x` on each interval.

    Args:
        table: Coefficients, constants; with an axis of degrees each is a Chebyshev series in `s`.
        interval: Number of the interval.
        x: Place, in the coordinate of the interval.
        s: Second coordinate in [−1, 1], or `None`.

    Returns:
        One array a function.
    """
    read = _reader(table, interval)
    _, powers, *degrees, functions = table.shape
    basis = None if s is None else chebyshev(s, *degrees)[0]

    def coefficient(i, f):
        if basis is None:
            return read(i, f)
        return sum(c * read(i, k, f) for k, c in enumerate(basis))

    return tuple(horner(x, [coefficient(i, f) for i in range(powers)]) for f in range(functions))


@piecewise.def_jvp
def _piecewise_jvp(primals, tangents):
    table, interval, x, s = primals
    if tangents[0] is not None:
        raise NotImplementedError(
            "coefficients of tables are constants; derivatives by them do not exist"
        )
    # The table's numbers at each place, (powers, [degrees,] functions, *places).
    rows = jnp.moveaxis(table.reshape(table.shape[0], -1)[interval], -1, 0)
    rows, x = rows.reshape(*table.shape[1:], *interval.shape), x[None]
    inner, change = list(rows), jnp.zeros((table.shape[-1], *interval.shape), x.dtype)
    if s is not None:
        basis, basis_slopes = (jnp.stack(c)[:, None] for c in chebyshev(s, table.shape[2]))
        inner = [(row * basis).sum(0) for row in rows]
        if tangents[3] is not None:
            slopes = [(row * basis_slopes).sum(0) for row in rows]
            change = change + horner(x, slopes) * tangents[3][None]
    if tangents[2] is not None:
        change = change + horner(x, [i * c for i, c in enumerate(inner)][1:]) * tangents[2][None]
    return tuple(horner(x, inner)), tuple(change)


def _reader(table, interval):
    """The number at fixed further indices, in every interval. XLA's own gather: NumPy's indexing
    traces ten times slower, and there are over a hundred."""
    flat, first = table.ravel(), interval * math.prod(table.shape[1:])
    numbers = jax.lax.GatherDimensionNumbers(
        offset_dims=(), collapsed_slice_dims=(0,), start_index_map=(0,)
    )

    def read(*position):
        index = first + int(np.ravel_multi_index(position, table.shape[1:]))
        return jax.lax.gather(
            flat, index[..., None], numbers, (1,), mode=jax.lax.GatherScatterMode.PROMISE_IN_BOUNDS
        )

    return read
