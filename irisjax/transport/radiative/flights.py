"""Where a flight ends that begins inside the stroma, in closed form.

Interfaces keep a ray's Snell invariant, so that all its mirror images at the ends of the slab are
geometric series. A flight ends outside the iris, in the ABL, in the IPE, or collides: on its way to
the first end, on its way back from there, or going on in its first sense after both ends.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from irisjax.numerics.roots import safe_sqrt
from irisjax.optics.phase import rayleigh
from irisjax.tissue.indices import RefractiveIndices
from irisjax.transport.process import attenuation, survival
from irisjax.transport.radiative.directions import Directions, from_inside
from irisjax.transport.radiative.fates import course


class Medium(NamedTuple):
    """Optical depths of ABL and stroma, the stroma's albedo and 1 − albedo, and the indices."""

    abl: jax.Array
    depth: jax.Array
    albedo: jax.Array
    coalbedo: jax.Array
    indices: RefractiveIndices


class Flight(NamedTuple):
    """Shares of light by where its flight ends; they sum to one."""

    out: jax.Array
    abl: jax.Array
    ipe: jax.Array
    straight: jax.Array  # collides before the first end of the slab
    back: jax.Array  # collides in the opposite sense
    again: jax.Array  # collides in the first sense, after both ends


class Leg(NamedTuple):
    """A straight way through the stroma: the optical depth below its top where it begins, how far
    it may go across the layers, and its cosine, positive downwards.
    """

    origin: jax.Array
    reach: jax.Array
    cosine: jax.Array


class View(NamedTuple):
    """Of directions of exit: the cosine in the stroma, the components across the layers in and out
    of the plane of incidence, the radiance outside for an intensity of 1 at the slab's top, and the
    share of light that the slab's floor sends back up.
    """

    cosine: jax.Array
    across: tuple[jax.Array, jax.Array]
    bright: jax.Array
    back: jax.Array


def flight(medium: Medium, at, cosine) -> Flight:
    """From optical depth `at` below the slab's top, in a direction of signed cosine."""
    down, mu = cosine > 0, jnp.abs(cosine)
    d = from_inside(medium.indices, mu)
    way = course(medium.abl, medium.depth, d)
    roof, floor = d.top[0] + way.roof.reflected, d.bottom[0]
    first, second = jnp.where(down, floor, roof), jnp.where(down, roof, floor)
    through, gone = survival(medium.depth, mu), attenuation(medium.depth, mu)
    ahead = _ahead(medium, at, down)
    there = survival(ahead, mu) * way.series
    opposite = there * first * through
    above, below = jnp.where(down, opposite, there), jnp.where(down, there, opposite)
    return Flight(
        out=above * way.roof.passed,
        abl=above * way.roof.absorbed,
        ipe=below * d.bottom[1],
        straight=attenuation(ahead, mu),
        back=there * first * gone,
        again=opposite * second * gone,
    )


def leg_of(medium: Medium, at, cosine, back, again) -> Leg:
    """On which a flight from `at` collides, given whether it does so in the opposite sense, or in
    the first one after both ends.
    """
    down = cosine > 0
    sense = down ^ back
    whole = back | again
    return Leg(
        origin=jnp.where(whole, jnp.where(sense, 0.0, medium.depth), at),
        reach=jnp.where(whole, medium.depth, _ahead(medium, at, down)),
        cosine=jnp.where(back, -cosine, cosine),
    )


def collision(medium: Medium, leg: Leg, u):
    """The depth at which light on a leg collides, its distribution's inverse at `u` in (0, 1)."""
    mu = jnp.abs(leg.cosine)
    flown = -jnp.log1p(-u * attenuation(leg.reach, mu))
    return jnp.clip(leg.origin + flown * leg.cosine, 0.0, medium.depth)


def view(abl, depth, exits: Directions, azimuth, indices: RefractiveIndices) -> View:
    """`View` along exits, out of a stroma under an ABL of these optical depths."""
    way, sine = course(abl, depth, exits), safe_sqrt(1 - exits.cosine * exits.cosine)
    wider = (indices.aqueous / indices.stroma) ** 2
    return View(
        cosine=exits.cosine,
        across=(sine * jnp.cos(azimuth), sine * jnp.sin(azimuth)),
        bright=way.series * way.roof.passed * wider / exits.cosine,
        back=way.back,
    )


def radiance(medium: Medium, seen: View, at, cosine, across):
    """Radiance outside of a power of 1 that is scattered at depth `at` and came with a signed
    cosine and components across the layers; exits along a first axis more.

    It leaves straight up, or down and mirrored at the floor: the next event, by expectation.
    """
    here, x, y, along = (v[None] for v in (at, *across, cosine))
    beside = seen.across[0] * x + seen.across[1] * y
    along = seen.cosine * along
    up = rayleigh(beside - along) * survival(here, seen.cosine)
    down = rayleigh(beside + along) * survival(medium.depth[None] - here, seen.cosine) * seen.back
    return seen.bright * (up + down) / (4 * jnp.pi)


def _ahead(medium: Medium, at, down):
    return jnp.where(down, medium.depth - at, at)
