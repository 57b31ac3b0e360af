"""Light on the iris at its pixels: its sum over lamps, the relief it falls on, and what else texels
differ in.
"""

import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye
from irisjax.numerics.chunks import pixelwise
from irisjax.numerics.fusion import materialise
from irisjax.numerics.interpolation import bilinear, polar_bilinear, smoothstep
from irisjax.numerics.roots import safe_sqrt, share_of
from irisjax.optics.conicoid import Parts, dot, from_axis, from_parts, norm, parts
from irisjax.optics.fresnel import fresnel_at
from irisjax.render.illumination import Illumination, near_light
from irisjax.render.lids import let_in
from irisjax.render.lights import Lights
from irisjax.render.project import IrisPixels
from irisjax.render.surfaces import IrisSurface, Place
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, Scales


class Facing(NamedTuple):
    """How a relief turns the iris towards light, at pixels.

    Attributes:
        normal: Components of the unit normal towards the cornea.
        sky: Share of a uniform sky that the relief lets through, see `sky_of`.
    """

    normal: Parts
    sky: Float[Array, " pixels"]

    def left_of(self, hidden: Float[Array, "*tints pixels"]) -> Float[Array, "*tints pixels"]:
        """Share of light that the relief leaves; `hidden` is `hidden_by` of its directions."""
        return jnp.maximum(1 - (1 - self.sky) * hidden, 0.0)


class Front(NamedTuple):
    """The iris that pixels see: its eye, its tissue (`None` if it is painted) and its maps."""

    eye: Eye
    iris: Any
    maps: IrisMaps | None

    def facing(self, pixels: IrisPixels) -> Facing | None:
        """Compute how its relief turns it at pixels; `None` without one. No light matters."""
        if self.maps is None or self.maps.relief is None:
            return None
        return tilted(pixels, self.eye, relief_of(self.maps.relief, self.eye))


def flux_at(
    flux: Float[Array, "... rows columns"], extent: Scalar, point: Parts
) -> Float[Array, "..."]:
    """Flux vectors at points of the iris (mm), from those on a square grid (rows y, columns x) of ±
    `extent` mm.
    """
    middle = (flux.shape[-1] - 1) / 2
    column, row = ((c / extent + 1) * middle for c in (point[0], point[1]))
    return bilinear(flux, row, column)


@eqx.filter_jit
def field_of(
    lights: Lights,
    eye: Eye,
    iris: Iris,
    tables: Illumination | None,
    size: int = 161,
    *,
    relief: bool = False,
) -> Float[Array, "tints vectors rows columns"]:
    """Sum the flux vectors of the lights on a grid over the iris, with the share 1 − F that enters
    the tissue; one tint where no light has a colour of its own. `tables`: `None` for a bare iris.
    For a `relief` the mean of `hidden_by` over their irradiance on the flat iris follows.
    """
    place = _grid(eye, size)
    normal = eye.iris_normal(place)
    n = iris.indices(eye.aqueous_index)

    def add(total, i):
        flux = _flux(lights, i, place, eye, tables)
        length = norm(flux)
        cosine = -dot(flux, normal) / jnp.where(length > 0, length, 1.0)
        entered = fresnel_at(jnp.maximum(cosine, 0.0), n.aqueous, n.abl)[1]
        flux = flux * jnp.where(cosine > 0, entered, 0.0)[..., None]
        if relief:
            across = -dot(flux, normal)
            both = jnp.stack([across, across * hidden_by(cosine, eye)], -1)
            flux = jnp.concatenate([flux, both], -1)
        return total + jnp.moveaxis(flux, -1, 0) * tints[i, :, None, None, None], None

    tints = lights.factors
    zero = jnp.zeros((tints.shape[1], 5 if relief else 3, size, size), lights.irradiance.dtype)
    total = jax.lax.scan(add, zero, jnp.arange(len(lights)))[0]
    if not relief:
        return total
    return total[:, :4].at[:, 3:].set(share_of(total[:, 4:], total[:, 3:4], 0.0))


