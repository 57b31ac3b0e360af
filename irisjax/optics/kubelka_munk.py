"""Kubelka and Munk's diffuse light in a layer so thick that nothing behind it is seen, and the
mirror on top of it.

K and S are absorption and scattering per length of the same unit; only their ratio counts here.
"""

import jax.numpy as jnp


def thick_layer(absorption, scattering, xp=jnp):
    """Reflectance R∞ = 1 + K/S − √((K/S)² + 2K/S)  [Kubelka & Munk 1931].

    Written as S/(K + S + √(K(K + 2S))), in which nothing cancels and S may be 0: black, and so is
    what neither absorbs nor scatters. At K = 0, where the slope in K is infinite, the derivative is
    taken without the root.

    **Arguments:** K and S, shapes that broadcast; `xp`: `numpy` to compute on the host.
    """
    product = absorption * (absorption + 2 * scattering)
    some = product > 0
    root = xp.where(some, xp.sqrt(xp.where(some, product, 1.0)), 0.0)
    total = absorption + scattering + root
    return scattering / xp.where(total != 0, total, 1.0)


def absorption_of(reflectance, scattering):
    """K of a thick layer: S (1 − R∞)²/2R∞  [Kubelka & Munk 1931]."""
    return scattering * (1 - reflectance) ** 2 / (2 * reflectance)


def under_surface(inner, outside, inside):
    """Reflectance of a layer under a smooth surface, without the light that the surface mirrors:
    (1 − k₁)(1 − k₂) R/(1 − k₂ R)  [Saunderson 1942].

    **Arguments:** `inner`: R, of the layer alone; `outside`, `inside`: k₁ and k₂, shares that the
    surface sends back of light from outside (0.04 at index 1.5) and of diffuse light from inside
    (0.6).
    """
    return (1 - outside) * (1 - inside) * inner / (1 - inside * inner)


def without_surface(reflectance, outside, inside):
    """The `inner` that `under_surface` makes `reflectance` of."""
    return reflectance / ((1 - outside) * (1 - inside) + inside * reflectance)
