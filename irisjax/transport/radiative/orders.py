"""Light by orders of scattering in the stroma: unscattered, scattered once, or more often.

The unscattered part of a beam has a closed form, and so has the BRDF of light scattered once. The
rest is smooth in the depths, the albedo and the directions; tables of radiative transfer contain
it. All directions are in the stroma, and each includes its mirror images at the stroma's
boundaries.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from irisjax.optics.phase import rayleigh
from irisjax.transport.process import attenuation, reflections, survival
from irisjax.transport.radiative.directions import (
    MODES,
    Absorber,
    Ordinates,
    abl_shares,
    boundaries,
)
from irisjax.transport.radiative.slab import Bounded, Slab, mean_survival
from irisjax.transport.solution import Flux


class Beam(NamedTuple):
    """Fate of light that falls on the iris, up to its first scattering; shares of shape (beams,).

    The first five sum to one.

    Attributes:
        mirrored: Reflected by the first surface.
        reflected: Reflected by the inner interfaces, and out again.
        abl: Absorbed in the ABL.
        lost: Absorbed or scattered in the stroma.
        passed: Passed into the IPE.
        entered: Arriving at the stroma's top for the first time.
        behind: Leaving the IPE behind, or `None`.
    """

    mirrored: jax.Array
    reflected: jax.Array
    abl: jax.Array
    lost: jax.Array
    passed: jax.Array
    entered: jax.Array
    behind: jax.Array | None

    def total(self, power: jax.Array) -> "Beam":
        """Fates of all the light, of which each beam has this share of the `power`."""
        return jax.tree.map(lambda x: x @ power, self)


class AngularProfile(NamedTuple):
    """Fate of unscattered light along directions in the stroma, shape (angles,).

    Attributes:
        series: Sum over all mirror images, see `reflections`.
        back: Share that comes back to the top from the lower boundary.
        lost: Share of entering light that the stroma absorbs or scatters.
        abl: Shares of light that meets the ABL from the stroma.
    """

    series: jax.Array
    back: jax.Array
    lost: jax.Array
    abl: Absorber


class ScatteredFates(NamedTuple):
    """Fate of light after its first scattering: the shares that leave the iris, end in the ABL and
    end in the IPE, and the mean number of further collisions; shape (beams,).
    """

    out: jax.Array
    abl: jax.Array
    ipe: jax.Array
    collisions: jax.Array


def unscattered_beam(abl: jax.Array, depth: jax.Array, beams: Ordinates) -> Beam:
    """Trace a `Beam` through an ABL and a stroma of these optical depths.

    The mirror images of both layers' faces are geometric series.
    """
    entering = abl_shares(abl, beams, from_stroma=False)
    through, inside = survival(depth, beams.cosine), angular_profile(abl, depth, beams)
    down = entering.passed * inside.series
    up = down * through * inside.back
    passed = down * through * beams.bottom[1]
    return Beam(
        mirrored=beams.surface[0],
        reflected=entering.reflected + up * inside.abl.passed,
        abl=entering.absorbed + up * inside.abl.absorbed,
        lost=entering.passed * inside.lost,
        passed=passed,
        entered=entering.passed,
        behind=None if beams.through is None else passed * beams.through,
    )


def angular_profile(abl: jax.Array, depth: jax.Array, d: Ordinates) -> AngularProfile:
    """`AngularProfile` of a stroma under an ABL of these optical depths."""
    upper = abl_shares(abl, d)
    through, loss = survival(depth, d.cosine), attenuation(depth, d.cosine)
    series, _ = reflections(through, loss, *boundaries(upper, d))
    back = through * d.bottom[0]
    return AngularProfile(series, back, series * loss * (1 + back), upper)


def with_scattered(
    beam: Beam, nodes: Ordinates, upper: Absorber, up: jax.Array, down: jax.Array, stroma: jax.Array
) -> Flux:
    """Sum the fates of unscattered and of scattered light.

    Args:
        beam: Fates of all the light before scattering, from `Beam.total`.
        nodes: Directions of the scattered light.
        upper: Shares of the ABL along the nodes, from the stroma.
        up: Radiance of scattered light at the stroma's top, along the nodes.
        down: The same downwards at its bottom.
        stroma: Share of the light that the stroma absorbs.
    """
    flux = nodes.weight * nodes.cosine
    into_ipe, behind = down * nodes.bottom[1], None
    if nodes.through is not None and beam.behind is not None:
        behind = beam.behind + flux @ (into_ipe * nodes.through)
    return Flux(
        reflectance=beam.reflected + flux @ (up * upper.passed),
        mirrored=beam.mirrored,
        abl=beam.abl + flux @ (up * upper.absorbed),
        stroma=stroma,
        ipe=beam.passed + flux @ into_ipe,
        behind=behind,
    )


def conserving_order(
    slab: Slab,
    coalbedo: jax.Array,
    source: jax.Array,
    system: jax.Array,
    right: jax.Array,
    angle: Bounded,
    nodes: Ordinates,
    upper: Absorber,
    beam: Beam,
) -> tuple[jax.Array, Flux]:
    """The moments of the one order in azimuth that carries energy, of shape `right`: (terms,
    moments, columns); and the fate of the light, the mean of the columns.

    `source`: strength times function of each term (terms, angles); `beam`: of all the light before
    scattering, one value or one a column.
    """
    top, bottom = slab.leaving_each(angle, 1)
    flux = nodes.weight * nodes.cosine
    # What each unknown takes from the light in the slab: absorbed by it, or sent out of it.
    loss = top * (upper.passed + upper.absorbed)[None] + bottom * nodes.bottom[1][None]
    sink = (source * flux[None]) @ loss.T
    balance = sink.at[0, :: slab.n_depths].add(coalbedo * slab.widths).ravel()
    columns = right.reshape(balance.size, -1)
    moments = slab.solve(system, columns, balance, beam.lost).reshape(right.shape)
    mean = moments.mean(-1)
    up, down = slab.leaving(angle, source.T @ mean, 1)
    stroma = coalbedo * slab.total(mean[0])
    beam = jax.tree.map(jnp.mean, beam)
    return moments, with_scattered(beam, nodes, upper, up, down, stroma)


def single_scattering(
    abl: jax.Array,
    depth: jax.Array,
    albedo: jax.Array,
    beam: Ordinates,
    exits: Ordinates,
    azimuth: jax.Array,
    phase: Callable[[jax.Array], jax.Array] = rayleigh,
) -> jax.Array:
    """Radiance at the slab's top of light scattered once, shape (exits,), from a beam of flux 1 on
    the iris: ω p(α)/(2 μ_i μ_o) ∫ exp(−t/μ_i − t/μ_o) dt over its paths, up or down before, up or
    down after.

    `phase`: p of the scattering angle's cosine; `azimuth` 0 is straight on.
    """
    incident, emergent = (angular_profile(abl, depth, d) for d in (beam, exits))
    cosine, series, back = beam.cosine[0], incident.series[0], incident.back[0]
    a, b = 1 / cosine, 1 / exits.cosine
    backward = depth * mean_survival(depth * (a + b))
    forward = depth * survival(depth, jnp.maximum(cosine, exits.cosine))
    forward = forward * mean_survival(depth * jnp.abs(a - b))
    across = jnp.maximum((1 - cosine**2) * (1 - exits.cosine**2), 0.0)
    sideways, straight = jnp.cos(azimuth) * jnp.sqrt(across), cosine * exits.cosine
    p_b, p_f = (phase(c + sideways) for c in (-straight, straight))
    paths = p_b * backward * (1 + back * emergent.back) + p_f * forward * (back + emergent.back)
    entry = abl_shares(abl, beam, from_stroma=False).passed[0] * series
    return 0.5 * albedo * entry * emergent.series * paths * a * b


def azimuthal(beam: Ordinates, exits: Ordinates, azimuth: jax.Array) -> jax.Array:
    """Factors of the azimuthal orders in the sum of light scattered twice and oftener, shape
    (orders, exits).
    """
    rows = []
    for mode in MODES:
        row = jnp.cos(mode.order * azimuth) * (1 if mode.order == 0 else 2)
        if mode.order:
            row = row * mode.functions(beam.cosine)[0][0] * mode.functions(exits.cosine)[0]
        rows.append(row)
    return jnp.stack(rows)


def collided_share(abl: jax.Array, depth: jax.Array, d: Ordinates) -> jax.Array:
    """Share of light along directions that the stroma absorbs or scatters, times (1 + τ)/τ."""
    profile = angular_profile(abl, depth, d)
    mean = mean_survival(depth / d.cosine) / d.cosine
    return profile.series * (1 + profile.back) * mean * (1 + depth)
