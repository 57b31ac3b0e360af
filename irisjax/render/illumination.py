"""Tables of the light that reaches the iris from any direction: refraction and caustics together,
ready to be summed over lights.

The caustic is grazing light that the cornea folds onto itself. F09 adds rays reflected inside the
cornea. With F09's own cornea there are none: a ray goes on at most 46.6° from the normal (total
reflection's angle), so that it meets the conicoid again 0.3 mm or more behind the limbus, where the
cornea has ended. The caustic is made by refraction alone. Of other corneas `reflects_inside` says
whether they have such rays, which are left out.
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
from irisjax.optics.conicoid import Vector, dot, from_parts, norm, parts
from irisjax.render import refraction
from irisjax.render.refraction import LARGEST_POLAR, UNIQUE_POLAR, RefractionFunction, on_cornea

# Radians between tabulated polar angles, up to `_STEEP` radians and beyond. The edge of the shadow
# on the iris moves by 0.05 mm a degree there, and by 0.1 at `UNIQUE_POLAR`.
_SPACING, _FINE = 0.05, 0.0125
_COARSE = 20  # number of the wider steps
_STEEP = _COARSE * _SPACING
_CHUNK = 1 << 14  # rays traced together: their intermediates stay in the cache


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
        arrivals = RefractionFunction.build(eye, *_searched(size))
        return _build(eye, arrivals, caustics, size, n_rays)

    def at(self, point: Float[Array, "*#s 2"], towards_light: Float[Array, "*#s 3"]) -> Vector:
        """Flux vectors at iris points (x, y) of light from unit directions (that broadcast with
        them).

        On the axis itself, where azimuths have none, the gradient to the direction is taken as
        zero.
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
        index = jnp.minimum(polar / _SPACING, _COARSE) + jnp.maximum(polar - _STEEP, 0.0) / _FINE
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
        u, v, w = parts(f)
        return from_parts([cos * u - sin * v, sin * u + cos * v, w])


def _searched(size: int) -> tuple[int, int, int]:
    """Polar angles, azimuths and radii of the entry points for a grid of `size`."""
    share = min(size / 129, 1.0)
    polars = 50 if share == 1 else round(UNIQUE_POLAR / _SPACING) + 1
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
    rims = {
        "pupil_radius": 1.0,
        "pupil_margin": 0.12,
        "pupil_centre": None,
        "pupil_harmonics": None,
        "limbus_width": 1.0,
        "limbal_ring": None,
        "lids": None,
    }
    return eye.replace(cornea=cornea, sclera=None, **rims)


def reflects_inside(eye: Eye) -> bool:
    """Return whether light that enters the cornea, reflected once on its inside, reaches the iris.

    That needs a limbus of 6 mm or more on F09's conicoid, or a sphere. Rays in one plane through
    the axis are traced.
    """
    if eye.cornea is None:
        return False
    front, limbus = eye.cornea.anterior, float(eye.limbus_radius)
    entry, bent = jnp.meshgrid(jnp.linspace(-limbus, limbus, 201), jnp.linspace(0, 1, 100)[:-1])
    origin = jnp.stack([entry, 0 * entry, front.sagitta(entry)], -1)
    inward = -front.normal(origin)
    along = jnp.stack([-inward[..., 2], 0 * entry, inward[..., 0]], -1)  # to the other side
    sine = bent / float(eye.aqueous_index)  # `bent` is that of the angle outside
    outside, inside = (
        s[..., None] * along + jnp.sqrt(1 - s * s)[..., None] * inward for s in (bent, sine)
    )
    length, met = front.intersect(origin, inside, far=True)
    again = origin + length[..., None] * inside
    normal = front.normal(again)
    back = inside - 2 * (inside * normal).sum(-1, keepdims=True) * normal
    depth = (float(eye.iris_depth) - again[..., 2]) / jnp.where(back[..., 2] > 0, back[..., 2], 1.0)
    landing = again[..., 0] + depth * back[..., 0]
    there = met & (outside[..., 2] > jnp.cos(LARGEST_POLAR)) & (back[..., 2] > 0)
    there &= (jnp.abs(again[..., 0]) < limbus) & (
        again[..., 2] < front.sagitta(eye.limbus_radius) + 1e-6
    )
    return bool((there & (depth > 0) & (jnp.abs(landing) < float(eye.iris_radius))).any())


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
            return refraction.enter(eye, on_cornea(cornea, entry), -light / norm(light)).point[:2]

        arrival = refraction.arrive(eye, target, towards, 0.9 * target)
        fixed, turned = jax.jacfwd(landing, (0, 1))(arrival.entry, arrival.entry)
        area, wider = (m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0] for m in (fixed, fixed + turned))
        lit = (norm(arrival.flux) > 0) & (area * wider > 0) & (-towards[2] >= jnp.cos(UNIQUE_POLAR))
        spread = jnp.where(lit, area / jnp.where(lit, wider, 1.0), 1.0)
        return *jnp.where(lit, arrival.entry, target), spread

    row, column = ((point[..., k] / eye.iris_radius + 1) * ((size - 1) / 2) for k in (1, 0))
    x, y, spread = (bilinear(v.reshape(size, size), row, column) for v in jax.vmap(found)(targets))
    r = safe_sqrt(x * x + y * y)  # 0 on the axis, where a lamp's gradient is wanted too
    inside = jnp.minimum(1.0, eye.limbus_radius / jnp.where(r > 0, r, 1.0))
    return on_cornea(cornea, jnp.stack([x * inside, y * inside], axis=-1)), spread


