"""A painted iris in a scene: coats of paint in place of tissue, from the uppermost down  [L03
Section 3.3].

A line of sight meets the base's cones exactly, and each coat where its plane, parallel to the base
there, meets it; so do rays of light. Cones are bent the less the nearer a coat is: for one 0.4 mm
high, seen and lit at 45°, the place is off by 4 μm at most.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye
from irisjax.numerics.interpolation import bilinear, smoothstep
from irisjax.numerics.portions import pixelwise
from irisjax.numerics.programs import program
from irisjax.numerics.roots import safe_sqrt
from irisjax.ocularist.coats import Coat, Painting, through
from irisjax.ocularist.cones import Cones
from irisjax.optics.conicoid import Parts, joined, parts
from irisjax.render.bands import Bands
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import AbstractIntegrator, AbstractResponse
from irisjax.render.lights import Lights
from irisjax.render.project import IrisPixels
from irisjax.render.shading import PUPIL_MARGIN, fluxes_of
from irisjax.render.steps import Once, simply
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, Scales

SHADOW = 384
"""Texels along each side of the maps of light that falls through coats."""
NEAR = 0.02
"""Difference in height (mm) up to which coats are lit alike but for what they take from each other:
light moves aside by less than a texel of a shadow between them.
"""
_BEHIND = 2.0  # mm before the eye's iris at which lines of sight begin


class Painted(AbstractIntegrator):
    """Integrator: coats of paint; a scene with it has no tissue.

    - `painting`: its coats. `as_printed`: shadows by the paper's Eq. 2 as it is printed.
    """

    painting: Painting
    as_printed: bool = eqx.field(static=True, default=False)
    process: None = None

    def place(
        self,
        pixels: IrisPixels,
        lights: Lights,
        eye: Eye,
        iris: Iris | None,
        maps: IrisMaps | None,
        tables: Illumination | None,
        ranges: Scales,
        once: Once = simply,
    ) -> tuple["Texels", None]:
        """See `AbstractIntegrator`. With a memory for `once`, a coat that changes is done anew with
        those below it, whose light it tints, and no other.
        """
        profile, reach = self.painting.profile, eye.iris_radius
        flux = once("fluxes", fluxes_of, lights, eye, tables)
        seen = once("painted ground", _ground, pixels, profile, eye, flux)
        rays = once("rays to paint", _rays, flux, profile, reach)
        shape = len(lights), 3, SHADOW, SHADOW
        light = once("light on paint", _full, flux, shape)
        state = once("bare ground", _nothing, seen)
        for group in _groups(self.painting):
            top, colours = group[0], tuple(coat.colour for coat in group)
            wheres = [(coat.opacity, coat.height, profile, reach) for coat in group]
            names = [coat.name for coat in group]
            covered = tuple(
                once(f"opacity of {name}", _opacity, seen, *where)
                for name, where in zip(names, wheres, strict=True)
            )
            known = state, covered, seen
            more = colours, top.height, lights.tint, reach, self.as_printed
            state = once(f"paint of {top.name}", _painted, known, light, *more)
            crossed = tuple(
                once(f"shadow of {name}", _crossed, rays, *where)
                for name, where in zip(names, wheres, strict=True)
            )
            known = crossed, colours, self.as_printed
            light = once(f"light under {top.name}", _under, light, *known)
        return Texels(pixels.index, state.radiance), None

    def response(
        self, iris: Iris | None, aqueous_index: Scalar, bands: Bands, ranges: Scales
    ) -> "PaintedResponse":
        """Of a picture in linear sRGB: colours of paints are no spectra.

        **Raises:** `ValueError` for a picture of other channels.
        """
        if bands.channels != ("R", "G", "B"):
            raise ValueError("a painted iris has colours, not spectra: ask for no wavelengths")
        return PaintedResponse(white=bands.weights.sum(1))


class Texels(eqx.Module):
    """Of each pixel the radiance in white light, (channels, pixels)."""

    index: Int[Array, " pixels"] | None
    radiance: Float[Array, "3 pixels"]


class PaintedResponse(AbstractResponse):
    """`white`: what a white sheet shows behind the cornea, in the picture's channels."""

    white: Float[Array, "3"]
    error: None = None
    status: None = None

    def shade(self, texels: Texels, ground: None) -> Float[Array, "channels pixels"]:
        """See `AbstractResponse`."""
        del ground
        return self.white[:, None] * texels.radiance


class Ground(NamedTuple):
    """Of each pixel: the point of the base, the line of sight into the eye, the normal; the flux of
    every light there, (lights, pixels) thrice; and the share that reaches the camera.
    """

    point: Parts
    direction: Parts
    normal: Parts
    flux: Parts
    share: Float[Array, " pixels"]


class State(NamedTuple):
    """What coats from the uppermost down send back, and the share that they let through."""

    radiance: Float[Array, "3 pixels"]
    clear: Float[Array, " pixels"]


@pixelwise
def _ground(pixels: IrisPixels, profile: Cones, eye: Eye, flux) -> Ground:
    """Where pixels see the base, or its cones straight on beyond pupil and root."""
    whole = _extended(profile)
    direction = joined(pixels.direction)
    origin = joined(pixels.point) - _BEHIND * direction
    hit = whole.meet(origin, direction)
    point = origin + hit.distance[..., None] * direction
    normal = whole.normal(point, hit.cone)
    x, y, _ = parts(point)
    middle = (flux.shape[-1] - 1) / 2
    at = bilinear(flux, (y / eye.iris_radius + 1) * middle, (x / eye.iris_radius + 1) * middle)
    share = jnp.where(hit.met, pixels.share, 0.0)
    if pixels.index is not None:
        share = jnp.where(pixels.index < 0, 0.0, share)
    return Ground(
        parts(point), pixels.direction, parts(normal), (at[:, 0], at[:, 1], at[:, 2]), share
    )


