"""The iris as a matt surface, for renderers that know no other: the albedo of each texel, and how wrong it is.

ILIT's BRDF is (1 − F(μ_i)) g(μ_o): it does not ask whence light comes but for the first surface, and falls towards
grazing exits, the more the more the ABL absorbs. A Lambertian surface of the same power is its nearest relative.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax.optics.fresnel import fresnel_at
from irisjax.render.bands import Bands
from irisjax.render.chunks import in_chunks
from irisjax.render.separable import Response, Separable
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, Scales

CONE = 50.0
"""Angle (degrees) about the iris's normal that holds nearly all light and lines of sight behind a cornea."""


class LambertError(NamedTuple):
    """A Lambertian surface of the albedo against ILIT's response, channel by channel, shape (channels,).

    - `rms`: of the relative error over pairs of directions within `CONE` of the normal, in proportion to their
        cosines. `most`: the largest there, with its sign (negative: the Lambertian one is darker).
    - `hemisphere`: as `rms`, over all directions, relative to the mean BRDF.
    """

    rms: np.ndarray
    most: np.ndarray
    hemisphere: np.ndarray


def albedo(iris: Iris, maps: IrisMaps | None, bands: Bands, integrator: Separable) -> Float[Array, "angles radii c"]:
    """Directional–hemispherical reflectance at normal incidence of each texel, in the channels of `bands`.

    Without what the first surface mirrors; in the aqueous humour. With `colour_bands` linear sRGB of a white of
    (1, 1, 1) under their illuminant, with bands of unit weights the spectral reflectance. Shape (angles, radii,
    channels), that of the maps; without maps (2, 2, channels), every texel alike.
    """
    scales = Scales.of(maps, iris)
    ranges = scales.ranges()
    shape = (2, 2) if maps is None else maps.shape
    return _albedo(iris, scales, ranges, bands, integrator, shape)


def responding(iris: Iris, bands: Bands, integrator: Separable) -> Response:
    """The response of the uniform iris."""
    return _response(iris, bands, integrator)


def brdf_of(iris: Iris, response: Response, cos_incidence, cos_exit) -> Float[Array, "channels exits"]:
    """BRDF (1/sr) of the uniform iris in the channels of its response, without the first surface's mirror."""
    n = iris.indices()
    return fresnel_at(cos_incidence, n.aqueous, n.abl)[1] * response(Scales(), cos_exit)


def lambert_error(iris: Iris, response: Response) -> LambertError:
    """How far a Lambertian surface of the uniform iris's `albedo` is from its response."""
    n = iris.indices()
    flat = np.asarray(_entering(n, 1.0) * response.hemispherical(Scales()))[:, 0] / np.pi

    def ratio(cosine):  # the two factors of the BRDF over the Lambertian one
        return np.asarray(_entering(n, cosine)), np.asarray(response(Scales(), cosine)) / flat[:, None]

    def square(lowest):  # mean of (1 / (t s) − 1)² and of (t s − m)² / m², m the mean, over both cosines
        x, w = np.polynomial.legendre.leggauss(48)
        cosine = lowest + (1 - lowest) * (x + 1) / 2
        w = w * cosine / (w * cosine).sum()
        t, s = ratio(jnp.asarray(cosine))
        inverse = (w @ t**-2) * (s**-2 @ w) - 2 * (w @ t**-1) * (s**-1 @ w) + 1
        product = (w @ t**2) * (s**2 @ w)
        mean = (w @ t) * (s @ w)
        return inverse, (product - 2 * mean + 1) / mean**2

    t, s = ratio(jnp.cos(jnp.radians(jnp.linspace(0.0, CONE, 51))))
    off = 1 / (t[:, None] * s[:, None, :]) - 1
    off = off.reshape(len(s), -1)
    most = off[np.arange(len(s)), np.abs(off).argmax(1)]
    return LambertError(np.sqrt(square(np.cos(np.radians(CONE)))[0]), most, np.sqrt(square(0.0)[1]))


def _entering(n, cosine):
    return fresnel_at(cosine, n.aqueous, n.abl)[1]


@eqx.filter_jit
def _response(iris: Iris, bands: Bands, integrator: Separable) -> Response:
    return integrator.response(iris, bands, Scales())


@eqx.filter_jit
def _albedo(iris, scales: Scales, ranges: Scales, bands: Bands, integrator: Separable, shape: tuple[int, int]):
    response = integrator.response(iris, bands, ranges)
    n = iris.indices()
    entering = _entering(n, jnp.ones((), response.error.dtype))
    if all(s is None for s in scales):
        return jnp.broadcast_to(entering * response.hemispherical(scales)[:, 0], (*shape, len(bands.channels)))
    texels = Scales(*(None if s is None else s.ravel() for s in scales))
    return (entering * in_chunks(lambda found: response.hemispherical(found).T, texels)).reshape(*shape, -1)
