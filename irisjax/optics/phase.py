"""Phase functions: density, sampler, and azimuth-averaged redistribution of each.

Both are even in the scattering angle's cosine, so in a plane layer a ray scatters up and down
alike: the redistribution k(μ, μ') needs cosines in (0, 1] only, with ∫₀¹ k(μ, μ') dμ' = ½.
"""

import abc
import itertools
from functools import lru_cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax.numerics.interpolation import horner
from irisjax.numerics.quadrature import CosineRule, gauss_legendre, graded, interpolation


class Redistribution(eqx.Module):
    """The scattering operator on a cosine rule, without its isotropic part.

    S(μ_i) = ½ Σ_q w_q f(μ_q) + Σ_r scatter[r, i] Σ_q collect[r, q] f(μ_q), where f and S are
    densities over the cosine, f summed over the two senses of travel, S for one sense. What is
    written here neither adds nor takes energy; the isotropic part carries it all.

    - `collect`: shape (rank, n) with the rule's weights inside, or `None` for the identity (rank
        n).
    - `scatter`: shape (rank, n).
    """

    collect: Float[Array, "rank n"] | None
    scatter: Float[Array, "rank n"]

    def anisotropic(self, f: Float[Array, "*s n"]) -> Float[Array, "*s n"]:
        """The operator on densities on the nodes."""
        return (f if self.collect is None else f @ self.collect.T) @ self.scatter


class AbstractPhase(eqx.Module):
    """A phase function symmetric between forward and backward."""

    @abc.abstractmethod
    def angle_density(self, alpha: Float[Array, "*s"]) -> Float[Array, "*s"]:
        """Probability density of the deflection angle per radian on [0, π]."""

    @abc.abstractmethod
    def sample_cosine(self, u: Float[Array, "*s"]) -> Float[Array, "*s"]:
        """Cosine of the deflection angle from a uniform in [0, 1]: the inverse distribution
        function.

        A rational function of 2u − 1, so that a Monte Carlo step has no loop and no trigonometry.
        """

    @abc.abstractmethod
    def redistribution(self, rule: CosineRule) -> Redistribution:
        """The azimuth-averaged scattering operator on the nodes of `rule`."""


# Minimax-like fits of the inverse distribution functions: odd numerator and even denominator in 2u
# − 1.
_RAYLEIGH_INVERSE = (
    (1.33333217, 4.88499044, 3.67262038, 0.33877668),
    (1.0, 4.25625501, 4.22517445, 0.74828951),
)
_PER_ANGLE_INVERSE = (
    (2.35618496, 29.65395127, 73.73855077, 14.28983691, -7.68017775),
    (1.0, 15.36027524, 56.28493536, 41.3255323, -1.61242091),
)


class Rayleigh(AbstractPhase):
    """Rayleigh's phase function ¾(1 + cos²α) per solid angle over 4π.

    Its azimuth average is ½(1 + ½ P₂(μ) P₂(μ')): two moments carry it exactly.
    """

    def angle_density(self, alpha):
        """¾(1 + cos²α)·½ sin α."""
        return 0.375 * (1 + jnp.cos(alpha) ** 2) * jnp.sin(alpha)

    def sample_cosine(self, u):
        """The root of c³ + 3c = 4(2u − 1), to 8e-8."""
        return _odd_rational(u, _RAYLEIGH_INVERSE)

    def redistribution(self, rule):
        """Rank one beside the isotropic part: P₂ with weight ¼."""
        p2 = (1.5 * rule.cosine**2 - 0.5)[None, :]
        return Redistribution(collect=rule.weight * p2, scatter=0.25 * p2)


class RayleighPerAngle(AbstractPhase):
    """The rejection sampling printed in LB06 Section 3.4: (1 + cos²α)/(3π/2) per radian of α.

    It lacks the sin α of the solid angle, so the density on the sphere diverges as 1/sin α straight
    ahead and straight back, and the azimuth average has a logarithmic singularity at μ = μ'.
    """

    def angle_density(self, alpha):
        """(1 + cos²α)/(3π/2)  [LB06 Section 3.4]."""
        return (1 + jnp.cos(alpha) ** 2) / (1.5 * jnp.pi)

    def sample_cosine(self, u):
        """The cosine of the angle at which (α + (α + sin α cos α)/2)/(3π/2) reaches 1 − u,
        to 4e-7.
        """
        return _odd_rational(u, _PER_ANGLE_INVERSE)

    def redistribution(self, rule):
        """Product integration: exact for polynomials in the rule's own variable, singularity
        included.

        The rule's own panels are the pieces, so critical angles cost no accuracy, only time; no
        iris of LB06 has one inside its scattering layer.
        """
        n, dtype = rule.cosine.shape[0], rule.cosine.dtype
        if rule.n_panels == 1:
            # Nodes without critical angles are constants: build the operator once, on the host.
            operator = jnp.asarray(_constant_operator(n), dtype)
        else:
            operator = _per_angle_operator(rule)
        operator = _conserving(operator, rule.weight)
        return Redistribution(collect=None, scatter=operator.T - 0.5 * rule.weight[:, None])


