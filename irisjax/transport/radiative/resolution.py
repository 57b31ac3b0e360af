"""Tests of whether depth polynomials, angles and precision suffice for some layers."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from irisjax._types import Real
from irisjax.numerics.checks import is_known
from irisjax.optics.fresnel import refract
from irisjax.optics.mixture import PhaseMixture
from irisjax.tissue.layers import Layers
from irisjax.transport.light import Light
from irisjax.transport.radiative.slab import fractions
from irisjax.transport.solution import RESULTS, outcome

# `_coarseness` up to which reflectance is good to 1e-7.
_RESOLVED = 0.47
_STEEP = 0.25  # cosine up to which directions need no panels of their own
_SHARP = 5e-3  # `_angular_error` up to which there are enough angles
_MOST_PANELS = 32  # optical depths of 1e9
_DARK = 36.0  # optical depth behind which less than rounding is left
_OPAQUE = 18.5  # optical depth of an ABL behind which less than 1e-8 is left


def panels_for(layers: Layers, n_depths: int, slant: Real) -> int | None:
    """Depth panels needed for concrete layers of such a `steepness`; `None` for traced ones."""
    if not is_known(layers.extinction, layers.albedo, slant):
        return None
    for panels in range(1, _MOST_PANELS):
        coarseness = np.asarray(_coarseness(layers, n_depths, panels, slant))
        # Layers that are not numbers are refused by the status; no panels help them.
        if coarseness[np.isfinite(coarseness)].max(initial=0.0) <= _RESOLVED:
            return panels
    return _MOST_PANELS


def effective_depth(extinction: jax.Array, coalbedo: jax.Array) -> jax.Array:
    """Return the optical depth of a slab down to where it is dark: all of it, unless it is opaque.

    Light deep in a slab decays faster than e^{−τ√(1 − ω)}.
    """
    return jnp.minimum(extinction, jax.lax.stop_gradient(_DARK / jnp.sqrt(coalbedo)))


def steepness(layers: Layers, light: Light) -> jax.Array:
    """Factor, 1 or more, by which sources change faster in depth than those of light at a cosine of
    0.25 in the stroma, because a beam or an exit is nearer to grazing.

    It is 1 in LB06's stroma, which is denser than the aqueous humour, and for diffuse light, little
    of which is grazing.
    """
    n, steep = layers.indices, jnp.ones((), layers.extinction.dtype)
    for outside in (light.cosine, None if light.exits is None else light.exits.cosine):
        if outside is None:
            continue
        inside = refract(jnp.asarray(outside, steep.dtype), n.aqueous, n.stroma)
        # What is mirrored totally does not come in.
        enters = inside > 0
        slant = jnp.where(enters, _STEEP / jnp.where(enters, inside, 1.0), 1.0)
        steep = jnp.maximum(steep, slant.max())
    return steep


def _coarseness(layers: Layers, n_depths: int, n_panels: int, slant: Real):
    """Coarseness of the panels; the relative error of reflectance is about 8e-7 times its cube.

    Fitted to a scan over depths 0.1 to 32, albedos 0.003 to 1, 6 to 10 polynomials
    (test_depth_resolved.py checks it at other points). Light scattered twice makes the error, hence
    the albedo's square.
    """
    depth = effective_depth(layers.extinction, layers.coalbedo)
    outer = depth * (fractions(n_panels)[0] * 8 / n_depths)
    # The second is what it takes to follow the beam itself where next to nothing scatters.
    twice = jnp.cbrt(layers.albedo) ** 2 * outer * (8 / n_depths) ** (4 / 3)
    coarse = slant * jnp.maximum(twice, outer**4 / 406)
    # No light comes to a slab under an opaque ABL. (Depths that are not numbers stay so.)
    return jnp.where(layers.abl_absorption > _OPAQUE, 0.0 * coarse, coarse)


def depths_resolved(layers: Layers, light: Light, n_depths: int, n_panels: int) -> jax.Array:
    """Whether so many polynomials in so many panels follow the light (traced)."""
    return (_coarseness(layers, n_depths, n_panels, steepness(layers, light)) <= _RESOLVED).all()


def status_of(layers: Layers, resolved: jax.Array, angles: Array | bool = True) -> RESULTS:
    """The status of a deterministic solve, given whether its depths and `angles` are resolved."""
    return outcome(
        layers.valid(),
        (resolved, RESULTS.under_resolved),
        (_conditioned(layers), RESULTS.ill_conditioned),
        (jnp.asarray(angles), RESULTS.too_few_angles),
    )


def angles_resolved(
    layers: Layers, phase: PhaseMixture, n_angles: int, cosine: jax.Array, power: jax.Array
) -> jax.Array:
    """Whether so many angles follow the light of a slab, which may scatter sharply (traced);
    `cosine` and `power` of the beams in the stroma, (beams,).
    """
    return (_angular_error(layers, phase, n_angles, cosine, power) <= _SHARP).all()


def brdf_resolved(layers: Layers, phase: PhaseMixture, n_angles: int) -> jax.Array:
    """Whether so many moments of the phase function follow a BRDF (traced).

    Light scattered once is as wrong in a direction as these are. Beside 96 moments the share of the
    first that is left out bounds the error of g −0.9 to 0.95, Rayleigh's share 0 to 0.3, depths
    0.02 to 3, cosines 0.05 to 1, 32 moments; where they follow it is half of that or less.
    """
    scatters = (layers.extinction > 0) & (layers.albedo > 0)
    return jnp.where(scatters, _beyond(phase, n_angles) <= _SHARP, True).all()


def moments_for(anisotropy: float) -> int:
    """Moments of a phase function that follow a BRDF for every share of Rayleigh's law."""
    g = abs(anisotropy)
    return 1 if g < _SHARP else int(np.ceil(np.log(_SHARP) / np.log(g)))


