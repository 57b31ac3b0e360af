"""Light on the iris at its pixels: flux summed over lights, the relief that it falls on, and
look-up in the maps.
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
from irisjax.numerics.interpolation import bilinear, polar_bilinear, polar_multilinear, smoothstep
from irisjax.numerics.roots import safe_sqrt, share_of
from irisjax.optics.conicoid import Parts, dot, from_axis, from_parts, norm, parts
from irisjax.optics.fresnel import fresnel_at
from irisjax.render.illumination import Illumination, near_lamp_entry
from irisjax.render.lids import lid_visibility, light_past_lids
from irisjax.render.lights import Lights
from irisjax.render.project import IrisPixels
from irisjax.render.surfaces import IrisSurface, TextureCoordinates
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, Scales

_GRID_SIZE = 161  # points along each side of a grid of flux
_HORIZON_STEPS = 2, 5, 12  # texels at which the horizon of a relief is sought


class Facing(NamedTuple):
    """How a relief turns the iris towards light, at pixels.

    Attributes:
        normal: Components of the unit normal towards the cornea.
        sky: Share of a uniform sky that the relief lets through, see `sky_share`.
    """

    normal: Parts
    sky: Float[Array, " pixels"]

    def unshadowed(self, hiding: Float[Array, "*tints pixels"]) -> Float[Array, "*tints pixels"]:
        """Return the share of light that the relief does not shadow, from the `hiding_factor` of
        its directions.
        """
        return jnp.maximum(1 - (1 - self.sky) * hiding, 0.0)


class IrisModel(NamedTuple):
    """An iris in its eye.

    Attributes:
        eye: The eye.
        iris: Tissue of the iris; `None` if it is painted.
        maps: Maps of the iris; `None` if it is uniform.
        relief: The `relief_field` of the maps, if it is computed already.
        textures: The `scale_textures` of the maps, likewise.
        ranges: The `scale_ranges` of the maps, likewise.
        flux: The `entering_flux` of lights, likewise.
    """

    eye: Eye
    iris: Any
    maps: IrisMaps | None
    relief: Float[Array, "angles radii 4"] | None = None
    textures: Scales | None = None
    ranges: Scales | None = None
    flux: Float[Array, "tints vectors rows columns"] | None = None

    def prepared(self) -> "IrisModel":
        """Compute once for many views what neither light nor pigments change."""
        ranges = scale_ranges(self.iris, self.maps)
        textures = None if self.iris is None else scale_textures(self.maps, self.iris)
        return self._replace(relief=self._relief(), textures=textures, ranges=ranges)

    def with_flux(self, lights: Lights, tables: Illumination | None) -> "IrisModel":
        """Compute the flux of lights once for many views."""
        has_relief = self._relief() is not None
        flux = entering_flux(lights, self.eye, self.iris, tables, relief=has_relief)
        return self._replace(flux=flux)

    def facing(self, pixels: IrisPixels) -> Facing | None:
        """Compute how the relief turns the iris at pixels; `None` without a relief."""
        relief = self._relief()
        return None if relief is None else facing_at(pixels, self.eye, relief)

    def _relief(self) -> Float[Array, "angles radii 4"] | None:
        if self.relief is not None or self.maps is None or self.maps.relief is None:
            return self.relief
        return relief_field(self.maps.relief, self.eye)


def flux_at(
    flux: Float[Array, "... rows columns"], extent: Scalar, point: Parts
) -> Float[Array, "..."]:
    """Interpolate flux vectors at points of the iris (mm) from those on a square grid (rows y,
    columns x) of ± `extent` mm.
    """
    middle = (flux.shape[-1] - 1) / 2
    column, row = ((c / extent + 1) * middle for c in (point[0], point[1]))
    return bilinear(flux, row, column)


@eqx.filter_jit
def entering_flux(
    lights: Lights, eye: Eye, iris: Iris, tables: Illumination | None, *, relief: bool = False
) -> Float[Array, "tints vectors rows columns"]:
    """Sum the lights' flux on a grid over the iris, times the share 1 − F that enters the tissue.

    Args:
        lights: The lights.
        eye: The eye.
        iris: The iris, whose refractive index decides that share.
        tables: Illumination tables; `None` for an eye without a cornea.
        relief: Whether to add a channel for light on a relief.

    Returns:
        Flux vectors, one tint where no light has a colour of its own. With `relief` a fourth
        component is the mean of `hiding_factor` weighted by irradiance on the flat iris.
    """
    entry = _grid(eye)
    normal = eye.iris_normal(entry)
    indices = iris.indices(eye.aqueous_index)

    def add(total, i):
        flux = _flux_of_light(lights, i, entry, eye, tables)
        length = norm(flux)
        cosine = -dot(flux, normal) / jnp.where(length > 0, length, 1.0)
        entered = fresnel_at(jnp.maximum(cosine, 0.0), indices.aqueous, indices.abl)[1]
        flux = flux * jnp.where(cosine > 0, entered, 0.0)[..., None]
        if relief:
            irradiance = -dot(flux, normal)
            irradiances = jnp.stack([irradiance, irradiance * hiding_factor(cosine, eye)], -1)
            flux = jnp.concatenate([flux, irradiances], -1)
        return total + jnp.moveaxis(flux, -1, 0) * tints[i, :, None, None, None], None

    tints = lights.tint_factors
    shape = tints.shape[1], 5 if relief else 3, *entry.shape[:-1]
    total = jax.lax.scan(add, jnp.zeros(shape, lights.irradiance.dtype), jnp.arange(len(lights)))[0]
    if not relief:
        return total
    return total[:, :4].at[:, 3:].set(share_of(total[:, 4:], total[:, 3:4], 0.0))


@eqx.filter_jit
def incident_flux(
    lights: Lights, eye: Eye, tables: Illumination | None, size: int = _GRID_SIZE
) -> Float[Array, "lights 3 rows columns"]:
    """Compute the flux vectors of each light just before the iris, on a grid over it."""
    entry = _grid(eye, size)

    def flux_of(i):
        return jnp.stack(parts(_flux_of_light(lights, i, entry, eye, tables)))

    return jax.lax.map(flux_of, jnp.arange(len(lights)))


def _grid(eye: Eye, size: int = _GRID_SIZE):
    """Return grid points over the iris at the depth of the cornea, about where light enters; at the
    iris's own depth if there is no cornea.
    """
    line = jnp.linspace(-1, 1, size) * eye.iris_radius
    x, y = jnp.meshgrid(line, line)
    r = safe_sqrt(x * x + y * y)
    if eye.cornea is None:
        return from_parts([x, y, eye.iris_depth + jnp.zeros_like(r)])
    return from_parts([x, y, eye.cornea.anterior.sagitta(jnp.minimum(r, eye.limbus_radius))])


def _flux_of_light(lights: Lights, i, point, eye: Eye, tables: Illumination | None):
    flux = _flux_without_lids(lights, i, point, eye, tables)
    if eye.lids is None:
        return flux
    # Go back along the light to about where it entered.
    x, y, z = parts(point)
    u, v, w = parts(flux)
    distance = share_of(eye.iris_depth - z, w, 0.0)
    entry = x - distance * u, y - distance * v, z
    towards, _ = lights.incident_at(entry, i)
    visibility = lid_visibility(eye, entry, towards, lights.radius[i])
    return flux * light_past_lids(visibility, eye.lids)[..., None]


def _flux_without_lids(lights: Lights, i, entry, eye: Eye, tables: Illumination | None):
    concentration, point, towards = 1.0, entry[..., :2], lights.towards[i]
    if tables is not None:
        if lights.distance is None:
            return tables.at(point, towards) * lights.irradiance[i]
        entry, concentration = near_lamp_entry(eye, towards, 1.0 / lights.distance[i], point)
    towards, irradiance = lights.incident_at(parts(entry), i)
    towards = from_parts(towards)
    flux = -towards if tables is None else tables.at(point, towards)
    return flux * jnp.broadcast_to(irradiance * concentration, entry.shape[:-1])[..., None]


@eqx.filter_jit
def scale_textures(maps: IrisMaps | None, iris: Iris) -> Scales:
    """Return the texels' scales relative to the uniform iris, as textures."""
    return Scales.of(maps, iris)