PHASES: dict[str, AbstractPhase] = {"rayleigh": Rayleigh(), "lb06": RayleighPerAngle()}
"""Phase functions by the name a process gives them."""


@lru_cache(maxsize=32)
def _constant_operator(n: int) -> np.ndarray:
    x, w = gauss_legendre(n)
    mu, slope = graded(x, 0.0, np)
    # NumPy on purpose: constants, and in double precision whatever the program's.
    constants: Any = (mu, w * slope, np.zeros((0, n)), np.zeros(()), np.zeros(1), np.ones(1))
    rule = CosineRule(*constants)
    # A row at a time: the polynomials on all circles at once would not fit in a cache.
    return np.stack([_scattered_into(rule, m, np) for m in mu])


def _per_angle_operator(rule: CosineRule) -> Array:
    """The traced operator, a target at a time: all at once would take some 100 MB an iris."""
    return jax.lax.map(lambda mu: _scattered_into(rule, mu, jnp), rule.cosine)


def _scattered_into(rule: CosineRule, mu, xp):
    """W[q] with S(μ) = Σ_q W[q] f(μ_q) for the density (1 + cos²α)/(3π/2) per radian.

    Integrating along the great circles through direction μ removes the singularity of the averaged
    kernel: per radian the density is smooth. A circle that passes the pole at cosine M meets the
    cosine
    |M sin γ| at angle γ from the grazing plane; where M crosses a panel's edge the integral over
    the circles has a kink, and is split.
    """
    n = rule.cosine.shape[0]
    # Enough points to integrate the Lagrange polynomials of the rule's degree.
    x_psi, w_psi = gauss_legendre(max(48, 3 * n // 2))
    g_psi, slope_psi = graded(x_psi, 0.0, np)
    x_gamma, w_gamma = gauss_legendre(max(64, 2 * n))
    g_gamma, slope_gamma = graded(x_gamma, 0.0, np)

    # Circles by their angle ψ from the one through the grazing plane: M² = μ² + (1 − μ²) sin²ψ.
    steepness = xp.where(mu < 1, 1 - mu * mu, 1.0)
    kinks = [
        _arcsin_sqrt((rule.starts[k] - mu * mu) / steepness, xp) for k in range(1, rule.n_panels)
    ]
    ends = [0.0, *kinks, np.pi / 2]
    psi = xp.concatenate([lo + (hi - lo) * g_psi for lo, hi in itertools.pairwise(ends)])
    w_psi = xp.concatenate([(hi - lo) * w_psi * slope_psi for lo, hi in itertools.pairwise(ends)])

    side = (1 - mu * mu) * xp.sin(psi) ** 2
    pole_squared = mu * mu + side
    pole = xp.sqrt(pole_squared)
    columns = []
    for panel in range(rule.n_panels):
        start, end = rule.starts[panel], rule.starts[panel] + rule.widths[panel]
        first, last = (_arcsin_sqrt(edge / pole_squared, xp) for edge in (start, end))
        gamma = first[:, None] + (last - first)[:, None] * g_gamma
        v2 = xp.sin(gamma) ** 2
        # cos²α averaged over the two senses round the circle.
        cos2 = (mu * mu / pole_squared)[:, None] * v2 + (side / pole_squared)[:, None] * (1 - v2)
        density = (1 + cos2) / (1.5 * np.pi) * (2 / np.pi)
        weights = density * w_gamma * slope_gamma * (w_psi * (last - first))[:, None]
        met = xp.minimum(pole[:, None] * xp.sqrt(v2), 1.0)
        columns.append(xp.einsum("ab,abq->q", weights, interpolation(rule, panel, met, xp)))
    return xp.concatenate(columns)


def _odd_rational(u, coefficients):
    x = 2 * u - 1
    numerator, denominator = coefficients
    return jnp.clip(x * horner(x * x, numerator) / horner(x * x, denominator), -1.0, 1.0)


def _arcsin_sqrt(x, xp):
    """arcsin √x with x clipped to [0, 1], with zero instead of infinite slopes at both ends."""
    low, high = x <= 0, x >= 1
    inside = xp.arcsin(xp.sqrt(xp.where(low | high, 0.5, x)))
    return xp.where(high, np.pi / 2, xp.where(low, 0.0, inside))


def _conserving(operator, weight):
    """The operator with its error in energy, a quadrature error, given back to all directions
    alike.
    """
    return operator + (0.5 * weight - weight @ operator) / weight.sum()
