"""Reflection and transmission of a homogeneous slab by doubling, for one azimuthal order.

Operators act on radiances. Rows are the directions that light leaves along (quadrature nodes, then
exits), columns those that it comes from (nodes, then beams); only nodes take part in what happens
between. Unscattered light is kept apart, so that thin slabs keep all their digits.  [de Haan, Bosma
& Hovenier 1987, Section 3]
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from irisjax.numerics import linear
from irisjax.transport.process import attenuation, survival
from irisjax.transport.radiative.slab import mean_absence, mean_survival


class Response(NamedTuple):
    """Response of a slab to radiance 1 along each column: scattered radiance that is reflected and
    transmitted, shape (rows, columns), and the flux absorbed (columns,).
    """

    reflected: jax.Array
    transmitted: jax.Array
    absorbed: jax.Array


class Lines(NamedTuple):
    """Cosines along which a slab is seen: `rows`, `columns` with their weights, the first `nodes`
    of both the same.
    """

    rows: jax.Array
    columns: jax.Array
    weight: jax.Array
    nodes: int


class Medium(NamedTuple):
    """A slab: optical depth, albedo and 1 − albedo; phase matrices (rows, columns) for light that
    keeps its sense of travel, and for light that turns back.
    """

    depth: jax.Array
    albedo: jax.Array
    coalbedo: jax.Array
    same: jax.Array
    opposite: jax.Array


def slab_response(medium: Medium, lines: Lines, doublings: int) -> Response:
    """`Response` of a slab, doubled from 2^−doublings of its depth.

    The first layer's error goes as the square of its depth; two halves of it take it away to the
    fourth power.
    """
    depth = medium.depth / 2**doublings
    pair = jax.vmap(lambda d: thin(medium._replace(depth=d), lines))(jnp.stack([depth, depth / 2]))
    coarse, fine = (jax.tree.map(lambda x, k=k: x[k], pair) for k in (0, 1))

    def step(state, first):
        response, depth = state
        response = double(response, depth, lines)
        third = jnp.where(first, 1 / 3, 0.0).astype(depth.dtype)
        response = jax.tree.map(lambda f, c: f + third * (f - c), response, coarse)
        return (response, 2 * depth), None

    first = jnp.arange(doublings + 1) == 0
    return jax.lax.scan(step, (fine, depth / 2), first)[0][0]


def thin(medium: Medium, lines: Lines) -> Response:
    """A layer whose light is scattered once exactly; what follows comes from sources that are alike
    over its depth. It conserves energy.
    """
    n, identity = lines.nodes, jnp.eye(lines.nodes, dtype=medium.depth.dtype)
    depth, rows, columns = medium.depth, lines.rows[:, None], lines.columns[None]
    factor = 0.5 * medium.albedo * lines.weight[None]
    t, r = factor * medium.same, factor * medium.opposite
    mean, absence = mean_survival(depth / columns), mean_absence(depth / lines.rows[:n])
    # Of sources that fade along each column, in the mean over the depth: what leaves along a row.
    up = mean_survival(depth * (1 / rows + 1 / columns))
    down = survival(depth, jnp.maximum(rows, columns))
    down = down * mean_survival(depth * jnp.abs(1 / rows - 1 / columns))
    inside_t, inside_r = (t * (mean - down))[:n], (r * (mean - up))[:n]

    def later(sign):
        """Compute the sum (sign 1) or the difference (sign −1) of light down and up: sources after
        one or more scatterings, and the mean over the depth of all scattered light inside.
        """
        kernel = t[:, :n] + sign * r[:, :n]
        single = inside_t + sign * inside_r
        source = kernel @ single
        inner = linear.solve(identity - kernel[:n] * absence[None], source[:n])
        multiple = absence[:, None] * inner
        return source + kernel @ multiple, single + multiple

    (even, odd), (inside, _) = jax.vmap(later)(jnp.asarray([1.0, -1.0], depth.dtype))
    emission = 0.5 * attenuation(depth, lines.rows)[:, None]
    light = lines.weight * mean[0] + lines.weight[:n] @ inside
    return Response(
        reflected=r * up * (depth / rows) + emission * (even - odd),
        transmitted=t * down * (depth / rows) + emission * (even + odd),
        absorbed=medium.coalbedo * depth * light,
    )


def double(layer: Response, depth: jax.Array, lines: Lines) -> Response:
    """Two equal layers of optical depth `depth`  [de Haan, Bosma & Hovenier 1987, Eqs. 5 to 11]."""
    n, identity = lines.nodes, jnp.eye(lines.nodes, dtype=depth.dtype)
    r, t, absorbed = layer
    passed = survival(depth, lines.columns)
    t_in, t_out = passed[None], survival(depth, lines.rows)[:, None]
    twice = r[:n, :n] @ r[:n]
    # Between the two: downwards, then upwards.
    down = linear.solve(identity - twice[:, :n], t[:n] + twice * t_in)
    up = r[:, :n] @ down + r * t_in
    below = jnp.concatenate([down, t[n:] + r[n:, :n] @ up[:n]])
    return Response(
        reflected=r + t[:, :n] @ up[:n] + t_out * up,
        transmitted=t[:, :n] @ down + t_out * below + t * t_in,
        absorbed=absorbed * (1 + passed) + absorbed[:n] @ (down + up[:n]),
    )