@eqx.filter_jit
def scale_ranges(iris: Iris | None, maps: IrisMaps | None) -> Scales:
    """Return `Scales.ranges` of the maps."""
    return Scales() if iris is None else Scales.of(maps, iris).ranges()


def sample_textures(pixels: IrisPixels, eye: Eye, textures: Any) -> Any:
    """Interpolate textures (angles, radii) at the points that pixels see."""
    if not jax.tree.leaves(textures):
        return textures
    place = _map_place(pixels, eye)
    return jax.tree.map(lambda texture: polar_bilinear(texture, *place), textures)


def _map_place(pixels: IrisPixels, eye: Eye) -> TextureCoordinates:
    """Return the angle (radians) and relative radius in the maps at which pixels see them."""
    angle, radius = IrisSurface(eye).texture_coordinates(from_parts(pixels.point))
    angle = angle if pixels.turn is None else angle + pixels.turn
    # Computed once: XLA would otherwise work both out again for each texture.
    return materialise((angle, radius))


@pixelwise
def irradiance_at(
    pixels_and_facing: tuple[IrisPixels, Facing | None],
    flux_grid: Float[Array, "tints vectors rows columns"],
    eye: Eye,
) -> Float[Array, "tints 1 pixels"]:
    """Compute the irradiance on the iris at pixels from `entering_flux`, times the share of the
    iris's radiance that reaches the camera.
    """
    pixels, facing = pixels_and_facing
    flux = flux_at(flux_grid, eye.iris_radius, pixels.point)
    normal = normal_at(pixels, eye, facing)
    normal_flux = [-sum(f * n for f, n in zip(tint, normal, strict=False)) for tint in flux]
    irradiance = jnp.maximum(jnp.stack(normal_flux), 0.0)
    if facing is not None:
        irradiance = irradiance * facing.unshadowed(flux[:, 3])
    return (irradiance * camera_share(pixels, eye))[:, None]


