"""Polynomials, steps and look-ups in textures and tables."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


def horner(t, coefficients):
    """Polynomial in `t`, lowest power first; coefficients are numbers, or arrays of the shape of
    `t`.
    """
    out = coefficients[-1]
    for c in coefficients[-2::-1]:
        out = out * t + c
    return out


def chebyshev(t: Float[Array, "..."], count: int):
    """The first `count` (two at least) Chebyshev polynomials of the first kind at `t`, and their
    derivatives.
    """
    values, slopes = [jnp.ones_like(t), t], [jnp.zeros_like(t), jnp.ones_like(t)]
    for _ in range(count - 2):
        slopes.append(2 * values[-1] + 2 * t * slopes[-1] - slopes[-2])
        values.append(2 * t * values[-1] - values[-2])
    return values, slopes


def smoothstep(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """Smooth rise from 0 to 1 between the same."""
    x = jnp.clip(x, 0.0, 1.0)
    return x * x * (3 - 2 * x)


def piecewise_linear(x: Float[Array, "..."], grid, values, *, outside: float):
    """Linear interpolation in a table at traced places; `outside` it, and where x is not a number.

    A sum of hat functions: unlike a search and a look-up it needs nothing to be known of how `x` is
    laid out over devices. `grid` (increasing) and `values` are host arrays.
    """
    steps = np.diff(grid)
    rows = grid, values, 1 / np.append(steps[:1], steps), -1 / np.append(steps, steps[-1:])
    grid, values, rising, falling = (
        jnp.asarray(row, x.dtype).reshape((1,) * x.ndim + (-1,)) for row in rows
    )
    away = x[..., None] - grid
    hats = jnp.maximum(1 + jnp.where(away < 0, rising, falling) * away, 0.0)
    inside = (x >= grid.min()) & (x <= grid.max())
    return jnp.where(inside, (hats * values).sum(-1), outside)


def bilinear(texture: Float[Array, "*c angles radii"], angle, radius) -> Float[Array, "..."]:
    """Bilinear look-up, round in `angle` (radians) and held at the ends of `radius` (0 pupil's
    edge, 1 root).
    """
    rows, columns = texture.shape[-2:]
    row = angle * (rows / (2 * jnp.pi)) - 0.5
    column = jnp.clip(radius * columns - 0.5, 0, columns - 1)
    i, j = jnp.floor(row), jnp.minimum(jnp.floor(column), columns - 2)
    u, v = row - i, column - j
    i0 = jnp.asarray(i, jnp.int32) % rows
    i1 = jnp.where(i0 + 1 == rows, 0, i0 + 1)
    j0 = jnp.asarray(j, jnp.int32)
    here, next_ = i0 * columns + j0, i1 * columns + j0

    def one(flat):
        def at(place):
            return flat.at[place].get(mode="promise_in_bounds")

        below = at(here) * (1 - v) + at(here + 1) * v
        above = at(next_) * (1 - v) + at(next_ + 1) * v
        return below * (1 - u) + above * u

    layers = texture.reshape(-1, rows * columns)
    if texture.ndim == 2:
        return one(layers[0])
    return jnp.stack([one(layer) for layer in layers]).reshape(*texture.shape[:-2], *row.shape)


def trilinear(table, position):
    """Linear interpolation at fractional indices, held at the ends."""
    flat = table.reshape(-1, table.shape[-1])
    index, weight = [], []
    for x, n in zip(position, table.shape, strict=False):
        x = jnp.clip(x, 0, n - 1)
        i = jnp.minimum(jnp.floor(x), n - 2)
        index.append(jnp.asarray(i, jnp.int32))
        weight.append((x - i)[..., None])
    (i, j, k), (u, v, w) = index, weight
    _, n_j, n_k = table.shape[:3]

    def row(a, b):
        base = ((i + a) * n_j + (j + b)) * n_k + k
        low = flat.at[base].get(mode="promise_in_bounds")
        return low + w * (flat.at[base + 1].get(mode="promise_in_bounds") - low)

    below = row(0, 0) * (1 - v) + row(0, 1) * v
    above = row(1, 0) * (1 - v) + row(1, 1) * v
    return below * (1 - u) + above * u
