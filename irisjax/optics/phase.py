"""Phase functions: sampler and azimuth-averaged redistribution of each.

Both are even in the scattering angle's cosine, so in a plane layer a ray scatters up and down
alike: the redistribution k(μ, μ') needs cosines in (0, 1] only, with ∫₀¹ k(μ, μ') dμ' = ½.
"""

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from irisjax._types import Real
from irisjax.numerics.interpolation import horner
from irisjax.numerics.quadrature import CosineRule
from irisjax.optics.per_angle import scattering_operator


class Redistribution(eqx.Module):
    """The scattering operator on a cosine rule, without its isotropic part.

    S(μ_i) = ½ Σ_q w_q f(μ_q) + Σ_r scatter[r, i] Σ_q collect[r, q] f(μ_q), where f and S are
    densities over the cosine, f summed over the two senses of travel, S for one sense. What is
    written here neither adds nor takes energy; the isotropic part carries it all.

    Attributes:
        collect: Shape (rank, n), with the rule's weights; `None` for the identity (rank n).
        scatter: Shape (rank, n).
    """

    collect: Float[Array, "rank n"] | None
    scatter: Float[Array, "rank n"]

    def anisotropic(self, f: Float[Array, "*s n"]) -> Float[Array, "*s n"]:
        """Apply the operator to densities on the nodes."""
        return (f if self.collect is None else f @ self.collect.T) @ self.scatter


class AbstractPhase(eqx.Module):
    """A phase function symmetric between forward and backward."""

    @abc.abstractmethod
    def sample_cosine(self, u: Float[Array, "*s"]) -> Float[Array, "*s"]:
        """Compute the cosine of the deflection angle at a quantile in [0, 1].

        A rational function of 2u − 1, so that a Monte Carlo step has no loop and no trigonometry.
        """

    @abc.abstractmethod
    def redistribution(self, rule: CosineRule) -> Redistribution:
        """Compute the azimuth-averaged scattering operator on the nodes of `rule`."""


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

    Its azimuth average is ½(1 + ½ P₂(μ) P₂(μ')), which two moments represent exactly.
    """

    def sample_cosine(self, u: Float[Array, "*s"]) -> Float[Array, "*s"]:
        """Compute the root of c³ + 3c = 4(2u − 1), to 8e-8."""
        return _odd_rational(u, _RAYLEIGH_INVERSE)

    def redistribution(self, rule: CosineRule) -> Redistribution:
        """Rank one beside the isotropic part: P₂ with weight ¼."""
        p2 = (1.5 * rule.cosine**2 - 0.5)[None, :]
        return Redistribution(collect=rule.weight[None, :] * p2, scatter=0.25 * p2)


class RayleighPerAngle(AbstractPhase):
    """The rejection sampling printed in LB06 Section 3.4: (1 + cos²α)/(3π/2) per radian of α.

    It lacks the sin α of the solid angle, so the density on the sphere diverges as 1/sin α straight
    ahead and straight back, and the azimuth average has a logarithmic singularity at μ = μ'.
    """

    def sample_cosine(self, u: Float[Array, "*s"]) -> Float[Array, "*s"]:
        """Compute the cosine at which (α + (α + sin α cos α)/2)/(3π/2) = 1 − u, to 4e-7."""
        return _odd_rational(u, _PER_ANGLE_INVERSE)

    def redistribution(self, rule: CosineRule) -> Redistribution:
        """Compute the operator by product integration over the singularity, exact for polynomials
        in the rule's own variable.
        """
        operator, weight = scattering_operator(rule), rule.weight
        # Its error in energy, a quadrature error, is distributed evenly over directions.
        operator = operator + ((0.5 * weight - weight @ operator) / weight.sum())[None, :]
        return Redistribution(collect=None, scatter=operator.T - 0.5 * weight[:, None])


def rayleigh(cosine: Real) -> Any:
    """Compute Rayleigh's law, ¾(1 + cos²α), whose mean over all directions is 1."""
    return 0.75 * (1 + cosine * cosine)


PHASES: dict[str, AbstractPhase] = {"rayleigh": Rayleigh(), "lb06": RayleighPerAngle()}
"""Phase functions by their names in a process."""


def _odd_rational(u, coefficients):
    x = 2 * u - 1
    numerator, denominator = coefficients
    return jnp.clip(x * horner(x * x, numerator) / horner(x * x, denominator), -1.0, 1.0)
