"""The iris as a matt surface, for renderers that have no other: the albedo of each texel, and its
error.

ILIT's BRDF is (1 − F(μ_i)) g(μ_o): it depends on the direction of the light at the first surface
alone, and falls towards grazing exits, the more the ABL absorbs. Radiative transfer's is larger
towards the light. A Lambertian surface of the same power is the nearest relative of either.
"""

import functools
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
from irisjax.render.integrator import solve_response
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
        rms: Root mean square error of the whole iris's mean radiance, over pairs of directions
            within `CONE` of the normal in proportion to their cosines.
        most: Largest error there, with its sign (negative: the Lambertian iris is darker).
        texels: As `rms`, over texels too, relative to the mean radiance of the iris.
        hemisphere: As `rms`, over all directions, relative to the mean BRDF.
    """

    rms: np.ndarray
    most: np.ndarray
    texels: np.ndarray
    hemisphere: np.ndarray


class Matt(eqx.Module):
    """An iris whose albedo can be computed, without the mirror of the first surface.

    Made with `build`.
    """

    response: TabulatedResponse
    scales: Scales
    eye: Eye
    shape: tuple[int, int] = eqx.field(static=True)

    @classmethod
    def build(
        cls,
        iris: Iris,
        maps: IrisMaps | None,
        eye: Eye,
        bands: Bands,
        integrator: Separable | RadiativeIntegrator,
    ) -> "Matt":
        """Tabulate the response of an iris in the channels of `bands`.

        `colour_bands` give linear sRGB; bands whose weights are the unit matrix give spectral
        reflectance.
        """
        scales = Scales.of(maps, iris)

        def include_uniform(span):  # whose scales are 1
            return jnp.stack([jnp.minimum(span[0], 1.0), jnp.maximum(span[1], 1.0)])

        ranges = jax.tree.map(include_uniform, scales.ranges())
        arguments = iris, eye.aqueous_index, bands, ranges
        response = solve_response(integrator.prepare(*arguments), *arguments)
        assert isinstance(response, TabulatedResponse)
        return cls(response, scales, eye, (2, 2) if maps is None else maps.shape)

    def first_channels(self, channels: int) -> "Matt":
        """Return the same iris with its first `channels` channels alone."""
        coefficients = self.response.coefficients[..., :channels]
        return eqx.tree_at(lambda m: m.response.coefficients, self, coefficients)

    def albedo(self) -> Float[Array, "angles radii channels"]:
        """Compute the directional–hemispherical reflectance of each texel at normal incidence, in
        the aqueous humour.

        The result has the shape of the maps; without maps it is (2, 2), with equal texels.
        """
        values = _albedo(self.response, jax.tree.map(jnp.ravel, self.scales)).T
        shape = self.shape if len(values) > 1 else (1, 1)
        return jnp.broadcast_to(values.reshape(*shape, -1), (*self.shape, values.shape[1]))

    def brdf(
        self,
        cos_incidence: Float[Array, " incidences"],
        cos_exit: Float[Array, " exits"],
        azimuth: Float[Array, " azimuths"],
    ) -> Float[Array, "incidences exits azimuths channels"]:
        """Compute the BRDF of the uniform iris, 1/sr; azimuth 0 is forward."""
        uniform = jax.tree.map(lambda s: jnp.ones(1, s.dtype), self.scales)
        return _brdf_of_pairs(self.response, uniform, cos_incidence, cos_exit, azimuth)[..., 0]

    def error(self) -> LambertError:
        """Compare a Lambertian iris with this one at 2048 texels at most, 128 by radiative
        transfer, whose BRDF depends on three angles.
        """
        if isinstance(self.response.directions, AngularFunctions):
            most_texels, nodes, azimuths = 128, 8, np.pi * (np.arange(6) + 0.5) / 6
        else:
            most_texels, nodes, azimuths = 2048, 24, np.zeros(1)
        texels, weight = self._sample_texels(most_texels)
        dtype = self.response.error.dtype

        def brdf(cosines):
            directions = (jnp.asarray(x, dtype) for x in (cosines, cosines, azimuths))
            return np.asarray(_brdf_of_pairs(self.response, texels, *directions), np.float64)

        lambertian = np.asarray(_albedo(self.response, texels), np.float64) / np.pi
        near, near_weights = _cosine_nodes(np.cos(np.radians(CONE)), nodes)
        all_cosines, all_weights = _cosine_nodes(0.0, nodes)
        near_brdf = extreme_brdf = brdf(near)
        if azimuths.size == 1:
            extreme_brdf = brdf(np.cos(np.radians(np.linspace(0, CONE, 26))))
        whole = brdf(all_cosines), all_weights
        return lambert_error(lambertian, weight, (near_brdf, near_weights), whole, extreme_brdf)

    def _sample_texels(self, count: int) -> tuple[Scales, np.ndarray]:
        """Return the scales of about `count` texels, and weights in proportion to their area."""
        if all(s is None for s in self.scales):
            return Scales(), np.ones(1)
        rows, columns = self.shape
        step = max(1, round((rows * columns / count) ** 0.5))
        radius = np.asarray(self.eye.from_axis(cell_centres(self.shape)[1]))
        weight = np.broadcast_to(radius, self.shape)[::step, ::step].ravel()
        scales = jax.tree.map(lambda s: s[::step, ::step].ravel(), self.scales)
        return scales, weight / weight.sum()


def lambert_error(
    lambertian: np.ndarray,
    weight: np.ndarray,
    near: tuple[np.ndarray, np.ndarray],
    hemisphere: tuple[np.ndarray, np.ndarray],
    extreme: np.ndarray,
) -> LambertError:
    """Compute the `LambertError` of an iris whose BRDF is known for pairs of directions.

    Args:
        lambertian: BRDF of the Lambertian texels, (channels, texels).
        weight: Weight of each texel.
        near: BRDFs for cosines near the normal, (in, out, azimuths, channels, texels), with
            the cosines' weights.
        hemisphere: The same for cosines over the hemisphere.
        extreme: BRDFs for cosines near the normal, of which the largest error is taken.
    """
    (near_brdf, near_weights), (brdf, weights) = near, hemisphere
    mean = lambertian @ weight

    def average(values, cosine_weights):
        pairs = (cosine_weights[:, None] * cosine_weights)[..., None, None] / values.shape[2]
        return (pairs * values).sum((0, 1, 2))

    near_mean, ratio = near_brdf @ weight, (brdf @ weight) / mean
    of_texels = ((lambertian - near_brdf) / near_mean[..., None]) ** 2 @ weight
    errors = (mean / (extreme @ weight) - 1).reshape(-1, mean.size)
    return LambertError(
        rms=np.sqrt(average((mean / near_mean - 1) ** 2, near_weights)),
        most=errors[np.abs(errors).argmax(0), np.arange(mean.size)],
        texels=np.sqrt(average(of_texels, near_weights)),
        hemisphere=np.sqrt(average((ratio - 1) ** 2, weights)) / average(ratio, weights),
    )


def _cosine_nodes(lowest: float, count: int):
    """Return cosines between a lowest one and 1, and weights in proportion to them."""
    x, w = gauss_legendre(count)
    cosine = lowest + (1 - lowest) * x
    return cosine, w * cosine / (w * cosine).sum()


@eqx.filter_jit
def _brdf_of_pairs(response: TabulatedResponse, scales: Scales, incidence, exits, azimuth):
    """Compute the BRDF of texels for all pairs of directions: (in, out, azimuths, channels,
    texels).
    """
    ones = next((jnp.ones_like(s) for s in scales if s is not None), jnp.ones(1, exits.dtype))
    shape = incidence.size, exits.size, azimuth.size
    pairs = [x.ravel() for x in jnp.meshgrid(incidence, exits, azimuth, indexing="ij")]
    values = jax.lax.map(lambda v: response.brdf(scales, *(x * ones for x in v)), tuple(pairs))
    return values.reshape(*shape, *values.shape[1:])


@eqx.filter_jit
def _albedo(response: TabulatedResponse, scales: Scales):
    """Compute the albedo of texels, (channels, texels); of one where nothing varies."""
    albedo = functools.partial(response.hemispherical, cos_incidence=1.0)
    return map_chunks(albedo, scales) if jax.tree.leaves(scales) else albedo(scales)
