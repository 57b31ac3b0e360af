"""A painted iris in a scene: coats of paint in place of tissue, from the uppermost down  [L03
Section 3.3].

A line of sight or a ray meets the cones of the base exactly. Each coat is approximated by the plane
parallel to the base at that point: for a coat 0.4 mm high, seen and lit at 45°, the place is off by
4 μm at most.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye
from irisjax.numerics.interpolation import bilinear, multilinear, smoothstep
from irisjax.numerics.portions import pixelwise
from irisjax.numerics.roots import safe_sqrt
from irisjax.ocularist.coats import Coat, Painting, over, through
from irisjax.ocularist.cones import Cones
from irisjax.optics.conicoid import Parts, joined, parts
from irisjax.render.bands import Bands
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import AbstractIntegrator, AbstractResponse
from irisjax.render.lights import Lights
from irisjax.render.project import IrisPixels
from irisjax.render.shading import Field, Front, fluxes_of
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import Scales

NEAR = 0.03
"""Difference in height (mm) up to which coats are lit alike but for what they take from each other:
light moves aside by less than a texel of a shadow between them.
"""
SHADOW = 384
"""Texels along each side of the maps of light below coats."""
_CHANNELS = 4  # of these maps; the last one is not used, since rows of four are read at once
_BEHIND = 2.0  # mm in front of the iris at which lines of sight begin


class Painted(AbstractIntegrator):
    """Integrator: coats of paint; a scene with it has no tissue.

    - `painting`: its coats. `as_printed`: shadows by the paper's Eq. 2 as it is printed.
    """

    painting: Painting
    as_printed: bool = eqx.field(static=True, default=False)
    process: None = None

    def illuminate(
        self, pixels: IrisPixels, lights: Lights, front: Front, tables: Illumination | None
    ) -> Float[Array, "3 pixels"]:
        """Radiance of each pixel in white light; see `AbstractIntegrator`."""
        base = self.base(pixels, lights, front.eye, tables)
        return [base.state, *(layer.state for layer in self.layers(base))][-1].radiance

    def base(
        self, pixels: IrisPixels, lights: Lights, eye: Eye, tables: Illumination | None
    ) -> "PaintBase":
        """Compute everything that does not depend on the coats."""
        profile, reach = self.painting.profile, eye.iris_radius
        flux = fluxes_of(lights, eye, tables)
        rim = profile, reach, eye.pupil_margin
        seen, state = _ground(pixels, profile, eye, flux)
        return PaintBase(seen, state, *_above_all(flux, profile, reach, SHADOW), lights.tint, rim)

    def layers(
        self, base: "PaintBase", before: Sequence["PaintedLayer"] = ()
    ) -> Iterator["PaintedLayer"]:
        """Paint the groups of coats, from the uppermost down.

        Args:
            base: Result of `base`.
            before: Layers of a painting on the same base. A layer whose coats, and those above it,
                are the same objects is not painted again; a coat's opacity is looked up again only
                where it has changed.
        """
        known = {part.coat.name: part for layer in before for part in layer.parts}
        groups, state, light, same = _groups(self.painting), base.state, base.light, True
        for nth, group in enumerate(groups):
            last = nth == len(groups) - 1
            same = same and nth < len(before) and before[nth].paints(group)
            if same and (last or before[nth].light is not None):
                layer = before[nth]
            else:
                layer = self._painted(base, state, light, group, known, last)
            yield layer
            state, light = layer.state, layer.light

    def _painted(self, base, state, light, group: list[Coat], known, last: bool) -> "PaintedLayer":
        coats = tuple(_looked_up(coat, base, known.get(coat.name), last) for coat in group)
        colours, height = tuple(coat.colour for coat in group), group[0].height
        seen = state, tuple(part.covered for part in coats), base.seen
        reach = base.rim[1]
        state = _paint_over(seen, light, colours, height, base.tint, reach, self.as_printed)
        crossed = tuple(part.crossed for part in coats)
        below = None if last else _light_under(light, crossed, colours, self.as_printed)
        return PaintedLayer(coats, state, below)

    def response(
        self, iris: Iris | None, aqueous_index: Scalar, bands: Bands, ranges: Scales
    ) -> "PaintedResponse":
        """Of a picture in linear sRGB: colours of paints are no spectra.

        **Raises:** `ValueError` for a picture of other channels.
        """
        if bands.channels != ("R", "G", "B"):
            raise ValueError("a painted iris has colours, not spectra: leave out the wavelengths")
        return PaintedResponse(white=bands.white)


class _Ground(NamedTuple):
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


class _State(NamedTuple):
    """Radiance that the coats so far send back, and the transmittance of all of them."""

    radiance: Float[Array, "3 pixels"]
    clear: Float[Array, " pixels"]


class PaintBase(NamedTuple):
    """What all coats are painted on.

    Attributes:
        seen: Where pixels see the base.
        state: State before any coat.
        rays: Directions of the lights at the base's texels.
        light: Maps of light above all coats, relative to the lamps'.
        tint: Tint of each light.
        rim: Profile of the base, its radius and the width over which coats fade into the pupil, mm.
    """

    seen: _Ground
    state: _State
    rays: Float[Array, "lights 3 rows columns"]
    light: Float[Array, "lights rows columns channels"]
    tint: Array | None
    rim: tuple[Cones, Array, Array]


class PaintedCoat(NamedTuple):
    """A coat, its opacity at the pixels and where rays cross it (`None` of the lowest group)."""

    coat: Coat
    covered: Array
    crossed: Array | None


class PaintedLayer(NamedTuple):
    """A group of coats, what they and those above send back, and the light below them."""

    parts: tuple[PaintedCoat, ...]
    state: _State
    light: Array | None

    def paints(self, group: list[Coat]) -> bool:
        """Whether these are the layer's coats, by the identity of their arrays."""
        leaves = [jax.tree.leaves(c) for c in (group, [part.coat for part in self.parts])]
        return len(group) == len(self.parts) and all(a is b for a, b in zip(*leaves, strict=True))


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


