"""Radiative transfer with any phase function that a tissue has: a slab by doubling, its interfaces
by a small solve.

The forward peak of scattering counts as unscattered (δ-M), and a BRDF's singly scattered light is
exact (TMS).  [Wiscombe 1977; Nakajima & Tanaka 1988; de Haan, Bosma & Hovenier 1987; Prahl, van
Gemert & Welch 1993]
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from irisjax._types import PRNGKey, Real
from irisjax.numerics import linear
from irisjax.numerics.checks import check_whole, is_known
from irisjax.numerics.precision import full_precision
from irisjax.numerics.roots import share_of
from irisjax.numerics.sharding import call_with_layout
from irisjax.optics.mixture import PhaseMixture
from irisjax.tissue.layers import Layers
from irisjax.transport.light import Light
from irisjax.transport.process import DEPTH_RESOLVED, RadiativeTransfer, survival
from irisjax.transport.radiative import resolution
from irisjax.transport.radiative.directions import (
    BeamsAndExits,
    Ordinates,
    beams_and_exits,
    boundaries,
    gauss_nodes,
    over_epithelium,
)
from irisjax.transport.radiative.doubling import Lines, Medium, Response, slab_response
from irisjax.transport.radiative.expansion import phase_matrices, series_value
from irisjax.transport.radiative.orders import (
    AngularProfile,
    angular_profile,
    single_scattering,
    unscattered_beam,
    with_scattered,
)
from irisjax.transport.solution import Flux, Solution
from irisjax.transport.solver import AbstractSolver

_FIRST = 0.025  # optical depth of the first layer that is chosen: 2e-5 of reflectance, grazing 2e-4
_COARSEST = 0.125  # of one that is allowed: 5e-4 under LB06's indices, grazing 2e-3
_TRACED = 10  # doublings where the depth is not known: 128 deep


class AddingDoubling(AbstractSolver):
    """Deterministic solver of scalar radiative transfer with any phase function of the stroma.

    Attributes:
        n_angles: Quadrature nodes over the cosine; as many moments of the phase function are kept.
            Where they leave an estimated error of 5e-3 or more in the reflectance, or in the BRDF
            if exits are requested, since the slab scatters too sharply, the status is
            `too_few_angles`.
        n_doublings: How often the slab is doubled from its first layer; `None` takes as many as the
            optical depth requires where it is known, and 10 while tracing: enough for depths of
            128. Where the first layer is deeper than 0.125, known or traced, the status is
            `under_resolved`.
        process: `DEPTH_RESOLVED`.
    """

    process: RadiativeTransfer = eqx.field(default=DEPTH_RESOLVED, init=False)
    n_angles: int = eqx.field(static=True, default=32)
    n_doublings: int | None = eqx.field(static=True, default=None)

    def __check_init__(self) -> None:
        check_whole("n_angles", self.n_angles, 4)
        if self.n_doublings is not None:
            check_whole("n_doublings", self.n_doublings, 0, 60)

    @classmethod
    def following(cls, anisotropy: Real) -> "AddingDoubling":
        """Make a solver with enough angles for a BRDF of a stroma that scatters with this mean
        cosine; the usual number if it is traced.
        """
        if not is_known(anisotropy):
            return cls()
        return cls(max(cls.n_angles, resolution.moments_for(float(anisotropy))))

    def prepare(self, layers: Layers, light: Light) -> "AddingDoubling":
        if self.n_doublings is not None or not is_known(layers.extinction):
            return self
        depth = np.asarray(layers.extinction)
        # Layers that are not numbers are refused by the status; nothing helps them.
        deepest = depth[np.isfinite(depth)].max(initial=_FIRST)
        doublings = min(60, int(np.ceil(np.log2(max(deepest / _FIRST, 1.0)))))
        return AddingDoubling(self.n_angles, doublings)

    @property
    def numbers_per_wavelength(self) -> int:
        return self.n_angles**2

    @full_precision
    def solve(self, layers: Layers, light: Light, *, key: PRNGKey | None = None) -> Solution:
        nodes = gauss_nodes(layers, self.n_angles)
        rays = beams_and_exits(layers, light, max(48, self.n_angles))
        doublings = _TRACED if self.n_doublings is None else self.n_doublings
        phase = layers.phase
        if phase is None:
            phase = PhaseMixture(jnp.ones_like(layers.albedo), jnp.zeros_like(layers.albedo))
        flux = call_with_layout(
            jax.vmap(partial(_one_wavelength, doublings=doublings), (0, 0, 0, 0, 0, None, None)),
            layers.extinction,
            *(layers.abl_absorption, layers.stroma_absorption, layers.stroma_scattering, phase),
            *(layers.ipe_absorption, nodes, rays),
        )
        resolved = (layers.extinction <= 1.001 * _COARSEST * 2.0**doublings).all()
        angles = resolution.angles_resolved(
            layers, phase, self.n_angles, rays.beams.cosine, rays.power
        )
        if rays.exits is not None:
            angles &= resolution.brdf_resolved(layers, phase, self.n_angles)
        return flux.solution(resolution.status_of(layers, resolved, angles))


def _one_wavelength(
    abl, absorption, scattering, phase, ipe, nodes, rays: BeamsAndExits, *, doublings: int
) -> Flux:
    power = rays.power
    nodes, beams, exits = (over_epithelium(ipe, d) for d in (nodes, rays.beams, rays.exits))
    count = nodes.cosine.size
    moments, peak = phase.truncated(count)
    scattering = scattering * (1 - peak)
    depth = absorption + scattering
    albedo, coalbedo = share_of(scattering, depth, 0.0), share_of(absorption, depth, 1.0)
    incident, profile = (angular_profile(abl, depth, d) for d in (beams, nodes))
    # Of all mirror images of the beams: radiance downwards at the top, upwards at the bottom.
    unscattered = unscattered_beam(abl, depth, beams)
    downward = power * unscattered.entered * incident.series / beams.cosine
    radiance = jnp.concatenate([downward, downward * incident.back])
    lines = Lines(
        nodes.cosine if exits is None else jnp.concatenate([nodes.cosine, exits.cosine]),
        jnp.concatenate([nodes.cosine, beams.cosine]),
        jnp.concatenate([nodes.weight, jnp.ones_like(beams.cosine)]),
        count,
    )
    orders = range(1 if exits is None else count)
    matrices = phase_matrices(phase, moments, peak, orders, lines)

    def solve_order(pair):
        slab = slab_response(Medium(depth, albedo, coalbedo, *pair), lines, doublings)
        return slab.absorbed, _between(slab, radiance, profile, nodes, depth)

    # One order after another: side by side they would fill the memory.
    fields = jax.lax.map(solve_order, matrices)
    absorbed, (up, down, inward, _) = jax.tree.map(lambda x: x[0], fields)
    brdf = None
    if exits is not None:
        leave = angular_profile(abl, depth, exits)
        top, bottom = fields[1][3][..., count:].swapaxes(0, 1)
        order = np.arange(count)[:, None]
        cosines = jnp.cos(jnp.asarray(order, rays.azimuth.dtype) * rays.azimuth[None])
        cosines = cosines * jnp.asarray(np.where(order > 0, 2.0, 1.0), rays.azimuth.dtype)
        total = leave.series * (cosines * (top + leave.back[None] * bottom)).sum(0)

        def residual(cosine):
            return phase.value(cosine) / (1 - peak) - series_value(moments, cosine)

        total += single_scattering(abl, depth, albedo, beams, exits, rays.azimuth, residual)
        brdf = total * leave.abl.passed * rays.to_brdf
    direct = jnp.tile(absorbed[count:], 2) @ radiance
    stroma = direct + jnp.tile(absorbed[:count], 2) @ inward
    flux = with_scattered(unscattered.total(power), nodes, profile.abl, up, down, stroma)
    return flux._replace(brdf=brdf)


def _between(slab: Response, radiance, profile: AngularProfile, nodes: Ordinates, depth):
    """Scattered light of beams in a slab between its boundaries.

    Returns the radiance at the nodes, up at its top and down at its bottom; the radiance that the
    boundaries send back in (2·nodes,); and that which the slab itself sends along its rows to the
    top and to the bottom (2, rows).
    """
    n, (r, t, _) = nodes.cosine.size, slab
    upper, lower = (share[0] for share in boundaries(profile.abl, nodes))
    through = survival(depth, nodes.cosine)
    # Rows: to the top, to the bottom. Columns: from above, from below.
    blocks = jnp.stack([r, t]), jnp.stack([t, r])
    from_beams = jnp.concatenate([x[..., n:] for x in blocks], axis=-1) @ radiance
    operator = jnp.concatenate([x[..., :n] for x in blocks], axis=-1)
    # Unscattered from end to end, back and forth, light keeps its direction.
    images = profile.series[None, None] * jnp.stack(
        [jnp.stack([upper, upper * through * lower]), jnp.stack([lower * through * upper, lower])]
    )

    inner = operator[:, :n].reshape(2 * n, 2, n)
    feedback = jnp.einsum("rsn,stn->rtn", inner, images).reshape(2 * n, 2 * n)
    identity = jnp.eye(2 * n, dtype=depth.dtype)
    emission = linear.solve(identity - feedback, from_beams[:, :n].reshape(2 * n))
    inward = (images * emission.reshape(1, 2, n)).sum(1).ravel()
    top, bottom = emission.reshape(2, n)
    up = profile.series * (top + through * lower * bottom)
    down = profile.series * (bottom + through * upper * top)
    return up, down, inward, from_beams + operator @ inward