@eqx.filter_jit
def fluxes_of(
    lights: Lights, eye: Eye, tables: Illumination | None, size: int = 161
) -> Float[Array, "lights 3 rows columns"]:
    """Flux vectors of each light by itself, just before the iris, on a grid over it."""
    place = _grid(eye, size)

    def one(i):
        return jnp.stack(parts(_flux(lights, i, place, eye, tables)))

    return jax.lax.map(one, jnp.arange(len(lights)))


def _grid(eye: Eye, size: int):
    line = jnp.linspace(-1, 1, size) * eye.iris_radius
    x, y = jnp.meshgrid(line, line)
    r = safe_sqrt(x * x + y * y)
    if eye.cornea is None:
        return from_parts([x, y, eye.iris_depth + jnp.zeros_like(r)])
    # About where the light enters.
    return from_parts([x, y, eye.cornea.anterior.sagitta(jnp.minimum(r, eye.limbus_radius))])


def _flux(lights: Lights, i, place, eye: Eye, tables: Illumination | None):
    flux = _flux_past_lids(lights, i, place, eye, tables)
    if eye.lids is None:
        return flux
    # Back along the light to about where it entered.
    x, y, z = parts(place)
    u, v, w = parts(flux)
    back = share_of(eye.iris_depth - z, w, 0.0)
    entry = x - back * u, y - back * v, z
    towards, _ = lights.seen_from(entry, i)
    return flux * let_in(eye, entry, towards, lights.radius[i])[..., None]


def _flux_past_lids(lights: Lights, i, place, eye: Eye, tables: Illumination | None):
    spread, point = 1.0, place[..., :2]
    if tables is not None and lights.distance is not None:
        place, spread = near_light(eye, lights.towards[i], 1.0 / lights.distance[i], point)
    if tables is not None and lights.distance is None:
        return tables.at(point, lights.towards[i]) * lights.irradiance[i]
    towards, power = lights.seen_from(parts(place), i)
    towards = from_parts(towards)
    flux = -towards if tables is None else tables.at(point, towards)
    return flux * jnp.broadcast_to(power * spread, place.shape[:-1])[..., None]


@eqx.filter_jit
def textures_of(maps: IrisMaps | None, iris: Iris) -> Scales:
    """How the texels differ from the uniform iris, as textures."""
    return Scales.of(maps, iris)


@eqx.filter_jit
def ranges_of(iris: Iris | None, maps: IrisMaps | None) -> Scales:
    """`Scales.ranges` of the maps."""
    return Scales() if iris is None else Scales.of(maps, iris).ranges()


def scales_at(pixels: IrisPixels, eye: Eye, textures: Scales) -> Scales:
    """How the texels that pixels see differ from the uniform iris."""
    if not jax.tree.leaves(textures):
        return textures
    return textures_at(pixels, eye, textures)


def textures_at(pixels: IrisPixels, eye: Eye, textures: Any) -> Any:
    """Textures (angles, radii) where pixels see them."""
    place = _place_of(pixels, eye)
    return jax.tree.map(lambda texture: polar_bilinear(texture, *place), textures)


def _place_of(pixels: IrisPixels, eye: Eye) -> Place:
    """Angle (radians) and relative radius at which the pixels see maps that may stand turned."""
    angle, radius = IrisSurface(eye).place(from_parts(pixels.point))
    angle = angle if pixels.turn is None else angle + pixels.turn
    # Computed once: XLA would otherwise work both out again for each texture.
    return materialise((angle, radius))


@pixelwise
def irradiance_at(
    turned: tuple[IrisPixels, Facing | None],
    field: Float[Array, "tints vectors rows columns"],
    eye: Eye,
) -> Float[Array, "tints 1 pixels"]:
    """Irradiance on the iris at pixels times all shares on the way out to the camera."""
    pixels, facing = turned
    flux = flux_at(field, eye.iris_radius, pixels.point)
    normal = normal_at(pixels, eye, facing)
    towards = [-sum(f * n for f, n in zip(tint, normal, strict=False)) for tint in flux]
    found = jnp.maximum(jnp.stack(towards), 0.0)
    if facing is not None:
        found = found * facing.left_of(flux[:, 3])
    return (found * shares(pixels, eye))[:, None]


