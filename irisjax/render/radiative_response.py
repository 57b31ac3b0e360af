"""What an iris under radiative transfer sends back at a picture's pixels: coefficients of its BRDF,
made by `radiative.RadiativeIntegrator`.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from irisjax.render.angular import AngularFunctions, Mixtures
from irisjax.render.integrator import AbstractResponse
from irisjax.render.products import basis, summed
from irisjax.render.texels import polynomials_of
from irisjax.tissue.maps import Scales
from irisjax.transport.solution import RESULTS

_COSINES = 48


class Texels(eqx.Module):
    """What a pigment change leaves alone: of each pixel the polynomials of the `scales` that vary,
    and `light`: irradiance of all lights together times each function of directions and all shares
    on the way out, (tints, functions, pixels).
    """

    index: Int[Array, " pixels"] | None
    scales: tuple[Float[Array, "_ pixels"], ...]
    light: Float[Array, "tints functions pixels"]


class RadiativeResponse(AbstractResponse):
    """The BRDF of every texel of an iris: coefficients of the products of scales (`texels`), of the
    functions of directions, and of the channels.

    - `error`: largest difference from the solver at points off the nodes, relative to the brightest
        of them.
    - `degrees`: the most of each scale that varies; `angular`: of the cosines.
    - `status`: of the solver, a `RESULTS` item.
    """

    coefficients: Float[Array, "products functions channels"]
    indices: tuple[Float[Array, ""], Float[Array, ""]]
    ranges: Scales
    error: Float[Array, ""]
    status: RESULTS
    degrees: tuple[int, ...] = eqx.field(static=True)
    angular: tuple[int, int, int] = eqx.field(static=True)

    def brdf(
        self, scales: Scales, cos_incidence, cos_exit, azimuth
    ) -> Float[Array, "channels pixels"]:
        """BRDF (1/sr, times the picture's white) of pixels, each for a pair of directions in the
        aqueous humour; `azimuth` 0 is straight on.
        """
        angles = AngularFunctions(self.angular)
        sines = [jnp.sqrt(jnp.maximum(1 - c * c, 0.0)) for c in (cos_incidence, cos_exit)]
        across = sines[0] * sines[1] * jnp.cos(azimuth)
        light = angles.functions(cos_incidence, cos_exit, across, self.indices)
        return summed(self.coefficients, self._polynomials(scales), light[None])

    def hemispherical(self, scales: Scales, cos_incidence) -> Float[Array, "channels pixels"]:
        """Directional–hemispherical reflectance of pixels for one incidence, without the first
        surface's mirror and without light that is never scattered. Where nothing varies there is
        one pixel.
        """
        x, w = (jnp.asarray(v, self.error.dtype) for v in np.polynomial.legendre.leggauss(_COSINES))
        cosine = (x + 1) / 2
        angles = AngularFunctions(self.angular)
        into = jnp.full_like(cosine, cos_incidence)
        # Of the azimuthal orders the mean over azimuth has the first alone.
        functions = angles.functions(into, cosine, jnp.zeros_like(cosine), self.indices)
        first = angles.count(1)
        moments = functions[:first] @ (jnp.pi * w * cosine)
        whole = jnp.tensordot(self.coefficients[:, :first], moments, (1, 0))
        terms = self._polynomials(scales)
        one = terms[0][0] if terms else jnp.ones(1, self.error.dtype)
        return whole.T @ basis(terms, one)

    def _polynomials(self, scales: Scales):
        return polynomials_of(scales, self.ranges, self.degrees)

    def shade(self, texels: Texels, ground: Mixtures | None) -> Float[Array, "channels pixels"]:
        """See `AbstractResponse`."""
        some = self.coefficients
        if ground is not None:
            some = jnp.einsum("pkc,kr->prc", some, ground.weights)
        return summed(some, texels.scales, texels.light)
