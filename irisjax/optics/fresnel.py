"""Refraction and Fresnel's coefficients, for either polarisation, at a smooth dielectric interface.

Conventions: cosines are those of the angle to the interface normal, in [0, 1]; indices are real.
[LB06 Section 3.1; Shirley 1990]
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Complex, Float

from irisjax._types import Real
from irisjax.numerics.quadrature import CosineRule
from irisjax.numerics.roots import safe_sqrt

Cosine = Float[Array, "*s"]
Shares = tuple[Array, Array]


def critical_cosine_squared(n_in: Real, n_out: Real) -> Any:
    """Compute the square of the critical cosine, below which the interface reflects totally.

    It is negative if the interface never does. With this c² Snell's law is μ_out² = (n_in/n_out)²
    (μ_in² − c²), an identity that is robust to rounding when the indices nearly agree.
    """
    return (n_in - n_out) * (n_in + n_out) / (n_in * n_in)


def refract(cos_in: Float[Array, "*s"], n_in: Real, n_out: Real) -> Float[Array, "*s"]:
    """Compute the cosine after refraction by Snell's law; 0 under total internal reflection."""
    return n_in / n_out * safe_sqrt(cos_in * cos_in - critical_cosine_squared(n_in, n_out))


def fresnel(cos_in: Cosine, cos_out: Cosine, n_in: Real, n_out: Real) -> Shares:
    """Compute reflectance F and transmittance 1 − F of unpolarised light from `n_in` into `n_out`.

    `cos_out` is the refracted cosine, 0 under total internal reflection. The transmittance has its
    own formula, so that its relative precision is kept where F is close to 1.
    """
    s, p = (law(cos_in, cos_out, n_in, n_out) for law in (fresnel_s, fresnel_p))
    return 0.5 * (s[0] + p[0]), 0.5 * (s[1] + p[1])


def fresnel_s(cos_in: Cosine, cos_out: Cosine, n_in: Real, n_out: Real) -> Shares:
    """Compute `fresnel` for a field perpendicular to the plane of incidence."""
    return _shares(cos_in, cos_out, n_in, n_out, n_in, n_out)


def fresnel_p(cos_in: Cosine, cos_out: Cosine, n_in: Real, n_out: Real) -> Shares:
    """Compute `fresnel` for a field in the plane of incidence."""
    return _shares(cos_in, cos_out, n_in, n_out, n_out, n_in)


class Coherence(NamedTuple):
    """Effect of an interface on U + iV = 2 E_p E_s*, whose flux is treated as that of I.

    Attributes:
        reflected: r_p r_s*, complex.
        lost: 1 − r_p r_s*, without cancellation.
        passed: √(T_p T_s), real.
        contrast: r_s − r_p, 0 under total reflection.
    """

    reflected: Complex[Array, "*s"]
    lost: Complex[Array, "*s"]
    passed: Float[Array, "*s"]
    contrast: Float[Array, "*s"]


def coherence(cos_in: Cosine, cos_out: Cosine, n_in: Real, n_out: Real) -> Coherence:
    """`Coherence` at an interface from `n_in` into `n_out`; `cos_out` as in `fresnel`.

    Where all is reflected, p runs ahead of s by 2 arctan(μ √(c² − μ²)/(1 − μ²)), c the critical
    cosine (field ∝ e^{−iωt}): linearly polarised light comes back elliptical. [Born & Wolf 1999,
    Section 1.5.4]
    """
    past_critical = critical_cosine_squared(n_in, n_out) - cos_in * cos_in
    total, empty = past_critical > 0, (cos_in == 0) & (cos_out == 0)
    a, b = (jnp.where(empty, 1.0, c) for c in (cos_in, cos_out))
    x = 2 * a * b / ((n_in * a + n_out * b) * (n_out * a + n_in * b))
    # Nothing meets an interface of equal media, exactly along it neither; any other one mirrors.
    unhindered = jnp.where(n_in == n_out, 1 / (n_in * n_in + n_out * n_out), 0.0)
    x = jnp.where(empty, unhindered, x)
    sine_squared = jnp.where(total, 1 - cos_in * cos_in, 1.0)
    q = jnp.where(total, cos_in * safe_sqrt(past_critical) / sine_squared, 0.0)
    phase_sine = 2 * q / (1 + q * q)
    lost = jnp.where(total, phase_sine * q, (n_in * n_in + n_out * n_out) * x)
    return Coherence(
        reflected=lax.complex(1 - lost, -phase_sine),
        lost=lax.complex(lost, phase_sine),
        passed=jnp.where(total, 0.0, 2 * n_in * n_out * x),
        contrast=jnp.where(total, 0.0, (n_in - n_out) * (n_in + n_out) * x),
    )


def fresnel_at(cos_in: Cosine, n_in: Real, n_out: Real) -> Shares:
    """Compute `fresnel` with the refracted cosine by Snell's law."""
    return fresnel(cos_in, refract(cos_in, n_in, n_out), n_in, n_out)


def refracted(rule: CosineRule, k: int, n_in: Real, n_out: Real) -> Float[Array, " n"]:
    """Compute the cosines of a rule's nodes behind interface `k`; 0 under total reflection."""
    return n_in / n_out * safe_sqrt(rule.excess[k])


def _shares(cos_in, cos_out, n_in, n_out, w_in, w_out):
    """Compute ((x − y)/(x + y))², x = `w_in` μ_in, y = `w_out` μ_out, and 1 minus that."""
    # Two equal media at exact grazing are 0/0: a ray there meets no interface, so it is
    # transmitted.
    grazing = (cos_in == 0) & (cos_out == 0)
    a, b = (jnp.where(grazing, 1.0, c) for c in (cos_in, cos_out))
    total = w_in * a + w_out * b
    amplitude = (w_in * a - w_out * b) / total
    # Not over the square of `total`, which underflows for cosines below 1e-160.
    transmittance = 4.0 * n_in * n_out * (a / total) * (b / total)
    mirrors = jnp.where(n_in == n_out, 0.0, 1.0)
    reflectance = jnp.where(grazing, mirrors, amplitude * amplitude)
    return reflectance, jnp.where(grazing, 1.0 - mirrors, transmittance)