def _looked_up(coat: Coat, base: PaintBase, before: PaintedCoat | None, last: bool) -> PaintedCoat:
    """A coat where pixels and rays meet it; what was looked up of the same opacity is kept."""
    where = coat.opacity, coat.height, *base.rim
    covered, crossed = None, None
    same = before is not None and before.coat.opacity is coat.opacity
    if before is not None and same and before.coat.height is coat.height:
        covered, crossed = before.covered, before.crossed
    if covered is None:
        covered = _opacity_at(base.seen, *where)
    if crossed is None and not last:
        crossed = _crossed(base.rays, *where)
    return PaintedCoat(coat, covered, crossed)


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


@pixelwise
def _ground(pixels: IrisPixels, profile: Cones, eye: Eye, flux: Array) -> tuple[_Ground, _State]:
    """Where pixels see the base, extended to the axis and past the root, and the first state."""
    ends = jnp.stack([jnp.zeros_like(profile.radius[0]), 2 * profile.radius[-1]])
    z = profile.height(ends)
    whole = Cones(
        jnp.concatenate([z[:1], profile.z, z[1:]]),
        jnp.concatenate([ends[:1], profile.radius, ends[1:]]),
    )
    direction = joined(pixels.direction)
    origin = joined(pixels.point) - _BEHIND * direction
    hit = whole.meet(origin, direction)
    point = origin + hit.distance[..., None] * direction
    share = jnp.where(hit.met, pixels.share, 0.0)
    if pixels.index is not None:
        share = jnp.where(pixels.index < 0, 0.0, share)
    n = parts(whole.normal(point, hit.cone))
    at = Field(flux, eye.iris_radius).at(parts(point))
    light, view = (at[:, 0], at[:, 1], at[:, 2]), _aside(pixels.direction, n)
    irradiance = jnp.maximum(-sum(f * c for f, c in zip(light, n, strict=True)), 0.0)
    falls = view - jax.vmap(lambda direction: _aside(direction, n))(_directed(light))
    place = jnp.stack([point[..., 0], point[..., 1]])
    one = jnp.ones_like(place[0])
    above = _State(jnp.zeros((3, one.size), one.dtype), one)
    return _Ground(place, view, falls, irradiance * share / jnp.pi), above


