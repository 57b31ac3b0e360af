"""Light through the cornea onto the iris: where it enters, and its irradiance  [F09 Eq. 15].

The cornea is a surface of revolution: a light's azimuth only turns the picture, so that tables
depend on its polar angle alone. Lengths are in mm; irradiances are relative to that on a surface
outside the eye that faces the light.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from irisjax.anatomy.eye import Cornea, Eye, cornea_of
from irisjax.numerics.interpolation import multilinear, smoothstep
from irisjax.numerics.roots import solve_2x2
from irisjax.optics.conicoid import Vector, advance, dot, from_parts, norm, parts, refract_vector

LARGEST_POLAR = 2.25
"""Polar angle (radians) beyond which a negligible share of light enters a cornea that ends at the
limbus.
"""

UNIQUE_POLAR = 1.40
"""Polar angle of light (radians) up to which one ray lands at each iris point; beyond it the cornea
folds the light.
"""


def direction_of(polar: ArrayLike, azimuth: ArrayLike = 0.0) -> Vector:
    """Return unit vectors at polar angles from −z and azimuths from +x to +y, radians."""
    sin, cos = jnp.sin(polar), jnp.cos(polar)
    components = sin * jnp.cos(azimuth), sin * jnp.sin(azimuth), -cos
    return jnp.stack(jnp.broadcast_arrays(*components), axis=-1)


class Landing(NamedTuple):
    """A ray refracted by the cornea: the point of the iris it meets, its direction there, and the
    share of its power that is transmitted.
    """

    point: Vector
    direction: Vector
    share: Float[Array, "*s"]


def refract_to_iris(eye: Eye, entry: Vector, direction: Vector) -> Landing:
    """Follow rays from points on the anterior cornea to the iris  [F09 Eqs. 3, 15].

    Snell's and Fresnel's laws hold at each surface; the cornea's haze, which depends on wavelength,
    is left to `Cornea.transmittance`.
    """
    start, inside, share = refract_into_chamber(eye, entry, direction)
    path = eye.meet_iris(start, inside)
    if eye.attenuation is not None:
        share = share * jnp.exp(-eye.attenuation * path)
    return Landing(advance(start, path, inside), inside, share)


def refract_into_chamber(
    eye: Eye, entry: Vector, direction: Vector
) -> tuple[Vector, Vector, Float[Array, "*s"]]:
    """Refract rays at the cornea: the points where they enter the chamber from points on the
    anterior cornea, their directions there, and the share of their power that is transmitted.
    """
    cornea = cornea_of(eye)
    outer, back, aqueous = cornea.anterior.normal(entry), cornea.posterior, eye.aqueous_index
    if back is None:
        return entry, *refract_vector(direction, outer, 1.0, aqueous)
    within, first = refract_vector(direction, outer, 1.0, cornea.index)
    start = advance(entry, back.intersect(entry, within)[0], within)
    inside, second = refract_vector(within, back.normal(start), cornea.index, aqueous)
    return start, inside, first * second


def cornea_point(cornea: Cornea, xy: Float[Array, "*s 2"]) -> Vector:
    """Return the point of the anterior cornea at (x, y)."""
    z = cornea.anterior.apex + cornea.anterior.sagitta(norm(xy))
    return jnp.concatenate([xy, z[..., None]], axis=-1)


class Arrival(NamedTuple):
    """Light at points of the iris.

    Attributes:
        entry: x and y of the points where it enters the cornea, mm.
        flux: Flux as a vector along the light, whose component along the iris normal is the
            irradiance. It continues smoothly beyond the limbus: multiply it by `limbus_window` of
            the entry.
    """

    entry: Float[Array, "*s 2"]
    flux: Vector


def find_arrival(
    eye: Eye,
    target: Float[Array, "2"],
    towards_light: Vector,
    start: Float[Array, "2"],
    steps: int = 12,
) -> Arrival:
    """Search the entry point whose ray lands at `target` (x, y), by Newton's method from `start`.

    Fermat's principle and Snell's law have the same solution; the latter works for any number of
    surfaces.
    """
    cornea = cornea_of(eye)
    reach = search_radius(cornea)

    def land(entry):
        return refract_to_iris(eye, cornea_point(cornea, entry), -towards_light).point[:2]

    def step(entry, _):
        return newton_step(land, entry, target, reach), None

    entry = jax.lax.scan(step, start, None, length=steps)[0]
    landed = norm(land(entry) - target) < 1e-4
    # No ray lands at the target: it would have to enter where the cornea, even if it went on, has
    # turned away from the light.
    outside = reach * towards_light[:2] / jnp.maximum(norm(towards_light[:2]), 1e-9)
    arriving = jnp.where(landed, arriving_flux(eye, entry, towards_light), 0.0)
    return Arrival(jnp.where(landed, entry, outside), arriving)


def search_radius(cornea: Cornea) -> Float[Array, ""]:
    """Return the distance from the axis (mm) up to which entry points are searched, which is short
    of the conicoid's equator.
    """
    return 0.97 * cornea.anterior.radius / jnp.sqrt(jnp.maximum(cornea.anterior.shape, 0.05))


def newton_step(
    landing: Callable[[Float[Array, "2"]], Float[Array, "2"]],
    entry: Float[Array, "2"],
    target: Float[Array, "2"],
    reach: Float[Array, ""],
) -> Float[Array, "2"]:
    """Take a step of Newton's method towards the entry point whose ray lands at `target`, of 1 mm
    at most and never beyond `reach` from the axis.
    """
    value, jacobian = landing(entry), jax.jacfwd(landing)(entry)
    move = -solve_2x2(jacobian, value - target)
    size = norm(move)
    entry = entry + move * jnp.minimum(1.0, 1.0 / jnp.where(size > 0, size, 1.0))
    radius = norm(entry)
    return entry * jnp.minimum(1.0, reach / jnp.where(radius > 0, radius, 1.0))


def arriving_flux(eye: Eye, entry: Float[Array, "2"], towards_light: Vector) -> Vector:
    """Compute the flux vector (3,) on the iris of unit light that enters at `entry`: the share that
    is transmitted, times the light's concentration.
    """
    cornea = cornea_of(eye)

    def land(entry):
        return refract_to_iris(eye, cornea_point(cornea, entry), -towards_light)

    landing = land(entry)
    lit = jax.jacfwd(lambda k: land(k).point)(entry)
    patch = jax.jacfwd(lambda k: cornea_point(cornea, k))(entry)
    # Area that a patch of the cornea shows to the light, over the area of the refracted beam.
    patch_area = jnp.abs(dot(jnp.cross(patch[:, 0], patch[:, 1]), towards_light))
    beam_area = jnp.abs(dot(jnp.cross(lit[:, 0], lit[:, 1]), landing.direction))
    flux = landing.share * patch_area / jnp.where(beam_area > 0, beam_area, jnp.inf)
    return flux * landing.direction


def limbus_window(eye: Eye, entry: Float[Array, "*s 2"]) -> Float[Array, "*s"]:
    """Return 1 where the entry lies on the cornea and 0 beyond the limbus, which is no sharp edge:
    the step is 0.3 mm wide.
    """
    return smoothstep(0.5 + (eye.limbus_radius - norm(entry)) / 0.3)


class RefractionFunction(eqx.Module):
    """Arrivals tabulated over the light's polar angle, the azimuth between light and iris point,
    and radius. Made with `build`.

    The table has 50 × 50 × 100 entries (2,500 directions, 100 radii), as F09's, and ends at
    `UNIQUE_POLAR`, beyond which several rays land at one point; `at` is dark there.
    """

    entry: Float[Array, "polars azimuths radii 2"]
    flux: Float[Array, "polars azimuths radii 3"]
    radius: Float[Array, ""]

    @classmethod
    def build(
        cls, eye: Eye, n_polar: int = 50, n_azimuth: int = 50, n_radius: int = 100
    ) -> "RefractionFunction":
        """Search the entry points of all arrivals."""
        entry, flux = _search_entries(eye, n_polar, n_azimuth, n_radius)
        return cls(entry, flux, eye.iris_radius)

    def at(self, point: Float[Array, "*#s 2"], towards_light: Float[Array, "*#s 3"]) -> Arrival:
        """Interpolate the arrivals at iris points (x, y), mm, of light from unit directions, which
        broadcast with them.
        """
        radius = norm(point)
        light_azimuth = jnp.arctan2(towards_light[..., 1], towards_light[..., 0])
        polar = jnp.arctan2(norm(towards_light[..., :2]), -towards_light[..., 2])
        azimuth = jnp.arctan2(point[..., 1], point[..., 0]) - light_azimuth
        azimuth = jnp.arctan2(jnp.sin(azimuth), jnp.cos(azimuth))  # −π to π
        place = polar / UNIQUE_POLAR, jnp.abs(azimuth) / jnp.pi, radius / self.radius
        index = [p * (n - 1) for p, n in zip(place, self.entry.shape[:3], strict=True)]
        values = multilinear(jnp.concatenate([self.entry, self.flux], axis=-1), index)
        side = jnp.where(azimuth < 0, -1.0, 1.0)
        cos, sin = jnp.cos(light_azimuth), jnp.sin(light_azimuth)

        def rotate(x, y):
            y = y * side
            return cos * x - sin * y, sin * x + cos * y

        x, y, u, v, w = parts(values)
        entry, flux = jnp.stack(rotate(x, y), axis=-1), from_parts([*rotate(u, v), w])
        tabulated = polar < UNIQUE_POLAR + 1e-3  # the last angle itself, whatever its rounding
        return Arrival(entry, jnp.where(tabulated[..., None], flux, 0.0))


@eqx.filter_jit
def _search_entries(eye: Eye, n_polar: int, n_azimuth: int, n_radius: int):
    """Search `entry` and `flux` of `RefractionFunction`, each polar angle from the one before."""
    polar = jnp.linspace(0, UNIQUE_POLAR, n_polar)
    azimuth = jnp.linspace(0, jnp.pi, n_azimuth)
    radius = jnp.linspace(0, 1, n_radius) * eye.iris_radius
    # Light at azimuth 0, iris points at `azimuth` from it.
    targets = radius[None, :, None] * jnp.stack([jnp.cos(azimuth), jnp.sin(azimuth)], -1)[:, None]
    search = jax.vmap(jax.vmap(find_arrival, (None, 0, None, 0, None)), (None, 0, None, 0, None))

    def next_polar(start, angle):
        # From the entry at the last angle six steps converge to rounding.
        arrivals = search(eye, targets, direction_of(angle), start, 6)
        return arrivals.entry, arrivals

    _, arrivals = jax.lax.scan(next_polar, 0.9 * targets, polar)
    return arrivals.entry, arrivals.flux
