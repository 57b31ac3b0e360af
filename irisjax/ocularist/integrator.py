"""A painted iris in a scene: coats of paint in place of tissue, from the uppermost down  [L03
Section 3.3].

A line of sight or a ray meets the cones of the base exactly. Each coat is approximated by the plane
parallel to the base at that point: for a coat 0.4 mm high, seen and lit at 45°, the place is off by
4 μm at most.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye
from irisjax.numerics.checks import is_known
from irisjax.numerics.chunks import pixelwise
from irisjax.numerics.interpolation import bilinear, multilinear, smoothstep
from irisjax.numerics.roots import safe_sqrt
from irisjax.ocularist.coats import Coat, Painting, over, through
from irisjax.ocularist.cones import Cones
from irisjax.optics.conicoid import Parts, from_parts, parts
from irisjax.render.bands import Bands
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import AbstractIntegrator, AbstractResponse
from irisjax.render.lights import Lights
from irisjax.render.project import IrisPixels
from irisjax.render.shading import Facing, IrisModel, flux_at, incident_flux
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import Scales, texel_places

NEAR = 0.03
"""Difference in height (mm) up to which coats are lit alike but for what they take from each other:
light moves aside by less than a texel of a shadow between them.
"""
SHADOW = 384
"""Texels along each side of the maps of light below coats."""
_CHANNELS = 4  # of these maps; the last one is not used, since rows of four are read at once
_BEHIND = 2.0  # mm in front of the iris at which lines of sight begin
# Radiance that the coats so far send back, and the transmittance of all of them.
_State = tuple[Float[Array, "3 pixels"], Float[Array, " pixels"]]


class Painted(AbstractIntegrator):
    """Integrator: coats of paint; a scene with it has no tissue.

    Attributes:
        painting: The coats.
        as_printed: Whether shadows follow the paper's Eq. 2 as it is printed.
    """

    painting: Painting
    as_printed: bool = eqx.field(static=True, default=False)
    process: None = None

    def illuminate(
        self,
        pixels: IrisPixels,
        lights: Lights,
        front: IrisModel,
        tables: Illumination | None,
        facing: Facing | None,
    ) -> Float[Array, "3 pixels"]:
        """Radiance of each pixel in white light; see `AbstractIntegrator`."""
        del facing
        return self.paint(self.base(pixels, lights, front.eye, tables))

    def base(
        self, pixels: IrisPixels, lights: Lights, eye: Eye, tables: Illumination | None
    ) -> "PaintBase":
        """Compute everything that does not depend on the coats."""
        extent = _Extent(self.painting.profile, eye.iris_radius, eye.pupil_margin)
        flux = incident_flux(lights, eye, tables)
        seen, state = _geometry(pixels, extent, flux)
        return PaintBase(seen, state, *_above_all(flux, extent.reach, SHADOW), lights.tint, extent)

    def paint(
        self, base: "PaintBase", steps: dict[Any, Any] | None = None
    ) -> Float[Array, "3 pixels"]:
        """Paint the groups of coats, from the uppermost down, and return the radiance of pixels.

        Args:
            base: Result of `base`.
            steps: Steps of the latest painting on the same base, at first empty; replaced by those
                of this one. A step whose arrays are the same objects is not done again.
        """
        step = (lambda f, *given: f(*given)) if steps is None else _kept(steps)
        state, light, groups = base.state, base.light, _groups(self.painting)
        for group in groups:
            colours, height = tuple(coat.colour for coat in group), group[0].height
            shapes = [(coat.opacity, coat.height, base.extent) for coat in group]
            covered = tuple(step(_opacity_at, base.seen, *shape) for shape in shapes)
            seen, reach = (state, covered, base.seen), base.extent.reach
            given = light, colours, height, base.tint, reach, self.as_printed
            state = step(_paint_over, seen, *given)
            if group is not groups[-1]:
                crossed = tuple(step(_crossed, base.rays, *shape) for shape in shapes)
                light = step(_light_under, light, crossed, colours, self.as_printed)
        return state[0]

    def response(
        self, iris: Iris | None, aqueous_index: Scalar, bands: Bands, ranges: Scales
    ) -> "PaintedResponse":
        """Make the response of a picture in linear sRGB: colours of paints are not spectra.

        Raises:
            ValueError: For a picture of other channels.
        """
        if bands.channels != ("R", "G", "B"):
            raise ValueError("a painted iris has colours, not spectra: leave out the wavelengths")
        return PaintedResponse(white=bands.white)


class _Geometry(NamedTuple):
    """The geometry of pixels, which all coats share; displacements in mm per mm of their height."""

    place: Float[Array, "2 pixels"]  # where a pixel sees the base, mm
    view: Float[Array, "2 pixels"]  # displacement of the point where it sees a coat
    light: Float[Array, "lights 2 pixels"]  # on the base, of a lamp's ray that meets that point
    # Radiance of a white sheet there in the light of each lamp, times the transmittance to the eye.
    white: Float[Array, "lights pixels"]


class _Extent(NamedTuple):
    """The base's profile, its radius and the width (mm) over which coats fade into the pupil."""

    profile: Cones
    reach: Scalar
    margin: Scalar

    def covered(self, opacity: Array, x: Array, y: Array) -> Array:
        """Opacity at places; it fades into the pupil and is 0 beyond the root."""
        r = safe_sqrt(x * x + y * y)
        edge = smoothstep((r - self.profile.radius[0]) / self.margin)
        here = edge * look_up(opacity, x, y, self.reach)
        return jnp.where(r <= self.profile.radius[-1], here, 0.0)


