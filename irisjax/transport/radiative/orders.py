"""Light by orders of scattering in the stroma: not scattered, scattered once, and oftener.

What a beam does before it is scattered has a closed form, and so has a BRDF of light scattered
once; what follows is smooth in the depths, the albedo and the directions, and is what tables of
radiative transfer hold. All directions are in the stroma; each carries its mirror images at the
slab's ends.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from irisjax.optics.phase import rayleigh
from irisjax.transport.process import attenuation, reflections, survival
from irisjax.transport.radiative.directions import MODES, Ordinates, Roof, ends_of, roof_of
from irisjax.transport.radiative.slab import Bounded, Slab, mean_survival
from irisjax.transport.solution import Flux


class Beam(NamedTuple):
    """Shares of light that falls on the iris, before any of it is scattered; shape (beams,).

    `mirrored` at the first surface; `reflected` by the inner interfaces and out again; `abl`,
    absorbed there; `lost` to the stroma, absorbed or scattered in it; `passed` into the IPE. They
    sum to one. `entered`: the share that comes to the stroma's top for the first time; `behind`:
    the share that leaves the IPE behind, or `None`.
    """

    mirrored: jax.Array
    reflected: jax.Array
    abl: jax.Array
    lost: jax.Array
    passed: jax.Array
    entered: jax.Array
    behind: jax.Array | None


class Course(NamedTuple):
    """Of directions in the stroma, shape (angles,): the sum over all mirror images; the share that
    comes back from the slab's floor; what of light that enters is lost to the slab; the share that
    leaves through the ABL.
    """

    series: jax.Array
    back: jax.Array
    lost: jax.Array
    roof: Roof


class ScatteredFates(NamedTuple):
    """Of light scattered once: shares that leave the iris and that end in the ABL and in the IPE,
    and the mean number of times that it collides again; shape (beams,).
    """

    out: jax.Array
    abl: jax.Array
    ipe: jax.Array
    collisions: jax.Array


def before(abl: jax.Array, depth: jax.Array, beams: Ordinates) -> Beam:
    """`Beam` through an ABL and a stroma of these optical depths.

    The mirror images of both layers' faces are geometric series.
    """
    roof_in = roof_of(abl, beams, from_stroma=False)
    through, way = survival(depth, beams.cosine), course(abl, depth, beams)
    down = roof_in.passed * way.series
    up = down * through * way.back
    passed = down * through * beams.bottom[1]
    return Beam(
        mirrored=beams.surface[0],
        reflected=roof_in.reflected + up * way.roof.passed,
        abl=roof_in.absorbed + up * way.roof.absorbed,
        lost=roof_in.passed * way.lost,
        passed=passed,
        entered=roof_in.passed,
        behind=None if beams.through is None else passed * beams.through,
    )


def course(abl: jax.Array, depth: jax.Array, d: Ordinates) -> Course:
    """`Course` of directions between the ends of a stroma under an ABL of these optical depths."""
    roof = roof_of(abl, d)
    through, gone = survival(depth, d.cosine), attenuation(depth, d.cosine)
    ends = ends_of(roof, d)
    series, _ = reflections(through, gone, ends[:2], ends[2:])
    back = through * d.bottom[0]
    return Course(series, back, series * gone * (1 + back), roof)


def with_scattered(
    beam: Beam,
    power: jax.Array,
    nodes: Ordinates,
    roof: Roof,
    up: jax.Array,
    down: jax.Array,
    stroma: jax.Array,
) -> Flux:
    """Where light goes: unscattered light of beams with these shares of its `power`, and scattered
    light with radiances `up` at the stroma's top and `down` at its bottom along the nodes.
    """
    flux = nodes.weight * nodes.cosine
    into_ipe, behind = down * nodes.bottom[1], None
    if nodes.through is not None and beam.behind is not None:
        behind = power @ beam.behind + flux @ (into_ipe * nodes.through)
    return Flux(
        reflectance=power @ beam.reflected + flux @ (up * roof.passed),
        mirrored=power @ beam.mirrored,
        abl=power @ beam.abl + flux @ (up * roof.absorbed),
        stroma=stroma,
        ipe=power @ beam.passed + flux @ into_ipe,
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
    roof: Roof,
    beam: Beam,
    power: jax.Array,
) -> tuple[jax.Array, Flux]:
    """The moments of the one order in azimuth that carries energy, of shape `right`: (terms,
    moments, beams); and where the mean of the beams goes, `beam` with these shares of its `power`.

    `source`: strength times function of each term (terms, angles).
    """
    top, bottom = slab.leaving_each(angle, 1)
    flux = nodes.weight * nodes.cosine
    # What each unknown takes from the light in the slab: absorbed by it, or sent out of it.
    lost = top * (roof.passed + roof.absorbed)[None] + bottom * nodes.bottom[1][None]
    taken = (source * flux[None]) @ lost.T
    balance = taken.at[0, :: slab.n_depths].add(coalbedo * slab.widths).ravel()
    columns = right.reshape(balance.size, -1)
    moments = slab.solve(system, columns, balance, beam.lost @ power).reshape(right.shape)
    mean = moments.mean(-1)
    up, down = slab.leaving(angle, source.T @ mean, 1)
    stroma = coalbedo * slab.total(mean[0])
    beam = jax.tree.map(lambda x: x.mean(0), beam)
    return moments, with_scattered(beam, power, nodes, roof, up, down, stroma)


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
    the iris: ω p(α)/(2 μ_i μ_o) ∫ exp(−t/μ_i − t/μ_o) dt over its courses, up or down before, up or
    down after.

    `phase`: p of the scattering angle's cosine; `azimuth` 0 is straight on.
    """
    before, after = course(abl, depth, beam), course(abl, depth, exits)
    cosine, series, back = beam.cosine[0], before.series[0], before.back[0]
    a, b = 1 / cosine, 1 / exits.cosine
    turned = depth * mean_survival(depth * (a + b))
    along = depth * survival(depth, jnp.maximum(cosine, exits.cosine))
    along = along * mean_survival(depth * jnp.abs(a - b))
    across = jnp.maximum((1 - cosine**2) * (1 - exits.cosine**2), 0.0)
    sideways, straight = jnp.cos(azimuth) * jnp.sqrt(across), cosine * exits.cosine
    away, on = (phase(c + sideways) for c in (-straight, straight))
    courses = away * turned * (1 + back * after.back) + on * along * (back + after.back)
    into = roof_of(abl, beam, from_stroma=False).passed[0] * series
    return 0.5 * albedo * into * after.series * courses * a * b


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


def taken_of(abl: jax.Array, depth: jax.Array, d: Ordinates) -> jax.Array:
    """What the slab takes of light along directions, times (1 + τ)/τ."""
    way = course(abl, depth, d)
    each = mean_survival(depth / d.cosine) / d.cosine
    return way.series * (1 + way.back) * each * (1 + depth)
