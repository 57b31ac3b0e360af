"""Light through coats of paint onto coats of paint, of pixels and of rays  [L03 Section 3.3].

A line of sight meets the base's cones exactly, and each coat where its plane, parallel to the base
there, meets it; so do rays of light. Cones are bent the less the nearer a coat is: for one 0.4 mm
high, seen and lit at 45°, the place is off by 4 μm at most.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from irisjax.anatomy.eye import Eye
from irisjax.numerics.interpolation import bilinear, bilinear_rows, smoothstep
from irisjax.numerics.portions import pixelwise
from irisjax.numerics.roots import safe_sqrt
from irisjax.ocularist.coats import over, through
from irisjax.ocularist.cones import Cones
from irisjax.optics.conicoid import Parts, joined, parts
from irisjax.render.project import IrisPixels
from irisjax.render.shading import Field

SHADOW = 384
"""Texels along each side of the maps of light that falls through coats."""
CHANNELS = 4
"""Of these maps, the last one idle: rows of four are read at once."""
_BEHIND = 2.0  # mm before the eye's iris at which lines of sight begin


class Ground(NamedTuple):
    """Of each pixel, what all coats are drawn from.

    - `place`: where it sees the base, (x, y) in mm; `view`: by how much further aside it sees a
        coat, per mm of its height. `light`: by how much a ray of each lamp that meets the coat
        there falls beside the base's place, per mm.
    - `white`: radiance of a white sheet there in the light of each lamp, times the share that
        reaches the camera, (lights, pixels).
    """

    place: Float[Array, "2 pixels"]
    view: Float[Array, "2 pixels"]
    light: Float[Array, "lights 2 pixels"]
    white: Float[Array, "lights pixels"]


class State(NamedTuple):
    """What coats from the uppermost down send back, and the share that they let through."""

    radiance: Float[Array, "3 pixels"]
    clear: Float[Array, " pixels"]


@pixelwise
def ground(pixels: IrisPixels, profile: Cones, eye: Eye, flux) -> Ground:
    """Where pixels see the base, or its cones straight on beyond pupil and root."""
    whole = _extended(profile)
    direction = joined(pixels.direction)
    origin = joined(pixels.point) - _BEHIND * direction
    hit = whole.meet(origin, direction)
    point = origin + hit.distance[..., None] * direction
    normal = whole.normal(point, hit.cone)
    share = jnp.where(hit.met, pixels.share, 0.0)
    if pixels.index is not None:
        share = jnp.where(pixels.index < 0, 0.0, share)
    n, view = parts(normal), _aside(pixels.direction, parts(normal))
    at = Field(flux, eye.iris_radius).at(parts(point))
    light = at[:, 0], at[:, 1], at[:, 2]
    irradiance = jnp.maximum(-sum(f * c for f, c in zip(light, n, strict=True)), 0.0)
    falls = view - jax.vmap(lambda direction: _aside(direction, n))(_directed(light))
    place = jnp.stack([point[..., 0], point[..., 1]])
    return Ground(place, view, falls, irradiance * share / jnp.pi)


def _extended(profile: Cones) -> Cones:
    """The cones straight on to the axis and to twice the root's radius."""
    ends = jnp.stack([jnp.zeros_like(profile.radius[0]), 2 * profile.radius[-1]])
    z = profile.height(ends)
    return Cones(
        jnp.concatenate([z[:1], profile.z, z[1:]]),
        jnp.concatenate([ends[:1], profile.radius, ends[1:]]),
    )


def _aside(direction: Parts, normal: Parts):
    """By how much lines through points of the base are beside them, (2, …), where they meet the
    parallel plane that lies a unit of height before it.
    """
    along = sum(d * n for d, n in zip(direction, normal, strict=True))
    path = -normal[2] / along
    return jnp.stack([direction[0] * path, direction[1] * path])


def look_up(texture, x, y, reach):
    """In square pictures of the iris whose sides are `reach` (mm) from the axis, at places in mm;
    linear between texels.
    """
    return bilinear(texture, *_texel(x, y, reach, texture.shape[-2:]))


def _texel(x, y, reach, shape: tuple[int, int]):
    """Row and column of places in mm."""
    rows, columns = shape
    return (1 - y / reach) * (rows / 2) - 0.5, (1 + x / reach) * (columns / 2) - 0.5


