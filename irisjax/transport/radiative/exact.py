"""Depth-resolved transport: scalar radiative transfer in the same layers, solved as an integral
equation.

Rayleigh's phase function has rank two (azimuth-averaged), so the unknowns are not radiances but a
few moments of them over angle, as functions of depth: polynomials of low order in depth (Galerkin).
Given the moments, each direction is a scalar problem, since interfaces keep a ray's Snell
invariant: all mirror images are one geometric series. The cost is linear in angles.  [Chandrasekhar
1960, Sections 10, 16]
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from irisjax.numerics import linear as elimination
from irisjax.numerics.quadrature import conserving, cosine_rule, gauss_legendre
from irisjax.optics.fresnel import critical_cosine_squared, fresnel, refract, refracted
from irisjax.tissue.layers import Layers
from irisjax.transport.process import attenuation, survival
from irisjax.transport.radiative.slab import Bounded, Ends, Slab, fractions
from irisjax.transport.solution import RESULTS, Absorbed, Solution

# `_coarseness` up to which reflectance is good to 1e-7, and to 1e-6.
_PLANNED, _RESOLVED = 0.47, 1.0
_MOST_PANELS = 32  # optical depths of 1e9


class Mode(NamedTuple):
    """One azimuthal order of Rayleigh's phase function: J(μ) = ω Σ_k strength_k f_k(μ) ∫ f_k I
    dμ'.
    """

    order: int
    parity: int
    strength: tuple[float, ...]

    def functions(self, mu):
        """f_k at cosines `mu` > 0, shape (rank, angles); at −μ they take the sign `parity`."""
        sine_squared = jnp.maximum(1 - mu * mu, 0.0)
        if self.order == 0:
            return jnp.stack([jnp.ones_like(mu), 1.5 * mu * mu - 0.5])
        if self.order == 1:
            return (mu * jnp.sqrt(sine_squared))[None]
        return sine_squared[None]


MODES = (Mode(0, 1, (0.5, 0.25)), Mode(1, -1, (0.375,)), Mode(2, 1, (0.09375,)))


class Directions(NamedTuple):
    """Directions in the stroma with what each meets at the interfaces, all of shape (angles,)."""

    cosine: jax.Array
    weight: jax.Array
    abl_cosine: jax.Array
    top: tuple[jax.Array, jax.Array]  # stroma/ABL
    surface: tuple[jax.Array, jax.Array]  # ABL/aqueous
    bottom: tuple[jax.Array, jax.Array]  # stroma/IPE


class Roof(NamedTuple):
    """The ABL seen from the stroma, or from the aqueous humour: shares of the flux that falls on
    it.
    """

    reflected: jax.Array
    passed: jax.Array
    absorbed: jax.Array


class Flux(NamedTuple):
    """Where the light of one wavelength goes."""

    reflectance: jax.Array
    mirrored: jax.Array
    abl: jax.Array
    stroma: jax.Array
    ipe: jax.Array
    brdf: jax.Array | None


def panels_for(layers: Layers, n_depths: int) -> int | None:
    """Depth panels needed for concrete layers; `None` for traced ones."""
    if isinstance(layers.extinction, Tracer) or isinstance(layers.albedo, Tracer):
        return None
    panels, coarseness = 1, np.asarray(_coarseness(layers, n_depths, 1))
    # Layers that are not numbers are refused by the status; no panels help them.
    while panels < _MOST_PANELS and coarseness[np.isfinite(coarseness)].max(initial=0.0) > _PLANNED:
        panels += 1
        coarseness = np.asarray(_coarseness(layers, n_depths, panels))
    return panels


def _coarseness(layers: Layers, n_depths: int, n_panels: int):
    """How coarse the panels are; the relative error of reflectance is about 8e-7 of its cube.

    Fitted to a scan over depths 0.1 to 32, albedos 0.003 to 1, 6 to 10 polynomials
    (test_depth_resolved.py checks it at other points). Light scattered twice makes the error, hence
    the albedo's square.
    """
    outer = layers.extinction * (fractions(n_panels)[0] * 8 / n_depths)
    # The second is what it takes to follow the beam itself where next to nothing scatters.
    return jnp.maximum(
        jnp.cbrt(layers.albedo) ** 2 * outer * (8 / n_depths) ** (4 / 3), outer**4 / 406
    )


def solve(
    layers: Layers, cos_incidence, cos_exit, azimuth, *, n_angles: int, n_depths: int, n_panels: int
):
    """Radiative transfer in the iris; see `Solution`.

    The part of `reflectance` that is mirrored by the inner interfaces without scattering is not in
    the BRDF.
    """
    n, dtype = layers.indices, layers.extinction.dtype
    nodes = _nodes(layers, n_angles)
    if isinstance(cos_incidence, str):
        x, w = gauss_legendre(max(16, n_angles // 2))
        outside, power = jnp.asarray(x, dtype), jnp.asarray(2 * x * w, dtype)
    else:
        outside, power = jnp.atleast_1d(jnp.asarray(cos_incidence, dtype)), jnp.ones(1, dtype)
    beams = _entering(layers, outside)
    exits = None if cos_exit is None else _entering(layers, jnp.asarray(cos_exit, dtype))
    if exits is not None and azimuth is None:
        azimuth = jnp.zeros_like(exits.cosine)

    def one(abl, depth, albedo, coalbedo):
        return _one_wavelength(
            abl, depth, albedo, coalbedo, n, nodes, beams, power, exits, azimuth, n_depths, n_panels
        )

    flux = jax.vmap(one)(layers.abl_absorption, layers.extinction, layers.albedo, layers.coalbedo)
    resolved = (_coarseness(layers, n_depths, n_panels) <= _RESOLVED).all()
    return Solution(
        reflectance=flux.reflectance,
        mirrored=flux.mirrored,
        absorbed=Absorbed(abl=flux.abl, stroma=flux.stroma, ipe=flux.ipe),
        standard_error=None,
        brdf=flux.brdf,
        brdf_error=None,
        result=RESULTS.where(
            layers.valid(),
            RESULTS.where(
                resolved,
                RESULTS.where(_conditioned(layers), RESULTS.successful, RESULTS.ill_conditioned),
                RESULTS.under_resolved,
            ),
            RESULTS.invalid_input,
        ),
    )


def _conditioned(layers: Layers):
    """Whether the balance of many scatterings survives rounding; its condition is 1/(1 − ω + 1/τ²).

    At the limit float32 is wrong by 2e-4 of the light; float64 is never near it.
    """
    tau = jnp.maximum(layers.extinction, 1.0)
    return (layers.coalbedo + 1 / (tau * tau) >= 10 * jnp.finfo(tau.dtype).eps).all()


def _nodes(layers: Layers, n_angles: int) -> Directions:
    n, order = layers.indices, layers.order
    neighbours = (n.aqueous, n.abl, n.ipe)
    rule = cosine_rule(
        jnp.stack([critical_cosine_squared(n.stroma, k) for k in neighbours]),
        (order.stroma_over_aqueous, order.stroma_over_abl, order.stroma_over_ipe),
        n_angles,
    )
    rule = conserving(rule)
    cosines = [refracted(rule, i, n.stroma, k) for i, k in enumerate(neighbours)]
    return _directions(layers, rule.cosine, rule.weight, *cosines)


def _entering(layers: Layers, outside) -> Directions:
    """Directions with given cosines in the aqueous humour; they carry no quadrature weight."""
    n = layers.indices
    abl, stroma = (refract(outside, n.aqueous, k) for k in (n.abl, n.stroma))
    ipe = refract(outside, n.aqueous, n.ipe)
    return _directions(layers, stroma, jnp.zeros_like(outside), outside, abl, ipe)


def _directions(layers: Layers, stroma, weight, aqueous, abl, ipe) -> Directions:
    n = layers.indices
    return Directions(
        # A beam that cannot enter has cosine 0 and no power; keep the exponentials finite.
        cosine=jnp.where(stroma > 0, stroma, 1.0),
        weight=weight,
        abl_cosine=jnp.where(abl > 0, abl, 1.0),
        top=fresnel(stroma, abl, n.stroma, n.abl),
        surface=fresnel(abl, aqueous, n.abl, n.aqueous),
        bottom=fresnel(stroma, ipe, n.stroma, n.ipe),
    )


def _roof(depth, d: Directions, *, from_stroma: bool) -> Roof:
    near, far = (d.top, d.surface) if from_stroma else (d.surface, d.top)
    t, lost = survival(depth, d.abl_cosine), attenuation(depth, d.abl_cosine)
    escape = lost * (1 + t) + t * t * (near[1] + near[0] * far[1])
    sealed = escape <= 0
    inside = jnp.where(sealed, 0.0, near[1] / jnp.where(sealed, 1.0, escape))
    return Roof(
        reflected=inside * t * t * far[0] * near[1],  # beyond the first interface's own reflectance
        passed=inside * t * far[1],
        absorbed=inside * lost * (1 + t * far[0]),
    )


def _one_wavelength(
    abl, depth, albedo, coalbedo, n, nodes, beams, power, exits, azimuth, n_depths, n_panels
):
    slab = Slab(depth, n_depths, n_panels)
    roof_in = _roof(abl, beams, from_stroma=False)
    entering = power * roof_in.passed
    # All directions together, so that one fused loop serves them.
    sets = [d for d in (nodes, beams, exits) if d is not None]
    everywhere = jax.tree.map(lambda *x: jnp.concatenate(x), *sets)
    roof = _roof(abl, everywhere, from_stroma=True)
    meets = Ends(
        everywhere.top[0] + roof.reflected, roof.passed + roof.absorbed, *everywhere.bottom
    )
    roofs = _split(roof, sets)
    (angle, beam, *exit_), (roof_out, roof_beam) = (
        _split(slab.bounded(everywhere.cosine, meets), sets),
        roofs[:2],
    )

    # What of the beam is absorbed or scattered on its way between the slab's ends.
    along = beam.series * attenuation(depth, beams.cosine) * (1 + beam.through * beam.floor)
    lost_beam = entering @ along
    moments = {}
    leaving_exit = 0.0
    for mode in MODES if exits is not None else MODES[:1]:
        strength = albedo * jnp.asarray(mode.strength, depth.dtype)
        f_nodes, f_beams = mode.functions(nodes.cosine), mode.functions(beams.cosine)
        operator = slab.moments(angle, nodes.weight, f_nodes, mode.parity)
        driving = slab.driving(beam, f_beams * (entering / beams.cosine), mode.parity)
        size = operator.shape[0]
        system = jnp.eye(size, dtype=depth.dtype) - operator * jnp.repeat(
            strength, size // strength.size
        )
        right = driving.reshape(size)
        if mode.order == 0:
            balance = _energy_balance(slab, strength, f_nodes, angle, nodes, roof_out, coalbedo)
            solution = _solve_balanced(slab, system, right, balance, lost_beam)
        else:
            solution = elimination.solve(system, right)
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
    # What no one scatters: the beam mirrored between the slab's ends.
    beam_down = entering * beam.series
    beam_bottom = beam_down * beam.through
    beam_top = beam_bottom * beams.bottom[0] * beam.through
    brdf = None
    if exits is not None:
        brdf = leaving_exit * roofs[2].passed * (n.aqueous / n.stroma) ** 2 / (2 * jnp.pi)
    return Flux(
        reflectance=power @ roof_in.reflected
        + flux @ (up_top * roof_out.passed)
        + beam_top @ roof_beam.passed,
        mirrored=power @ beams.surface[0],
        abl=power @ roof_in.absorbed
        + flux @ (up_top * roof_out.absorbed)
        + beam_top @ roof_beam.absorbed,
        stroma=coalbedo * (slab.widths @ moments[0][0].reshape(n_panels, n_depths)[:, 0]),
        ipe=flux @ (down_bottom * nodes.bottom[1]) + beam_bottom @ beams.bottom[1],
        brdf=brdf,
    )


def _split(tree, sets):
    """What belongs to each set of directions, of arrays over all of them."""
    ends = np.cumsum([d.cosine.size for d in sets])[:-1].tolist()
    leaves, structure = jax.tree.flatten(tree)
    return [
        jax.tree.unflatten(structure, x)
        for x in zip(*(jnp.split(x, ends, axis=-1) for x in leaves), strict=True)
    ]


def _energy_balance(slab, strength, f, b: Bounded, d: Directions, roof: Roof, coalbedo):
    """What each unknown takes from the light in the slab: absorbed by it, or sent out of it."""
    top, bottom = slab.leaving_each(b, 1)
    flux = d.weight * d.cosine
    leaving = (flux * f) @ (top * (roof.passed + roof.absorbed) + bottom * d.bottom[1]).T
    return (strength[:, None] * leaving).at[0, :: slab.n_depths].add(coalbedo * slab.widths).ravel()


def _solve_balanced(slab, system, right, balance, lost_beam):
    """Solve with the slab's balance of energy, balance·x = lost_beam, in place of one row.

    The balance is a sum of the rows, so nothing changes mathematically; in a thick slab that hardly
    absorbs, the rows' own sum would be lost in rounding. What rounding is left is scaled away.
    """
    empty = slab.depth <= 0
    scale = 1 / jnp.where(empty, 1.0, slab.depth)
    which = slab.n_panels // 2 * slab.n_depths  # the mean over the thickest panel
    system = system.at[which].set(jnp.where(empty, system[which], balance * scale))
    right = right.at[which].set(jnp.where(empty, right[which], lost_beam * scale))
    # Eliminated last, where a small pivot is the small loss of light that it stands for.
    order = np.append(np.delete(np.arange(right.size), which), which)
    x = elimination.solve(system[order][:, order], right[order])[np.argsort(order)]
    spent = balance @ x
    dark = spent <= 0
    return x * jnp.where(dark, 1.0, lost_beam / jnp.where(dark, 1.0, spent))