class PaintBase(NamedTuple):
    """Geometry and light that all coats share, computed once for a scene."""

    seen: _Geometry
    state: _State
    rays: Float[Array, "lights 3 rows columns"]  # directions of the lights at the base's texels
    light: Float[Array, "lights rows columns channels"]  # above all coats, relative to the lamps'
    tint: Array | None  # of each light
    extent: _Extent


class PaintedResponse(AbstractResponse):
    """`white`: what a white sheet shows behind the cornea, in the picture's channels."""

    white: Float[Array, "3"]
    error: None = None
    status: None = None

    def shade(
        self, pixels: IrisPixels, texels: None, light: Float[Array, "3 pixels"]
    ) -> Float[Array, "channels pixels"]:
        """See `AbstractResponse`."""
        return self.white[:, None] * light


def look_up(texture: Array, x: Array, y: Array, reach: Scalar) -> Array:
    """Values of square pictures of the iris, whose sides are `reach` (mm) from the axis, at places
    in mm; linear between texels.
    """
    return bilinear(texture, *_texel(x, y, reach, texture.shape[-2:]))


def _kept(steps: dict[Any, Any]) -> Callable[..., Any]:
    """Make a function that caches results of other functions by the identity of their arrays.

    `steps` holds the results of the painting before and is filled with those of this one; it keeps
    the arrays alive.
    """
    before = dict(steps)
    steps.clear()

    def step(f, *given):
        leaves = jax.tree.leaves(given)
        key = f, *map(id, leaves)
        steps[key] = before[key] if key in before else (leaves, f(*given))
        return steps[key][1]

    return step


def _groups(painting: Painting) -> list[list[Coat]]:
    """Coats from the uppermost down, those within `NEAR` of the first of a group together."""
    groups: list[list[Coat]] = []
    for coat in reversed(painting.coats):
        first = groups[-1][0].height if groups else None
        traced = not is_known(coat.height, first)
        if first is None or traced or float(first) - float(coat.height) > NEAR:
            groups.append([coat])
        else:
            groups[-1].append(coat)
    return groups


@pixelwise
def _geometry(pixels: IrisPixels, extent: _Extent, flux: Array) -> tuple[_Geometry, _State]:
    """Compute where pixels see the base, extended to the axis and past the root, and the first
    state.
    """
    profile = extent.profile
    ends = jnp.stack([jnp.zeros_like(profile.radius[0]), 2 * profile.radius[-1]])
    z = profile.height(ends)
    whole = Cones(
        jnp.concatenate([z[:1], profile.z, z[1:]]),
        jnp.concatenate([ends[:1], profile.radius, ends[1:]]),
    )
    direction = from_parts(pixels.direction)
    origin = from_parts(pixels.point) - _BEHIND * direction
    hit = whole.meet(origin, direction)
    point = origin + hit.distance[..., None] * direction
    share = jnp.where(hit.met, pixels.share, 0.0)
    if pixels.index is not None:
        share = jnp.where(pixels.index < 0, 0.0, share)
    n = parts(whole.normal(point, hit.cone))
    light = tuple(jnp.moveaxis(flux_at(flux, extent.reach, parts(point)), 1, 0))
    irradiance = jnp.maximum(-sum(f * c for f, c in zip(light, n, strict=True)), 0.0)
    view = _displacement(pixels.direction, n)
    falls = view - jax.vmap(lambda direction: _displacement(direction, n))(_directed(light))
    place, one = point[..., :2].T, jnp.ones_like(share)
    above = jnp.zeros((3, one.size), one.dtype), one
    return _Geometry(place, view, falls, irradiance * share / jnp.pi), above


