"""The BRDF by orders of scattering: once in closed form, oftener as a table may hold it.

All directions are in the stroma; each carries its mirror images at the slab's ends.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from irisjax.numerics import linear
from irisjax.optics.phase import rayleigh
from irisjax.transport.process import survival
from irisjax.transport.radiative.directions import MODES, Directions, roof_of
from irisjax.transport.radiative.fates import course, met
from irisjax.transport.radiative.slab import Slab, mean_survival


class Ways(NamedTuple):
    """Of light that leaves along exits, shape (exits,): what the slab would take of light that came
    their way, times (1 + τ)/τ, and what of radiance at the slab's top is BRDF outside.
    """

    taken: jax.Array
    outside: jax.Array


def ways(abl, depth, exits: Directions, indices) -> Ways:
    """`Ways` out of a stroma under an ABL of these optical depths."""
    wider = (indices.aqueous / indices.stroma) ** 2 / (2 * jnp.pi)
    return Ways(_taken(abl, depth, exits), course(abl, depth, exits).roof.passed * wider)


def _taken(abl, depth, d: Directions):
    way = course(abl, depth, d)
    each = mean_survival(depth / d.cosine) / d.cosine
    return way.series * (1 + way.back) * each * (1 + depth)


def single_scattering(
    abl, depth, albedo, beam: Directions, exits: Directions, azimuth, phase=rayleigh
):
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


def multiple_scattering(
    abl, depth, albedo, nodes: Directions, beams: Directions, exits: Directions, how
):
    """Radiance at the slab's top of light scattered twice and oftener, by azimuthal order: shape
    (beams, exits, orders), over ω², what of each beam is lost to the slab, and each exit's
    `Ways.taken`.

    Of the orders 1 and 2 the factors f(μ_i) f(μ_o) are left out; `how`: polynomials and panels.
    """
    slab, found = Slab(depth, *how), []
    angle, beam, exit_ = (met(slab, abl, d) for d in (nodes, beams, exits))
    given, taken = course(abl, depth, beams).lost, _taken(abl, depth, exits)
    for mode in MODES:
        strength = jnp.asarray(mode.strength, depth.dtype)
        f_nodes = mode.functions(nodes.cosine)
        f_in, f_out = (
            mode.functions(d.cosine) if mode.order == 0 else jnp.ones_like(d.cosine)[None]
            for d in (beams, exits)
        )
        operator = slab.moments(angle, nodes.weight, f_nodes, mode.parity)
        operator = operator * jnp.repeat(strength, operator.shape[0] // strength.size)[None, :]
        each = slab.driving_each(beam, mode.parity) / (beams.cosine * given)[None]
        driving = (f_in[:, None] * each[None]).reshape(-1, beams.cosine.size)
        one = jnp.eye(driving.shape[0], dtype=depth.dtype)
        again = operator @ linear.solve(one - albedo * operator, driving)
        again = again.reshape(strength.size, -1, beams.cosine.size)
        top, _ = slab.leaving_each(exit_, mode.parity)
        sent = (strength[:, None] * f_out)[:, None] * (top / taken[None])[None]
        found.append(jnp.einsum("lko,lki->io", sent, again))
    return jnp.stack(found, axis=-1)


def azimuthal(beam: Directions, exits: Directions, azimuth):
    """Factors of the orders of `multiple_scattering` in their sum, shape (orders, exits)."""
    rows = []
    for mode in MODES:
        row = jnp.cos(mode.order * azimuth) * (1 if mode.order == 0 else 2)
        if mode.order:
            row = row * mode.functions(beam.cosine)[0][0] * mode.functions(exits.cosine)[0]
        rows.append(row)
    return jnp.stack(rows)
