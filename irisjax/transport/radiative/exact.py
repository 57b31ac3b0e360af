"""Depth-resolved transport: scalar radiative transfer in the same layers, solved as an integral
equation.

Rayleigh's phase function has rank two (azimuth-averaged), so the unknowns are not radiances but a
few moments of them over angle, as functions of depth: polynomials of low order in depth (Galerkin).
Given the moments, each direction is a scalar problem, since interfaces keep a ray's Snell
invariant: all mirror images are one geometric series. The cost is linear in angles.  [Chandrasekhar
1960, Sections 10, 16]
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer

from irisjax._types import PRNGKey
from irisjax.numerics import linear
from irisjax.numerics.checks import check_whole
from irisjax.numerics.sharding import laid_out
from irisjax.tissue.layers import Layers
from irisjax.transport.light import Light, beams_of
from irisjax.transport.process import DEPTH_RESOLVED, RadiativeTransfer
from irisjax.transport.radiative.balance import energy_balance, solve_balanced
from irisjax.transport.radiative.directions import (
    MODES,
    from_outside,
    quadrature_nodes,
    roof_of,
    split,
)
from irisjax.transport.radiative.fates import before
from irisjax.transport.radiative.polarised import exact as polarised
from irisjax.transport.radiative.resolution import panels_for, seen_depth, status_of, steepness
from irisjax.transport.radiative.slab import Ends, Slab
from irisjax.transport.solution import Absorbed, Solution
from irisjax.transport.solver import AbstractSolver, check_process, check_rayleigh


class Flux(NamedTuple):
    """Where the light of one wavelength goes."""

    reflectance: jax.Array
    mirrored: jax.Array
    abl: jax.Array
    stroma: jax.Array
    ipe: jax.Array
    brdf: jax.Array | None


class RadiativeExact(AbstractSolver):
    """Deterministic solver of radiative transfer in the iris to 1e-7 relative, scalar or polarised.

    The part of `reflectance` that is mirrored by the inner interfaces without scattering is not in
    the BRDF.

    Attributes:
        n_angles: Quadrature nodes over the cosine.
        n_depths: Polynomials in depth, per panel.
        n_panels: Panels in depth; `None` takes as many as the optical depth requires where it is
            known, and one while tracing: enough for every iris of LB06. Opaque slabs and a stroma
            3 mm thick take 5. Where the panels are too few, known or traced, the status is
            `under_resolved`.
        process: `DEPTH_RESOLVED` or `POLARISED`.
    """

    n_angles: int = eqx.field(static=True, default=40)
    n_depths: int = eqx.field(static=True, default=8)
    n_panels: int | None = eqx.field(static=True, default=None)
    process: RadiativeTransfer = eqx.field(default=DEPTH_RESOLVED, kw_only=True)

    def __check_init__(self):
        check_process(self, RadiativeTransfer)
        for name, low in (("n_angles", 4), ("n_depths", 2), ("n_panels", 1)):
            value = getattr(self, name)
            if value is not None:
                check_whole(name, value, low)

    def prepare(self, layers: Layers, light: Light) -> "RadiativeExact":
        """Return the solver with its number of panels fixed."""
        if self.n_panels is not None:
            return self
        known = not any(isinstance(x, Tracer) for x in jax.tree.leaves(light))
        slant = _steepness(layers, light) if known else 1.0
        panels = panels_for(layers, self.n_depths, slant)
        return RadiativeExact(self.n_angles, self.n_depths, panels, process=self.process)

    def solve(self, layers: Layers, light: Light, *, key: PRNGKey | None = None) -> Solution:
        """See `AbstractSolver.solve`."""
        check_rayleigh(self, layers)
        solve = polarised.solve if self.process.polarised else _solve
        return solve(
            layers,
            light,
            n_angles=self.n_angles,
            n_depths=self.n_depths,
            n_panels=self.n_panels or 1,
        )


# One program: operation by operation it takes a tenth of a spectrum's time.
_steepness = jax.jit(steepness)


def _solve(
    layers: Layers, light: Light, *, n_angles: int, n_depths: int, n_panels: int
) -> Solution:
    n, dtype = layers.indices, layers.extinction.dtype
    nodes = quadrature_nodes(layers, n_angles)
    outside, power = beams_of(light, 2 * n_angles, n, dtype)
    beams = from_outside(layers, outside)
    exits = azimuth = None
    if light.exits is not None:
        exits, azimuth = from_outside(layers, light.exits.cosine), light.exits.azimuth

    one = partial(_one_wavelength, n_depths=n_depths, n_panels=n_panels)
    flux = laid_out(
        jax.vmap(one, in_axes=(0, 0, 0, 0, *(None,) * 6)),
        layers.extinction,
        *(layers.abl_absorption, layers.extinction, layers.albedo, layers.coalbedo),
        *(n, nodes, beams, power, exits, azimuth),
    )
    return Solution(
        reflectance=flux.reflectance,
        mirrored=flux.mirrored,
        absorbed=Absorbed(abl=flux.abl, stroma=flux.stroma, ipe=flux.ipe),
        standard_error=None,
        total_error=None,
        brdf=flux.brdf,
        brdf_error=None,
        status=status_of(layers, n_depths, n_panels, steepness(layers, light)),
    )


def _one_wavelength(
    abl, depth, albedo, coalbedo, n, nodes, beams, power, exits, azimuth, n_depths, n_panels
):
    depth = seen_depth(depth, coalbedo)
    slab = Slab(depth, n_depths, n_panels)
    roof_in = roof_of(abl, beams, from_stroma=False)
    entering = power * roof_in.passed
    # All directions together, so that one fused loop serves them.
    sets = [d for d in (nodes, beams, exits) if d is not None]
    everywhere = jax.tree.map(lambda *x: jnp.concatenate(x), *sets)
    roof = roof_of(abl, everywhere, from_stroma=True)
    meets = Ends(
        everywhere.top[0] + roof.reflected, roof.passed + roof.absorbed, *everywhere.bottom
    )
    roofs = split(roof, sets)
    angle, beam, *exit_ = split(slab.bounded(everywhere.cosine, meets), sets)
    roof_out = roofs[0]

    unscattered = before(abl, depth, beams)
    lost_beam = power @ unscattered.lost
    moments = {}
    leaving_exit = 0.0
    for mode in MODES if exits is not None else MODES[:1]:
        strength = albedo * jnp.asarray(mode.strength, depth.dtype)
        f_nodes, f_beams = mode.functions(nodes.cosine), mode.functions(beams.cosine)
        operator = slab.moments(angle, nodes.weight, f_nodes, mode.parity)
        driving = slab.driving(beam, f_beams * (entering / beams.cosine)[None, :], mode.parity)
        size = operator.shape[0]
        each = jnp.repeat(strength, size // strength.size)
        system = jnp.eye(size, dtype=depth.dtype) - operator * each[None, :]
        right = driving.reshape(size)
        if mode.order == 0:
            balance = energy_balance(slab, strength, f_nodes, angle, nodes, roof_out, coalbedo)
            solution = solve_balanced(slab, system, right[:, None], balance, lost_beam[None])
        else:
            solution = linear.solve(system, right)
        moments[mode.order] = solution.reshape(driving.shape)
        if exits is not None:
            source = (strength[:, None] * mode.functions(exits.cosine)).T @ moments[mode.order]
            up_top, _ = slab.leaving(exit_[0], source, mode.parity)
            leaving_exit += up_top * jnp.cos(mode.order * azimuth) * (1 if mode.order == 0 else 2)

    mode = MODES[0]
    strength = albedo * jnp.asarray(mode.strength, depth.dtype)
    source = (strength[:, None] * mode.functions(nodes.cosine)).T @ moments[0]
    up_top, down_bottom = slab.leaving(angle, source, mode.parity)
    flux = nodes.weight * nodes.cosine
    brdf = None
    if exits is not None:
        brdf = leaving_exit * roofs[2].passed * (n.aqueous / n.stroma) ** 2 / (2 * jnp.pi)
    return Flux(
        reflectance=power @ unscattered.reflected + flux @ (up_top * roof_out.passed),
        mirrored=power @ unscattered.mirrored,
        abl=power @ unscattered.abl + flux @ (up_top * roof_out.absorbed),
        stroma=coalbedo * (slab.widths @ moments[0][0].reshape(n_panels, n_depths)[:, 0]),
        ipe=flux @ (down_bottom * nodes.bottom[1]) + power @ unscattered.passed,
        brdf=brdf,
    )
