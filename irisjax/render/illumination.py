"""Tables of the light that reaches the iris from any direction: refraction and caustics together,
ready to be summed over lights.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye
from irisjax.numerics.interpolation import bilinear, multilinear
from irisjax.numerics.roots import safe_sqrt
from irisjax.optics.conicoid import Vector, norm
from irisjax.render.caustic import SquareGrid, gathered
from irisjax.render.refraction import (
    LARGEST_POLAR,
    UNIQUE_POLAR,
    RefractionFunction,
    arrive,
    enter,
    on_cornea,
    window,
)

_SPACING, _FINE = (
    0.05,
    0.0125,
)  # radians between tabulated polar angles, up to `UNIQUE_POLAR` and beyond
_UNIQUE = round(UNIQUE_POLAR / _SPACING)


class Illumination(eqx.Module):
    """Flux vectors on the iris of unit light, over its polar angle and a square grid turned to its
    azimuth; made with `build`.

    Light within the soft edge of the limbus is dimmed. Where rays are counted (beyond
    `UNIQUE_POLAR`) the grid's cell, 2 × extent / (size − 1), is the resolution; the grid reaches
    one cell beyond the iris. A caustic moves by up to 0.15 mm per degree: half-way between two
    angles up to 4 % of its power is misplaced by that much.

    Attributes:
        flux: Flux vectors over polar angle, rows y and columns x.
        extent: Half the side of the grid, mm.
        largest: Polar angle that the tables reach, radians; light from beyond fades out over one
            step of them.
    """

    flux: Float[Array, "polars size size 3"]
    extent: Float[Array, ""]
    largest: float = eqx.field(static=True)

    @classmethod
    def build(
        cls, eye: Eye, *, caustics: bool = True, size: int = 129, n_rays: int = 131_072
    ) -> "Illumination":
        """Tables of an eye with a cornea; without `caustics` they end at `UNIQUE_POLAR` and no ray
        is counted. A coarser grid than usual has entry points searched as coarsely.
        """
        # From what decides them and nothing else: a file kept for one eye then serves all that
        # share it.
        eye = deciding(eye)
        refraction = RefractionFunction.build(eye, *_searched(size))
        return _build(eye, refraction, caustics, size, n_rays)

    def at(self, point: Float[Array, "*#s 2"], towards_light: Float[Array, "*#s 3"]) -> Vector:
        """Flux vectors at iris points (x, y) of light from unit directions (that broadcast with
        them).

        On the axis itself, where azimuths have none, the gradient to the direction is taken as
        zero.
        """
        across = norm(towards_light[..., :2])
        polar = jnp.arctan2(across, -towards_light[..., 2])
        some = across > 0
        cos = jnp.where(some, towards_light[..., 0] / jnp.where(some, across, 1.0), 1.0)
        sin = jnp.where(some, towards_light[..., 1] / jnp.where(some, across, 1.0), 0.0)
        x = cos * point[..., 0] + sin * point[..., 1]
        y = -sin * point[..., 0] + cos * point[..., 1]
        size = self.flux.shape[1]
        position = tuple((c / self.extent + 1) * ((size - 1) / 2) for c in (y, x))
        index = (
            jnp.minimum(polar / _SPACING, _UNIQUE) + jnp.maximum(polar - UNIQUE_POLAR, 0.0) / _FINE
        )
        if towards_light.ndim == 1:  # one layer for all points
            below = jnp.clip(jnp.floor(index), 0, len(self.flux) - 2).astype(int)
            low, high = (
                jax.lax.dynamic_index_in_dim(self.flux, below + k, keepdims=False) for k in (0, 1)
            )
            layer = low + jnp.clip(index - below, 0, 1) * (high - low)
            f = multilinear(layer, position)
        else:
            f = multilinear(self.flux, (index, *position))
        f = f * jnp.clip((self.largest - polar) / _SPACING + 1, 0, 1)[..., None]
        return jnp.stack(
            [cos * f[..., 0] - sin * f[..., 1], sin * f[..., 0] + cos * f[..., 1], f[..., 2]],
            axis=-1,
        )


def _searched(size: int) -> tuple[int, int, int]:
    """Polar angles, azimuths and radii of the entry points for a grid of `size`."""
    share = min(size / 129, 1.0)
    polars = 50 if share == 1 else _UNIQUE + 1  # those that are tabulated, no more
    return polars, max(round(50 * share), 13), max(round(100 * share), 25)


def deciding(eye: Eye) -> Eye:
    """The eye without everything that its tables do not depend on: pupil, sclera and the cornea's
    haze.

    Raises:
        ValueError: The eye has no cornea.
    """
    cornea = eye.cornea
    if cornea is None:
        raise ValueError("an eye without a cornea needs no illumination tables")
    # Behind a single surface lies the chamber; the cornea's own index is then met nowhere.
    index = eye.aqueous_index if cornea.posterior is None else cornea.index
    cornea = dataclasses.replace(cornea, scatter=None, index=index)
    rims = {"pupil_radius": 1.0, "pupil_margin": 0.12, "limbus_width": 1.0}
    return eye.replace(cornea=cornea, sclera=None, **rims)


def near_light(
    eye: Eye, towards: Float[Array, "3"], near: Scalar, point: Float[Array, "*s 2"], size: int = 17
) -> tuple[Vector, Float[Array, "*s"]]:
    """Where the light of a lamp 1/`near` mm from the apex enters on its way to iris points (x, y),
    and how much it spreads.

    The second is a factor on the flux of the tables, made for the sun's light: along the axis 0.89
    at 50 mm. Both are searched at `size` × `size` points and interpolated. Where no ray lands, and
    from one moment to the next beyond `UNIQUE_POLAR`, the light enters right before the point, and
    the factor is 1.
    """
    cornea = eye.cornea
    assert cornea is not None
    line = jnp.linspace(-1, 1, size) * eye.iris_radius
    targets = jnp.stack(jnp.meshgrid(line, line), axis=-1).reshape(-1, 2)

    def found(target):
        def landing(entry, place):  # of a ray that enters at `entry` as the lamp's does at `place`
            light = towards - on_cornea(cornea, place) * near
            return enter(eye, on_cornea(cornea, entry), -light / norm(light)).point[:2]

        arrival = arrive(eye, target, towards, 0.9 * target)
        fixed, turned = jax.jacfwd(landing, (0, 1))(arrival.entry, arrival.entry)
        area, wider = (m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0] for m in (fixed, fixed + turned))
        lit = (norm(arrival.flux) > 0) & (area * wider > 0) & (-towards[2] >= jnp.cos(UNIQUE_POLAR))
        return *jnp.where(lit, arrival.entry, target), jnp.where(
            lit, area / jnp.where(lit, wider, 1.0), 1.0
        )

    row, column = ((point[..., k] / eye.iris_radius + 1) * ((size - 1) / 2) for k in (1, 0))
    x, y, spread = (bilinear(v.reshape(size, size), row, column) for v in jax.vmap(found)(targets))
    r = safe_sqrt(x * x + y * y)  # 0 on the axis, where a lamp's gradient is wanted too
    inside = jnp.minimum(1.0, eye.limbus_radius / jnp.where(r > 0, r, 1.0))
    return on_cornea(cornea, jnp.stack([x * inside, y * inside], axis=-1)), spread


@eqx.filter_jit
def _build(
    eye: Eye, refraction: RefractionFunction, caustics: bool, size: int, n_rays: int
) -> Illumination:
    # One cell beyond the iris: cells that its edge cuts would lose the power landing outside and
    # darken the rim.
    extent = eye.iris_radius * (size - 1) / (size - 3)
    grid = SquareGrid(size, extent)
    line = jnp.linspace(-1, 1, size) * extent
    x, y = jnp.meshgrid(line, line)
    points = jnp.stack([x, y], axis=-1)

    def smooth(angle):
        found = refraction.at(
            points, jnp.stack([jnp.sin(angle), jnp.zeros_like(angle), -jnp.cos(angle)])
        )
        return window(eye, found.entry)[..., None] * found.flux

    smoothly = jax.lax.map(smooth, jnp.arange(_UNIQUE + 1) * _SPACING)
    if not caustics:
        return Illumination(smoothly, extent, UNIQUE_POLAR)
    steps = round((LARGEST_POLAR - UNIQUE_POLAR) / _FINE)
    counted = jax.lax.map(
        lambda a: gathered(eye, a, grid, n_rays), UNIQUE_POLAR + _FINE * jnp.arange(1, steps + 1)
    )
    return Illumination(jnp.concatenate([smoothly, counted]), extent, UNIQUE_POLAR + steps * _FINE)


def bare(point: Vector, towards_light: Vector) -> Vector:
    """Flux vectors of unit light on an iris in air: no cornea, nothing to tabulate."""
    return jnp.broadcast_to(-towards_light, jnp.broadcast_shapes(point.shape, towards_light.shape))
