"""Tables of the light that reaches the iris from any direction, by refraction and in caustics.

The caustic is grazing light that the cornea folds onto itself. F09 adds rays reflected inside the
cornea. With F09's own cornea there are none: a refracted ray is at most 46.6° from the normal (the
critical angle), so that it meets the conicoid again 0.3 mm or more behind the limbus, where the
cornea has ended. The caustic is made by refraction alone. `reflects_inside` says whether another
cornea has such rays, which are left out.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye, cornea_of
from irisjax.numerics.interpolation import bilinear, multilinear
from irisjax.numerics.roots import safe_sqrt
from irisjax.optics.conicoid import Vector, advance, dot, from_parts, norm, parts, reflect_vector
from irisjax.render import refraction
from irisjax.render.refraction import LARGEST_POLAR, UNIQUE_POLAR, RefractionFunction, cornea_point

# Radians between tabulated polar angles, up to `_FINE_FROM` radians and beyond. The edge of the
# shadow on the iris moves by 0.05 mm a degree there, and by 0.1 at `UNIQUE_POLAR`.
_SPACING, _FINE = 0.05, 0.0125
_COARSE = 20  # number of the wider steps
_FINE_FROM = _COARSE * _SPACING
_CHUNK = 1 << 14  # rays traced together: their intermediates stay in the cache


class Illumination(eqx.Module):
    """Flux vectors on the iris of unit light, tabulated over its polar angle and a square grid
    turned to its azimuth. Made with `build`.

    Light within the soft edge of the limbus is dimmed. Beyond `UNIQUE_POLAR`, where rays are
    counted, the resolution is the grid's cell, 2 × extent / (size − 1); the grid reaches one cell
    beyond the iris. A caustic moves by up to 0.15 mm per degree: half-way between two angles up to
    4 % of its power is misplaced by that much.

    Attributes:
        flux: Flux vectors over polar angle, rows y and columns x.
        extent: Half the side of the grid, mm.
        largest: Polar angle that the tables reach, radians; light from beyond fades out within
            0.05.
    """

    flux: Float[Array, "polars size size 3"]
    extent: Float[Array, ""]
    largest: float = eqx.field(static=True)

    @classmethod
    def build(
        cls, eye: Eye, *, caustics: bool = True, size: int = 129, n_rays: int = 131_072
    ) -> "Illumination":
        """Compute the tables of an eye with a cornea.

        Args:
            eye: The eye.
            caustics: Whether the tables go on beyond `UNIQUE_POLAR`, where rays are counted.
            size: Number of grid points along each side; entry points are searched as coarsely.
            n_rays: Number of rays that are counted for each polar angle, over the whole cornea.

        Raises:
            ValueError: The eye has no cornea.
        """
        # Eyes that differ in other parts then share one file of tables.
        eye = canonical_eye(eye)
        arrivals = RefractionFunction.build(eye, *_search_resolution(size))
        return _build(eye, arrivals, caustics, size, n_rays)

    def at(self, point: Float[Array, "*#s 2"], towards_light: Float[Array, "*#s 3"]) -> Vector:
        """Interpolate the flux vectors at iris points (x, y), mm, of light from unit directions,
        which broadcast with them.

        The gradient to the direction is zero for light along the axis, which has no azimuth.
        """
        across = norm(towards_light[..., :2])
        polar = jnp.arctan2(across, -towards_light[..., 2])
        cos, sin = (
            jnp.where(across > 0, towards_light[..., k] / jnp.where(across > 0, across, 1.0), 1 - k)
            for k in (0, 1)
        )
        x = cos * point[..., 0] + sin * point[..., 1]
        y = -sin * point[..., 0] + cos * point[..., 1]
        size = self.flux.shape[1]
        position = tuple((c / self.extent + 1) * ((size - 1) / 2) for c in (y, x))
        index = (
            jnp.minimum(polar / _SPACING, _COARSE) + jnp.maximum(polar - _FINE_FROM, 0.0) / _FINE
        )
        if towards_light.ndim == 1:  # one layer for all points
            below = jnp.clip(jnp.floor(index), 0, len(self.flux) - 2).astype(int)
            low, high = (
                jax.lax.dynamic_index_in_dim(self.flux, below + k, keepdims=False) for k in (0, 1)
            )
            # No `clip`: at a whole index, where its argument is 0, it would halve the derivative.
            layer = low + jnp.minimum(index - below, 1) * (high - low)
            flux = multilinear(layer, position)
        else:
            flux = multilinear(self.flux, (index, *position))
        flux = flux * jnp.clip((self.largest - polar) / _SPACING + 1, 0, 1)[..., None]
        u, v, w = parts(flux)
        return from_parts([cos * u - sin * v, sin * u + cos * v, w])


def _search_resolution(size: int) -> tuple[int, int, int]:
    """Choose the numbers of polar angles, azimuths and radii of the entry points that are searched
    for a grid of `size`.
    """
    share = min(size / 129, 1.0)
    polars = 50 if share == 1 else round(UNIQUE_POLAR / _SPACING) + 1
    return polars, max(round(50 * share), 13), max(round(100 * share), 25)


def canonical_eye(eye: Eye) -> Eye:
    """Replace those parts of an eye that its tables do not depend on by fixed ones: pupil, sclera,
    lids and the cornea's haze.

    Raises:
        ValueError: The eye has no cornea.
    """
    cornea = eye.cornea
    if cornea is None:
        raise ValueError("an eye without a cornea needs no illumination tables")
    # Behind a single surface lies the chamber, so that the cornea's index makes no difference.
    index = eye.aqueous_index if cornea.posterior is None else cornea.index
    cornea = dataclasses.replace(cornea, scatter=None, index=index)
    absent = dict.fromkeys(("pupil_centre", "pupil_harmonics", "limbal_ring", "lids", "sclera"))
    sizes = {"pupil_radius": 1.0, "pupil_margin": 0.12, "limbus_width": 1.0}
    return eye.replace(cornea=cornea, **sizes, **absent)


def reflects_inside(eye: Eye) -> bool:
    """Return whether light that enters the cornea, reflected once on its inside, reaches the iris.

    That needs a limbus of 6 mm or more on F09's conicoid, or a sphere. Rays in one plane through
    the axis are traced.
    """
    if eye.cornea is None:
        return False
    front, limbus = eye.cornea.anterior, float(eye.limbus_radius)
    places, sines = jnp.linspace(-limbus, limbus, 201), jnp.linspace(0, 1, 100)[:-1]
    entry, sine_outside = jnp.meshgrid(places, sines)
    origin = jnp.stack([entry, 0 * entry, front.sagitta(entry)], -1)
    inward = -front.normal(origin)
    along = jnp.stack([-inward[..., 2], 0 * entry, inward[..., 0]], -1)  # to the other side
    outside, inside = (
        sine[..., None] * along + jnp.sqrt(1 - sine * sine)[..., None] * inward
        for sine in (sine_outside, sine_outside / float(eye.aqueous_index))
    )
    length, hit = front.intersect(origin, inside, far=True)
    mirror = advance(origin, length, inside)
    normal = front.normal(mirror)
    reflected = reflect_vector(inside, normal)
    backward = reflected[..., 2] > 0
    depth = (float(eye.iris_depth) - mirror[..., 2]) / jnp.where(backward, reflected[..., 2], 1.0)
    landing = mirror[..., 0] + depth * reflected[..., 0]
    end_of_cornea = front.sagitta(eye.limbus_radius) + 1e-6
    on_cornea = (jnp.abs(mirror[..., 0]) < limbus) & (mirror[..., 2] < end_of_cornea)
    on_iris = (depth > 0) & (jnp.abs(landing) < float(eye.iris_radius))
    enters = outside[..., 2] > jnp.cos(LARGEST_POLAR)
    return bool((hit & enters & backward & on_cornea & on_iris).any())


def near_lamp_entry(
    eye: Eye,
    towards: Float[Array, "3"],
    inverse_distance: Scalar,
    point: Float[Array, "*s 2"],
) -> tuple[Vector, Float[Array, "*s"]]:
    """Find where the light of a near lamp enters the cornea, and how much more it spreads than a
    parallel beam.

    Both are searched at 17 × 17 points and interpolated. Where no ray lands, and abruptly
    beyond `UNIQUE_POLAR`, the light enters right in front of the point, and the factor is 1.

    Args:
        eye: The eye, with a cornea.
        towards: Unit vector from the apex to the lamp.
        inverse_distance: 1 over the lamp's distance from the apex, 1/mm.
        point: x and y of points of the iris, mm.

    Returns:
        Entry points (…, 3), mm, and factors on the flux in the tables, which hold for a parallel
        beam; on the axis the factor is 0.89 for a lamp at 50 mm.
    """
    cornea, size = cornea_of(eye), 17
    grid = jnp.linspace(-1, 1, size) * eye.iris_radius
    targets = jnp.stack(jnp.meshgrid(grid, grid), axis=-1).reshape(-1, 2)

    def search(target):
        def land(entry, aim):  # of a ray at `entry`, in the direction of the lamp's light at `aim`
            light = towards - cornea_point(cornea, aim) * inverse_distance
            start, direction = cornea_point(cornea, entry), -light / norm(light)
            return refraction.refract_to_iris(eye, start, direction).point[:2]

        arrival = refraction.find_arrival(eye, target, towards, 0.9 * target)
        fixed, turned = jax.jacfwd(land, (0, 1))(arrival.entry, arrival.entry)
        area, wider = (m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0] for m in (fixed, fixed + turned))
        lit = (norm(arrival.flux) > 0) & (area * wider > 0) & (-towards[2] >= jnp.cos(UNIQUE_POLAR))
        spread = jnp.where(lit, area / jnp.where(lit, wider, 1.0), 1.0)
        return *jnp.where(lit, arrival.entry, target), spread

    row, column = ((point[..., k] / eye.iris_radius + 1) * ((size - 1) / 2) for k in (1, 0))
    x, y, spread = (bilinear(v.reshape(size, size), row, column) for v in jax.vmap(search)(targets))
    r = safe_sqrt(x * x + y * y)  # 0 on the axis, where gradients to the lamp must be finite
    inside = jnp.minimum(1.0, eye.limbus_radius / jnp.where(r > 0, r, 1.0))
    return cornea_point(cornea, jnp.stack([x * inside, y * inside], axis=-1)), spread


def trace_flux(
    eye: Eye, polar: Array, size: int, extent: Scalar, n_rays: int
) -> Float[Array, "size size 3"]:
    """Compute the flux vectors of unit light from azimuth 0 by tracing rays  [F09 Eq. 17].

    A quasi-random ray carries the power of its share of the cornea's area, which is split between
    the four grid points round the point where it lands, so that the sum over the iris is the power
    that arrives. One half of the cornea is traced; the other is its mirror image.

    Args:
        eye: The eye, with a cornea.
        polar: Polar angle of the light, radians.
        size: Number of grid points along each side.
        extent: Half the side of the grid, mm; its rows are y, its columns x.
        n_rays: Number of rays over the whole cornea.
    """
    cornea = cornea_of(eye)
    towards = refraction.direction_of(polar)
    chunks = -(-n_rays // (2 * _CHUNK))
    area = jnp.pi / 2 * (eye.limbus_radius + 0.15) ** 2 / (chunks * _CHUNK)

    def chunk(total, first):
        i = first * _CHUNK + jnp.arange(_CHUNK)
        # The R2 sequence [Roberts 2018] covers half of the cornea evenly, without a seed.
        u, v = (i * 0.7548776662466927 + 0.5) % 1.0, (i * 0.5698402909980532 + 0.5) % 1.0
        radius, angle = (eye.limbus_radius + 0.15) * jnp.sqrt(u), jnp.pi * v
        entry_xy = jnp.stack([radius * jnp.cos(angle), radius * jnp.sin(angle)], axis=-1)
        entry = cornea_point(cornea, entry_xy)
        normal = cornea.anterior.normal(entry)
        projected_area = jnp.maximum(dot(normal, towards), 0) / -normal[..., 2] * area
        power = refraction.limbus_window(eye, entry_xy) * projected_area
        landing = refraction.refract_to_iris(eye, entry, jnp.broadcast_to(-towards, entry.shape))
        return _deposit(total, size, extent, eye, landing, power * landing.share), None

    half = jax.lax.scan(chunk, jnp.zeros((size * size, 3), polar.dtype), jnp.arange(chunks))[0]
    half = half.reshape(size, size, 3) / (2 * extent / (size - 1)) ** 2
    return half + half[::-1] * jnp.asarray([1.0, -1.0, 1.0], half.dtype)


def _deposit(total, size: int, extent, eye: Eye, landing: refraction.Landing, power):
    """Add the power of landings, as flux vectors per cell, to the four grid points round each."""
    xy = landing.point[..., :2]
    on_grid = (jnp.abs(xy).max(-1) < extent) & (power > 0)
    normal = eye.iris_normal(landing.point)
    cosine = jnp.where(on_grid, -dot(landing.direction, normal), 1.0)
    # Cells are measured in the plane; a conical iris has more area in each.
    weight = jnp.where(on_grid, power, 0.0) * -normal[..., 2] / cosine
    vector = weight[..., None] * landing.direction
    inside = jnp.where(on_grid[..., None], xy, 0.0)
    column, row = parts((inside / extent + 1) * ((size - 1) / 2))
    j, i = (jnp.clip(jnp.floor(c), 0, size - 2) for c in (column, row))
    u, v = column - j, row - i
    base = jnp.asarray(i * size + j, jnp.int32)
    for down, across in ((0, 0), (0, 1), (1, 0), (1, 1)):
        weight = (u if across else 1 - u) * (v if down else 1 - v)
        place = base + down * size + across
        total = total.at[place].add(weight[..., None] * vector, mode="promise_in_bounds")
    return total


@eqx.filter_jit
def _build(
    eye: Eye, arrivals: RefractionFunction, caustics: bool, size: int, n_rays: int
) -> Illumination:
    # The grid reaches one cell beyond the iris: cells cut by its edge would lose the power that
    # lands outside, and the rim would be dark.
    extent = eye.iris_radius * (size - 1) / (size - 3)
    grid = jnp.linspace(-1, 1, size) * extent
    x, y = jnp.meshgrid(grid, grid)
    points = jnp.stack([x, y], axis=-1)

    def smooth_flux(angle):
        arrival = arrivals.at(points, refraction.direction_of(angle))
        return refraction.limbus_window(eye, arrival.entry)[..., None] * arrival.flux

    fine = _FINE_FROM + _FINE * jnp.arange(1, round((UNIQUE_POLAR - _FINE_FROM) / _FINE) + 1)
    angles = jnp.concatenate([_SPACING * jnp.arange(_COARSE + 1), fine])
    searched = jax.lax.map(smooth_flux, angles)
    if not caustics:
        return Illumination(searched, extent, UNIQUE_POLAR)
    steps = round((LARGEST_POLAR - UNIQUE_POLAR) / _FINE)
    grazing = UNIQUE_POLAR + _FINE * jnp.arange(1, steps + 1)
    traced = jax.lax.map(lambda angle: trace_flux(eye, angle, size, extent, n_rays), grazing)
    return Illumination(jnp.concatenate([searched, traced]), extent, UNIQUE_POLAR + steps * _FINE)
