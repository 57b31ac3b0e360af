"""The media in front of the iris: tear film, cornea, aqueous humour."""

from functools import lru_cache

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from irisjax._types import Numbers, Scalar, float_field
from irisjax.numerics.checks import Range, check_fields
from irisjax.optics.fresnel import fresnel, refract

AIR, TEAR, CORNEA, AQUEOUS = 1.0, 1.337, 1.3771, 1.336
"""Refractive indices [LB06 Table 1]."""

INDEX = Range(1, 3)


class Media(eqx.Module):
    """Refractive indices of aqueous humour, cornea and tear film, by default of LB06 Table 1.

    Raises:
        ValueError: For an index out of range, with its field, value and range.
    """

    aqueous: Scalar = float_field(AQUEOUS)
    cornea: Scalar = float_field(CORNEA)
    tear: Scalar = float_field(TEAR)

    def __check_init__(self) -> None:
        check_fields(self, dict.fromkeys(("aqueous", "cornea", "tear"), INDEX))

    @classmethod
    def default(cls) -> "Media":
        """Return the indices of LB06 Table 1, made once: that takes as long as a spectrum."""
        return _default(jnp.result_type(float))

    def inward(self, cos_air: Numbers) -> tuple[Array, Array]:
        """Compute the share of light that reaches the iris, ∏(1 − F) over air→tear→cornea→aqueous.

        The interfaces are parallel and crossed once, without wavelength dependence and absorption,
        as in the in vivo comparison of [LB06 Section 4]: 0.979 at normal incidence.

        Args:
            cos_air: Cosine of the angle of incidence in air.

        Returns:
            The transmittance, and the cosine in the aqueous humour.
        """
        cos_air = jnp.asarray(cos_air, jnp.result_type(float, cos_air))
        total, cosine, n = jnp.ones_like(cos_air), cos_air, AIR
        for n_next in (self.tear, self.cornea, self.aqueous):
            cos_next = refract(cosine, n, n_next)
            total = total * fresnel(cosine, cos_next, n, n_next)[1]
            cosine, n = cos_next, n_next
        return total, cosine


@lru_cache(maxsize=2)
def _default(dtype) -> Media:
    with jax.ensure_compile_time_eval():
        return Media(*(jnp.asarray(n, dtype) for n in (AQUEOUS, CORNEA, TEAR)))
