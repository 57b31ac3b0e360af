"""The caustic: grazing light that the cornea folds onto itself, counted ray by ray on the iris
[F09 Eq. 17].

A quasi-random ray stands for its share of the cornea's area; its power is shared out between the
four grid points round the place where it lands, so that the sum over the iris is the power that
arrived.

F09 adds rays reflected inside the cornea. With F09's own cornea there are none: a ray goes on at
most 46.6° from the normal (total reflection's angle), so that it meets the conicoid again 0.3 mm or
more behind the limbus, where the cornea has ended. The caustic is made by refraction alone.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from irisjax.anatomy.eye import Eye
from irisjax.optics.conicoid import dot
from irisjax.render.refraction import Landing, cross, into_chamber, on_cornea, window

_CHUNK = 1 << 14  # rays traced together: their intermediates stay in the cache


class SquareGrid(NamedTuple):
    """A square grid over the iris: `size` points a side from −`extent` to +`extent` mm."""

    size: int
    extent: Float[Array, ""]

    @property
    def cell(self) -> Float[Array, ""]:
        """Area of a cell, mm²."""
        return (2 * self.extent / (self.size - 1)) ** 2


def gathered(eye: Eye, polar: Array, grid: SquareGrid, n_rays: int) -> Float[Array, "size size 3"]:
    """Flux vectors on the grid (rows y, columns x) of unit light from azimuth 0 and the given polar
    angle.

    `n_rays` over the whole cornea; one half is traced and mirrored.
    """
    cornea = eye.cornea
    assert cornea is not None
    towards = jnp.stack([jnp.sin(polar), jnp.zeros_like(polar), -jnp.cos(polar)])
    chunks = -(-n_rays // (2 * _CHUNK))
    area = jnp.pi / 2 * (eye.limbus_radius + 0.15) ** 2 / (chunks * _CHUNK)

    def chunk(total, first):
        i = first * _CHUNK + jnp.arange(_CHUNK)
        # The R2 sequence [Roberts 2018]: even cover without a seed. One half of the cornea; the
        # other mirrors it.
        u, v = (i * 0.7548776662466927 + 0.5) % 1.0, (i * 0.5698402909980532 + 0.5) % 1.0
        r, angle = (eye.limbus_radius + 0.15) * jnp.sqrt(u), jnp.pi * v
        k = jnp.stack([r * jnp.cos(angle), r * jnp.sin(angle)], axis=-1)
        entry = on_cornea(cornea, k)
        normal = cornea.anterior.normal(entry)
        power = window(eye, k) * jnp.maximum(dot(normal, towards), 0) / -normal[..., 2] * area
        start, inside, share = into_chamber(eye, entry, jnp.broadcast_to(-towards, entry.shape))
        return _share_out(total, grid, eye, cross(eye, start, inside, power * share)), None

    zero = jnp.zeros((grid.size * grid.size, 3), polar.dtype)
    half, _ = jax.lax.scan(chunk, zero, jnp.arange(chunks))
    half = half.reshape(grid.size, grid.size, 3) / grid.cell
    return half + half[::-1] * jnp.asarray([1.0, -1.0, 1.0], half.dtype)


def _share_out(total, grid: SquareGrid, eye: Eye, landing: Landing):
    """Add the power of landings to their four grid points, as flux vectors (per cell, not yet per
    area).
    """
    x, y = landing.point[..., 0], landing.point[..., 1]
    on_grid = (jnp.maximum(jnp.abs(x), jnp.abs(y)) < grid.extent) & (landing.share > 0)
    power = jnp.where(on_grid, landing.share, 0.0)
    normal = eye.iris_normal(landing.point)
    cosine = -dot(landing.direction, normal)
    # Cells are those of the plane; an iris that is a cone has more area in each.
    vector = (power * -normal[..., 2] / jnp.where(on_grid, cosine, 1.0))[
        ..., None
    ] * landing.direction
    column, row = (
        (jnp.where(on_grid, c, 0.0) / grid.extent + 1) * ((grid.size - 1) / 2) for c in (x, y)
    )
    j, i = (jnp.clip(jnp.floor(c), 0, grid.size - 2) for c in (column, row))
    u, v = column - j, row - i
    base = jnp.asarray(i * grid.size + j, jnp.int32)
    for step, weight in (
        (0, (1 - u) * (1 - v)),
        (1, u * (1 - v)),
        (grid.size, (1 - u) * v),
        (grid.size + 1, u * v),
    ):
        total = total.at[base + step].add(weight[..., None] * vector, mode="promise_in_bounds")
    return total
