"""Weighted Monte Carlo: one path for all wavelengths, expected values wherever a rule allows.

Absorption tests, Fresnel coins and each visit to the ABL are replaced by their expectations (inside
the ABL a ray keeps its cosine, so its bounces are a geometric series). Only the way on inside the
stroma is drawn, with one probability for all wavelengths and the ratios carried as weights; Russian
roulette ends paths without bias, and nothing is truncated. The uniforms come from the path's key,
or for the first dimensions from a randomly shifted lattice (quasi-Monte Carlo).
"""

from functools import partial

import jax
import jax.numpy as jnp
from jax import lax

from irisjax.numerics.streams import fold_in_words, uniform
from irisjax.optics.fresnel import fresnel_at
from irisjax.tissue.layers import Layers
from irisjax.transport.analog import cosine_of_turn
from irisjax.transport.process import Process, attenuation, sample_entry, survival

GROUPS = 16
"""Independent replicates, whose scatter is the standard error."""

_LANES = 128  # few: the weights of all wavelengths of all lanes should stay in the cache
_ROULETTE = (
    0.05  # share of its first weight below which a path is played for; above 0.1 tails grow heavy
)
_STEP = 5  # uniforms a stroma step: direction, deflection, azimuth, ABL cosine, way on
_DIMENSIONS = 11  # that come from the lattice: the entry and two steps

# Generating vector exod2_base2_m20 [Cools, Kuo & Nuyens 2006], first components.
_LATTICE = (1, 182667, 469891, 498753, 110745, 446247, 250185, 118627, 245333, 283199, 408519)


