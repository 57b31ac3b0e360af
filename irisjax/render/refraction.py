"""Light through the cornea onto the iris: where it enters, how strong it arrives  [F09 Eq. 15].

The cornea is a surface of revolution: a light's azimuth only turns the picture, so that tables need
its polar angle alone. All lengths mm; irradiances are relative to that on a surface that faces the
light outside the eye.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from irisjax.anatomy.eye import Cornea, Eye
from irisjax.numerics.interpolation import multilinear, smoothstep
from irisjax.numerics.roots import solve_2x2
from irisjax.optics.conicoid import Vector, advance, dot, from_parts, norm, parts, refract_vector

LARGEST_POLAR = 2.25
"""Polar angle (radians) beyond which no light worth counting enters a cornea that ends at the
limbus.
"""

UNIQUE_POLAR = 1.40
"""Up to this polar angle (radians) one ray lands at each iris point; beyond, the cornea folds the
light.
"""


def direction_of(polar: ArrayLike, azimuth: ArrayLike = 0.0) -> Vector:
    """Unit vectors at polar angles from straight ahead (−z) and azimuths from +x to +y, radians."""
    sin, cos = jnp.sin(polar), jnp.cos(polar)
    found = sin * jnp.cos(azimuth), sin * jnp.sin(azimuth), -cos
    return jnp.stack(jnp.broadcast_arrays(*found), axis=-1)


class Landing(NamedTuple):
    """A ray that met the cornea: where on the iris it arrives, its direction there, and the share
    let through.
    """

    point: Vector
    direction: Vector
    share: Float[Array, "*s"]


def enter(eye: Eye, entry: Vector, direction: Vector) -> Landing:
    """Follow rays from points on the anterior cornea to the iris  [F09 Eqs. 3, 15].

    Snell and Fresnel at each surface; the cornea's wavelength-dependent haze is left to
    `Cornea.transmittance`.
    """
    start, inside, share = into_chamber(eye, entry, direction)
    path = eye.meet_iris(start, inside)
    if eye.attenuation is not None:
        share = share * jnp.exp(-eye.attenuation * path)
    return Landing(advance(start, path, inside), inside, share)


def into_chamber(
    eye: Eye, entry: Vector, direction: Vector
) -> tuple[Vector, Vector, Float[Array, "*s"]]:
    """Where rays from points on the anterior cornea begin in the chamber, their direction there,
    the share let in.
    """
    cornea = eye.cornea
    assert cornea is not None
    outer, back, aqueous = cornea.anterior.normal(entry), cornea.posterior, eye.aqueous_index
    if back is None:
        return entry, *refract_vector(direction, outer, 1.0, aqueous)
    within, first = refract_vector(direction, outer, 1.0, cornea.index)
    start = advance(entry, back.intersect(entry, within)[0], within)
    inside, second = refract_vector(within, back.normal(start), cornea.index, aqueous)
    return start, inside, first * second


def on_cornea(cornea: Cornea, xy: Float[Array, "*s 2"]) -> Vector:
    """The point of the anterior cornea at (x, y)."""
    z = cornea.anterior.apex + cornea.anterior.sagitta(norm(xy))
    return jnp.concatenate([xy, z[..., None]], axis=-1)


class Arrival(NamedTuple):
    """Light at points of the iris: entry on the cornea (…, 2), and the flux as a vector along the
    light (…, 3).

    `flux`'s component along the iris normal is the irradiance. It continues smoothly beyond the
    limbus: multiply by `window` of the entry.
    """

    entry: Float[Array, "*s 2"]
    flux: Vector


def arrive(
    eye: Eye,
    target: Float[Array, "2"],
    towards_light: Vector,
    start: Float[Array, "2"],
    steps: int = 12,
) -> Arrival:
    """Newton's search for the entry point whose ray lands at `target` (x, y), from `start`; an
    `Arrival`.

    Fermat's principle and Snell's law have the same solution; the latter works for any number of
    surfaces.
    """
    cornea = eye.cornea
    assert cornea is not None
    reach = reach_of(cornea)

    def landing(k):
        return enter(eye, on_cornea(cornea, k), -towards_light)

    def newton(k, _):
        return nearer(lambda k: landing(k).point[:2], k, target, reach), None

    entry = jax.lax.scan(newton, start, None, length=steps)[0]
    found = norm(landing(entry).point[:2] - target) < 1e-4
    # No ray lands there: it would have to enter where the cornea, even if it went on, has turned
    # away.
    beyond = reach * towards_light[:2] / jnp.maximum(norm(towards_light[:2]), 1e-9)
    lit = jnp.where(found, flux(eye, entry, towards_light), 0.0)
    return Arrival(jnp.where(found, entry, beyond), lit)


def reach_of(cornea: Cornea) -> Float[Array, ""]:
    """Distance from the axis (mm) up to which entry points are searched, short of the equator."""
    return 0.97 * cornea.anterior.radius / jnp.sqrt(jnp.maximum(cornea.anterior.shape, 0.05))


def nearer(
    landing: Callable[[Float[Array, "2"]], Float[Array, "2"]],
    entry: Float[Array, "2"],
    target: Float[Array, "2"],
    reach: Float[Array, ""],
) -> Float[Array, "2"]:
    """A step of Newton's search for the entry point whose ray lands at `target`, at most 1 mm and
    never beyond `reach`.
    """
    value, slope = landing(entry), jax.jacfwd(landing)(entry)
    move = -solve_2x2(slope, value - target)
    size = norm(move)
    entry = entry + move * jnp.minimum(1.0, 1.0 / jnp.where(size > 0, size, 1.0))
    r = norm(entry)
    return entry * jnp.minimum(1.0, reach / jnp.where(r > 0, r, 1.0))


def flux(eye: Eye, entry: Float[Array, "2"], towards_light: Vector) -> Vector:
    """Flux vector (3,) on the iris of unit light that enters at `entry`: shares kept, and its
    concentration.
    """
    cornea = eye.cornea
    assert cornea is not None
    there = enter(eye, on_cornea(cornea, entry), -towards_light)
    slope = jax.jacfwd(lambda k: enter(eye, on_cornea(cornea, k), -towards_light).point)(entry)
    surface = jax.jacfwd(lambda k: on_cornea(cornea, k))(entry)
    # Area that a patch of the cornea shows to the light, over the area it lights seen along the
    # ray.
    shown = jnp.abs(dot(jnp.cross(surface[:, 0], surface[:, 1]), towards_light))
    seen = jnp.abs(dot(jnp.cross(slope[:, 0], slope[:, 1]), there.direction))
    return there.share * shown / jnp.where(seen > 0, seen, jnp.inf) * there.direction


def window(eye: Eye, entry: Float[Array, "*s 2"], soft: float = 0.15) -> Float[Array, "*s"]:
    """1 where the entry lies on the cornea, 0 beyond the limbus, soft (± mm) between: the limbus is
    no edge.
    """
    return smoothstep(0.5 + (eye.limbus_radius - norm(entry)) / (2 * soft))


class RefractionFunction(eqx.Module):
    """Arrivals tabulated over the light's polar angle, the azimuth between light and iris point,
    and radius.

    Make one with `build`; linear interpolation. 50 × 50 × 100 entries (2,500 directions, 100
    radii), as F09's. The tables end at `UNIQUE_POLAR`, where a point begins to have several
    arrivals; beyond, `at` is dark.
    """

    entry: Float[Array, "polars azimuths radii 2"]
    flux: Float[Array, "polars azimuths radii 3"]
    radius: Float[Array, ""]

    @classmethod
    def build(
        cls, eye: Eye, n_polar: int = 50, n_azimuth: int = 50, n_radius: int = 100
    ) -> "RefractionFunction":
        """Search all entry points, from each polar angle to the next."""
        entry, flux = _searched(eye, n_polar, n_azimuth, n_radius)
        return cls(entry, flux, eye.iris_radius)

    def at(self, point: Float[Array, "*#s 2"], towards_light: Float[Array, "*#s 3"]) -> Arrival:
        """Arrivals at iris points (x, y) of light from unit directions (that broadcast with
        them).
        """
        r = norm(point)
        light_azimuth = jnp.arctan2(towards_light[..., 1], towards_light[..., 0])
        polar = jnp.arctan2(norm(towards_light[..., :2]), -towards_light[..., 2])
        turn = jnp.arctan2(point[..., 1], point[..., 0]) - light_azimuth
        turn = jnp.arctan2(jnp.sin(turn), jnp.cos(turn))  # −π to π
        n_polar, n_azimuth, n_radius, _ = self.entry.shape
        found = multilinear(
            jnp.concatenate([self.entry, self.flux], axis=-1),
            (polar / UNIQUE_POLAR * (n_polar - 1), jnp.abs(turn) / jnp.pi * (n_azimuth - 1),
             r / self.radius * (n_radius - 1)),
        )  # fmt: skip
        side = jnp.where(turn < 0, -1.0, 1.0)
        cos, sin = jnp.cos(light_azimuth), jnp.sin(light_azimuth)

        def turned(x, y):
            y = y * side
            return cos * x - sin * y, sin * x + cos * y

        x, y, u, v, w = parts(found)
        entry, flux = jnp.stack(turned(x, y), axis=-1), from_parts([*turned(u, v), w])
        lit = polar < UNIQUE_POLAR + 1e-3  # the last angle itself, whatever its rounding
        return Arrival(entry, jnp.where(lit[..., None], flux, 0.0))


@eqx.filter_jit
def _searched(eye: Eye, n_polar: int, n_azimuth: int, n_radius: int):
    """`entry` and `flux` of `RefractionFunction`."""
    polar = jnp.linspace(0, UNIQUE_POLAR, n_polar)
    azimuth = jnp.linspace(0, jnp.pi, n_azimuth)
    radius = jnp.linspace(0, 1, n_radius) * eye.iris_radius
    # Light at azimuth 0, iris points at `azimuth` from it.
    targets = radius[None, :, None] * jnp.stack([jnp.cos(azimuth), jnp.sin(azimuth)], -1)[:, None]
    search = jax.vmap(jax.vmap(arrive, (None, 0, None, 0, None)), (None, 0, None, 0, None))

    def next_polar(start, angle):
        # From the entry of the last angle six steps reach rounding.
        found = search(eye, targets, direction_of(angle), start, 6)
        return found.entry, found

    _, found = jax.lax.scan(next_polar, 0.9 * targets, polar)
    return found.entry, found.flux
