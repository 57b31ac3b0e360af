"""Weighted Monte Carlo: one path for all wavelengths, expected values wherever a rule allows.

Absorption tests, Fresnel coins and each visit to the ABL are replaced by their expectations (inside
the ABL a ray keeps its cosine, so its bounces are a geometric series). Only the way on inside the
stroma is drawn, with one probability for all wavelengths and the ratios carried as weights; Russian
roulette ends paths without bias, and nothing is truncated. The uniforms come from the path's key,
or for the first dimensions from a randomly shifted lattice (quasi-Monte Carlo).
"""

import math
from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from irisjax.numerics.checks import check_whole
from irisjax.numerics.sharding import laid_out_as, vary_alike
from irisjax.numerics.streams import check_key, fold_in_words, scales, uniform
from irisjax.optics.fresnel import fresnel_at
from irisjax.tissue.indices import RefractiveIndices
from irisjax.tissue.layers import Layers
from irisjax.transport.incidence import first_surface
from irisjax.transport.lanes import cosine_of_turn
from irisjax.transport.pointwise import by_wavelength
from irisjax.transport.process import Ilit, attenuation, sample_entry, survival
from irisjax.transport.series import visit
from irisjax.transport.solution import RESULTS, Absorbed, Solution
from irisjax.transport.solver import AbstractSolver, checked_process

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


class IlitWeighted(AbstractSolver):
    """Expected values in place of absorption and Fresnel tests; needs a `key`.

    Treats ILIT that keeps directions on reflection. Arithmetic is float32; errors come from 16
    replicates.

    - `n_paths`: paths shared by all wavelengths, rounded up to 16·2^k.
    - `quasi`: whether the first dimensions come from a randomly shifted lattice.

    Derivatives, forward and reverse, are unbiased. By depths and pigments they are about as precise
    as the values; by indices they have heavy tails, for Fresnel's coefficients have no finite slope
    at the critical angle: `IlitExact` has those to rounding.
    """

    n_paths: int = eqx.field(static=True)
    quasi: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        check_whole("n_paths", self.n_paths, 1, 2**31)

    def prepare(self, layers: Callable[[], Layers], process) -> "IlitWeighted":
        """Check that the process is one that it treats."""
        if checked_process(self, process, Ilit).perturb_on_reflection:
            raise ValueError(
                "IlitWeighted treats ILIT without perturb_on_reflection; "
                "use MonteCarlo or IlitExact"
            )
        return self

    def solve(
        self,
        layers: Layers,
        process,
        cos_incidence,
        *,
        cos_exit=None,
        azimuth=None,
        key=None,
        rays=None,
    ):
        """See `AbstractSolver.solve`; the same paths serve all wavelengths, so `rays` are not used.

        **Raises:** `ValueError` where a BRDF is asked for.
        """
        self.prepare(lambda: layers, process)
        process = checked_process(self, process, Ilit, layers)
        check_key(key)
        if cos_exit is not None:
            raise ValueError("a BRDF by Monte Carlo needs MonteCarlo")
        dtype = layers.extinction.dtype
        mirrored, entering = first_surface(cos_incidence, layers.indices, dtype)
        log2_paths = max(4, math.ceil(math.log2(max(1, self.n_paths / GROUPS))))
        run = partial(_shares, layers.order, process, log2_paths, self.quasi)
        depths = layers.abl_absorption, layers.stroma_absorption, layers.stroma_scattering
        n = layers.indices
        shared = n.aqueous, n.abl, n.stroma, n.ipe, entering
        groups = laid_out_as(
            layers.extinction,
            3,
            lambda *x: jnp.moveaxis(by_wavelength(run, *x), -1, 0),
            *(key, depths, shared),
        )
        mean = groups.mean(axis=2)
        error = groups[:, 0].std(axis=1, ddof=1) / math.sqrt(GROUPS)
        return Solution(
            reflectance=mean[:, 0],
            mirrored=mirrored * jnp.ones_like(error),
            absorbed=Absorbed(abl=mean[:, 1], stroma=mean[:, 2], ipe=mean[:, 3]),
            standard_error=error,
            total_error=error,
            brdf=None,
            brdf_error=None,
            status=RESULTS.where(layers.valid(), RESULTS.successful, RESULTS.invalid_input),
        )


