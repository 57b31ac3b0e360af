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

from irisjax.numerics.interpolation import chebyshev, horner


@eqx.filter_custom_jvp
def piecewise(table, interval, x):
    """Polynomials in `x` on intervals.

    **Arguments:** `table`: shape (intervals, powers, functions), constants; `interval`: whole
    numbers; `x`: in the coordinate of the interval, of the same shape.

    **Returns:** a tuple, one array a function.
    """
    read = _reader(table, interval)
    _, powers, functions = table.shape
    return tuple(horner(x, [read(i, f) for i in range(powers)]) for f in range(functions))


@piecewise.def_jvp
def _piecewise_jvp(primals, tangents):
    table, interval, x = primals
    _check_constant(tangents[0])
    rows = list(_rows(table, interval))
    x, dx = x[None], tangents[2][None]
    slope = horner(x, [i * row for i, row in enumerate(rows)][1:]) * dx
    return tuple(horner(x, rows)), tuple(slope)


@eqx.filter_custom_jvp
def piecewise_chebyshev(table, interval, x, s):
    """`piecewise` in two coordinates: each coefficient is a Chebyshev series in `s`.

    **Arguments:** `table`: shape (intervals, powers, degrees, functions), constants.
    """
    along, _ = chebyshev(s, table.shape[2])
    read = _reader(table, interval)
    _, powers, _, functions = table.shape

    def series(i, f):
        return sum(c * read(i, k, f) for k, c in enumerate(along))

    return tuple(horner(x, [series(i, f) for i in range(powers)]) for f in range(functions))


@piecewise_chebyshev.def_jvp
def _piecewise_chebyshev_jvp(primals, tangents):
    table, interval, x, s = primals
    _check_constant(tangents[0])
    along, across = (jnp.stack(c)[:, None] for c in chebyshev(s, table.shape[2]))
    rows, x = _rows(table, interval), x[None]
    inner = [(row * along).sum(0) for row in rows]
    change = jnp.zeros((table.shape[3], *s.shape), s.dtype)
    if tangents[2] is not None:
        change = change + horner(x, [i * c for i, c in enumerate(inner)][1:]) * tangents[2][None]
    if tangents[3] is not None:
        change = change + horner(x, [(row * across).sum(0) for row in rows]) * tangents[3][None]
    return tuple(horner(x, inner)), tuple(change)


def _reader(table, interval):
    """The number at fixed further indices, in every interval. XLA's own gather: NumPy's indexing
    traces ten times slower, and there are over a hundred."""
    flat, first = table.ravel(), interval * math.prod(table.shape[1:])
    numbers = jax.lax.GatherDimensionNumbers(
        offset_dims=(), collapsed_slice_dims=(0,), start_index_map=(0,)
    )

    def read(*place):
        index = first + int(np.ravel_multi_index(place, table.shape[1:]))
        return jax.lax.gather(
            flat, index[..., None], numbers, (1,), mode=jax.lax.GatherScatterMode.PROMISE_IN_BOUNDS
        )

    return read


def _rows(table, interval):
    """The table's numbers at each place, shape (powers, [degrees,] functions, *places)."""
    return jnp.moveaxis(table.reshape(table.shape[0], -1)[interval], -1, 0).reshape(
        *table.shape[1:], *interval.shape
    )


def _check_constant(tangent) -> None:
    if tangent is not None:
        raise NotImplementedError(
            "coefficients of tables are constants; derivatives by them do not exist"
        )
