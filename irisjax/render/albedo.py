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
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from irisjax.anatomy.eye import Eye
from irisjax.numerics.portions import in_portions
from irisjax.optics.fresnel import fresnel_at
from irisjax.render.bands import Bands
from irisjax.render.integrator import checked_response
from irisjax.render.radiative import RadiativeIntegrator, RadiativeResponse
from irisjax.render.separable import Separable, SeparableResponse
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, Scales, cell_centres

CONE = 50.0
"""Angle (degrees) about the iris's normal that holds nearly all light and lines of sight behind a
cornea.
"""
_TEXELS = 2048
_TURNS = np.pi * (np.arange(6) + 0.5) / 6  # azimuths, each once


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

    response: SeparableResponse | RadiativeResponse
    scales: Scales
    iris: Iris
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
            return (
                None
                if span is None
                else jnp.stack([jnp.minimum(span[0], 1.0), jnp.maximum(span[1], 1.0)])
            )

        ranges = Scales(*map(with_one, scales.ranges()))
        made = integrator.prepare(iris, eye.aqueous_index, bands, ranges)
        response = checked_response(made, iris, eye.aqueous_index, bands, ranges)
        assert isinstance(response, SeparableResponse | RadiativeResponse)
        return cls(response, scales, iris, eye, (2, 2) if maps is None else maps.shape)

    def first(self, channels: int) -> "Matt":
        """The same in the first so many channels."""
        some = self.response.coefficients[..., :channels]
        return eqx.tree_at(lambda m: m.response.coefficients, self, some)

    def albedo(self) -> Float[Array, "angles radii channels"]:
        """Directional–hemispherical reflectance of each texel at normal incidence, in the aqueous
        humour.

        It has the shape of the maps; without maps (2, 2), every texel alike.
        """
        return _albedo(self.response, self.scales, self._given(1.0), self.shape)

    def entering(self, cosine: ArrayLike) -> Array:
        """Share of light that enters the tissue, 1 − F."""
        x = jnp.asarray(cosine, self.response.error.dtype)
        return _entering(self.iris, self.eye.aqueous_index, x)

    def brdf(
        self,
        cos_incidence: Float[Array, " incidences"],
        cos_exit: Float[Array, " exits"],
        azimuth: Float[Array, " azimuths"],
    ) -> Float[Array, "incidences exits azimuths channels"]:
        """BRDF of the uniform iris, 1/sr, azimuth 0 straight on."""
        one = Scales(*(None if s is None else jnp.ones(1, s.dtype) for s in self.scales))
        return _pairs(self.response, one, cos_incidence, cos_exit, azimuth)[..., 0]

    def _given(self, cosine):
        """The argument of the response's `hemispherical` for an incidence."""
        if isinstance(self.response, SeparableResponse):
            return self.entering(cosine)
        return jnp.asarray(cosine, self.response.error.dtype)

    def error(self) -> LambertError:
        """How far a Lambertian iris is from this one, from at most 2048 texels, of radiative
        transfer 128.
        """
        if isinstance(self.response, RadiativeResponse):
            texels, weight = self._some(128)
            flat = _power(self.response, texels, self._given(1.0)) / np.pi
            near, far = (_nodes(lowest, 8) for lowest in (np.cos(np.radians(CONE)), 0.0))
            within, whole = (
                np.asarray(_pairs(self.response, texels, *(jnp.asarray(x, flat.dtype) for x in v)))
                for v in ((near[0], near[0], _TURNS), (far[0], far[0], _TURNS))
            )
            return of_pairs(np.asarray(flat), weight, within, near[1], whole, far[1])
        response = self.response
        texels, weight = self._some(_TEXELS)
        power = _power(response, texels, self.entering(1.0))
        flat = np.asarray(power, np.float64) / np.pi  # (channels, texels)
        mean = flat @ weight

        def factors(cosine):  # of BRDF over mean Lambertian one: t(μ_i) and s(μ_o), of all texels
            t = np.asarray(self.entering(cosine), np.float64)
            x = jnp.asarray(cosine, response.error.dtype)
            s = np.asarray(_exits_of_all(response, texels, x), np.float64)
            return t, np.swapaxes(s, 0, 1) / mean[:, None, None]

        cosine, w = _nodes(np.cos(np.radians(CONE)), 24)
        t, all_s = factors(cosine)
        off = 1 / (t[:, None] * (all_s @ weight)[:, None, :]) - 1
        seen = flat / mean[:, None]
        # The mean over texels of (seen − t s)², for each incidence and exit, multiplied out.
        squares = (t[:, None] ** 2) * ((all_s**2) @ weight)[:, None, :]
        mixed = t[:, None] * np.einsum("ck,cok,k->co", seen, all_s, weight)[:, None, :]
        by_texel = ((seen**2) @ weight)[:, None, None] - 2 * mixed + squares
        by_texel = by_texel / (t[:, None] * (all_s @ weight)[:, None, :]) ** 2
        t, s = factors(np.cos(np.radians(np.linspace(0, CONE, 26))))
        most = (1 / (t[:, None] * (s @ weight)[:, None, :]) - 1).reshape(len(mean), -1)
        most = most[np.arange(len(mean)), np.abs(most).argmax(1)]
        rms, texel = (np.sqrt(np.einsum("cio,i,o->c", x, w, w)) for x in (off**2, by_texel))
        cosine, w = _nodes(0.0, 24)
        t, s = factors(cosine)
        whole = t[:, None] * (s @ weight)[:, None, :]
        average = np.einsum("cio,i,o->c", whole, w, w)
        return LambertError(
            rms, most, texel, np.sqrt(np.einsum("cio,i,o->c", (whole - 1) ** 2, w, w)) / average
        )

    def _some(self, most: int) -> tuple[Scales, np.ndarray]:
        """Scales of some texels, and weights by their area."""
        if all(s is None for s in self.scales):
            return Scales(), np.ones(1)
        rows, columns = self.shape
        step = max(1, round((rows * columns / most) ** 0.5))
        place = np.asarray(self.eye.from_axis(cell_centres(self.shape)[1]))
        weight = np.broadcast_to(place, self.shape)[::step, ::step].ravel()
        return Scales(
            *(None if s is None else s[::step, ::step].ravel() for s in self.scales)
        ), weight / weight.sum()


