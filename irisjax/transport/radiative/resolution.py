"""Whether a slab's depth polynomials are enough, and whether precision is."""

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from irisjax.tissue.layers import Layers
from irisjax.transport.radiative.slab import fractions
from irisjax.transport.solution import RESULTS

# `_coarseness` up to which reflectance is good to 1e-7.
_RESOLVED = 0.47
_SHARP = 3e-3  # `_sharpness` up to which light that grazes a slab is followed
_MOST_PANELS = 32  # optical depths of 1e9


def panels_for(layers: Layers, n_depths: int) -> int | None:
    """Depth panels needed for concrete layers; `None` for traced ones."""
    if isinstance(layers.extinction, Tracer) or isinstance(layers.albedo, Tracer):
        return None
    panels, coarseness = 1, np.asarray(_coarseness(layers, n_depths, 1))
    # Layers that are not numbers are refused by the status; no panels help them.
    while (
        panels < _MOST_PANELS and coarseness[np.isfinite(coarseness)].max(initial=0.0) > _RESOLVED
    ):
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


def status_of(layers: Layers, n_depths: int, n_panels: int) -> RESULTS:
    """The status of a solve with so many polynomials in so many panels."""
    resolved = (_coarseness(layers, n_depths, n_panels) <= _RESOLVED).all()
    return outcome(layers, resolved)


def angles_resolved(layers: Layers, peak, cosine, power):
    """Whether the angles follow light that grazes a slab which scatters sharply forwards (traced).

    - `peak`: share of the phase function beyond the moments that count, g^n_angles (wavelengths,).
    - `cosine`, `power`: of the beams in the stroma (beams,).
    """
    return (_sharpness(layers, peak, cosine, power) <= _SHARP).all()


def _sharpness(layers: Layers, peak, cosine, power):
    """Bound on the relative error of reflectance by the number of angles, shape (wavelengths,).

    Fitted to slabs without interfaces, which mirror nothing and let beams graze: depths 1e-4 to 10,
    g 0.8 to 0.95, cosines 0.03 to 1, 16 and 32 angles, beside 128 and 96.
    """
    depth = jnp.where(layers.albedo > 0, layers.extinction, 0.0)
    whole = jnp.where(depth > 0, depth, 1.0)
    # Worst where the beam is scattered about once: thinner it is followed exactly, thicker it
    # forgets where it came from.
    known = jnp.minimum(1.0, jnp.minimum((whole / 0.005) ** 0.7, 0.15 / whole))
    grazing = power @ jnp.minimum(1.0, jnp.square(0.08 / cosine))
    return jnp.where(depth > 0, 0.12 * peak * known * grazing, 0.0)


def outcome(layers: Layers, resolved, angles=None) -> RESULTS:
    """The status of a deterministic solve, given whether its depths and `angles` are resolved."""
    enough = jnp.asarray(True) if angles is None else angles
    followed = RESULTS.where(enough, RESULTS.successful, RESULTS.too_few_angles)
    conditioned = RESULTS.where(_conditioned(layers), followed, RESULTS.ill_conditioned)
    return RESULTS.where(
        layers.valid(),
        RESULTS.where(resolved, conditioned, RESULTS.under_resolved),
        RESULTS.invalid_input,
    )


def _conditioned(layers: Layers):
    """Whether the balance of many scatterings survives rounding; its condition is 1/(1 − ω + 1/τ²).

    At the limit float32 is wrong by 2e-4 of the light; float64 is never near it.
    """
    tau = jnp.maximum(layers.extinction, 1.0)
    return (layers.coalbedo + 1 / (tau * tau) >= 10 * jnp.finfo(tau.dtype).eps).all()