def gathered(
    eye: Eye, polar: Array, size: int, extent: Scalar, n_rays: int
) -> Float[Array, "size size 3"]:
    """Flux vectors on a square grid (rows y, columns x) of ± `extent` mm of unit light from azimuth
    0 and the given polar angle, counted ray by ray  [F09 Eq. 17].

    A quasi-random ray stands for its share of the cornea's area; its power is shared out between
    the four grid points round the place where it lands, so that the sum over the iris is the power
    that arrived. `n_rays` over the whole cornea; one half is traced and mirrored.
    """
    cornea = eye.cornea
    assert cornea is not None
    towards = refraction.direction_of(polar)
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
        shown = jnp.maximum(dot(normal, towards), 0) / -normal[..., 2] * area
        power = refraction.window(eye, k) * shown
        landing = refraction.enter(eye, entry, jnp.broadcast_to(-towards, entry.shape))
        return _share_out(total, size, extent, eye, landing, power * landing.share), None

    half = jax.lax.scan(chunk, jnp.zeros((size * size, 3), polar.dtype), jnp.arange(chunks))[0]
    half = half.reshape(size, size, 3) / (2 * extent / (size - 1)) ** 2
    return half + half[::-1] * jnp.asarray([1.0, -1.0, 1.0], half.dtype)


def _share_out(total, size: int, extent, eye: Eye, landing: refraction.Landing, power):
    """Add the power of landings to their four grid points, as flux vectors per cell."""
    xy = landing.point[..., :2]
    on_grid = (jnp.abs(xy).max(-1) < extent) & (power > 0)
    normal = eye.iris_normal(landing.point)
    cosine = jnp.where(on_grid, -dot(landing.direction, normal), 1.0)
    # Cells are those of the plane; an iris that is a cone has more area in each.
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
    # One cell beyond the iris: cells that its edge cuts would lose the power landing outside and
    # darken the rim.
    extent = eye.iris_radius * (size - 1) / (size - 3)
    line = jnp.linspace(-1, 1, size) * extent
    x, y = jnp.meshgrid(line, line)
    points = jnp.stack([x, y], axis=-1)

    def smooth(angle):
        found = arrivals.at(points, refraction.direction_of(angle))
        return refraction.window(eye, found.entry)[..., None] * found.flux

    fine = _STEEP + _FINE * jnp.arange(1, round((UNIQUE_POLAR - _STEEP) / _FINE) + 1)
    smoothly = jax.lax.map(smooth, jnp.concatenate([_SPACING * jnp.arange(_COARSE + 1), fine]))
    if not caustics:
        return Illumination(smoothly, extent, UNIQUE_POLAR)
    steps = round((LARGEST_POLAR - UNIQUE_POLAR) / _FINE)
    counted = jax.lax.map(
        lambda a: gathered(eye, a, size, extent, n_rays),
        UNIQUE_POLAR + _FINE * jnp.arange(1, steps + 1),
    )
    return Illumination(jnp.concatenate([smoothly, counted]), extent, UNIQUE_POLAR + steps * _FINE)
