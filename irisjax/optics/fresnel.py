"""Refraction and unpolarised Fresnel coefficients at a smooth dielectric interface.

Conventions: cosines are those of the angle to the interface normal, in [0, 1]; indices are real.
[LB06 Section 3.1; Shirley 1990]
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from irisjax.numerics.quadrature import CosineRule
from irisjax.numerics.roots import safe_sqrt


def critical_cosine_squared(n_in, n_out):
    """Square of the cosine below which the interface reflects totally; negative where it never
    does.

    Snell's law reads μ_out² = (n_in/n_out)² (μ_in² − c²) with this c², an identity that survives
    rounding when the indices nearly agree.
    """
    return (n_in - n_out) * (n_in + n_out) / (n_in * n_in)


def refract(cos_in: Float[Array, "*s"], n_in, n_out) -> Float[Array, "*s"]:
    """Cosine after refraction from `n_in` into `n_out`; 0 under total internal reflection.

    Snell's law; works on arrays that broadcast together.
    """
    return n_in / n_out * safe_sqrt(cos_in * cos_in - critical_cosine_squared(n_in, n_out))


def fresnel(cos_in: Float[Array, "*s"], cos_out: Float[Array, "*s"], n_in, n_out):
    """Unpolarised reflectance F and transmittance 1 − F for a ray from `n_in` into `n_out`.

    `cos_out` is the refracted cosine, 0 under total internal reflection. The transmittance has its
    own formula, so that it keeps its relative precision where F is close to 1. Returns `(F, 1 -
    F)`.
    """
    matched_grazing = (cos_in == 0) & (cos_out == 0)
    # Two equal media at exact grazing are 0/0: a ray there meets no interface, so it is
    # transmitted.
    a = jnp.where(matched_grazing, 1.0, cos_in)
    b = jnp.where(matched_grazing, 1.0, cos_out)
    s = n_in * a + n_out * b
    p = n_out * a + n_in * b
    r_s = (n_in * a - n_out * b) / s
    r_p = (n_out * a - n_in * b) / p
    product = 4.0 * n_in * n_out * a * b
    reflectance = 0.5 * (r_s * r_s + r_p * r_p)
    transmittance = 0.5 * (product / (s * s) + product / (p * p))
    matched = matched_grazing & (n_in == n_out)
    reflectance = jnp.where(matched_grazing, jnp.where(matched, 0.0, 1.0), reflectance)
    transmittance = jnp.where(matched_grazing, jnp.where(matched, 1.0, 0.0), transmittance)
    return reflectance, transmittance


def fresnel_at(cos_in: Float[Array, "*s"], n_in, n_out):
    """`fresnel` with the refracted cosine worked out by Snell's law; returns `(F, 1 - F)`."""
    return fresnel(cos_in, refract(cos_in, n_in, n_out), n_in, n_out)


def refracted(rule: CosineRule, k: int, n_in, n_out) -> Float[Array, " n"]:
    """Cosines of the rule's nodes after refraction at interface `k`,
    0 where it reflects totally.
    """
    return n_in / n_out * safe_sqrt(rule.excess[k])
