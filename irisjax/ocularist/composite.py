"""Light that passes through coats of paint, along lines of sight and rays of lamps
[L03 Section 3.3].

A line of sight or a ray meets the cones of the base exactly. Each coat is approximated by the plane
parallel to the base at that point: for a coat 0.4 mm high, seen and lit at 45°, the place is off by
4 μm at most.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye
from irisjax.numerics.interpolation import bilinear, multilinear, smoothstep
from irisjax.numerics.portions import pixelwise
from irisjax.numerics.roots import safe_sqrt
from irisjax.ocularist.coats import over, through
from irisjax.ocularist.cones import Cones
from irisjax.optics.conicoid import Parts, joined, parts
from irisjax.render.project import IrisPixels
from irisjax.render.shading import Field

SHADOW = 384
"""Texels along each side of the maps of light below coats."""
CHANNELS = 4
"""Of these maps; the last one is not used, since rows of four are read at once."""
_BEHIND = 2.0  # mm in front of the iris at which lines of sight begin


class Ground(NamedTuple):
    """The geometry of pixels, which all coats share.

    Attributes:
        place: Where a pixel sees the base, (x, y) in mm.
        view: Displacement of the point where it sees a coat, mm per mm of the coat's height.
        light: Displacement on the base of a ray of each lamp that meets the coat at that point, mm
            per mm.
        white: Radiance of a white sheet there in the light of each lamp, times the transmittance to
            the camera.
    """

    place: Float[Array, "2 pixels"]
    view: Float[Array, "2 pixels"]
    light: Float[Array, "lights 2 pixels"]
    white: Float[Array, "lights pixels"]


class State(NamedTuple):
    """Coats from the uppermost down.

    Attributes:
        radiance: Of the light that they send back.
        clear: Transmittance of all of them.
    """

    radiance: Float[Array, "3 pixels"]
    clear: Float[Array, " pixels"]


@pixelwise
def ground(pixels: IrisPixels, profile: Cones, eye: Eye, flux: Array) -> Ground:
    """Where pixels see the base, whose cones are extended beyond pupil and root."""
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
    """The cones, extended straight to the axis and to twice the root's radius."""
    ends = jnp.stack([jnp.zeros_like(profile.radius[0]), 2 * profile.radius[-1]])
    z = profile.height(ends)
    return Cones(
        jnp.concatenate([z[:1], profile.z, z[1:]]),
        jnp.concatenate([ends[:1], profile.radius, ends[1:]]),
    )


def _aside(direction: Parts, normal: Parts):
    """Displacement (2, …) along lines through points of the base, up to the parallel plane at unit
    height in front of it.
    """
    along = sum(d * n for d, n in zip(direction, normal, strict=True))
    path = -normal[2] / along
    return jnp.stack([direction[0] * path, direction[1] * path])


def look_up(texture: Array, x: Array, y: Array, reach: Scalar) -> Array:
    """Values of square pictures of the iris, whose sides are `reach` (mm) from the axis, at places
    in mm; linear between texels.
    """
    return bilinear(texture, *_texel(x, y, reach, texture.shape[-2:]))


def _texel(x, y, reach, shape: tuple[int, ...]):
    """Row and column of places in mm."""
    rows, columns = shape
    return (1 - y / reach) * (rows / 2) - 0.5, (1 + x / reach) * (columns / 2) - 0.5


def _covering(opacity, x, y, profile: Cones, reach, margin):
    """Opacity at places; it fades into the pupil and is 0 beyond the root."""
    r = safe_sqrt(x * x + y * y)
    edge = smoothstep((r - profile.radius[0]) / margin)
    return jnp.where(r <= profile.radius[-1], edge * look_up(opacity, x, y, reach), 0.0)


@pixelwise
def opacity_at(
    seen: Ground, opacity: Array, height: Scalar, profile: Cones, reach: Scalar, margin: Scalar
) -> Float[Array, " pixels"]:
    """Opacity of a coat at the pixels.

    Args:
        seen: Geometry of the pixels.
        opacity: The coat's map.
        height: Of the coat, mm.
        profile: Cross-section of the base.
        reach: Radius of the iris, mm.
        margin: Width over which the coat fades into the pupil, mm.
    """
    x, y = seen.place + height * seen.view
    return _covering(opacity, x, y, profile, reach, margin)