def hiding_factor(cosine: Float[Array, "..."], eye: Eye) -> Float[Array, "..."]:
    """Compute how much more or less of the light from one direction a relief hides than of a
    uniform sky.

    The factor is 3 s², with s = sin²θ of the polar angle θ outside the cornea: light from straight
    ahead reaches into every fold, light from the side does not, and over a uniform sky the mean is
    1. Where a relief hides more than a third of the sky, the product exceeds all light from the
    rim and is limited to it; irides that `procedural` grows hide at most a twentieth.

    Args:
        cosine: Cosine of the light's angle to the normal of the flat iris, behind the cornea.
        eye: The eye.
    """
    n = 1.0 if eye.cornea is None else eye.aqueous_index
    s = jnp.minimum(n * n * (1 - cosine * cosine), 1.0)
    return 3 * s * s


def normal_at(pixels: IrisPixels, eye: Eye, facing: Facing | None) -> Parts:
    """Return the components of unit normals towards the cornea, of the relief if there is one."""
    return parts(eye.iris_normal(from_parts(pixels.point))) if facing is None else facing.normal


@pixelwise
def facing_at(pixels: IrisPixels, eye: Eye, relief: Float[Array, "angles radii 4"]) -> Facing:
    """Compute how a relief turns the iris at pixels, from its `relief_field`."""
    u, v, w = parts(eye.iris_normal(from_parts(pixels.point)))
    place = _map_place(pixels, eye)
    _, x, y = eye.ring_of(*pixels.point[:2])
    radius = safe_sqrt(x * x + y * y)
    radius = jnp.where(radius > 0, radius, 1.0)  # in the middle of the pupil
    *slopes, sky, _ = parts(materialise(polar_multilinear(relief, *place)))
    # Per unit normal, which for a conical iris is not along z.
    along, across = (-w * s for s in slopes)
    u, v = u - (along * x - across * y) / radius, v - (along * y + across * x) / radius
    length = jnp.sqrt(u * u + v * v + w * w)
    return Facing((u / length, v / length, w / length), sky)


def camera_share(pixels: IrisPixels, eye: Eye) -> Float[Array, " pixels"]:
    """Return the share of the iris's radiance that reaches the camera. It fades to 0 in the pupil
    and is 0 for padding.
    """
    point, pupil_radius = pixels.point, eye.pupil_edge(*pixels.point[:2])
    if eye.pupil_centre is not None:
        (x, y, z), (cx, cy) = point, eye.pupil_centre
        point = x - cx, y - cy, z
    visible = smoothstep((from_axis(from_parts(point)) - pupil_radius) / eye.pupil_margin)
    share = pixels.share * visible
    return share if pixels.index is None else jnp.where(pixels.index < 0, 0.0, share)


@eqx.filter_jit
def relief_field(
    relief: Float[Array, "angles radii"], eye: Eye
) -> Float[Array, "2*angles 2*radii 4"]:
    """Compute the `relief_slopes` of a relief and its `sky_share` on the same grid, and nothing in
    the fourth place: look-ups in four places side by side are fastest.
    """
    sky = jnp.repeat(jnp.repeat(sky_share(relief, eye), 2, 0), 2, 1)
    return jnp.stack([*relief_slopes(relief, eye), sky, jnp.zeros_like(sky)], axis=-1)