def _beyond(phase: PhaseMixture, n_angles: int):
    """Size of the first moment of the phase function that is left out."""
    return (1 - phase.rayleigh) * jnp.abs(phase.anisotropy) ** n_angles


def _angular_error(layers: Layers, phase: PhaseMixture, n_angles: int, cosine, power):
    """Estimate of the relative error of reflectance by the number of angles, shape (wavelengths,).

    Fitted to slabs without interfaces beside CDISORT, to LB06's and to a stroma in air, which traps
    light, beside 72 angles: depths 1e-4 to 10, albedos 0.5 and 1, g −0.9 to 0.95, cosines 0.003 to
    1 outside, 8, 16 and 32 angles; without a peak 4 and 6 too. It bounds none of them strictly.
    """
    n, g = layers.indices, phase.anisotropy
    depth = jnp.where(layers.albedo > 0, layers.extinction, 0.0)
    safe_depth, forwards = jnp.where(depth > 0, depth, 1.0), g > 0
    # Worst where the beam is scattered about once. Thinner it is followed exactly; thicker it
    # forgets where it came from, unless it is absorbed first.
    thin = (safe_depth / 0.005) ** 0.7
    thick = 0.15 * jnp.maximum(1 / safe_depth, jnp.sqrt(jnp.clip(2 * layers.coalbedo, 0.0, 1.0)))
    angular = jnp.clip(0.03 / cosine, 1.0, 3.0) * jnp.minimum(1.0, jnp.square(0.08 / cosine))
    # Each beam counts as it is scattered: of thin layers the grazing ones most.
    # Beams share a depth below rounding as they do the least above it.
    share = power[None] * -jnp.expm1(-jnp.maximum(safe_depth, 1e-30)[:, None] / cosine[None])
    angular = (share * angular[None]).sum(1) / share.sum(1)
    # Beside a critical angle, where all that grazes outside enters, nodes are as far as anywhere.
    outside = refract(cosine, n.stroma, n.aqueous)
    oblique = jnp.where(n.stroma > n.aqueous, power @ (0.07 / (1 + outside / 0.08)), 0.0)
    spread = jnp.minimum(1.0, jnp.minimum(thin, thick))
    grazing = jnp.maximum(0.12 * angular, oblique) * spread
    # Light scattered oftener, or sent back by interfaces, comes along all directions.
    mirrored_below = (n.stroma > n.ipe) | (layers.ipe_absorption is not None)
    trapped = mirrored_below & (n.stroma > n.aqueous)
    ceiling, onset = jnp.where(trapped, 0.025, 0.011), jnp.where(trapped, 0.3, 0.02)
    growth = jnp.where(forwards, jnp.minimum(1.0, (safe_depth / onset) ** 0.7), 1.0)
    diffuse = ceiling * growth * max(1.0, (16 / n_angles) ** 4)
    sharp = _beyond(phase, n_angles) * jnp.maximum(jnp.where(forwards, grazing, 0.0), diffuse)
    # Critical angles share out the nodes, whatever the phase function.
    critical = n.stroma > jnp.minimum(jnp.minimum(n.aqueous, n.abl), n.ipe)
    split = jnp.where(critical, 0.03 * (6 / n_angles) ** 8, 0.0)
    return jnp.where(depth > 0, jnp.maximum(sharp, split), 0.0)


def _conditioned(layers: Layers):
    """Whether the balance of many scatterings survives rounding; its condition is 1/(1 − ω + 1/τ²).

    At the limit float32 is wrong by 2e-4 of the light; float64 is never near it.
    """
    tau = jnp.maximum(layers.extinction, 1.0)
    return (layers.coalbedo + 1 / (tau * tau) >= 10 * jnp.finfo(tau.dtype).eps).all()