def _shares(order, process: Ilit, log2_paths: int, quasi: bool, key, depths, shared):
    abl, absorption, scattering = depths
    aqueous, abl_index, stroma, ipe, entering = shared
    indices = RefractiveIndices(aqueous, abl_index, stroma, ipe)
    layers = Layers(abl, absorption, scattering, indices, order)
    groups = run_paths(key, layers, process, entering, scales(), log2_paths=log2_paths, quasi=quasi)
    return groups.astype(layers.extinction.dtype)


def run_paths(key, layers: Layers, process: Ilit, entering, scale, *, log2_paths: int, quasi: bool):
    """Shares of the light in each of `GROUPS` replicates of 2**log2_paths paths, the first surface
    left out.

    **Returns:** shape (4, GROUPS, wavelengths): reflected, absorbed in ABL, stroma, IPE.

    Forward derivatives are unbiased: what is drawn, and with what probability, is held; what a way
    contributes over that probability moves. (Where nothing scatters at any wavelength, ways that
    scatter first are never drawn, and the derivative lacks what they would bring. By the indices of
    two media that nearly agree (ABL and stroma do) it converges slowly: rare paths near their
    critical angle carry it.)
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

    held = lax.stop_gradient

    def mirror(cosine, here, ahead):
        return fresnel_at(cosine, here, ahead)[0]

    def visit_abl(cosine, near, far):
        """The ABL in expectation, for a ray that enters it with `cosine`."""
        t, lost = survival(depth_abl, cosine), attenuation(depth_abl, cosine)
        return visit(t, lost, *(fresnel_at(cosine, n.abl, ahead) for ahead in (near, far)))

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
        first_weight = jnp.where(born, held(w.mean(0)), first_weight)
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
        a, b, c = held(
            (
                (into_abl * again).mean(0),
                scattering.mean(0) * turned_share,
                passing.mean(0) * f_pass,
            )
        )
        total = a + b + c
        stays = jnp.minimum(1.0, total / (_ROULETTE * first_weight))
        v = u(5) * total / stays
        in_a, in_b = v < a, (v >= a) & (v < a + b)
        dies = ~(v < total)  # also when nothing is left (0/0)
        if process.rescatter == "to-interface":
            side = (v - a) * (f_up + f_down) < b * f_up  # reflected at the top: now going down
            # The side is drawn too, with its part in both: what it brings over that is 1, and
            # moves.
            part = jnp.where(side, f_up, f_down) / jnp.maximum(f_up + f_down, 1e-37)
            turned_share = turned_share * (part / jnp.maximum(held(part), 1e-37))
        else:
            side = turned > 0
        w = jnp.where(
            in_a, into_abl * again, jnp.where(in_b, scattering * turned_share, passing * f_pass)
        )
        share = jnp.where(in_a, a, jnp.where(in_b, b, c)) * (stays / total)
        w = w / jnp.maximum(share, 1e-37)
        down = jnp.where(in_a, True, jnp.where(in_b, side, ~down))
        mu = jnp.where(in_b, new, mu)
        return i, next_i, k0, k1, live & ~dies, step + 1, w, first_weight, down, ~in_a, mu, score

    zero, no = jnp.zeros((_LANES,), f), jnp.zeros((_LANES,), bool)
    blank = jnp.zeros((depth.size, _LANES), f)
    init = (first_path, first_path, group_words[:, 0], group_words[:, 1], no, first_path * 0)
    init += (blank, zero + 1, no, no, zero + 1, (blank,) * 4)
    init = vary_alike(init, depth_abl, depth, albedo, coalbedo, n, entering)
    out = lax.while_loop(lambda s: jnp.any(s[4] | (s[1] < paths)), body, init)
    return jnp.stack([s.reshape(-1, GROUPS, a_group).sum(-1).T for s in out[-1]]) / paths
