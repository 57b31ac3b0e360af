"""Light that falls on the iris, directions of observation, and what the surface mirrors."""

import equinox as eqx
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from irisjax._types import Reals, Scalar, Spectrum, as_float, as_float_or_none
from irisjax.numerics.quadrature import cosine_rule
from irisjax.optics.fresnel import critical_cosine_squared, fresnel_at
from irisjax.tissue.indices import RefractiveIndices


class Directions(eqx.Module):
    """Directions in the aqueous humour in which light leaves the iris, shape (exits,).

    Attributes:
        cosine: Cosines of the angles to the iris's normal.
        azimuth: Azimuths from the plane of incidence, radians; 0 is where a mirror would send the
            light.
    """

    cosine: Float[Array, " exits"]
    azimuth: Float[Array, " exits"]

    def __init__(self, cosine: Reals, azimuth: Reals = 0.0):
        cosine, azimuth = (jnp.atleast_1d(as_float(x)) for x in (cosine, azimuth))
        self.cosine, self.azimuth = jnp.broadcast_arrays(cosine, azimuth)


class Light(eqx.Module):
    """Light that falls on the iris from the aqueous humour, and what is observed of it.

    Attributes:
        cosine: Cosine of the light's angle to the iris's normal; `None` for diffuse light, which
            comes from every direction of the hemisphere alike.
        exits: Directions in which the BRDF is requested, or `None`.
        power: Relative spectral power, shape (wavelengths,). Solvers that sample send photons in
            proportion to it; `None` sends equally many at each wavelength.
        matrices: Whether Mueller matrices are requested of a polarised process. Where `exits` are
            given they are computed anyway.

    Raises:
        ValueError: For `exits` or `matrices` under diffuse light, which has no plane of incidence.
    """

    cosine: Scalar | None = eqx.field(converter=as_float_or_none)
    exits: Directions | None = None
    power: Spectrum | None = eqx.field(default=None, converter=as_float_or_none)
    matrices: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        if self.cosine is None and (self.exits is not None or self.matrices):
            raise ValueError(
                "a BRDF or Mueller matrix is of light from one direction, not of diffuse light"
            )


def beams_of(
    light: Light, nodes: int, indices: RefractiveIndices, dtype: DTypeLike, interfaces: int = 3
) -> tuple[Array, Array]:
    """Cosines of the light's directions and its shares along them: `nodes` for diffuse light, a few
    more where that makes the shares of their panels even.

    Grazing light of a thin layer is resolved, and so is total reflection at the first `interfaces`,
    for which the nodes are shared out where the aqueous humour is denser than what lies beyond.
    """
    if light.cosine is None:
        media = (indices.abl, indices.stroma, indices.ipe)[:interfaces]
        breaks = [critical_cosine_squared(indices.aqueous, n) for n in media]
        rule = cosine_rule(jnp.asarray(breaks, dtype), (True,) * interfaces, nodes, entering=True)
        shares = 2 * rule.cosine * rule.weight
        return rule.cosine, shares / shares.sum()
    return jnp.atleast_1d(jnp.asarray(light.cosine, dtype)), jnp.ones(1, dtype)


def first_surface(
    light: Light, indices: RefractiveIndices, dtype: DTypeLike
) -> tuple[Array, Array]:
    """Shares of the light mirrored by and passing the interface of aqueous humour and ABL."""
    if light.cosine is None:
        mu, w = beams_of(light, 48, indices, dtype, interfaces=1)
        mirrored, entered = fresnel_at(mu, indices.aqueous, indices.abl)
        return w @ mirrored, w @ entered
    return fresnel_at(jnp.asarray(light.cosine, dtype), indices.aqueous, indices.abl)