def _extended(profile: Cones) -> Cones:
    """The cones straight on to the axis and to twice the root's radius."""
    ends = jnp.stack([jnp.zeros_like(profile.radius[0]), 2 * profile.radius[-1]])
    z = profile.height(ends)
    return Cones(
        jnp.concatenate([z[:1], profile.z, z[1:]]),
        jnp.concatenate([ends[:1], profile.radius, ends[1:]]),
    )


def _lifted(point: Parts, direction: Parts, normal: Parts, height) -> Parts:
    """Where lines through points of the base meet the plane that lies `height` before it."""
    along = sum(d * n for d, n in zip(direction, normal, strict=True))
    path = -height * normal[2] / along
    return tuple(p + d * path for p, d in zip(point, direction, strict=True))


def look_up(texture, x, y, reach):
    """In square pictures of the iris whose sides are `reach` (mm) from the axis, at places in mm;
    linear between texels.
    """
    rows, columns = texture.shape[-2:]
    return bilinear(
        texture,
        (1 - y / reach) * (rows / 2) - 0.5,
        (1 + x / reach) * (columns / 2) - 0.5,
    )


def _covering(opacity, x, y, profile: Cones, reach):
    """Opacity at places, softly none in the pupil, none beyond the root."""
    r = safe_sqrt(x * x + y * y)
    edge = smoothstep((r - profile.radius[0]) / PUPIL_MARGIN)
    return jnp.where(r <= profile.radius[-1], edge * look_up(opacity, x, y, reach), 0.0)


@pixelwise
def _opacity(seen: Ground, opacity, height, profile: Cones, reach):
    x, y, _ = _lifted(seen.point, seen.direction, seen.normal, height)
    return _covering(opacity, x, y, profile, reach)


@pixelwise
def _nothing(seen: Ground) -> State:
    return State(jnp.zeros((3, seen.share.size), seen.share.dtype), jnp.ones_like(seen.share))


@pixelwise
def _painted(known, light, colours, height, tint, reach, as_printed: bool) -> State:
    """A group of coats under those above it: Eq. 1 from the uppermost down."""
    (radiance, clear), covered, seen = known
    place = _lifted(seen.point, seen.direction, seen.normal, height)
    lit = jnp.zeros_like(radiance)
    for i in range(light.shape[0]):
        flux = tuple(f[i] for f in seen.flux)
        irradiance = jnp.maximum(-sum(f * n for f, n in zip(flux, seen.normal, strict=True)), 0.0)
        x, y, _ = _lifted(place, _directed(flux), seen.normal, -height)
        arriving = look_up(light[i], x, y, reach) * irradiance
        lit = lit + (arriving if tint is None else tint[i][:, None] * arriving)
    for alpha, colour in zip(covered, colours, strict=True):
        radiance = radiance + (clear * alpha * seen.share) * colour[:, None] * lit
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


@program
def _rays(flux, profile: Cones, reach):
    """Directions of lights at texels of the base, (lights, 3, rows, columns)."""
    x, y = _texels(SHADOW, reach, flux.dtype)
    middle = (flux.shape[-1] - 1) / 2
    at = jax.lax.map(
        lambda f: bilinear(f, (y / reach + 1) * middle, (x / reach + 1) * middle), flux
    )
    return jnp.stack(_directed((at[:, 0], at[:, 1], at[:, 2])), 1)


def _texels(size: int, reach, dtype):
    line = ((2 * jnp.arange(size) + 1) / size - 1).astype(dtype) * reach
    x, y = jnp.meshgrid(line, -line)
    return x, y


@program
def _full(flux, shape: tuple[int, ...]):
    return jnp.ones(shape, flux.dtype)


@program
def _crossed(rays, opacity, height, profile: Cones, reach):
    """Opacity of a coat where rays to texels of the base cross it, (lights, rows, columns)."""
    x, y = _texels(rays.shape[-1], reach, rays.dtype)
    r = safe_sqrt(x * x + y * y)
    cone = jnp.clip(jnp.searchsorted(profile.radius, r) - 1, 0, len(profile.z) - 2)
    point = jnp.stack([x, y, profile.height(r)], -1)
    normal = parts(profile.normal(point, cone))

    def one(direction):
        place = _lifted((x, y, point[..., 2]), tuple(direction), normal, height)
        return _covering(opacity, place[0], place[1], profile, reach)

    return jax.lax.map(one, rays)


@program
def _under(light, crossed, colours, as_printed: bool):
    for opacity, colour in zip(crossed, colours, strict=True):
        light = through(light, opacity[:, None], colour[:, None, None], as_printed)
    return light


def _groups(painting: Painting) -> list[list[Coat]]:
    """Coats from the uppermost down, those within `NEAR` of the first of a group together."""
    groups: list[list[Coat]] = []
    for coat in reversed(painting.coats):
        first = groups[-1][0].height if groups else None
        traced = isinstance(coat.height, Tracer) or isinstance(first, Tracer)
        if first is None or traced or float(first) - float(coat.height) > NEAR:
            groups.append([coat])
        else:
            groups[-1].append(coat)
    return groups