@pixelwise
def nothing(seen: Ground) -> State:
    """The state above all coats."""
    one = jnp.ones_like(seen.place[0])
    return State(jnp.zeros((3, one.size), one.dtype), one)


@pixelwise
def paint_over(
    known: tuple[State, tuple[Array, ...], Ground],
    light: Array,
    colours: tuple[Array, ...],
    height: Scalar,
    tint: Array | None,
    reach: Scalar,
    as_printed: bool,
) -> State:
    """Add a group of coats below those above it: Eq. 1 from the uppermost down.

    Args:
        known: The state of the coats above, the opacities of the group's coats at the pixels, and
            the geometry of the pixels.
        light: Maps of light below the coats above.
        colours: Of the group's coats.
        height: Of the group, mm.
        tint: Of each lamp.
        reach: Radius of the iris, mm.
        as_printed: Whether shadows follow Eq. 2 as printed.
    """
    (radiance, clear), covered, seen = known

    def lamp(lit, one):
        texture, falls, white, colour = one
        x, y = seen.place + height * falls
        found = multilinear(texture, _texel(x, y, reach, texture.shape[:2]))
        arriving = jnp.moveaxis(found, -1, 0)[:3] * white
        return lit + (arriving if colour is None else colour[:, None] * arriving), None

    # Two at a time: unrolled completely, 16 lamps take XLA minutes to compile.
    lamps = light, seen.light, seen.white, tint
    lit = jax.lax.scan(lamp, jnp.zeros_like(radiance), lamps, unroll=2)[0]
    for alpha, colour in zip(covered, colours, strict=True):
        radiance = radiance + clear * over(0.0, alpha, colour[:, None], lit)
        clear = clear * (1 - alpha)
        lit = through(lit, alpha, colour[:, None], as_printed)
    return State(radiance, clear)


def _directed(flux: Parts) -> Parts:
    """Unit vectors along fluxes; straight into the eye where the flux is 0 or comes from behind."""
    length = jnp.sqrt(sum(f * f for f in flux))
    lit = (length > 0) & (flux[2] > 0.05 * length)
    length = jnp.where(lit, length, 1.0)
    x, y, z = (f / length for f in flux)
    return jnp.where(lit, x, 0.0), jnp.where(lit, y, 0.0), jnp.where(lit, z, 1.0)


@eqx.filter_jit
def rays(flux: Array, profile: Cones, reach: Scalar) -> Float[Array, "lights 3 rows columns"]:
    """Directions of lights at texels of the base."""
    x, y = _texels(SHADOW, reach, flux.dtype)
    at = jax.lax.map(lambda f: Field(f[None], reach).at((x, y, x))[0], flux)
    return jnp.stack(_directed((at[:, 0], at[:, 1], at[:, 2])), 1)


def _texels(size: int, reach, dtype):
    line = ((2 * jnp.arange(size) + 1) / size - 1).astype(dtype) * reach
    x, y = jnp.meshgrid(line, -line)
    return x, y


@eqx.filter_jit
def full_light(flux: Array, shape: tuple[int, ...]) -> Array:
    """Maps of light above all coats, relative to the lamps'."""
    return jnp.ones(shape, flux.dtype)


@eqx.filter_jit
def crossed(
    rays: Array, opacity: Array, height: Scalar, profile: Cones, reach: Scalar, margin: Scalar
) -> Float[Array, "lights rows columns"]:
    """Opacity of a coat where rays to texels of the base cross it; arguments of `opacity_at`."""
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
def light_under(
    light: Array, crossed: tuple, colours: tuple[Array, ...], as_printed: bool
) -> Float[Array, "lights rows columns channels"]:
    """Maps of light below a group of coats."""
    for opacity, colour in zip(crossed, colours, strict=True):
        tint = jnp.concatenate([colour, jnp.ones_like(colour[:1])])
        light = through(light, opacity[..., None], tint, as_printed)
    return light
