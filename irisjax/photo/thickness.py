"""Freckles, and thickness of the stroma: what is brighter is thicker  [F09 Section 4.2]."""

import math
from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy.fft
from jaxtyping import Float
from scipy import ndimage

from irisjax.anatomy.eye import Eye
from irisjax.grow.procedural import stroma_profile
from irisjax.measure.colour import srgb_encode
from irisjax.numerics.checks import Range, check_range
from irisjax.photo.masks import find_freckles
from irisjax.photo.photograph import Brightness, Mask
from irisjax.photo.texture import MAP_SHAPE, Unrefracted, fill_holes, gaussian_mean, masked_mean
from irisjax.tissue.maps import IrisMaps

MEASURED = Range(2.25, 5.0, "mm")
"""Distances from the axis between which the iris's thickness was measured  [F09 Fig. 8]."""
SIGMA = 0.5
"""Width of the blur by scattering within the tissue, mm  [F09 Section 4.2.1]."""
BETA = 0.350
"""Thickness per encoded pixel value from 0 to 1, mm  [F09 Section 4.2.1]."""
_WIDTH = 0.8  # standard deviation of the neighbourhood whose mean Eq. 5 subtracts, mm
THINNEST = 0.03  # least thickness of the map, mm: the bottom of a deep crypt
_THICKEST = 1.5  # greatest thickness of the map that luminance and a response give, mm
SHADE_WIDTH, SHADE_SHARE = 0.4, 0.5
"""Width of the neighbourhood in the shade, mm, and share of the contrast there that is attributed
to thickness. Light that falls off within less than a millimetre makes contrast as thickness does;
in simulated photographs the two correlate by 0.3 to 0.5 in the shade, and by 0.8 to 0.9 elsewhere.
"""
# Other sources of contrast: standard deviation of ln luminance by pigment, vessels and folds (about
# 0.05) over that of ln thickness (about 0.2), both assumed.
_OTHER_CONTRAST = 0.25
_MID_GREY = 0.18  # linear luminance to which the surroundings of each texel are exposed
_RESPONSES = Range(-5, 5)  # next to 0 where the stroma is opaque
_NOISE_WIDTH = 0.05  # mm, of the Gaussian along the radius that removes the sensor's noise
_ARC_LENGTH, _ARC_WIDTH = 0.7, 0.05  # mm, of the neighbourhood along an arc and across it
ARC_LIGHT = 0.75
"""Standard deviation of the light's variation in ln luminance along arcs over that of ln thickness
along them. Assumed, and like the lengths above chosen on the simulated photographs of the package.
"""
_LEAST_ARC_WEIGHT = 1e-3
_BLUR = 0.02  # standard deviation of the Gaussian that smooths freckles against noise, mm


class Morphology(NamedTuple):
    """The iris's shape as estimated from a photograph.

    Attributes:
        maps: `stroma_depth`, and `freckles` if there are any; the ABL is equally thick everywhere.
        deconvolved: Pixel values less their mean [F09 Eq. 5] after deconvolution [F09 Eq. 6]; 0
            where the texture is not valid.
        thickness: Thickness of the stroma, mm [F09 Eq. 7], complete.
        clamped: Number of valid texels whose thickness was outside the allowed range.
        sigma_mm: Width of the deconvolution.
        response: d ln luminance / d ln thickness with which the thickness was estimated; `None` if
            it comes from Eq. 7 or was given.
    """

    maps: IrisMaps
    deconvolved: Brightness
    thickness: Brightness
    clamped: int
    sigma_mm: float
    response: float | None = None


