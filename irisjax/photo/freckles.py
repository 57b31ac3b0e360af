"""Freckles and other spots of pigment, found by their colour."""

import numpy as np
import skimage.filters
import skimage.measure
import skimage.morphology
from jaxtyping import Bool, Float
from scipy import ndimage

from irisjax.photo.texture import Unrefracted, masked_mean

_SMALLEST, _LARGEST = 0.05, 1.5  # mm, diameters
_RING = 0.1  # mm, width of a ring with one median
_AROUND = 1.0  # mm, standard deviation of the neighbourhood
_BROWNER, _DARKER = 0.2, 0.1  # least differences of the logarithms
_STRONG, _WEAK = 5.0, 2.5  # differences in units of the usual scatter
_COMPACT = 0.5  # least share of a spot in its convex hull


def find_freckles(texture: Unrefracted) -> Bool[np.ndarray, "size size"]:
    """Find texels of spots that are darker and browner than their surroundings.

    Browner means more red against blue, a ratio that does not fall in shadows and crypts. Each
    texel is compared with the median at its radius, so that rings of pigment around the pupil are
    no freckles, and with a neighbourhood of 1 mm; the scatter of the texture itself sets the scale.
    Spots are 0.05 to 1.5 mm wide and compact. Without colours freckles cannot be distinguished from
    crypts: none are found.
    """
    valid = texture.valid
    none = np.zeros_like(valid)
    pixels = texture.pixels.astype(np.float32)
    if not valid.any() or _colourless(pixels[valid]):
        return none
    texel = texture.millimetres_per_texel
    smooth = ndimage.gaussian_filter(pixels, (0.3 * _SMALLEST / texel,) * 2 + (0,))
    luminance = texture._replace(pixels=smooth).luminance()
    dim = 0.02 * np.median(luminance[valid])
    if not dim > 0:
        return none
    brown = np.log(np.maximum(smooth[..., 0], 0) + dim) - np.log(
        np.maximum(smooth[..., 2], 0) + dim
    )
    dark = -np.log(np.maximum(luminance, 0) + dim)
    browner, usual_brown = _deviation(brown, texture)
    darker, usual_dark = _deviation(dark, texture)
    high = (browner > max(_BROWNER, _STRONG * usual_brown)) & (darker > max(_DARKER, usual_dark))
    low = (browner > max(_BROWNER / 2, _WEAK * usual_brown)) & (darker > 0)
    spots = skimage.filters.apply_hysteresis_threshold(
        (low & valid).astype(np.uint8) + (high & valid), 0.5, 1.5
    )
    return _of_size(spots, texel)


def _colourless(pixels: Float[np.ndarray, "texels 3"]) -> bool:
    """Whether the channels are in one proportion."""
    usual = np.median(pixels, 0)
    scale = np.maximum(pixels.max(-1, keepdims=True), 1e-6)
    return bool(np.median(np.ptp(pixels / scale, axis=-1)) < 0.01 or not usual.max() > 0)


def _deviation(values: np.ndarray, texture: Unrefracted) -> tuple[np.ndarray, float]:
    """Difference from the median at each radius and from the neighbourhood, and its robust
    scatter.
    """
    valid = texture.valid
    ring = (texture.radius() / _RING).astype(np.int32)
    found, count = ring[valid], ring.max() + 1
    order = np.argsort(found, kind="stable")
    parts = np.split(values[valid][order], np.searchsorted(found[order], np.arange(1, count)))
    known = [(i, np.median(part)) for i, part in enumerate(parts) if len(part)]
    centre, median = np.array(known).T
    profile = np.interp(texture.radius() / _RING - 0.5, centre, median).astype(np.float32)
    off = values - profile
    scatter = _scatter(off[valid])
    # Clipped: a spot must not raise what it is compared with.
    around = masked_mean(
        np.clip(off, -2 * scatter, 2 * scatter), valid, _AROUND / texture.millimetres_per_texel
    )
    off = off - around
    return off, _scatter(off[valid])


def _scatter(values: np.ndarray) -> float:
    """Standard deviation of the middle of a distribution, from its median absolute deviation."""
    return float(1.4826 * np.median(np.abs(values - np.median(values))))


def _of_size(spots: np.ndarray, texel: float) -> np.ndarray:
    """Connected parts that are as large and compact as freckles, grown by half the smallest
    size.
    """
    label = np.asarray(skimage.measure.label(np.asarray(ndimage.binary_fill_holes(spots))))
    keep = np.zeros(label.max() + 1, bool)
    for region in skimage.measure.regionprops(label):
        width = region.equivalent_diameter_area * texel
        if _SMALLEST <= width <= _LARGEST:
            keep[region.label] = region.axis_major_length * texel <= _LARGEST and (
                region.solidity >= _COMPACT
            )
    return skimage.morphology.dilation(
        keep[label], skimage.morphology.disk(max(1, round(0.5 * _SMALLEST / texel)))
    )
