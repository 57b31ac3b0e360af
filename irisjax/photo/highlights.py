"""What hides the iris in a photograph: highlights, lashes and lids.

All work on a part of the photograph around the iris, reduced to at most `RESOLUTION` pixels a side.
"""

import numpy as np
import skimage.filters
import skimage.measure
import skimage.morphology
import skimage.transform
from jaxtyping import Bool, Float
from scipy import ndimage

from irisjax.photo.ellipse import Ellipse
from irisjax.photo.unrefracted import LUMINANCE

RESOLUTION = 400
"""Pixels along the longer side of the picture in which they are sought."""
_SEEN_AROUND = 1.35  # of the limbus's semi-axes: where lashes come from
_CLEAR = 0.15, 0.35  # contrast of lashes: 99 % of the textures of simulated irides stay below 0.29
_OF_A_LID = 0.3  # of what differs has to look like the skin beyond: shadow and lashes do not

Pixels = Float[np.ndarray, "rows columns 3"]
Mask = Bool[np.ndarray, "rows columns"]


def find_highlights(pixels: Pixels, saturated: Mask, iris: Mask) -> Mask:
    """Pixels of the iris that show a mirror image of lamps, wet spots or the like.

    Saturated ones, and ones that are brighter than the median round about by more than the iris's
    own scatter, the excess having the light's colour; both with the glow around them. `pixels`:
    linear; `iris`: the ring between limbus and pupil, as far as it is known. Nothing is marked
    outside of it.
    """
    if not iris.any():
        return np.zeros_like(iris)
    part = _Part.around(iris)
    small, ring = part.reduced(pixels), part.reduced(iris) > 0.5
    cut_off = part.reduced(saturated & iris) > 0.1
    encoded = _encoded(small @ LUMINANCE)
    counted = ring & ~cut_off
    if not counted.any():
        return iris.copy()
    size = max(ring.shape)
    usual = _median(encoded, counted, max(3, round(0.06 * size)))
    excess = encoded - usual
    scatter = 1.4826 * np.median(np.abs(excess[counted]))
    white = _colourless(small - usual[..., None] ** 2.2, small)
    bright = (excess > max(5 * scatter, 0.15)) & white & ring
    glow = (excess > max(2.5 * scatter, 0.06)) & ring
    seeds = bright | cut_off
    found = skimage.filters.apply_hysteresis_threshold(
        (glow | seeds).astype(np.uint8) + seeds, 0.5, 1.5
    )
    # Fibres that touch a highlight are as bright as its glow; the glow itself is near.
    away = np.asarray(ndimage.distance_transform_edt(~seeds))
    found &= away <= max(2.0, 0.03 * size)
    found = skimage.morphology.dilation(found, skimage.morphology.disk(max(1, size // 200)))
    return (part.enlarged(found) | saturated) & iris


def find_lashes(pixels: Pixels, limbus: Ellipse, lids: Mask | None = None) -> Mask:
    """Thin dark or bright streaks that cross the limbus, and clear dark ones that hang from lids.

    Fibres and furrows of the iris end at the limbus and vessels of the white are faint, so a streak
    that is as clear outside as inside lies in front. `pixels`: linear, the whole photograph.
    `lids`: of `find_lids`.
    """
    part, radius, small = _around_limbus(pixels, limbus)
    if part is None or small is None:
        return np.zeros(pixels.shape[:2], bool)
    encoded = _encoded(small @ LUMINANCE)
    width = max(2, round(0.02 * max(radius.shape)))
    disk = skimage.morphology.disk(width)
    found = np.zeros(radius.shape, bool)
    near = radius < _SEEN_AROUND
    for streak in (
        np.asarray(ndimage.black_tophat(encoded, footprint=disk)),
        np.asarray(ndimage.white_tophat(encoded, footprint=disk)),
    ):
        # In units of what fibres, or vessels and skin, usually reach.
        within, without = radius < 1, near & (radius >= 1)
        usual = np.where(within, _usual(streak[within]), _usual(streak[without]))
        clear = skimage.filters.apply_hysteresis_threshold(near * streak / usual, 1.0, 1.5)
        label = np.asarray(skimage.measure.label(clear))
        for region in skimage.measure.regionprops(label):
            at = radius[tuple(region.coords.T)]
            if (at.min() < 0.95 and at.max() > 1.12) and _long(region):
                found[tuple(region.coords.T)] = True
    hidden = np.zeros(radius.shape, bool) if lids is None else part.reduced(lids) > 0.5
    iris = (radius > 0.6) & (radius < 1) & ~hidden
    if hidden.any() and iris.any():
        dark = np.asarray(ndimage.black_tophat(encoded, footprint=disk))
        found |= near & _hanging(dark / max(float(np.median(encoded[iris])), 1e-3), hidden)
    found = skimage.morphology.dilation(found, skimage.morphology.disk(1))
    return part.enlarged(found)


def _hanging(streak: np.ndarray, lids: np.ndarray) -> np.ndarray:
    """Long streaks that begin at a lid; `streak`: their contrast, encoded, over the iris's own."""
    clear = skimage.filters.apply_hysteresis_threshold(streak, *_CLEAR) & ~lids
    reach = skimage.morphology.dilation(lids, skimage.morphology.disk(4))
    found = np.zeros(lids.shape, bool)
    for region in skimage.measure.regionprops(skimage.measure.label(clear)):
        at = tuple(region.coords.T)
        if reach[at].any() and _long(region):
            found[at] = True
    return found


def _long(region) -> bool:
    """Whether a region is a streak or several that branch."""
    slender = region.axis_major_length > 4 * max(region.axis_minor_length, 1.0)
    return bool(slender or region.solidity < 0.4)


def find_lids(pixels: Pixels, limbus: Ellipse, pupil: Ellipse) -> Mask:
    """Pixels within the limbus that lids cover.

    The iris at its sides, where lids never reach, tells at each radius which brightness and colour
    are usual. Parts above and below that differ and reach the limbus are lids, where outside of it
    the surface of a good deal of them goes on; the rest is the lid's shadow, and what differs next
    to a lid is taken to be. Lids are marked with a small margin. A lid of the iris's own colour is
    not found, nor is any where light and shadow divide the eye.
    """
    part, radius, small = _around_limbus(pixels, limbus)
    if part is None or small is None:
        return np.zeros(pixels.shape[:2], bool)
    size = max(radius.shape)
    inside = part.reduced(pupil.mask(pixels.shape[:2])) < 0.5
    smooth = ndimage.gaussian_filter(small, (0.012 * size,) * 2 + (0,))
    light = np.log(np.maximum(smooth, 0) + 0.02 * max(float(np.median(smooth)), 1e-4))
    seen = np.concatenate(
        [light @ LUMINANCE[:, None], light[..., :1] - light[..., 2:]], -1
    )  # brightness and colour
    row, column = np.indices(radius.shape)
    x, y = part.small(limbus.centre)
    aside = np.abs(row - y) < 0.5 * np.abs(column - x)
    ring = np.minimum((radius * 20).astype(int), int(20 * _SEEN_AROUND))
    strange = np.zeros(radius.shape)
    for k in range(20):
        at = (ring == k) & inside
        known = seen[at & aside]
        if len(known) < 8:
            continue
        middle = np.median(known, 0)
        scatter = np.maximum(1.4826 * np.median(np.abs(known - middle), 0), 0.12)
        off = np.sqrt((((seen[at] - middle) / scatter) ** 2).sum(-1))
        strange[at] = off
    strange *= (radius < 1) & ~aside
    covered = skimage.filters.apply_hysteresis_threshold(strange, 2.5, 4.0)
    covered = skimage.morphology.opening(
        covered, skimage.morphology.disk(max(1, round(0.02 * size)))
    )
    label = np.asarray(skimage.measure.label(covered))
    keep = np.zeros(label.max() + 1, bool)
    for k in range(1, label.max() + 1):
        at = label == k
        if not (radius[at] > 0.93).any():
            continue
        beyond = skimage.morphology.dilation(at, skimage.morphology.disk(round(0.05 * size)))
        beyond &= (radius > 1.03) & (radius < 1.2)
        if beyond.any():
            step = np.abs(seen[at & (radius > 0.8)] - np.median(seen[beyond], 0)).max(-1)
            keep[k] = bool((step < 0.5).mean() > _OF_A_LID)
    found = keep[label]
    for k in np.flatnonzero(keep):
        found |= _beyond_edge(label == k, upper=bool(row[label == k].mean() < y))
    beside = skimage.morphology.dilation(found, skimage.morphology.disk(round(0.02 * size)))
    shadow = np.isin(label, np.setdiff1d(label[beside], 0))
    return part.enlarged(found | shadow) & limbus.mask(pixels.shape[:2])


class _Part:
    """A rectangle of the photograph and the smaller picture of it."""

    def __init__(self, shape: tuple[int, int], rows: slice, columns: slice):
        self.shape, self.rows, self.columns = shape, rows, columns
        self.size = rows.stop - rows.start, columns.stop - columns.start
        factor = min(1.0, RESOLUTION / max(self.size))
        self.small_size = tuple(max(1, round(n * factor)) for n in self.size)

    @classmethod
    def around(cls, mask: np.ndarray) -> "_Part":
        rows, columns = (np.flatnonzero(mask.any(axis)) for axis in (1, 0))
        return cls(mask.shape, slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))

    def small(self, place: tuple[float, float]) -> tuple[float, float]:
        """Column and row in the smaller picture."""
        x, y = place[0] - self.columns.start, place[1] - self.rows.start
        return (
            (x + 0.5) * self.small_size[1] / self.size[1] - 0.5,
            (y + 0.5) * self.small_size[0] / self.size[0] - 0.5,
        )

    def reduced(self, picture: np.ndarray) -> np.ndarray:
        part = picture[self.rows, self.columns].astype(np.float32)
        whole = self.small_size + part.shape[2:]
        return skimage.transform.resize_local_mean(part, whole)

    def enlarged(self, mask: np.ndarray) -> np.ndarray:
        row, column = (
            np.arange(n) * m // n for n, m in zip(self.size, self.small_size, strict=True)
        )
        whole = np.zeros(self.shape, bool)
        whole[self.rows, self.columns] = mask[row[:, None], column]
        return whole


def _around_limbus(pixels: np.ndarray, limbus: Ellipse):
    """The part of the photograph round the limbus, the relative radius there and its pixels."""
    (x, y), reach = limbus.centre, _SEEN_AROUND * limbus.semi_axes[0]
    rows, columns = pixels.shape[:2]
    box = [
        slice(max(0, int(c - reach)), min(n, int(c + reach) + 1))
        for c, n in ((y, rows), (x, columns))
    ]
    if any(b.stop - b.start < 16 for b in box):
        return None, np.zeros((0, 0)), None
    part = _Part((rows, columns), *box)
    at = [
        b.start + (np.arange(n) + 0.5) * (size / n) - 0.5
        for b, n, size in zip(box, part.small_size, part.size, strict=True)
    ]
    return part, limbus.relative_radius(at[1][None, :], at[0][:, None]), part.reduced(pixels)


def _beyond_edge(lid: np.ndarray, upper: bool) -> np.ndarray:
    """All that lies beyond the edge of a lid, which is continued as a parabola: at its ends the
    limbus's blur hides it.
    """
    columns = np.flatnonzero(lid.any(0))
    if len(columns) < 0.15 * lid.shape[1]:  # too short to tell how it goes on
        return lid
    rows = [np.flatnonzero(lid[:, c])[-1 if upper else 0] for c in columns]
    edge = np.poly1d(np.polyfit(columns, rows, 2))(np.arange(lid.shape[1]))
    row = np.arange(len(lid))[:, None]
    return row <= edge if upper else row >= edge


def _usual(streak: np.ndarray) -> float:
    """What all but the clearest streaks of a texture stay below."""
    return max(1.5 * float(np.quantile(streak, 0.75)), 0.08) if streak.size else 0.08


def _encoded(luminance: np.ndarray) -> np.ndarray:
    """Roughly as a screen wants it, so that equal steps look equal."""
    return np.clip(luminance, 0, 1) ** np.float32(1 / 2.2)


def _median(values: np.ndarray, counted: np.ndarray, radius: int) -> np.ndarray:
    """Of the counted pixels within a radius, to 1/255."""
    levels = np.round(255 * values).astype(np.uint8)
    disk = skimage.morphology.disk(radius)
    return skimage.filters.rank.median(levels, disk, mask=counted.astype(np.uint8)) / 255


def _colourless(excess: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Whether what comes on top of the usual is about white, or cut off."""
    top = excess.max(-1)
    return (np.ptp(excess, axis=-1) < 0.6 * np.maximum(top, 1e-6)) | (pixels.min(-1) > 0.8)