def run_paths(
    key, layers: Layers, process: Process, entering, scale, *, log2_paths: int, quasi: bool
):
    """Shares of the light in each of `GROUPS` replicates of 2**log2_paths paths, the first surface
    left out.

    **Returns:** shape (4, GROUPS, wavelengths): reflected, absorbed in ABL, stroma, IPE.
    """
    f = jnp.float32
    n = jax.tree.map(lambda v: v.astype(f), layers.indices)
    depth_abl, depth, albedo, coalbedo = (
        v.astype(f)[:, None]
        for v in (layers.abl_absorption, layers.extinction, layers.albedo, layers.coalbedo)
    )
    paths, a_group = 1 << log2_paths, _LANES // GROUPS
    lane = jnp.arange(_LANES, dtype=jnp.int32)
    first_path = lane % a_group
    group_keys = jax.vmap(lambda g: jax.random.fold_in(key, g))(lane // a_group)
    group_words = jax.random.key_data(group_keys)
    # A count no path reaches keeps the shifts apart from the paths' own keys.
    shifts = jax.vmap(
        lambda k: jax.random.bits(jax.random.fold_in(k, 1 << 31), (len(_LATTICE),), jnp.uint32)
    )(group_keys)
    entering = jnp.asarray(entering, f)

    def mirror(cosine, here, ahead):
        return fresnel_at(cosine, here, ahead)[0]

    def visit_abl(cosine, near, far):
        """Leaves at the far face, or back at the near one, or is absorbed;
        entering with `cosine`.
        """
        t, lost = survival(depth_abl, cosine), attenuation(depth_abl, cosine)
        (f_near, t_near), (f_far, t_far) = (
            fresnel_at(cosine, n.abl, ahead) for ahead in (near, far)
        )
        escape = lost * (1 + t) + t * t * (t_near + f_near * t_far)
        series = jnp.where(escape > 0, 1 / jnp.where(escape > 0, escape, 1.0), 0.0)
        out, back = t * t_far * series, t * t * f_far * t_near * series
        return out, back, jnp.where(escape > 0, lost * (1 + t * f_far) * series, 1.0)

    def draw(i, k0, k1, step, slot):
        """Uniform number `slot` of this step: 0 the entry cosine, 1..5 the step's own."""
        words = fold_in_words(k0, k1, (step * 3 + slot // 2).astype(jnp.uint32))
        bits = words[slot % 2]
        for s in range(3):
            d = s * _STEP + slot
            if quasi and (slot or not s) and d < _DIMENSIONS:
                # Exact modulo 2³²: the lattice has 2**log2_paths points.
                point = (
                    (i.astype(jnp.uint32) * jnp.uint32(_LATTICE[d])) << (32 - log2_paths)
                ) + shifts[:, d]
                bits = jnp.where(step == s, point, bits)
        return uniform(bits >> 9, scale[0])

    def body(state):
        i, next_i, k0, k1, live, step, w, first_weight, down, kept, mu, score = state
        born = ~live & (next_i < paths)
        b0, b1 = fold_in_words(group_words[:, 0], group_words[:, 1], next_i.astype(jnp.uint32))
        k0, k1 = jnp.where(born, b0, k0), jnp.where(born, b1, k1)
        i, next_i = jnp.where(born, next_i, i), jnp.where(born, next_i + a_group, next_i)
        step, live = jnp.where(born, 0, step), live | born
        u = partial(draw, i, k0, k1, step)

        # A new path: through the ABL, in expectation.
        through, back, taken = visit_abl(sample_entry(u(0)), n.aqueous, n.stroma)
        w = jnp.where(born, entering * through, jnp.where(live, w, 0.0))
        first_weight = jnp.where(born, w.mean(0), first_weight)
        down, kept = down | born, kept & ~born

        # A flight through the stroma, and its two outcomes.
        mu = jnp.maximum(jnp.where(kept, mu, sample_entry(u(1))), 1e-12) / scale[2]
        event = w * attenuation(depth, mu)
        passing, scattering = w * survival(depth, mu), event * albedo
        cosine = process.phase_function.sample_cosine(u(2))
        turned = mu * cosine + cosine_of_turn(u(3)) * jnp.sqrt(
            jnp.maximum((1 - mu * mu) * (1 - cosine**2), 0.0)
        )
        turned = jnp.where(down, turned, -turned)
        new = jnp.clip(jnp.abs(turned), 1e-12, 1.0) / scale[2]
        f_pass = (
            jnp.where(down, mirror(mu, n.stroma, n.ipe), mirror(mu, n.stroma, n.abl)) / scale[2]
        )
        into_abl, into_ipe = (
            jnp.where(down, 0.0, 1 - f_pass) * passing,
            jnp.where(down, 1 - f_pass, 0.0) * passing,
        )
        f_up = f_down = turned_share = jnp.ones_like(mu)
        if process.rescatter == "to-interface":
            # The phase functions are even in the cosine: up and down are equally likely whatever
            # came before, so take both; each goes straight to its interface.
            f_up, f_down = mirror(new, n.stroma, n.abl), mirror(new, n.stroma, n.ipe)
            into_abl += 0.5 * scattering * (1 - f_up)
            into_ipe += 0.5 * scattering * (1 - f_down)
            turned_share = 0.5 * (f_up + f_down) / scale[2]
        out, again, lost = visit_abl(sample_entry(u(4)), n.stroma, n.aqueous)
        score = (
            score[0] + into_abl * out + jnp.where(born, entering * back, 0.0),
            score[1] + into_abl * lost + jnp.where(born, entering * taken, 0.0),
            score[2] + event * coalbedo,
            score[3] + into_ipe,
        )

        # One way on: back from the ABL | scattered and still inside | passed and reflected.
        a, b, c = (
            (into_abl * again).mean(0),
            scattering.mean(0) * turned_share,
            passing.mean(0) * f_pass,
        )
        total = a + b + c
        stays = jnp.minimum(1.0, total / (_ROULETTE * first_weight))
        v = u(5) * total / stays
        in_a, in_b = v < a, (v >= a) & (v < a + b)
        dies = ~(v < total)  # also when nothing is left (0/0)
        w = jnp.where(
            in_a, into_abl * again, jnp.where(in_b, scattering * turned_share, passing * f_pass)
        )
        share = jnp.where(in_a, a, jnp.where(in_b, b, c)) * (stays / total)
        w = w / jnp.maximum(share, 1e-37)
        if process.rescatter == "to-interface":
            side = (v - a) * (f_up + f_down) < b * f_up  # reflected at the top: now going down
        else:
            side = turned > 0
        down = jnp.where(in_a, True, jnp.where(in_b, side, ~down))
        mu = jnp.where(in_b, new, mu)
        return i, next_i, k0, k1, live & ~dies, step + 1, w, first_weight, down, ~in_a, mu, score

    zero, no = jnp.zeros((_LANES,), f), jnp.zeros((_LANES,), bool)
    blank = jnp.zeros((depth.size, _LANES), f)
    init = (first_path, first_path, group_words[:, 0], group_words[:, 1], no, first_path * 0)
    init += (blank, zero + 1, no, no, zero + 1, (blank,) * 4)
    out = lax.while_loop(lambda s: jnp.any(s[4] | (s[1] < paths)), body, init)
    return jnp.stack([s.reshape(-1, GROUPS, a_group).sum(-1).T for s in out[-1]]) / paths