@eqx.filter_jit
def _above_all(flux: Array, reach: Scalar, size: int) -> tuple[Array, Array]:
    """Directions of lights at texels of the base, and maps of light above all coats."""
    x, y = texel_places(size, reach, flux.dtype)
    at = jax.lax.map(lambda f: flux_at(f, reach, (x, y, x)), flux)
    rays = jnp.stack(_directed(tuple(jnp.moveaxis(at, 1, 0))), 1)
    return rays, jnp.ones((len(flux), size, size, _CHANNELS), flux.dtype)


@pixelwise
def _opacity_at(
    seen: _Geometry, opacity: Array, height: Scalar, extent: _Extent
) -> Float[Array, " pixels"]:
    """Opacity of a coat at the pixels."""
    return extent.covered(opacity, *(seen.place + height * seen.view))


@eqx.filter_jit
def _crossed(
    rays: Array, opacity: Array, height: Scalar, extent: _Extent
) -> Float[Array, "lights rows columns"]:
    """Opacity of a coat where rays to texels of the base cross it."""
    profile = extent.profile
    x, y = texel_places(rays.shape[-1], extent.reach, rays.dtype)
    r = safe_sqrt(x * x + y * y)
    cone = jnp.clip(jnp.searchsorted(profile.radius, r) - 1, 0, len(profile.z) - 2)
    normal = parts(profile.normal(jnp.stack([x, y, profile.height(r)], -1), cone))

    def one(direction):
        u, v = _displacement(tuple(direction), normal)
        return extent.covered(opacity, x + height * u, y + height * v)

    return jax.lax.map(one, rays)


@pixelwise
def _paint_over(
    known: tuple[_State, tuple[Array, ...], _Geometry],
    light: Array,
    colours: tuple[Array, ...],
    height: Scalar,
    tint: Array | None,
    reach: Scalar,
    as_printed: bool,
) -> _State:
    """Add a group of coats below those above it: Eq. 1 from the uppermost down. `known` are the
    state of the coats above, the opacities of the group's coats at the pixels, and their geometry.
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
    return radiance, clear


@eqx.filter_jit
def _light_under(
    light: Array, crossed: tuple[Array, ...], colours: tuple[Array, ...], as_printed: bool
) -> Float[Array, "lights rows columns channels"]:
    """Maps of light below a group of coats."""
    for opacity, colour in zip(crossed, colours, strict=True):
        tint = jnp.concatenate([colour, jnp.ones_like(colour[:1])])
        light = through(light, opacity[..., None], tint, as_printed)
    return light


def _displacement(direction: Parts, normal: Parts) -> Array:
    """Displacement (2, …) along lines through the base, to the plane at unit height before it."""
    along = sum(d * n for d, n in zip(direction, normal, strict=True))
    path = -normal[2] / along
    return jnp.stack([d * path for d in direction[:2]])


def _directed(flux: Parts) -> Parts:
    """Unit vectors along fluxes; straight into the eye where the flux is 0 or comes from behind."""
    length = safe_sqrt(jnp.asarray(sum(f * f for f in flux)))
    lit = (length > 0) & (flux[2] > 0.05 * length)
    x, y, z = (f / jnp.where(lit, length, 1.0) for f in flux)
    return jnp.where(lit, x, 0.0), jnp.where(lit, y, 0.0), jnp.where(lit, z, 1.0)


def _texel(x, y, reach, shape: tuple[int, ...]):
    """Row and column of places in mm."""
    rows, columns = shape
    return (1 - y / reach) * (rows / 2) - 0.5, (1 + x / reach) * (columns / 2) - 0.5