def _covering(opacity, x, y, profile: Cones, reach, margin):
    """Opacity at places, softly none in the pupil, none beyond the root."""
    r = safe_sqrt(x * x + y * y)
    edge = smoothstep((r - profile.radius[0]) / margin)
    return jnp.where(r <= profile.radius[-1], edge * look_up(opacity, x, y, reach), 0.0)


@pixelwise
def opacity_at(seen: Ground, opacity, height, profile: Cones, reach, margin):
    """Opacity of a coat at the pixels. `reach`: radius of the iris, `margin`: over which it fades
    into the pupil, mm.
    """
    x, y = seen.place + height * seen.view
    return _covering(opacity, x, y, profile, reach, margin)


@pixelwise
def nothing(seen: Ground) -> State:
    """Before any coat."""
    one = jnp.ones_like(seen.place[0])
    return State(jnp.zeros((3, one.size), one.dtype), one)


@pixelwise
def paint_over(known, light, colours, height, tint, reach, as_printed: bool) -> State:
    """A group of coats under those above it: Eq. 1 from the uppermost down."""
    (radiance, clear), covered, seen = known

    def lamp(lit, one):
        texture, falls, white, colour = one
        x, y = seen.place + height * falls
        arriving = bilinear_rows(texture, *_texel(x, y, reach, texture.shape[:2]))[:3] * white
        return lit + (arriving if colour is None else colour[:, None] * arriving), None

    # Two at a time: all written out, XLA compiles 16 lamps for minutes.
    lamps = light, seen.light, seen.white, tint
    lit = jax.lax.scan(lamp, jnp.zeros_like(radiance), lamps, unroll=2)[0]
    for alpha, colour in zip(covered, colours, strict=True):
        radiance = radiance + clear * over(0.0, alpha, colour[:, None], lit)
        clear = clear * (1 - alpha)
        lit = through(lit, alpha, colour[:, None], as_printed)
    return State(radiance, clear)


def _directed(flux: Parts) -> Parts:
    """Unit vectors along fluxes, straight into the eye where there is none or it comes from
    behind.
    """
    length = jnp.sqrt(sum(f * f for f in flux))
    lit = (length > 0) & (flux[2] > 0.05 * length)
    length = jnp.where(lit, length, 1.0)
    x, y, z = (f / length for f in flux)
    return jnp.where(lit, x, 0.0), jnp.where(lit, y, 0.0), jnp.where(lit, z, 1.0)


@eqx.filter_jit
def rays(flux, profile: Cones, reach):
    """Directions of lights at texels of the base, (lights, 3, rows, columns)."""
    x, y = _texels(SHADOW, reach, flux.dtype)
    at = jax.lax.map(lambda f: Field(f[None], reach).at((x, y, x))[0], flux)
    return jnp.stack(_directed((at[:, 0], at[:, 1], at[:, 2])), 1)


def _texels(size: int, reach, dtype):
    line = ((2 * jnp.arange(size) + 1) / size - 1).astype(dtype) * reach
    x, y = jnp.meshgrid(line, -line)
    return x, y


@eqx.filter_jit
def full_light(flux, shape: tuple[int, ...]):
    """Light above all coats, as a share."""
    return jnp.ones(shape, flux.dtype)


@eqx.filter_jit
def crossed(rays, opacity, height, profile: Cones, reach, margin):
    """Opacity of a coat where rays to texels of the base cross it, (lights, rows, columns)."""
    x, y = _texels(rays.shape[-1], reach, rays.dtype)
    r = safe_sqrt(x * x + y * y)
    cone = jnp.clip(jnp.searchsorted(profile.radius, r) - 1, 0, len(profile.z) - 2)
    point = jnp.stack([x, y, profile.height(r)], -1)
    normal = parts(profile.normal(point, cone))

    def one(direction):
        u, v = _aside(tuple(direction), normal)
        return _covering(opacity, x + height * u, y + height * v, profile, reach, margin)

    return jax.lax.map(one, rays)


@eqx.filter_jit
def light_under(light, crossed, colours, as_printed: bool):
    """Maps of light below a group of coats, (lights, rows, columns, channels)."""
    for opacity, colour in zip(crossed, colours, strict=True):
        tint = jnp.concatenate([colour, jnp.ones_like(colour[:1])])
        light = through(light, opacity[..., None], tint, as_printed)
    return light