@eqx.filter_jit
def _above_all(flux: Array, profile: Cones, reach: Scalar, size: int) -> tuple[Array, Array]:
    """Directions of lights at texels of the base, and maps of light above all coats."""
    x, y = _texels(size, reach, flux.dtype)
    at = jax.lax.map(lambda f: Field(f[None], reach).at((x, y, x))[0], flux)
    rays = jnp.stack(_directed((at[:, 0], at[:, 1], at[:, 2])), 1)
    return rays, jnp.ones((len(flux), size, size, _CHANNELS), flux.dtype)


@pixelwise
def _opacity_at(
    seen: _Ground, opacity: Array, height: Scalar, profile: Cones, reach: Scalar, margin: Scalar
) -> Float[Array, " pixels"]:
    """Opacity of a coat at the pixels; it fades into the pupil over `margin` (mm)."""
    x, y = seen.place + height * seen.view
    return _covering(opacity, x, y, profile, reach, margin)


@eqx.filter_jit
def _crossed(
    rays: Array, opacity: Array, height: Scalar, profile: Cones, reach: Scalar, margin: Scalar
) -> Float[Array, "lights rows columns"]:
    """Opacity of a coat where rays to texels of the base cross it; arguments of `_opacity_at`."""
    x, y = _texels(rays.shape[-1], reach, rays.dtype)
    r = safe_sqrt(x * x + y * y)
    cone = jnp.clip(jnp.searchsorted(profile.radius, r) - 1, 0, len(profile.z) - 2)
    normal = parts(profile.normal(jnp.stack([x, y, profile.height(r)], -1), cone))

    def one(direction):
        u, v = _aside(tuple(direction), normal)
        return _covering(opacity, x + height * u, y + height * v, profile, reach, margin)

    return jax.lax.map(one, rays)


@pixelwise
def _paint_over(
    known: tuple[_State, tuple[Array, ...], _Ground],
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
    return _State(radiance, clear)


@eqx.filter_jit
def _light_under(
    light: Array, crossed: tuple, colours: tuple[Array, ...], as_printed: bool
) -> Float[Array, "lights rows columns channels"]:
    """Maps of light below a group of coats."""
    for opacity, colour in zip(crossed, colours, strict=True):
        tint = jnp.concatenate([colour, jnp.ones_like(colour[:1])])
        light = through(light, opacity[..., None], tint, as_printed)
    return light


def _aside(direction: Parts, normal: Parts) -> Array:
    """Displacement (2, …) along lines through the base, to the plane at unit height before it."""
    along = sum(d * n for d, n in zip(direction, normal, strict=True))
    path = -normal[2] / along
    return jnp.stack([direction[0] * path, direction[1] * path])


def _directed(flux: Parts) -> Parts:
    """Unit vectors along fluxes; straight into the eye where the flux is 0 or comes from behind."""
    length = jnp.sqrt(sum(f * f for f in flux))
    lit = (length > 0) & (flux[2] > 0.05 * length)
    x, y, z = (f / jnp.where(lit, length, 1.0) for f in flux)
    return jnp.where(lit, x, 0.0), jnp.where(lit, y, 0.0), jnp.where(lit, z, 1.0)


def _covering(opacity, x, y, profile: Cones, reach, margin):
    """Opacity at places; it fades into the pupil and is 0 beyond the root."""
    r = safe_sqrt(x * x + y * y)
    edge = smoothstep((r - profile.radius[0]) / margin)
    return jnp.where(r <= profile.radius[-1], edge * look_up(opacity, x, y, reach), 0.0)


def _texel(x, y, reach, shape: tuple[int, ...]):
    """Row and column of places in mm."""
    rows, columns = shape
    return (1 - y / reach) * (rows / 2) - 0.5, (1 + x / reach) * (columns / 2) - 0.5


def _texels(size: int, reach, dtype):
    line = ((2 * jnp.arange(size) + 1) / size - 1).astype(dtype) * reach
    return jnp.meshgrid(line, -line)
