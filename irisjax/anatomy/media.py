"""The media in front of the iris: tear film, cornea, aqueous humour."""

from functools import lru_cache

import equinox as eqx
import jax
import jax.numpy as jnp

from irisjax._types import Scalar, as_float
from irisjax.numerics.checks import Range, check_fields
from irisjax.optics.fresnel import fresnel, refract

AIR, TEAR, CORNEA, AQUEOUS = 1.0, 1.337, 1.3771, 1.336
"""Refractive indices [LB06 Table 1]."""

INDEX = Range(1, 3)


class Media(eqx.Module):
    """Refractive indices of what lies before an iris; the defaults are those of LB06 Table 1.

    **Raises:** `ValueError` naming field, value and allowed range.
    """

    aqueous: Scalar = eqx.field(default=AQUEOUS, converter=as_float)
    cornea: Scalar = eqx.field(default=CORNEA, converter=as_float)
    tear: Scalar = eqx.field(default=TEAR, converter=as_float)

    def __check_init__(self):
        check_fields(self, dict.fromkeys(("aqueous", "cornea", "tear"), INDEX))

    @classmethod
    def default(cls) -> "Media":
        """Those of LB06 Table 1, kept in either precision: making arrays takes longer than a
        spectrum.
        """
        return _default(jnp.result_type(float))

    def inward(self, cos_air):
        """Share of light that reaches the iris and its cosine there, ∏(1 − F) over
        air→tear→cornea→aqueous.

        Parallel interfaces, one pass, no wavelength dependence and no absorption, as in the in vivo
        comparison of [LB06 Section 4]: 0.979 at normal incidence. Returns `(transmittance, cosine
        in the aqueous humour)`.
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
