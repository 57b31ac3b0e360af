"""The iris as a matt surface, for renderers that have no other: the albedo of each texel, and its
error.

ILIT's BRDF is (1 − F(μ_i)) g(μ_o): it depends on the direction of the light at the first surface
alone, and falls towards grazing exits, the more the ABL absorbs. Radiative transfer's is larger
towards the light. A Lambertian surface of the same power is the nearest relative of either.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax.anatomy.eye import Eye
from irisjax.numerics.chunks import map_chunks
from irisjax.numerics.quadrature import gauss_legendre
from irisjax.render.angular import AngularFunctions
from irisjax.render.bands import Bands
from irisjax.render.integrator import checked_response
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.separable import Separable
from irisjax.render.tabulated import TabulatedResponse
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, Scales, cell_centres

CONE = 50.0
"""Angle (degrees) about the iris's normal that holds nearly all light and lines of sight behind a
cornea.
"""


class LambertError(NamedTuple):
    """Relative error of a Lambertian iris of the albedo against the model, in each channel.

    Attributes:
        rms: Of the whole iris's mean radiance, over pairs of directions within `CONE` of the normal
            in proportion to their cosines.
        most: The largest there, with its sign (negative: the Lambertian iris is darker).
        texels: As `rms`, over texels too, relative to the mean radiance of the iris.
        hemisphere: As `rms`, over all directions, relative to the mean BRDF.
    """

    rms: np.ndarray
    most: np.ndarray
    texels: np.ndarray
    hemisphere: np.ndarray


class Matt(eqx.Module):
    """An iris whose albedo can be computed, without the mirror of the first surface; made with
    `of`.
    """

    response: TabulatedResponse
    scales: Scales
    eye: Eye
    shape: tuple[int, int] = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        iris: Iris,
        maps: IrisMaps | None,
        eye: Eye,
        bands: Bands,
        integrator: Separable | RadiativeIntegrator,
    ) -> "Matt":
        """The iris in the channels of `bands`: of `colour_bands` linear sRGB, of unit weights
        spectral reflectance.
        """
        scales = Scales.of(maps, iris)

        def with_one(span):  # the uniform iris too
            return jnp.stack([jnp.minimum(span[0], 1.0), jnp.maximum(span[1], 1.0)])

        ranges = jax.tree.map(with_one, scales.ranges())
        parts = iris, eye.aqueous_index, bands, ranges
        response = checked_response(integrator.prepare(*parts), *parts)
        assert isinstance(response, TabulatedResponse)
        return cls(response, scales, eye, (2, 2) if maps is None else maps.shape)

    def first(self, channels: int) -> "Matt":
        """The same in the first so many channels."""
        some = self.response.coefficients[..., :channels]
        return eqx.tree_at(lambda m: m.response.coefficients, self, some)

    def albedo(self) -> Float[Array, "angles radii channels"]:
        """Directional–hemispherical reflectance of each texel at normal incidence, in the aqueous
        humour.

        It has the shape of the maps; without maps (2, 2), every texel alike.
        """
        found = _power(self.response, jax.tree.map(jnp.ravel, self.scales)).T
        shape = self.shape if len(found) > 1 else (1, 1)
        return jnp.broadcast_to(found.reshape(*shape, -1), (*self.shape, found.shape[1]))

    def brdf(
        self,
        cos_incidence: Float[Array, " incidences"],
        cos_exit: Float[Array, " exits"],
        azimuth: Float[Array, " azimuths"],
    ) -> Float[Array, "incidences exits azimuths channels"]:
        """BRDF of the uniform iris, 1/sr, azimuth 0 straight on."""
        one = jax.tree.map(lambda s: jnp.ones(1, s.dtype), self.scales)
        return _pairs(self.response, one, cos_incidence, cos_exit, azimuth)[..., 0]

    def error(self) -> LambertError:
        """How far a Lambertian iris is from this one, from at most 2048 texels, of radiative
        transfer 128.
        """
        each = isinstance(self.response.directions, AngularFunctions)
        texels, weight = self._some(128 if each else 2048)
        turns = np.pi * (np.arange(6) + 0.5) / 6 if each else np.zeros(1)  # azimuths, each once
        rim = np.cos(np.radians(CONE))
        near, far = (_nodes(lowest, 8 if each else 24) for lowest in (rim, 0.0))

        def pairs(cosines):
            given = (jnp.asarray(x, self.response.error.dtype) for x in (cosines, cosines, turns))
            return np.asarray(_pairs(self.response, texels, *given), np.float64)

        flat = np.asarray(_power(self.response, texels), np.float64) / np.pi
        within, whole = pairs(near[0]), pairs(far[0])
        extreme = within if each else pairs(np.cos(np.radians(np.linspace(0, CONE, 26))))
        return of_pairs(flat, weight, (within, near[1]), (whole, far[1]), extreme)

    def _some(self, most: int) -> tuple[Scales, np.ndarray]:
        """Scales of some texels, and weights by their area."""
        if all(s is None for s in self.scales):
            return Scales(), np.ones(1)
        rows, columns = self.shape
        step = max(1, round((rows * columns / most) ** 0.5))
        place = np.asarray(self.eye.from_axis(cell_centres(self.shape)[1]))
        weight = np.broadcast_to(place, self.shape)[::step, ::step].ravel()
        some = jax.tree.map(lambda s: s[::step, ::step].ravel(), self.scales)
        return some, weight / weight.sum()


def of_pairs(
    flat: np.ndarray,
    weight: np.ndarray,
    within: tuple[np.ndarray, np.ndarray],
    whole: tuple[np.ndarray, np.ndarray],
    extreme: np.ndarray,
) -> LambertError:
    """`LambertError` of an iris whose BRDF is known for pairs of directions.

    Args:
        flat: BRDF of the Lambertian texels, (channels, texels); `weight` of each texel.
        within: BRDFs for cosines near the normal, (in, out, azimuths, channels, texels), with
            the cosines' weights; `whole`: the same over the hemisphere.
        extreme: The same for cosines near the normal, of which the largest error is taken.
    """
    mean, near, far = flat @ weight, within[1], whole[1]

    def averaged(values, cosines):
        weights = (cosines[:, None] * cosines)[..., None, None] / values.shape[2]
        return (weights * values).sum((0, 1, 2))

    seen, ratio = within[0] @ weight, (whole[0] @ weight) / mean
    by_texel = ((flat - within[0]) / seen[..., None]) ** 2 @ weight
    off = (mean / (extreme @ weight) - 1).reshape(-1, mean.size)
    return LambertError(
        rms=np.sqrt(averaged((mean / seen - 1) ** 2, near)),
        most=off[np.abs(off).argmax(0), np.arange(mean.size)],
        texels=np.sqrt(averaged(by_texel, near)),
        hemisphere=np.sqrt(averaged((ratio - 1) ** 2, far)) / averaged(ratio, far),
    )


def _nodes(lowest: float, count: int):
    """Cosines between a lowest one and 1, weights in proportion to them."""
    x, w = gauss_legendre(count)
    cosine = lowest + (1 - lowest) * x
    return cosine, w * cosine / (w * cosine).sum()


@eqx.filter_jit
def _pairs(response: TabulatedResponse, scales: Scales, incidence, exits, azimuth):
    """BRDF of each texel for all pairs of directions: (in, out, azimuths, channels, texels)."""
    one = next((jnp.ones_like(s) for s in scales if s is not None), jnp.ones(1, exits.dtype))
    shape = incidence.size, exits.size, azimuth.size
    every = [x.ravel() for x in jnp.meshgrid(incidence, exits, azimuth, indexing="ij")]
    found = jax.lax.map(lambda v: response.brdf(scales, *(x * one for x in v)), tuple(every))
    return found.reshape(*shape, *found.shape[1:])


@eqx.filter_jit
def _power(response: TabulatedResponse, scales: Scales):
    """Albedo of texels, (channels, texels); of one where nothing varies."""

    def one(texels):
        return response.hemispherical(texels, 1.0)

    return map_chunks(one, scales) if jax.tree.leaves(scales) else one(scales)
