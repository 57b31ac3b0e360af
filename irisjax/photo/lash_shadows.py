"""Fine lashes and the shadows that lashes throw on an iris below a lid."""

import numpy as np
import skimage.filters
import skimage.measure
import skimage.morphology
from jaxtyping import Bool, Float
from scipy import ndimage

from irisjax.photo.ellipse import Ellipse
from irisjax.photo.filling import masked_mean
from irisjax.photo.unrefracted import LUMINANCE

Mask = Bool[np.ndarray, "rows columns"]

# In units of the limbus's radius.
_REACH = 0.4  # below a lid
_THIN, _AROUND = 0.004, 0.03  # of a streak and of what it is compared with
_SHORTEST, _WIDEST = 0.04, 0.035  # crypts, which are as dark, are wider
_CLEAR = 0.025, 0.05  # contrast, encoded
_ISLAND = 0.02  # share of the iris


def find_lash_shadows(
    pixels: Float[np.ndarray, "rows columns 3"], limbus: Ellipse, lids: Mask, clear: Mask
) -> Mask:
    """Thin dark streaks near a lid, fainter than a lash before the iris; none where no lid is.

    A furrow of the iris that looks like one is lost with them: the texture is filled there.
    `pixels`: linear; `clear`: pixels that show the iris as far as known.
    """
    if not lids.any() or not clear.any():
        return np.zeros_like(clear)
    radius = limbus.semi_axes[0]
    encoded = (np.clip(pixels @ LUMINANCE, 0, 1) ** np.float32(1 / 2.2)).astype(np.float32)
    around, there = (masked_mean(encoded, clear, s * radius) for s in (_AROUND, _THIN))
    away = np.asarray(ndimage.distance_transform_edt(~lids), np.float32)
    near = away < _REACH * radius
    streak = np.where(clear & near, (around - there) / np.maximum(around, 1e-3), 0)
    dark = skimage.filters.apply_hysteresis_threshold(streak, *_CLEAR)
    found = np.zeros_like(clear)
    for region in skimage.measure.regionprops(skimage.measure.label(dark)):
        long, wide = region.axis_major_length, region.axis_minor_length
        branched = region.solidity < 0.4
        slender = long > 4 * max(wide, 1.0) and wide < _WIDEST * radius
        if long > _SHORTEST * radius and (branched or (slender and _hangs(region, away))):
            found[tuple(region.coords.T)] = True
    margin = skimage.morphology.disk(max(1, round(0.008 * radius)))
    return np.asarray(skimage.morphology.dilation(found, margin))


def _hangs(region, away) -> bool:
    """Whether a streak runs away from the lid rather than along it, as fibres beside a pupil do."""
    rows, columns = region.coords.T
    along = away[rows, columns]
    return bool(np.ptp(along) > 0.5 * region.axis_major_length)


def without_islands(clear: Mask) -> Mask:
    """Without what is cut off from the rest: slivers along the edge of a lid."""
    label = np.asarray(skimage.measure.label(clear))
    size = np.bincount(label.ravel())
    size[0] = 0
    return clear & (size > _ISLAND * clear.sum())[label]
