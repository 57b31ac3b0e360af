"""Kubelka and Munk's diffuse light in a layer, and the reflection of its surface.

K and S are absorption and scattering per unit length; of an opaque layer only their ratio matters.
"""

from typing import Any

import jax.numpy as jnp

from irisjax._types import AnyReals


def thick_layer(absorption: AnyReals, scattering: AnyReals, xp: Any = jnp) -> Any:
    """Reflectance R∞ = 1 + K/S − √((K/S)² + 2K/S)  [Kubelka & Munk 1931].

    Written as S/(K + S + √(K(K + 2S))), in which nothing cancels and S may be 0: black, and so is a
    layer that neither absorbs nor scatters. At K = 0, where the slope in K is infinite, the
    derivative is that without the root.

    Args:
        absorption: K.
        scattering: S, of a shape that broadcasts with K's.
        xp: `numpy` to compute on the host.
    """
    product = absorption * (absorption + 2 * scattering)
    positive = product > 0
    root = xp.where(positive, xp.sqrt(xp.where(positive, product, 1.0)), 0.0)
    total = absorption + scattering + root
    return scattering / xp.where(total != 0, total, 1.0)


def layer_before(absorption: AnyReals, scattering: AnyReals, thickness: Any, behind: Any) -> Any:
    """Reflectance of a layer before a background R_g: (1 − R_g (a − c))/(a − R_g + c) with
    a = 1 + K/S, c = b coth(b S X), b = √(a² − 1)  [Kubelka & Munk 1931; Kubelka 1948].

    Args:
        absorption: K.
        scattering: S, above 0.
        thickness: X.
        behind: R_g.
    """
    ratio = absorption / scattering
    b = jnp.sqrt(ratio * (ratio + 2) + 1e-12)  # at K = 0 coth has a limit and the root no slope
    c = b / jnp.tanh(b * scattering * thickness)
    return (1 - behind * (1 + ratio - c)) / (1 + ratio - behind + c)


def absorption_of(reflectance: AnyReals, scattering: AnyReals) -> Any:
    """K of a thick layer: S (1 − R∞)²/2R∞  [Kubelka & Munk 1931]."""
    return scattering * (1 - reflectance) ** 2 / (2 * reflectance)


def under_surface(inner: AnyReals, outside: AnyReals, inside: AnyReals) -> Any:
    """Reflectance of a layer under a smooth surface, without the light that the surface mirrors:
    (1 − k₁)(1 − k₂) R/(1 − k₂ R)  [Saunderson 1942].

    R is `inner`, that of the layer alone; k₁ and k₂ are reflectances of the surface for light from
    `outside` (0.04 at index 1.5) and for diffuse light from `inside` (0.6).
    """
    return (1 - outside) * (1 - inside) * inner / (1 - inside * inner)


def without_surface(reflectance: AnyReals, outside: AnyReals, inside: AnyReals) -> Any:
    """The inverse of `under_surface`: R of the layer alone."""
    return reflectance / ((1 - outside) * (1 - inside) + inside * reflectance)
