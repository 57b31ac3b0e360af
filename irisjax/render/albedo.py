"""The iris as a matt surface, for renderers that know no other: the albedo of each texel, and how
wrong it is.

ILIT's BRDF is (1 − F(μ_i)) g(μ_o): it does not ask whence light comes but for the first surface,
and falls towards grazing exits, the more the more the ABL absorbs. A Lambertian surface of the same
power is its nearest relative.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax.anatomy.eye import Eye
from irisjax.numerics.portions import in_portions
from irisjax.numerics.programs import program
from irisjax.optics.fresnel import fresnel_at
from irisjax.render.bands import Bands
from irisjax.render.separable import Separable, SeparableResponse
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, Scales, cell_centres

CONE = 50.0
"""Angle (degrees) about the iris's normal that holds nearly all light and lines of sight behind a
cornea.
"""
_TEXELS = 2048


class LambertError(NamedTuple):
    """A Lambertian iris of the albedo against ILIT's, relative, channel by channel, shape
    (channels,).

    - `rms`: of the whole iris's mean radiance, over pairs of directions within `CONE` of the normal
        in proportion to their cosines. `most`: the largest there, with its sign (negative: the
        Lambertian one is darker).
    - `texels`: r.m.s. over texels too, relative to the mean radiance of the iris.
    - `hemisphere`: as `rms`, over all directions, relative to the mean BRDF.
    """

    rms: np.ndarray
    most: np.ndarray
    texels: np.ndarray
    hemisphere: np.ndarray


class Matt(eqx.Module):
    """An iris ready to be asked for its albedo; make one with `of`. Without what the first surface
    mirrors.
    """

    response: SeparableResponse
    scales: Scales
    iris: Iris
    eye: Eye
    shape: tuple[int, int] = eqx.field(static=True)

    @classmethod
    def of(
        cls, iris: Iris, maps: IrisMaps | None, eye: Eye, bands: Bands, integrator: Separable
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
        response = _response(iris, eye.aqueous_index, bands, ranges, integrator)
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
        return _albedo(self.response, self.scales, self.entering(1.0), self.shape)

    def entering(self, cosine) -> Array:
        """Share of light that enters the tissue, 1 − F."""
        x = jnp.asarray(cosine, self.response.error.dtype)
        return _entering(self.iris, self.eye.aqueous_index, x)

    def brdf(
        self, cos_incidence: Float[Array, "..."], cos_exit: Float[Array, " exits"]
    ) -> Float[Array, "... channels exits"]:
        """BRDF of the uniform iris, 1/sr; the same for all azimuths."""
        one = Scales(*(None if s is None else jnp.ones_like(cos_exit) for s in self.scales))
        return self.entering(cos_incidence)[..., None, None] * _exits(self.response, one, cos_exit)

    def error(self) -> LambertError:
        """How far a Lambertian iris is from this one, from at most 2048 texels."""
        texels, weight = self._some()
        power = _power(self.response, texels)
        flat = np.asarray(self.entering(1.0) * power, np.float64) / np.pi  # (channels, texels)
        mean = flat @ weight

        def factors(cosine):  # of BRDF over mean Lambertian one: t(μ_i) and s(μ_o), of all texels
            t = np.asarray(self.entering(cosine), np.float64)
            x = jnp.asarray(cosine, self.response.error.dtype)
            s = np.asarray(_exits_of_all(self.response, texels, x), np.float64)
            return t, np.swapaxes(s, 0, 1) / mean[:, None, None]

        def nodes(lowest):
            x, w = np.polynomial.legendre.leggauss(24)
            cosine = lowest + (1 - lowest) * (x + 1) / 2
            return cosine, w * cosine / (w * cosine).sum()

        cosine, w = nodes(np.cos(np.radians(CONE)))
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
        cosine, w = nodes(0.0)
        t, s = factors(cosine)
        whole = t[:, None] * (s @ weight)[:, None, :]
        average = np.einsum("cio,i,o->c", whole, w, w)
        return LambertError(
            rms, most, texel, np.sqrt(np.einsum("cio,i,o->c", (whole - 1) ** 2, w, w)) / average
        )

    def _some(self) -> tuple[Scales, np.ndarray]:
        """Scales of some texels, and weights by their area."""
        if all(s is None for s in self.scales):
            return Scales(), np.ones(1)
        rows, columns = self.shape
        step = max(1, round((rows * columns / _TEXELS) ** 0.5))
        place = np.asarray(self.eye.from_axis(cell_centres(self.shape)[1]))
        weight = np.broadcast_to(place, self.shape)[::step, ::step].ravel()
        return Scales(
            *(None if s is None else s[::step, ::step].ravel() for s in self.scales)
        ), weight / weight.sum()


@program
def _response(iris, aqueous_index, bands, ranges, integrator: Separable) -> SeparableResponse:
    return integrator.response(iris, aqueous_index, bands, ranges)


@program
def _albedo(response: SeparableResponse, scales: Scales, entering, shape: tuple[int, int]):
    if all(s is None for s in scales):
        found = entering * response.hemispherical(scales)[:, 0]
        return jnp.broadcast_to(found, (*shape, found.size))
    texels = Scales(*(None if s is None else s.ravel() for s in scales))
    return (entering * in_portions(response.hemispherical, texels)).T.reshape(*shape, -1)


@program
def _entering(iris: Iris, aqueous_index, cosine):
    n = iris.indices(aqueous_index)
    return fresnel_at(cosine, n.aqueous, n.abl)[1]


@program
def _exits(response: SeparableResponse, scales: Scales, cosine):
    return response(scales, cosine)


@program
def _exits_of_all(response: SeparableResponse, scales: Scales, cosines):
    """Radiance of every texel at each cosine, (cosines, channels, texels)."""
    one = next((jnp.ones_like(s) for s in scales if s is not None), jnp.ones(1, cosines.dtype))
    return jax.lax.map(lambda c: response(scales, c * one), cosines)


@program
def _power(response: SeparableResponse, scales: Scales):
    return response.hemispherical(scales)