def hidden_by(cosine: Float[Array, "..."], eye: Eye) -> Float[Array, "..."]:
    """Factor, for light from one direction, on the share of the sky that a relief hides.

    It is 3 s², s = sin²θ of the polar angle outside of the cornea: light from straight ahead
    reaches into every fold, light from aside does not, and over a uniform sky the mean is 1. Where
    a relief hides more than a third of the sky, this exceeds the light from the rim, of which
    nothing is then left; irides that `procedural` grows hide at most a twentieth.

    Args:
        cosine: Of the light's angle to the normal of the flat iris, behind the cornea.
        eye: The eye.
    """
    n = 1.0 if eye.cornea is None else eye.aqueous_index
    s = jnp.minimum(n * n * (1 - cosine * cosine), 1.0)
    return 3 * s * s


def normal_at(pixels: IrisPixels, eye: Eye, facing: Facing | None) -> Parts:
    """Components of the iris's unit normals towards the cornea: tilted, or of the flat iris."""
    return parts(eye.iris_normal(from_parts(pixels.point))) if facing is None else facing.normal


@pixelwise
def tilted(pixels: IrisPixels, eye: Eye, relief: Float[Array, "3 angles radii"]) -> Facing:
    """Compute how a relief turns the iris at pixels, from its `relief_of`."""
    u, v, w = parts(eye.iris_normal(from_parts(pixels.point)))
    place = _place_of(pixels, eye)
    _, x, y = eye.ring_of(*pixels.point[:2])
    r = safe_sqrt(x * x + y * y)
    r = jnp.where(r > 0, r, 1.0)  # a pixel that looks straight at the middle of the pupil
    *slopes, sky = polar_bilinear(relief, *place)
    # Of a unit normal: a cone's is none along z.
    along, across = (-w * s for s in slopes)
    u, v = u - (along * x - across * y) / r, v - (along * y + across * x) / r
    length = jnp.sqrt(u * u + v * v + w * w)
    return Facing((u / length, v / length, w / length), sky)


def shares(pixels: IrisPixels, eye: Eye) -> Float[Array, " pixels"]:
    """Of the iris's radiance that reaches the camera; fades into the pupil, 0 for padding."""
    away, edge = pixels.point, eye.pupil_edge(*pixels.point[:2])
    if eye.pupil_centre is not None:
        (x, y, z), (cx, cy) = away, eye.pupil_centre
        away = x - cx, y - cy, z
    seen = smoothstep((from_axis(from_parts(away)) - edge) / eye.pupil_margin)
    share = pixels.share * seen
    return share if pixels.index is None else jnp.where(pixels.index < 0, 0.0, share)


@eqx.filter_jit
def relief_of(relief: Float[Array, "angles radii"], eye: Eye) -> Float[Array, "3 2*angles 2*radii"]:
    """`slopes_of` a relief, and its `sky_of` on the same grid."""
    sky = jnp.repeat(jnp.repeat(sky_of(relief, eye), 2, 0), 2, 1)
    return jnp.concatenate([slopes_of(relief, eye), sky[None]])


def sky_of(relief: Float[Array, "angles radii"], eye: Eye) -> Float[Array, "angles radii"]:
    """Share of a uniform sky's irradiance that the surrounding relief lets through to each texel.

    Horizons are sought in eight directions, above the level and above the texel's own tangent
    plane, whose tilt its normal accounts for. The cornea confines the sky to the cone in which
    sin θ ≤ 1/n: a horizon of elevation h leaves min(1, n² cos² h) of its direction's share, so that
    only what rises by more than √(n² − 1), 41°, shades. `hidden_by` shares out
    what is hidden among directions.
    """
    rows, columns = relief.shape
    n = 1.0 if eye.cornea is None else eye.aqueous_index
    radius = eye.from_axis((jnp.arange(columns) + 0.5) / columns)
    step = (eye.iris_radius - eye.pupil_radius) / columns
    turn = 2 * jnp.pi / rows * radius
    most = max(_REACH)
    wide = jnp.pad(relief, ((most, most), (0, 0)), mode="wrap")
    wide = jnp.pad(wide, ((0, 0), (most, most)), mode="edge")

    def rise(across: int, along: int):
        there = wide[most + across :, most + along :][:rows, :columns]
        return (there - relief) * (1 / jnp.sqrt((across * turn) ** 2 + (along * step) ** 2))

    total = 0.0
    for across, along in (0, 1), (1, 0), (1, 1), (1, -1):
        ahead, behind = ([rise(s * k * across, s * k * along) for k in _REACH] for s in (1, -1))
        slope = (ahead[0] - behind[0]) / 2
        for rises, own in (ahead, slope), (behind, -slope):
            horizon = functools.reduce(jnp.maximum, rises) - jnp.maximum(own, 0.0)
            steepest = jnp.maximum(horizon, 0.0)
            total += jnp.minimum(1.0, n * n / (1 + steepest**2))
    return total / 8