def sky_share(relief: Float[Array, "angles radii"], eye: Eye) -> Float[Array, "angles radii"]:
    """Compute the share of a uniform sky's irradiance that the surrounding relief lets through to
    each texel.

    Horizons are sought in eight directions, above the level and above the texel's own tangent
    plane, whose tilt its normal accounts for. The cornea confines the sky to the cone in which
    sin θ ≤ 1/n: a horizon of elevation h leaves min(1, n² cos² h) of its direction's share, so that
    only what rises by more than √(n² − 1), 41°, casts a shadow. `hiding_factor` distributes the
    hidden share over directions.
    """
    rows, columns = relief.shape
    n = 1.0 if eye.cornea is None else eye.aqueous_index
    radius = eye.from_axis((jnp.arange(columns) + 0.5) / columns)
    step = (eye.iris_radius - eye.pupil_radius) / columns
    turn = 2 * jnp.pi / rows * radius
    margin = max(_HORIZON_STEPS)
    padded = jnp.pad(relief, ((margin, margin), (0, 0)), mode="wrap")
    padded = jnp.pad(padded, ((0, 0), (margin, margin)), mode="edge")

    def rise(across: int, along: int):
        neighbours = padded[margin + across :, margin + along :][:rows, :columns]
        return (neighbours - relief) * (1 / jnp.sqrt((across * turn) ** 2 + (along * step) ** 2))

    total = 0.0
    for across, along in (0, 1), (1, 0), (1, 1), (1, -1):
        ahead, behind = (
            [rise(s * k * across, s * k * along) for k in _HORIZON_STEPS] for s in (1, -1)
        )
        slope = (ahead[0] - behind[0]) / 2
        for rises, tangent in (ahead, slope), (behind, -slope):
            horizon = functools.reduce(jnp.maximum, rises) - jnp.maximum(tangent, 0.0)
            steepest = jnp.maximum(horizon, 0.0)
            total += jnp.minimum(1.0, n * n / (1 + steepest**2))
    return total / 8


@eqx.filter_jit
def relief_slopes(
    relief: Float[Array, "angles radii"], eye: Eye
) -> Float[Array, "2 2*angles 2*radii"]:
    """Compute ∂h/∂r and ∂h/(r ∂angle) of a relief on a grid twice as fine, as the slopes of Catmull
    and Rom's cubics through its texels.

    Differences over two texels, blended between their centres, are flatter than any surface through
    these heights: by a third for the finest fibres, four texels wide, and irides were 10 % too
    bright round the pupil. Approximation: what an irregular pupil (`Eye.pupil_harmonics`) adds to
    the slopes, a few hundredths of them, is left out.
    """
    rows, columns = relief.shape
    span = eye.iris_radius - eye.pupil_radius
    radius = eye.from_axis((jnp.arange(2 * columns) + 0.5) / (2 * columns))
    # Extrapolated linearly beyond both edges; texels wrapped there by `_upsample` are cut off.
    first, last = relief[:, :1], relief[:, -1:]
    ahead, behind = first - relief[:, 1:2], last - relief[:, -2:-1]
    before, after = (first + 2 * ahead, first + ahead), (last + behind, last + 2 * behind)
    padded = jnp.concatenate([*before, relief, *after], 1)
    heights, along = (_upsample(padded, 1, stencil)[:, 4:-4] for stencil in (_HEIGHT, _SLOPE))
    across = _upsample(heights, 0, _SLOPE) * (rows / (2 * jnp.pi)) / radius
    along = _upsample(along, 0, _HEIGHT) * columns
    if eye.pupil_centre is not None:  # rings are closer together on the side of the pupil
        angle = (jnp.arange(2 * rows) + 0.5) * (jnp.pi / rows)
        (cx, cy), u, v = eye.pupil_centre, jnp.cos(angle), jnp.sin(angle)
        along = along + across * (cy * u - cx * v)[:, None]
        span = (span - cx * u - cy * v)[:, None]
    return jnp.stack([along / span, across])


# Weights of texels −1 to 2 at a quarter of the way from 0 to 1, and their sign at a quarter of the
# way to −1.
_HEIGHT = (-9 / 128, 111 / 128, 29 / 128, -3 / 128), 1
_SLOPE = (-3 / 32, -31 / 32, 39 / 32, -5 / 32), -1


def _upsample(texture, axis: int, stencil: tuple[tuple[float, ...], int]):
    """Evaluate a texture or its slope per texel at a quarter of a texel to either side of each
    texel, along an axis that closes on itself.
    """
    (weights, sign), n = stencil, texture.shape[axis]
    padded = jnp.pad(texture, [(2, 2) if i == axis else (0, 0) for i in (0, 1)], mode="wrap")

    def shift(offset: int) -> Array:
        return jax.lax.slice_in_dim(padded, 2 + offset, 2 + offset + n, axis=axis)

    low, high = (
        sum(w * shift(side * (k - 1)) for k, w in enumerate(weights)) * (1 if side > 0 else sign)
        for side in (-1, 1)
    )
    interleaved = jnp.stack([low, high], axis + 1)
    return interleaved.reshape(*(2 * n if i == axis else n for i, n in enumerate(texture.shape)))