def of_pairs(
    flat: np.ndarray,
    weight: np.ndarray,
    within: np.ndarray,
    within_weight: np.ndarray,
    whole: np.ndarray,
    whole_weight: np.ndarray,
) -> LambertError:
    """`LambertError` of an iris whose BRDF is known for pairs of directions.

    Args:
        flat: BRDF of the Lambertian texels, (channels, texels); `weight` of each texel.
        within: BRDFs for cosines near the normal, (in, out, azimuths, channels, texels), with
            the cosines' weights; `whole`: the same over the hemisphere.
    """
    mean = flat @ weight

    def pairs(cosines):
        return (cosines[:, None] * cosines[None])[..., None, None]

    seen = within @ weight
    near = pairs(within_weight) / within.shape[2]
    off = mean / seen - 1
    by_texel = (flat - within) / seen[..., None]
    rows = off.reshape(-1, mean.size)
    most = rows[np.abs(rows).argmax(0), np.arange(mean.size)]
    ratio = (whole @ weight) / mean
    far = pairs(whole_weight) / whole.shape[2]
    average = (far * ratio).sum((0, 1, 2))
    return LambertError(
        rms=np.sqrt((near * off**2).sum((0, 1, 2))),
        most=most,
        texels=np.sqrt((near * (by_texel**2 @ weight)).sum((0, 1, 2))),
        hemisphere=np.sqrt((far * (ratio - 1) ** 2).sum((0, 1, 2))) / average,
    )


def _nodes(lowest: float, count: int):
    """Cosines between a lowest one and 1, weights in proportion to them."""
    x, w = np.polynomial.legendre.leggauss(count)
    cosine = lowest + (1 - lowest) * (x + 1) / 2
    return cosine, w * cosine / (w * cosine).sum()


@eqx.filter_jit
def _albedo(response, scales: Scales, given, shape: tuple[int, int]):
    def one(texels):
        return response.hemispherical(texels, given)

    if all(s is None for s in scales):
        found = one(scales)[:, 0]
        return jnp.broadcast_to(found, (*shape, found.size))
    texels = Scales(*(None if s is None else s.ravel() for s in scales))
    return in_portions(one, texels).T.reshape(*shape, -1)


@eqx.filter_jit
def _pairs(response, scales: Scales, incidence, exits, azimuth):
    """BRDF of each texel for all pairs of directions: (in, out, azimuths, channels, texels)."""
    one = next((jnp.ones_like(s) for s in scales if s is not None), jnp.ones(1, exits.dtype))
    shape = incidence.size, exits.size, azimuth.size
    every = [x.ravel() for x in jnp.meshgrid(incidence, exits, azimuth, indexing="ij")]
    found = jax.lax.map(lambda v: response.brdf(scales, *(x * one for x in v)), tuple(every))
    return found.reshape(*shape, *found.shape[1:])


@eqx.filter_jit
def _entering(iris: Iris, aqueous_index, cosine):
    n = iris.indices(aqueous_index)
    return fresnel_at(cosine, n.aqueous, n.abl)[1]


@eqx.filter_jit
def _exits_of_all(response: SeparableResponse, scales: Scales, cosines):
    """Radiance of every texel at each cosine, (cosines, channels, texels)."""
    one = next((jnp.ones_like(s) for s in scales if s is not None), jnp.ones(1, cosines.dtype))
    return jax.lax.map(lambda c: response(scales, c * one), cosines)


@eqx.filter_jit
def _power(response, scales: Scales, given):
    return response.hemispherical(scales, given)