_REACH = 2, 5, 12  # texels at which the horizon is sought


@eqx.filter_jit
def slopes_of(relief: Float[Array, "angles radii"], eye: Eye) -> Float[Array, "2 2*angles 2*radii"]:
    """∂h/∂r and ∂h/(r ∂angle) of a relief, on a grid twice as fine: of Catmull and Rom's cubics
    through its texels.

    Differences over two texels, blended between their centres, are flatter than any surface through
    these heights: by a third for the finest fibres, four texels wide, and irides were 10 % too
    bright round the pupil. Approximation: what an irregular pupil (`Eye.pupil_harmonics`) adds to
    the slopes, a few hundredths of them, is left out.
    """
    rows, columns = relief.shape
    span = eye.iris_radius - eye.pupil_radius
    radius = eye.from_axis((jnp.arange(2 * columns) + 0.5) / (2 * columns))
    # Straight on beyond both edges: what closes on itself there is cut off again.
    first, last = relief[:, :1], relief[:, -1:]
    ahead, behind = first - relief[:, 1:2], last - relief[:, -2:-1]
    before, after = (first + 2 * ahead, first + ahead), (last + behind, last + 2 * behind)
    wide = jnp.concatenate([*before, relief, *after], 1)
    heights, along = (_quarters(wide, 1, kind)[:, 4:-4] for kind in (_HEIGHT, _SLOPE))
    across = _quarters(heights, 0, _SLOPE) * (rows / (2 * jnp.pi)) / radius
    along = _quarters(along, 0, _HEIGHT) * columns
    if eye.pupil_centre is not None:  # rings are nearer to one another where the pupil is
        angle = (jnp.arange(2 * rows) + 0.5) * (jnp.pi / rows)
        (cx, cy), u, v = eye.pupil_centre, jnp.cos(angle), jnp.sin(angle)
        along = along + across * (cy * u - cx * v)[:, None]
        span = (span - cx * u - cy * v)[:, None]
    return jnp.stack([along / span, across])


# Weights of texels −1 to 2 at a quarter of the way from 0 to 1, and their sign at a quarter of the
# way to −1.
_HEIGHT = (-9 / 128, 111 / 128, 29 / 128, -3 / 128), 1
_SLOPE = (-3 / 32, -31 / 32, 39 / 32, -5 / 32), -1


def _quarters(texture, axis: int, kind: tuple[tuple[float, ...], int]):
    """A texture or its slope, a texel's size one, at a quarter of a texel to either side of each
    along an axis that closes on itself."""
    (weights, sign), n = kind, texture.shape[axis]
    wide = jnp.pad(texture, [(2, 2) if i == axis else (0, 0) for i in (0, 1)], mode="wrap")

    def shifted(by: int) -> Array:
        return jax.lax.slice_in_dim(wide, 2 + by, 2 + by + n, axis=axis)

    low, high = (
        sum(w * shifted(side * (k - 1)) for k, w in enumerate(weights)) * (1 if side > 0 else sign)
        for side in (-1, 1)
    )
    both = jnp.stack([low, high], axis + 1)
    return both.reshape(*(2 * n if i == axis else n for i, n in enumerate(texture.shape)))