def shape_maps(
    texture: Unrefracted,
    freckles: Mask | None = None,
    *,
    sigma_mm: float = SIGMA,
    beta: float = BETA,
    response: float | None = None,
    shade: Mask | None = None,
    darkness: Float[np.ndarray, "2 shares"] | None = None,
    shape: tuple[int, int] = MAP_SHAPE,
) -> Morphology:
    """Find and fill freckles, and estimate the thickness from what is left  [F09 Section 4.2].

    Args:
        texture: The iris laid flat.
        freckles: The user's mask, in place of `find_freckles`.
        sigma_mm: Width of the deconvolution.
        beta: Thickness per encoded pixel value, mm  [F09 Eq. 7].
        response: The model's response, used by `relative_thickness` in place of `beta` and Eq. 7;
            the photograph is then taken as linear luminance.
        shade: Texels that lamps hardly reach; used with `response`.
        darkness: Shares of a freckle and the luminance of each over the iris's own, which falls
            with the share; without it freckles are whole.
        shape: Angles and radii of the maps.
    """
    valid, texel = texture.valid, texture.millimetres_per_texel
    freckles = freckle_mask(texture, freckles)
    filled = fill_holes(texture.pixels, ~(valid & ~freckles))
    # Filled freckles and small holes take part; texels outside the iris do not.
    used = valid | freckles
    luminance = texture._replace(pixels=filled).luminance()
    if response is None:
        relative = relative_luminance(luminance, used, _WIDTH, texel)
        normalised = local_normalisation(encoded_intensity(relative), used, _WIDTH, texel)
        estimate = partial(f09_thickness, beta=beta)
    else:
        normalised = local_contrast(luminance, used, shade, texel)
        normalised = remove_arcs(normalised, used, texture, response)
        estimate = partial(relative_thickness, response=response)
    normalised = np.maximum(normalised, np.float32(-0.99))
    deconvolved = deconvolve(normalised, used, sigma_mm, texel)
    thickness, clamped = estimate(texture.radius(), fill_holes(deconvolved, ~used))
    spots = freckles.astype(np.float32)
    if darkness is not None:
        # The share that makes the filled luminance as dark as the one seen, at most the greatest.
        ratio = texture.luminance() / np.maximum(luminance, 1e-6)
        ratio = np.where(freckles, ratio, 1).astype(np.float32)
        ratio = ndimage.gaussian_filter(ratio, _BLUR / texel)
        falling = np.minimum.accumulate(darkness[1])
        spots *= np.interp(ratio, falling[::-1], darkness[0][::-1]).astype(np.float32)
    maps = IrisMaps(stroma_depth=jnp.asarray(texture.to_polar(thickness, shape)))
    if freckles.any():  # limited against the rounding of means
        maps = maps.replace(freckles=jnp.asarray(np.clip(texture.to_polar(spots, shape), 0, 1)))
    count = int((clamped & used).sum())
    return Morphology(maps, deconvolved, thickness, count, sigma_mm, response)


def freckle_mask(texture: Unrefracted, given: Mask | None = None) -> Mask:
    """Return the user's mask of freckles or that of `find_freckles`; `ValueError` if it has another
    shape or leaves nothing of the iris.
    """
    freckles = find_freckles(texture) if given is None else given
    if freckles.shape != texture.valid.shape:
        raise ValueError(f"the freckle mask is {freckles.shape}, the texture {texture.valid.shape}")
    if not (texture.valid & ~freckles).any():
        raise ValueError("the texture has no texel that shows the iris beside freckles")
    return freckles


def smooth_maps(eye: Eye) -> IrisMaps:
    """Return the generic thickness of an eye's iris, without any texture."""
    share = (np.arange(MAP_SHAPE[1]) + 0.5) / MAP_SHAPE[1]
    depth = generic_thickness(np.asarray(eye.from_axis(jnp.asarray(share))))
    return IrisMaps(stroma_depth=jnp.asarray(np.broadcast_to(depth, MAP_SHAPE)))


