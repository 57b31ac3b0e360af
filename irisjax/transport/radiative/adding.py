"""Radiative transfer with any phase function that a tissue has: a slab by doubling, its interfaces
by a small solve.

The forward peak of scattering counts as unscattered (δ-M), and a BRDF's singly scattered light is
exact (TMS).  [Wiscombe 1977; Nakajima & Tanaka 1988; de Haan, Bosma & Hovenier 1987; Prahl, van
Gemert & Welch 1993]
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from irisjax._types import PRNGKey
from irisjax.numerics import linear
from irisjax.numerics.checks import check_whole
from irisjax.numerics.sharding import laid_out
from irisjax.optics.mixture import PhaseMixture
from irisjax.tissue.layers import Layers
from irisjax.transport.light import Light, beams_of
from irisjax.transport.process import DEPTH_RESOLVED, RadiativeTransfer, survival
from irisjax.transport.radiative.directions import (
    Directions,
    from_outside,
    gauss_nodes,
    roof_of,
)
from irisjax.transport.radiative.doubling import Lines, Medium, Response, respond
from irisjax.transport.radiative.exact import Flux
from irisjax.transport.radiative.expansion import phase_matrices, series_value
from irisjax.transport.radiative.fates import Course, before, course
from irisjax.transport.radiative.orders import single_scattering
from irisjax.transport.radiative.resolution import (
    angles_resolved,
    brdf_resolved,
    moments_for,
    outcome,
)
from irisjax.transport.solution import Absorbed, Solution
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

    def __check_init__(self):
        check_whole("n_angles", self.n_angles, 4)
        if self.n_doublings is not None:
            check_whole("n_doublings", self.n_doublings, 0, 60)

    @classmethod
    def following(cls, anisotropy) -> "AddingDoubling":
        """With as many angles as a BRDF takes of a stroma that scatters with this mean cosine; the
        usual number where it is traced.
        """
        if isinstance(anisotropy, Tracer):
            return cls()
        return cls(max(cls.n_angles, moments_for(float(anisotropy))))

    def prepare(self, layers: Layers, light: Light) -> "AddingDoubling":
        """Return the solver with its number of doublings fixed."""
        if self.n_doublings is not None:
            return self
        return AddingDoubling(self.n_angles, doublings_for(layers))

    @property
    def numbers_per_wavelength(self) -> int:
        """Of a matrix between directions."""
        return self.n_angles**2

    def solve(self, layers: Layers, light: Light, *, key: PRNGKey | None = None) -> Solution:
        """See `AbstractSolver.solve`."""
        n, dtype = layers.indices, layers.extinction.dtype
        nodes = gauss_nodes(layers, self.n_angles)
        outside, power = beams_of(light, max(48, self.n_angles), n, dtype)
        beams = from_outside(layers, outside)
        exits = azimuth = None
        if light.exits is not None:
            exits, azimuth = from_outside(layers, light.exits.cosine), light.exits.azimuth
        doublings = _TRACED if self.n_doublings is None else self.n_doublings
        phase = layers.phase
        if phase is None:
            phase = PhaseMixture(jnp.ones_like(layers.albedo), jnp.zeros_like(layers.albedo))
        flux = laid_out(
            jax.vmap(partial(_one_wavelength, doublings=doublings), (0, 0, 0, 0, *(None,) * 6)),
            layers.extinction,
            *(layers.abl_absorption, layers.stroma_absorption, layers.stroma_scattering, phase),
            *(n, nodes, beams, power, exits, azimuth),
        )
        resolved = (layers.extinction <= 1.001 * _COARSEST * 2.0**doublings).all()
        angles = angles_resolved(layers, phase, self.n_angles, beams.cosine, power)
        if exits is not None:
            angles &= brdf_resolved(layers, phase, self.n_angles)
        return Solution(
            reflectance=flux.reflectance,
            mirrored=flux.mirrored,
            absorbed=Absorbed(abl=flux.abl, stroma=flux.stroma, ipe=flux.ipe),
            standard_error=None,
            total_error=None,
            brdf=flux.brdf,
            brdf_error=None,
            status=outcome(layers, resolved, angles),
        )


def doublings_for(layers: Layers) -> int | None:
    """Doublings needed for concrete layers; `None` for traced ones."""
    if isinstance(layers.extinction, Tracer):
        return None
    depth = np.asarray(layers.extinction)
    # Layers that are not numbers are refused by the status; nothing helps them.
    deepest = depth[np.isfinite(depth)].max(initial=_FIRST)
    return min(60, int(np.ceil(np.log2(max(deepest / _FIRST, 1.0)))))


class Scattered(NamedTuple):
    """Scattered light between the slab's ends: radiance at the nodes `up` at its top and `down` at
    its bottom; `again` what of it roof and floor send back in (2·nodes,); `sent` what the slab
    itself sends along its rows to the top and to the bottom (2, rows).
    """

    up: jax.Array
    down: jax.Array
    again: jax.Array
    sent: jax.Array


def _one_wavelength(
    abl, absorption, scattering, phase, n, nodes, beams, power, exits, azimuth, doublings
):
    count = nodes.cosine.size
    moments, peak = phase.truncated(count)
    scattering = scattering * (1 - peak)
    depth = absorption + scattering
    empty = depth <= 0
    whole = jnp.where(empty, 1.0, depth)
    albedo = jnp.where(empty, 0.0, scattering / whole)
    coalbedo = jnp.where(empty, 1.0, absorption / whole)

    unscattered = before(abl, depth, beams)
    way, seen = course(abl, depth, beams), course(abl, depth, nodes)
    # Of all mirror images of the beams: radiance downwards at the top, upwards at the bottom.
    falling = power * roof_of(abl, beams, from_stroma=False).passed * way.series / beams.cosine
    beamed = jnp.concatenate([falling, falling * way.back])
    rows = nodes.cosine if exits is None else jnp.concatenate([nodes.cosine, exits.cosine])
    lines = Lines(
        rows,
        jnp.concatenate([nodes.cosine, beams.cosine]),
        jnp.concatenate([nodes.weight, jnp.ones_like(beams.cosine)]),
        count,
    )

    orders = range(1 if exits is None else count)
    matrices = phase_matrices(phase, moments, peak, orders, lines)

    def field(taken):
        slab = respond(Medium(depth, albedo, coalbedo, *taken), lines, doublings)
        return slab, _between(slab, beamed, seen, nodes, depth)

    # One order after another: side by side they would fill the memory.
    each = jax.lax.map(field, matrices)
    slab, light = jax.tree.map(lambda x: x[0], each)
    flux = nodes.weight * nodes.cosine
    absorbed = jnp.tile(slab.absorbed[count:], 2) @ beamed
    brdf = None
    if exits is not None:
        leave = course(abl, depth, exits)
        top, bottom = each[1].sent[..., count:].swapaxes(0, 1)
        of = np.arange(count)[:, None]
        cosines = jnp.cos(jnp.asarray(of, azimuth.dtype) * azimuth[None])
        cosines = cosines * jnp.asarray(np.where(of > 0, 2.0, 1.0), azimuth.dtype)
        total = leave.series * (cosines * (top + leave.back[None] * bottom)).sum(0)

        def left_out(cosine):
            return phase.value(cosine) / (1 - peak) - series_value(moments, cosine)

        total += single_scattering(abl, depth, albedo, beams, exits, azimuth, phase=left_out)
        brdf = total * leave.roof.passed * (n.aqueous / n.stroma) ** 2 / (2 * jnp.pi)
    return Flux(
        reflectance=power @ unscattered.reflected + flux @ (light.up * seen.roof.passed),
        mirrored=power @ unscattered.mirrored,
        abl=power @ unscattered.abl + flux @ (light.up * seen.roof.absorbed),
        stroma=absorbed + jnp.tile(slab.absorbed[:count], 2) @ light.again,
        ipe=flux @ (light.down * nodes.bottom[1]) + power @ unscattered.passed,
        brdf=brdf,
    )


def _between(slab: Response, beamed, seen: Course, nodes: Directions, depth) -> Scattered:
    """The scattered light of beams in a slab between its roof and its floor."""
    n = nodes.cosine.size
    roof, floor = nodes.top[0] + seen.roof.reflected, nodes.bottom[0]
    through = survival(depth, nodes.cosine)
    # Rows: to the top, to the bottom. Columns: from above, from below.
    whole = jnp.stack([slab.back, slab.on]), jnp.stack([slab.on, slab.back])
    from_beams = jnp.concatenate([x[..., n:] for x in whole], axis=-1) @ beamed
    operator = jnp.concatenate([x[..., :n] for x in whole], axis=-1)
    # Unscattered from end to end, back and forth, light keeps its direction.
    images = seen.series[None, None] * jnp.stack(
        [jnp.stack([roof, roof * through * floor]), jnp.stack([floor * through * roof, floor])]
    )

    def sent_back(emitted):
        return (images * emitted.reshape(1, 2, n)).sum(1).ravel()

    inner = operator[:, :n].reshape(2 * n, 2, n)
    back = jnp.einsum("rsn,stn->rtn", inner, images).reshape(2 * n, 2 * n)
    emitted = linear.solve(
        jnp.eye(2 * n, dtype=depth.dtype) - back, from_beams[:, :n].reshape(2 * n)
    )
    again = sent_back(emitted)
    top, bottom = emitted.reshape(2, n)
    return Scattered(
        up=seen.series * (top + through * floor * bottom),
        down=seen.series * (bottom + through * roof * top),
        again=again,
        sent=from_beams + operator @ again,
    )
