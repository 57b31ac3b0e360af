"""The media in front of the iris: tear film, cornea, aqueous humour."""

import jax.numpy as jnp

from irisjax.optics.fresnel import fresnel, refract

AIR, TEAR, CORNEA, AQUEOUS = 1.0, 1.337, 1.3771, 1.336
"""Refractive indices [LB06 Table 1]."""


def inward_transmittance(cos_air, media=(TEAR, CORNEA, AQUEOUS)):
    """Share of light that reaches the iris and its cosine there, ∏(1 − F) over
    air→tear→cornea→aqueous.

    Parallel interfaces, one pass, no wavelength dependence and no absorption, as in the in vivo
    comparison of [LB06 Section 4]: 0.979 at normal incidence. `media` are the indices met, from the
    air on. Returns `(transmittance, cosine in the last medium)`.
    """
    cos_air = jnp.asarray(cos_air, jnp.result_type(float, cos_air))
    total, cosine, n = jnp.ones_like(cos_air), cos_air, AIR
    for n_next in media:
        cos_next = refract(cosine, n, n_next)
        total = total * fresnel(cosine, cos_next, n, n_next)[1]
        cosine, n = cos_next, n_next
    return total, cosine