def remove_arcs(
    contrast: Brightness, valid: Mask, texture: Unrefracted, response: float
) -> Brightness:
    """Return the contrast of luminance smoothed along the radius, less what an arc about the axis
    has in common beyond the whole ring; 0 where not valid.

    Fibres run along the radius, and the collarette all the way round. The shadows of lids and
    limbus and the caustics of the cornea run along the limbus on one side of it, and so does a
    furrow, which is removed with the light; a round crypt 0.5 mm wide loses up to a quarter. The
    share removed is the linear estimate of least mean square error, `ARC_LIGHT`² / (`ARC_LIGHT`² +
    response²): 0.7 to 0.9 in a brown iris, 0.6 in a blue one.
    """
    inner, outer, texel = texture.pupil_radius, texture.iris_radius, texture.millimetres_per_texel
    angles = 64 * math.ceil(2 * math.pi * outer / texel / 64)  # Fourier transforms are fast
    radii = max(2, math.ceil((outer - inner) / texel))
    masked = (np.where(valid, v, np.float32(0)) for v in (contrast, valid))
    cells = [texture.to_polar(v, (angles, radii)) for v in masked]
    size = (outer - inner) / radii

    def along_radius(width):
        return [ndimage.gaussian_filter1d(c, width / size, mode="constant") for c in cells]

    smooth = _weighted_mean(*along_radius(_NOISE_WIDTH))
    values, weights = along_radius(_ARC_WIDTH)
    ring = _weighted_mean(values.sum(0), weights.sum(0))
    radius = inner + size * (np.arange(radii) + 0.5)
    frequency = np.arange(angles // 2 + 1, dtype=np.float32)[:, None]
    transfer = np.exp(-0.5 * (frequency * (_ARC_LENGTH / radius).astype(np.float32)) ** 2)

    def over_arcs(c):
        spectrum = np.asarray(scipy.fft.rfft(c, axis=0))
        return np.asarray(scipy.fft.irfft(spectrum * transfer, angles, axis=0))

    weight = over_arcs(weights)
    arc = np.where(weight < _LEAST_ARC_WEIGHT, 0, _weighted_mean(over_arcs(values), weight) - ring)
    share = np.float32(ARC_LIGHT**2 / (ARC_LIGHT**2 + response**2))
    result = texture.from_polar(smooth - share * arc)
    return np.where(valid, result, np.float32(0)).astype(np.float32)


def generic_thickness(radius: np.ndarray) -> np.ndarray:
    """Return the stroma's thickness (mm) of an average iris at distances from the axis (mm)  [F09
    Section 4.2.1].

    It is the quadratic through ultrasound's 0.645, 0.457 and 0.372 mm at 2.25, 3.5 and 5 mm, less
    0.07 mm of IPE and 0.05675 mm of ABL. It is constant inside and outside of these radii: 0.645 mm
    is the thickest place of an iris, where the quadratic would reach 1.3 mm, and it would rise
    again beyond 5.08 mm.
    """
    clipped = np.clip(np.asarray(radius, np.float32), MEASURED.low, MEASURED.high)
    return stroma_profile((clipped - 2.0) / 3.5)


def encoded_intensity(relative: Brightness) -> Brightness:
    """Return the pixel values of a photograph whose surroundings are exposed to mid-grey; 0.46
    where `relative` luminance is 1.

    β of Eq. 7 refers to encoded values in [0, 1]. They pass 1 where a texel is over 5.5 times as
    bright as its surroundings.
    """
    return np.asarray(srgb_encode(_MID_GREY * np.maximum(relative, np.float32(0))), np.float32)


def relative_luminance(
    luminance: Brightness, valid: Mask, width_mm: float, texel: float
) -> Brightness:
    """Return linear luminance over its mean around each texel; 1 where not valid or black: neither
    the exposure nor a shadow that falls across the eye shows.
    """
    surroundings = masked_mean(luminance, valid, width_mm / texel)
    usable = valid & (surroundings > 1e-6)
    return np.where(usable, luminance / np.where(usable, surroundings, 1), 1).astype(np.float32)


def local_contrast(
    luminance: Brightness, valid: Mask, shade: Mask | None, texel: float
) -> Brightness:
    """Return the contrast of linear luminance to its mean around each texel; 0 where not valid.

    Texels in the `shade`, where lamps hardly reach, and those beside it are compared each with
    their own kind only, for light falls off steeply between them.
    """
    shade = np.zeros_like(valid) if shade is None else shade & valid
    contrast = np.zeros(valid.shape, np.float32)
    regions = (valid & ~shade, _WIDTH, 1.0), (shade, SHADE_WIDTH, SHADE_SHARE)
    for region, width, share in regions:
        if region.any():
            relative = relative_luminance(luminance, region, width, texel)
            normalised = local_normalisation(relative, region, width, texel)
            contrast[region] = np.float32(share) * normalised[region]
    return contrast


def local_normalisation(
    values: Brightness, valid: Mask, width_mm: float, texel: float
) -> Brightness:
    """Return `values` less their mean around each texel; 0 where not valid  [F09 Eq. 5].

    The neighbourhood is a Gaussian of standard deviation `width_mm`; only valid texels count.
    """
    mean = masked_mean(values, valid, width_mm / texel)
    return np.where(valid, values - mean, np.float32(0)).astype(np.float32)


def deconvolve(
    normalised: Brightness, valid: Mask, sigma_mm: float, texel: float, iterations: int = 10
) -> Brightness:
    """Sharpen a texture by Richardson's and Lucy's method with a Gaussian of `sigma_mm`  [F09 Eq.
    6].

    The method needs positive values: an offset of 1 is added and removed again. It starts from the
    texture itself, so details finer than the Gaussian are kept; more iterations sharpen noise.
    Texels that are not valid are filled first and then left out of the comparison. The mean over
    the valid ones is kept; the result is 0 elsewhere. scikit-image has neither a mask nor a start.
    """
    check_range("sigma_mm", sigma_mm, Range(0, 2, "mm"))
    check_range("values to deconvolve", normalised[valid], Range(-1, np.inf, above=True))
    if not valid.any():
        raise ValueError("no texel is valid: there is nothing to deconvolve")
    if sigma_mm == 0:
        return np.where(valid, normalised, np.float32(0))
    sigma = sigma_mm / texel
    (box,) = ndimage.find_objects(valid.astype(np.uint8))
    part, margin = valid[box], int(np.ceil(3 * sigma))
    padded = np.pad(part, margin)
    # The tissue continues beyond the visible part: without it the edges would seem dark.
    light = np.pad(fill_holes(1 + normalised[box].astype(np.float32), ~part), margin, mode="edge")
    blur = partial(gaussian_mean, sigma=sigma, margin=False)
    weight = blur(padded)
    weighted = weight > 1e-3
    estimate = light
    for _ in range(iterations):
        blurred = np.maximum(blur(estimate), np.float32(1e-6))
        ratio = blur(np.where(padded, light / blurred, 0)) / np.where(weighted, weight, 1)
        estimate = np.where(weighted, estimate * ratio, estimate)
    sharpened = estimate[padded] - np.float32(1)
    offset = normalised[valid].mean(dtype=np.float64) - sharpened.mean(dtype=np.float64)
    deconvolved = np.zeros(valid.shape, np.float32)
    deconvolved[valid] = sharpened + np.float32(offset)
    return deconvolved


def f09_thickness(
    radius: Brightness, deconvolved: Brightness, beta: float = BETA
) -> tuple[Brightness, Mask]:
    """Return the thickness (mm), and the texels that were clamped to `THINNEST`  [F09 Eq. 7]."""
    check_range("beta", beta, Range(0, 5, "mm"))
    thickness = generic_thickness(radius) + np.float32(beta) * deconvolved
    return np.maximum(thickness, np.float32(THINNEST)), thickness < THINNEST


def relative_thickness(
    radius: Brightness, contrast: Brightness, response: float
) -> tuple[Brightness, Mask]:
    """Return, in place of Eq. 7, the generic thickness times (1 + contrast)^g, g = response /
    (response² + 0.25²), and the texels that were clamped.

    If all contrast came from thickness, g would be 1 / response. This is the linear estimate of
    least mean square error, which gives little where thickness hardly shows. The response is d ln
    luminance / d ln thickness of the model (ILIT: 0.6 for a blue iris, 0.5 for a green one, 0.2 to
    0.3 for a brown one); F09's β corresponds to about 5.
    """
    check_range("response", response, _RESPONSES)
    power = response / (response**2 + _OTHER_CONTRAST**2)
    factor = np.maximum(1 + contrast, np.float32(1e-3)) ** np.float32(power)
    thickness = generic_thickness(radius) * factor
    clamped = (thickness < THINNEST) | (thickness > _THICKEST)
    return np.clip(thickness, THINNEST, _THICKEST), clamped


def _weighted_mean(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Means by their weights; 0 where there is no weight."""
    empty = weights < _LEAST_ARC_WEIGHT
    return np.where(empty, 0, values / np.where(empty, 1, weights))
