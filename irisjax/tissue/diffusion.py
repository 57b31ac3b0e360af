"""Tissue round the iris, by reduced coefficients: diffuse reflectances of white and skin.

Coefficients are 1/mm, wavelengths nm. Two theories: diffusion for deep tissue, and two fluxes for a
slab, whose coefficients are K = 2 μ_a and S = ¾ μ_s' [van Gemert & Star 1987].
"""

import jax.numpy as jnp
from jax.typing import ArrayLike

from irisjax._types import Scalar, Spectrum, as_float
from irisjax.optics.kubelka_munk import layer_before

_INSIDE = 0.493  # share of diffuse light that a surface of index 1.4 reflects back inside


def diffuse_reflectance(
    absorption: Spectrum, scattering: Spectrum, inside: float = _INSIDE
) -> Spectrum:
    """Diffuse reflectance of a deep tissue, by diffusion theory
    [Flock et al. 1989, IEEE Trans. Biomed. Eng. 36, 1162].

    Args:
        absorption: Absorption coefficient, 1/mm.
        scattering: Reduced scattering coefficient, 1/mm.
        inside: Share of diffuse light that the surface reflects back inside; by default that of an
            index of 1.4.
    """
    albedo = scattering / (absorption + scattering)
    k = (1 + inside) / (1 - inside)
    coalbedo = 1 - albedo
    return albedo / (1 + 2 * k * coalbedo + (1 + 2 * k / 3) * jnp.sqrt(3 * coalbedo))


def slab_reflectance(
    absorption: Spectrum, scattering: Spectrum, thickness: Scalar | float, background: Spectrum
) -> Spectrum:
    """Diffuse reflectance of a slab by two fluxes, see `layer_before`.

    Args:
        absorption: Absorption coefficient, 1/mm.
        scattering: Reduced scattering coefficient, 1/mm.
        thickness: Thickness, mm.
        background: Diffuse reflectance of what lies behind.
    """
    return layer_before(2 * absorption, 0.75 * scattering, thickness, background)


def fibrous_scattering(wavelengths: ArrayLike) -> Spectrum:
    """Reduced scattering coefficient of fibrous tissue, the mean of those that Jacques lists
    [Jacques 2013, Phys. Med. Biol. 58, R37].
    """
    return 2.71 * (as_float(wavelengths) / 500.0) ** -1.627


def bloodless_absorption(wavelengths: ArrayLike) -> Spectrum:
    """Absorption coefficient of skin without blood and melanin [Jacques 1998, omlc.org]."""
    return 0.0244 + 8.53 * jnp.exp(-(as_float(wavelengths) - 154.0) / 66.2)


def melanosome_absorption(wavelengths: ArrayLike) -> Spectrum:
    """Absorption coefficient within a melanosome of skin [Jacques 2013]."""
    return 51.9 * (as_float(wavelengths) / 500.0) ** -3.0
