"""Packets of light in the stroma, followed by expected values in lanes that never wait.

What a packet meets at interfaces is never drawn. From each scattering all that becomes of its
flight unscattered is scored in closed form, mirror images included; what collides again is made to,
at a place drawn from its exact distribution, and goes on in a direction from the phase function. A
packet that has become faint ends as a photon does: each further flight has one outcome, which takes
all of it. So nothing is cut off, and every packet keeps its energy.

What is drawn, and with what probability, is held, while places and weights move with the
parameters: derivatives are unbiased.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from irisjax.numerics.roots import safe_sqrt
from irisjax.numerics.sharding import vary_alike
from irisjax.numerics.streams import fold_in_words, scales_of, uniform
from irisjax.optics.phase import AbstractPhase, rayleigh
from irisjax.transport.lanes import cosine_of_turn, deflect
from irisjax.transport.radiative.flights import (
    Leg,
    Medium,
    View,
    collision,
    flight,
    leg_of,
    radiance,
)

_FAINT = 0.05  # share of its first weight below which a packet ends as a photon does


class Beams(NamedTuple):
    """Light in the stroma before its first collision: cosines (beams,), and with shape
    (wavelengths, beams) each one's part of all first collisions, and the share of those that come
    after the mirror of the slab's floor.
    """

    cosine: jax.Array
    part: jax.Array
    back: jax.Array


class Packet(NamedTuple):
    """What a lane follows: a weight, the way on which it collides next and, where radiance is asked
    for, the components of its direction across the layers.
    """

    weight: jax.Array
    leg: Leg
    across: tuple[jax.Array, jax.Array] | None


def follow(
    phase: AbstractPhase,
    replicates: int,
    lanes,
    key,
    rounds,
    medium: Medium,
    light: Beams,
    seen: View | None,
):
    """Sums over each lane's packets, each of a first weight of 1: reflected, absorbed in ABL,
    stroma and IPE, and at each exit the radiance of light scattered twice and oftener; shape
    (4 + exits, wavelengths, lanes).

    Lane l has the packets l, l + `replicates`, ..., as many as `rounds` (wavelengths, 1) says, none
    where l is no replicate. Packet i at wavelength j draws from `fold_in(fold_in(key, j), i)`.
    """
    n_waves, dtype = medium.depth.shape[0], medium.depth.dtype
    rounds = jnp.where(lanes[None] < replicates, rounds, 0)
    words = jax.random.key_data(jax.vmap(lambda j: jax.random.fold_in(key, j))(jnp.arange(n_waves)))
    scale = scales_of(words[0, 0])

    def key_of(turn):
        number = (lanes[None] + turn * replicates).astype(jnp.uint32)
        return fold_in_words(words[:, 0, None], words[:, 1, None], number)

    def once(tree):
        # XLA on CPU makes numbers anew in every loop that uses them, unless they end in a division.
        floats = jnp.floating
        return jax.tree.map(lambda x: x / scale[2] if jnp.issubdtype(x, floats) else x, tree)

    def body(state):
        words, turn, step, live, packet, score = state
        u = _draws(words, step, scale)
        new = _first(medium, light, u.beam, seen is not None)
        packet = jax.tree.map(lambda a, b: jnp.where(step == 0, a, b), new, packet)
        packet = once(packet._replace(weight=jnp.where(live, packet.weight, 0.0)))

        # A collision, and what of it is seen.
        at = once(collision(medium, packet.leg, u.place))
        weight = packet.weight * medium.albedo
        if seen is not None:
            glow = radiance(medium, seen, at, packet.leg.cosine, packet.across)
            glow = jnp.where(step > 0, weight, 0.0)[None] * glow

        # A new direction, and where it leads.
        turned, across, ratio = once(_scatter(phase, packet.leg, packet.across, u))
        weight = weight * ratio
        to = once(flight(medium, at, turned))
        absorbed = packet.weight * medium.coalbedo
        ends = [weight * to.out, weight * to.abl, absorbed, weight * to.ipe]
        ways = [weight * x for x in (to.straight, to.back, to.again)]
        # Bright packets score all ends and take one of the ways; faint ones, one of them all.
        faint = lax.stop_gradient(packet.weight) < _FAINT
        chosen, brought = once(
            _one_of([*ways, *(jnp.where(faint, x, 0.0) for x in ends)], u.outcome)
        )
        scored = tuple(
            s + jnp.where(faint, jnp.where(c, brought, 0.0), e)
            for s, c, e in zip(score[:4], chosen[3:], ends, strict=True)
        )
        if seen is not None:
            scored += (score[4] + glow,)
        goes_on = live & (chosen[0] | chosen[1] | chosen[2])
        leg = leg_of(medium, at, turned, chosen[1], chosen[2])

        # The lane's next packet takes the place of one that has ended.
        born = ~goes_on & (turn < rounds)
        words = jax.tree.map(lambda a, b: jnp.where(born, a, b), key_of(turn), words)
        step = jnp.where(born, 0, step + 1)
        return (
            words,
            turn + born.astype(turn.dtype),
            step,
            goes_on | born,
            Packet(brought, leg, across),
            scored,
        )

    zero, none = jnp.zeros(rounds.shape, dtype), jnp.zeros_like(rounds)
    score = (zero,) * 4
    if seen is not None:
        score += (jnp.zeros((seen.bright.shape[0], *rounds.shape), dtype),)
    packet = Packet(zero, Leg(zero, zero, zero + 1), None if seen is None else (zero, zero))
    state = key_of(none), none + 1, none, rounds > 0, packet, score
    state = vary_alike(state, rounds, medium, light, seen)
    scored = lax.while_loop(lambda s: jnp.any(s[3]), body, state)[-1]
    return jnp.concatenate([jnp.stack(scored[:4]), *scored[4:]])


class _Draws(NamedTuple):
    """Uniform numbers of a step, and the cosine and sine of an azimuth."""

    place: jax.Array
    deflection: jax.Array
    outcome: jax.Array
    beam: jax.Array
    azimuth: tuple[jax.Array, jax.Array]


def _draws(words, step, scale) -> _Draws:
    first, second = words
    one, two = (fold_in_words(first, second, (2 * step + i).astype(jnp.uint32)) for i in (0, 1))
    place, deflection, outcome, beam = (uniform(w >> 9, scale[0]) for w in (*one, *two))
    cosine = cosine_of_turn(uniform((one[0] & 511) << 9 | (one[1] & 511), scale[1]))
    sine = jnp.sqrt(jnp.maximum(1 - cosine * cosine, 0.0))
    azimuth = cosine, jnp.where((two[0] & 1) > 0, sine, -sine)
    return _Draws(place, deflection, outcome, beam, azimuth)


def _first(medium: Medium, light: Beams, u, at_exits: bool) -> Packet:
    """A packet on its way to its first collision: along one of the beams, before the mirror of the
    slab's floor or after it.
    """
    parts = jnp.concatenate([light.part * (1 - light.back), light.part * light.back], axis=1)
    cosines = jnp.concatenate([light.cosine, -light.cosine])
    held = lax.stop_gradient(parts)
    above = jnp.cumsum(held, axis=1)
    below, above = above - held, above.at[:, -1].set(2.0)
    chosen = (u[None] >= below.T[..., None]) & (u[None] < above.T[..., None])
    part = jnp.where(chosen, parts.T[..., None], 0.0).sum(0)
    cosine = jnp.where(chosen, cosines[:, None, None], 0.0).sum(0)
    reach = jnp.broadcast_to(medium.depth, u.shape)
    leg = Leg(jnp.where(cosine > 0, 0.0, reach), reach, cosine)
    across = (safe_sqrt(1 - cosine * cosine), jnp.zeros_like(u)) if at_exits else None
    return Packet(_held_at_one(part), leg, across)


def _scatter(phase: AbstractPhase, leg: Leg, across, u: _Draws):
    """A direction drawn from the phase function: its cosine, its components across the layers, and
    how its density moves with the direction before.
    """
    cosine, turn = lax.stop_gradient(leg.cosine), phase.sample_cosine(u.deflection)
    sine = jnp.sqrt(jnp.maximum(1 - cosine * cosine, 0.0))
    aside = jnp.sqrt(jnp.maximum(1 - turn * turn, 0.0))
    new = jnp.clip(deflect(cosine, turn, u.azimuth[0]), -1.0, 1.0)
    new = jnp.where(new < 0, jnp.minimum(new, -1e-12), jnp.maximum(new, 1e-12))
    along = sine * turn - cosine * aside * u.azimuth[0]
    angle = leg.cosine * new + safe_sqrt(1 - leg.cosine * leg.cosine) * along
    ratio = _held_at_one(rayleigh(angle))
    if across is None:
        return new, None, ratio
    x, y = lax.stop_gradient(across)
    length = jnp.sqrt(x * x + y * y)
    upright = length < 1e-6  # any azimuth does
    scale = 1 / jnp.where(upright, 1.0, length)
    x, y = jnp.where(upright, 1.0, x * scale), jnp.where(upright, 0.0, y * scale)
    sideways = aside * u.azimuth[1]
    return new, (x * along - y * sideways, y * along + x * sideways), ratio


def _one_of(parts, u):
    """Which of some parts of a weight is drawn, and the weight that it has then: that of all, and
    it moves as the part does.
    """
    held = [lax.stop_gradient(x) for x in parts]
    total = sum(held[1:], held[0])
    # Less than the sum of all, however it is rounded.
    target = u * total * (1 - jnp.finfo(total.dtype).eps)
    passed, part, chosen = jnp.zeros_like(total), jnp.zeros_like(total), []
    found = jnp.zeros(total.shape, bool)
    for x, h in zip(parts, held, strict=True):
        passed = passed + h
        here = ~found & (target < passed)
        found |= here
        part = part + jnp.where(here, x, 0.0)
        chosen.append(here)
    return chosen, total * _held_at_one(part)


def _held_at_one(x):
    """1 where `x` is positive, with the derivative of its logarithm; else 0."""
    held = lax.stop_gradient(x)
    dark = held <= 0
    return jnp.where(dark, 0.0, x / jnp.where(dark, 1.0, held))
