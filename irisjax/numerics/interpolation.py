"""Polynomials, steps and look-ups in textures and tables."""

import functools
import math
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

_Reals = Float[Array, "..."]


def horner(t: _Reals, coefficients: Sequence[Any]) -> _Reals:
    """Polynomial in `t` with these coefficients, numbers or arrays, the lowest power first."""
    value = coefficients[-1]
    for c in coefficients[-2::-1]:
        value = value * t + c
    return value


def chebyshev(t: _Reals, count: int) -> tuple[list[_Reals], list[_Reals]]:
    """The first `count` (two at least) Chebyshev polynomials T_k at `t`, and their derivatives."""
    values, slopes = [jnp.ones_like(t), t], [jnp.zeros_like(t), jnp.ones_like(t)]
    for _ in range(count - 2):
        slopes.append(2 * values[-1] + 2 * t * slopes[-1] - slopes[-2])
        values.append(2 * t * values[-1] - values[-2])
    return values, slopes


def chebyshev_series(
    weights: Float[Array, "count functions"], t: Float[Array, " points"]
) -> Float[Array, "functions points"]:
    """Σ_k weights_k T_k(t) of several functions at many points.

    With w about the root of `count`, every T_k is a sum of ± 2 T_{wa} T_b, a and b below w: two
    short recurrences and a matrix product take the place of a long recurrence.
    """
    count = weights.shape[0]
    width = max(math.isqrt(count - 1) + 1, 2)
    low_orders, _ = chebyshev(t, width + 1)
    steps, _ = chebyshev(low_orders[width], width)  # T_a(T_w) = T_{wa}
    rows = jnp.stack(steps)[:, None] * jnp.stack(low_orders[:width])[None]
    products = jnp.asarray(_in_products(count, width), t.dtype)
    return (products @ weights).T @ rows.reshape(width * width, -1)


@functools.lru_cache(maxsize=32)
def _in_products(count: int, width: int) -> np.ndarray:
    """The matrix from weights of T_k to those of T_{wa} T_b, shape (w², count)."""
    matrix = np.zeros((width, width, count))
    for k in range(count):
        weight, order = 1.0, k
        # T_{wa + b} = 2 T_{wa} T_b − T_{wa − b}
        while order >= width and order % width:
            a, b = divmod(order, width)
            matrix[a, b, k] += 2 * weight
            weight, order = -weight, width * a - b
        matrix[(*divmod(order, width), k)] += weight
    return matrix.reshape(width * width, count)


def chebyshev_nodes(n: int) -> np.ndarray:
    """Zeros of T_n, the best nodes of a polynomial of degree n − 1."""
    return np.cos(np.pi * (np.arange(n) + 0.5) / n)


def smoothstep(x: _Reals) -> _Reals:
    """Smooth rise from 0 at x = 0 to 1 at x = 1."""
    x = jnp.clip(x, 0.0, 1.0)
    return x * x * (3 - 2 * x)


def piecewise_linear(x: _Reals, grid: np.ndarray, values: np.ndarray, *, outside: float) -> _Reals:
    """Linear interpolation in a table at traced places; `outside` of it, and where x is NaN.

    `grid` (increasing) and `values` are host arrays. It is a sum of hat functions, which is
    independent of how `x` is laid out over devices, unlike a search and a look-up.
    """
    steps = np.diff(grid)
    rows = grid, values, 1 / np.append(steps[:1], steps), -1 / np.append(steps, steps[-1:])
    nodes, heights, rising, falling = (
        jnp.asarray(row, x.dtype).reshape((1,) * x.ndim + (-1,)) for row in rows
    )
    offset = x[..., None] - nodes
    hats = jnp.maximum(1 + jnp.where(offset < 0, rising, falling) * offset, 0.0)
    in_table = (x >= nodes.min()) & (x <= nodes.max())
    return jnp.where(in_table, (hats * heights).sum(-1), outside)


def bilinear(
    texture: Float[Array, "*c rows columns"],
    row: _Reals,
    column: _Reals,
    *,
    round_rows: bool = False,
) -> _Reals:
    """Linear interpolation at fractional indices, held at the ends; rows may run round instead."""
    rows, columns = texture.shape[-2:]
    cells = (_round_cell if round_rows else _cell)(row, rows), _cell(column, columns)
    values = [
        _interpolate(layer, (rows, columns), cells) for layer in texture.reshape(-1, rows * columns)
    ]
    if texture.ndim == 2:
        return values[0]
    return jnp.stack(values).reshape(*texture.shape[:-2], *row.shape)


def polar_bilinear(
    texture: Float[Array, "*c angles radii"], angle: _Reals, radius: _Reals
) -> _Reals:
    """Linear interpolation between cell centres, round in `angle` (radians) and held at the ends of
    `radius` (0 pupil's edge, 1 root).
    """
    place = _polar_indices(texture.shape[-2:], angle, radius)
    return bilinear(texture, *place, round_rows=True)


def polar_multilinear(
    texture: Float[Array, "angles radii channels"], angle: _Reals, radius: _Reals
) -> Float[Array, "... channels"]:
    """Compute `polar_bilinear` of textures that lie side by side, four of them best.

    With four textures, one of which may be idle, it takes two thirds of the time of three.
    """
    place = _polar_indices(texture.shape[:2], angle, radius)
    return multilinear(texture, place, round_rows=True)


def multilinear(
    table: Float[Array, "*axes channels"], position: Sequence[_Reals], *, round_rows: bool = False
) -> Float[Array, "... channels"]:
    """Linear interpolation at fractional indices along every axis but the last, held at the ends;
    the first may run round instead.

    With four channels, one of which may be idle, this is two to three times as fast as `bilinear`
    of three textures.
    """
    *counts, channels = table.shape
    kinds = (_round_cell if round_rows else _cell, *[_cell] * (len(counts) - 1))
    cells = [cell(x, count) for cell, x, count in zip(kinds, position, counts, strict=True)]
    cells = [(below, above, weight[..., None]) for below, above, weight in cells]
    return _interpolate(table.reshape(-1, channels), counts, cells)


def _polar_indices(shape, angle, radius):
    """Compute fractional indices in a texture, which are whole at the centres of its cells."""
    rows, columns = shape
    return angle * (rows / (2 * jnp.pi)) - 0.5, radius * columns - 0.5


def _interpolate(flat, counts, cells, index=0):
    """Read a table of `counts` along its axes, flattened, between both ends of each cell."""
    if not cells:
        return flat.at[index].get(mode="promise_in_bounds")
    (below, above, weight), *cells = cells
    low, high = (
        _interpolate(flat, counts[1:], cells, index * counts[0] + end) for end in (below, above)
    )
    return low * (1 - weight) + high * weight


def _cell(x, count: int):
    """Indices below and above a fractional one, held at the ends, and the weight of the latter."""
    x = jnp.clip(x, 0, count - 1)
    below = jnp.minimum(jnp.floor(x), count - 2)
    index = jnp.asarray(below, jnp.int32)
    return index, index + 1, x - below


def _round_cell(x, count: int):
    """Find the same of an index that runs round: the first follows the last."""
    whole = jnp.floor(x)
    index = jnp.asarray(whole, jnp.int32) % count
    return index, jnp.where(index + 1 == count, 0, index + 1), x - whole
