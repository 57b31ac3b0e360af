"""The part of a photograph that shows the eye, and masks of what hides the iris in it."""

import math
from typing import NamedTuple

import numpy as np
import skimage.filters
import skimage.measure
import skimage.morphology
import skimage.transform
from jaxtyping import Bool, Float
from scipy import ndimage

from irisjax.photo.edges import by_channel
from irisjax.photo.photograph import Ellipse, Photograph
from irisjax.photo.texture import HALF_WIDTH, LUMINANCE_WEIGHTS, TEXTURE_SIZE, masked_mean
from irisjax.render.project import MirrorPixels, View, onto_picture

MOST_ACROSS = 1100
"""Most pixels across the iris; larger pictures are averaged."""
_RESOLUTION = 400  # px along the longer side of the picture in which masks are sought
_SEEN_AROUND = 1.35  # semi-axes of the limbus within which lashes begin
# Contrast of lashes: 99 % of the textures of simulated irides stay below 0.29.
_LASH_CLEAR = 0.15, 0.35
_OF_A_LID = 0.3  # least share of a lid that looks like the skin beyond; shadow and lashes do not
_Pixels = Float[np.ndarray, "rows columns 3"]
_Mask = Bool[np.ndarray, "rows columns"]
# Shadows of lashes, in units of the limbus's radius:
_REACH = 0.4  # distance from a lid
_STREAK, _STREAK_AROUND = 0.004, 0.03  # widths of a streak and of its surroundings
_SHORTEST, _WIDEST = 0.04, 0.035  # crypts, which are as dark, are wider
_CLEAR = 0.025, 0.05  # encoded contrast
_ISLAND = 0.02  # share of the iris below which a separate part is dropped
# The mirror image of the face:
_FACE_ANGLE = 90.0  # degrees from the eye's axis beyond which a mirrored line ends on the face
_FACE_SHARE = 0.1  # share of a pixel's light above which the mirror image hides the iris
_AROUND = 1.03, 1.25  # of the limbus: white and skin, as bright as what is mirrored
_SMOOTH = 0.01  # of the limbus's radius, against noise


class Part(NamedTuple):
    """A square of a photograph about the limbus.

    Attributes:
        pixels: Linear pixels; one is the mean of `reduction` × `reduction` of the photograph's.
        saturated: Pixels that may be cut off.
        outside: Pixels beyond the photograph.
        limbus: The outline on these pixels.
        reduction: Pixels of the photograph along each side of one of these.
        corner: Column and row in the photograph of the first pixel.
    """

    pixels: Float[np.ndarray, "side side 3"]
    saturated: Bool[np.ndarray, "side side"]
    outside: Bool[np.ndarray, "side side"]
    limbus: Ellipse
    reduction: int
    corner: tuple[int, int]

    def moved(self, outline: Ellipse) -> Ellipse:
        """Return an outline of the photograph on these pixels."""
        return outline.moved(-self.corner[0], -self.corner[1]).scaled(1 / self.reduction)

    def lids(self, pupil: Ellipse) -> Bool[np.ndarray, "side side"]:
        """Return the pixels within the limbus that lids cover; `pupil` is an outline on these
        pixels.
        """
        return find_lids(self.pixels, self.limbus, pupil)

    def clear(
        self, pupil: Ellipse, lids: Bool[np.ndarray, "side side"]
    ) -> Bool[np.ndarray, "side side"]:
        """Return the pixels between a pupil (an outline on these pixels) and the limbus that show
        the iris: no highlight, lash or lid.
        """
        ring = self.limbus.mask(self.outside.shape) & ~pupil.mask(self.outside.shape)
        covered = find_highlights(self.pixels, self.saturated & ring, ring)
        covered |= lids | find_lashes(self.pixels, self.limbus, lids)
        clear = ring & ~covered & ~self.outside
        clear &= ~find_lash_shadows(self.pixels, self.limbus, lids, clear)
        return without_islands(clear)


def pixels_shown(
    view: View, visible: Bool[np.ndarray, "size size"], shape: tuple[int, int]
) -> Bool[np.ndarray, "rows columns"]:
    """Return the pixels of the part that show what a mask of the flat iris marks as visible.

    Raises:
        ValueError: If the mask has another size than the texture.
    """
    size = TEXTURE_SIZE
    if visible.shape != (size, size):
        raise ValueError(f"the mask of what is visible is {visible.shape}, not {(size, size)}")
    seen = view.iris
    if seen is None:
        return np.zeros(shape, bool)
    x, y = (np.asarray(c) for c in seen.point[:2])
    texel = 2 * HALF_WIDTH / size
    column, row = (np.clip(((c + HALF_WIDTH) / texel).astype(int), 0, size - 1) for c in (x, -y))
    return onto_picture(seen, visible[row, column].astype(np.float32), shape) > 0.5


def find_mirrored_face(
    pixels: Float[np.ndarray, "rows columns 3"],
    outside: _Mask,
    limbus: Ellipse,
    mirror: MirrorPixels | None,
) -> _Mask:
    """Find pixels in which the mirror image of the face makes more than a tenth of the light.

    The tear film mirrors more the more grazing it is seen, up to a sixth of the light at the rim of
    an eye that is turned by 30 degrees. An eye that looks into the camera has no such pixel.

    Args:
        pixels: Linear pixels of the camera's picture.
        outside: Pixels beyond the photograph.
        limbus: Outline on these pixels.
        mirror: Directions that the tear film mirrors.
    """
    shape = pixels.shape[:2]
    if mirror is None:
        return np.zeros(shape, bool)
    row, column = np.ogrid[: shape[0], : shape[1]]
    radius = limbus.relative_radius(column, row)
    inside, around = radius < 1, (radius > _AROUND[0]) & (radius < _AROUND[1]) & ~outside
    back = onto_picture(mirror, np.asarray(mirror.mirror[2]), shape)
    reflectance = onto_picture(mirror, np.asarray(mirror.reflectance), shape)
    face = inside & (back > -np.cos(np.radians(_FACE_ANGLE))) & (reflectance > 0)
    if not (face.any() and around.any()):
        return np.zeros(shape, bool)
    luminance = pixels @ LUMINANCE_WEIGHTS
    seen = masked_mean(luminance, inside, _SMOOTH * limbus.semi_axes[0])
    return face & (reflectance * np.median(luminance[around]) > _FACE_SHARE * seen)


def find_lash_shadows(
    pixels: Float[np.ndarray, "rows columns 3"], limbus: Ellipse, lids: _Mask, clear: _Mask
) -> _Mask:
    """Find thin dark streaks near a lid that are fainter than a lash in front of the iris; none
    without a lid.

    A furrow of the iris that looks like one is lost with them: the texture is filled there.

    Args:
        pixels: Linear pixels.
        limbus: Outline in them.
        lids: Result of `find_lids`.
        clear: Pixels that show the iris as far as known.
    """
    if not lids.any() or not clear.any():
        return np.zeros_like(clear)
    radius = limbus.semi_axes[0]
    encoded = _encoded(pixels @ LUMINANCE_WEIGHTS).astype(np.float32)
    around, there = (masked_mean(encoded, clear, s * radius) for s in (_STREAK_AROUND, _STREAK))
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


def without_islands(clear: _Mask) -> _Mask:
    """Return the mask without parts that are cut off from the rest: slivers along the edge of a
    lid.
    """
    label = np.asarray(skimage.measure.label(clear))
    size = np.bincount(label.ravel())
    size[0] = 0
    return clear & (size > _ISLAND * clear.sum())[label]


def find_highlights(pixels: _Pixels, saturated: _Mask, iris: _Mask) -> _Mask:
    """Find pixels of the iris that show a mirror image of lamps, wet spots or the like.

    These are saturated pixels, and pixels that are brighter than the median around them by more
    than the iris's own scatter, if the excess has the colour of the light; both with the glow
    around them. Nothing outside the iris is marked.

    Args:
        pixels: Linear pixels.
        saturated: Pixels that may be cut off.
        iris: The ring between limbus and pupil, as far as it is known.
    """
    if not iris.any():
        return np.zeros_like(iris)
    part = _Reduced.around(iris)
    small, ring = part.reduced(pixels), part.reduced(iris) > 0.5
    cut_off = part.reduced(saturated & iris) > 0.1
    encoded = _encoded(small @ LUMINANCE_WEIGHTS)
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


def find_lashes(pixels: _Pixels, limbus: Ellipse, lids: _Mask | None = None) -> _Mask:
    """Find thin dark or bright streaks that cross the limbus, and clear dark ones that hang from
    lids.

    Fibres and furrows of the iris end at the limbus and vessels of the white are faint, so a streak
    that is as clear outside as inside lies in front.

    Args:
        pixels: Linear pixels of the whole picture.
        limbus: Outline in it.
        lids: Result of `find_lids`.
    """
    part, radius, small = _around_limbus(pixels, limbus)
    if part is None or small is None:
        return np.zeros(pixels.shape[:2], bool)
    encoded = _encoded(small @ LUMINANCE_WEIGHTS)
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


def find_lids(pixels: _Pixels, limbus: Ellipse, pupil: Ellipse) -> _Mask:
    """Find pixels within the limbus that lids cover.

    The sides of the iris, which lids never reach, give the usual brightness and colour at each
    radius. Parts above and below that differ from these and reach the limbus are lids if a good
    deal of them goes on outside the limbus; the rest is the lid's shadow, and different parts
    beside a lid count as shadow, too. Lids are marked with a small margin. A lid of the iris's own
    colour is not found, nor is any if light and shadow divide the eye.
    """
    part, radius, small = _around_limbus(pixels, limbus)
    if part is None or small is None:
        return np.zeros(pixels.shape[:2], bool)
    size = max(radius.shape)
    inside = part.reduced(pupil.mask(pixels.shape[:2])) < 0.5
    smooth = ndimage.gaussian_filter(small, (0.012 * size,) * 2 + (0,))
    light = np.log(np.maximum(smooth, 0) + 0.02 * max(float(np.median(smooth)), 1e-4))
    seen = np.concatenate(
        [light @ LUMINANCE_WEIGHTS[:, None], light[..., :1] - light[..., 2:]], -1
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


def part_of(photograph: Photograph, limbus: Ellipse) -> Part:
    """Cut out the part about a limbus, wide enough for every pixel of the camera's picture."""
    reduction = max(1, math.ceil(2 * limbus.semi_axes[0] / MOST_ACROSS))
    half = math.ceil(1.3 * limbus.semi_axes[0] / reduction + 4) * reduction
    x, y = tuple(int(np.floor(c)) - half for c in limbus.centre)
    side = 2 * half

    def cut(values, fill):
        rows, columns = (
            slice(max(0, c), min(n, c + side)) for n, c in zip(values.shape, (y, x), strict=False)
        )
        whole = np.full((side, side, *values.shape[2:]), fill, values.dtype)
        there = slice(rows.start - y, rows.stop - y), slice(columns.start - x, columns.stop - x)
        whole[there] = values[rows, columns]
        return whole

    pixels = cut(photograph.pixels, np.float32(0))
    masks = (
        cut(photograph.saturated, True),
        cut(np.zeros_like(photograph.saturated), True),
    )
    if reduction > 1:
        pixels = by_channel(pixels, lambda c: c.reduce(reduction))
        masks = [skimage.measure.block_reduce(m, reduction, np.max) for m in masks]
    made = Part(np.asarray(pixels, np.float32), *masks, limbus, reduction, (x, y))
    return made._replace(limbus=made.moved(limbus))


class _Reduced:
    """A rectangle of the photograph and a smaller picture of it."""

    def __init__(self, shape: tuple[int, int], rows: slice, columns: slice):
        self.shape, self.rows, self.columns = shape, rows, columns
        self.size = rows.stop - rows.start, columns.stop - columns.start
        factor = min(1.0, _RESOLUTION / max(self.size))
        self.small_size = tuple(max(1, round(n * factor)) for n in self.size)

    @classmethod
    def around(cls, mask: np.ndarray) -> "_Reduced":
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


def _hangs(region, away) -> bool:
    """Whether a streak runs away from the lid, not along it as fibres beside a pupil do."""
    rows, columns = region.coords.T
    along = away[rows, columns]
    return bool(np.ptp(along) > 0.5 * region.axis_major_length)


def _hanging(streak: np.ndarray, lids: np.ndarray) -> np.ndarray:
    """Long streaks that begin at a lid; `streak` is their encoded contrast over the iris's own."""
    clear = skimage.filters.apply_hysteresis_threshold(streak, *_LASH_CLEAR) & ~lids
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


def _around_limbus(pixels: np.ndarray, limbus: Ellipse):
    """The part of the photograph around the limbus, the relative radius there and its pixels."""
    (x, y), reach = limbus.centre, _SEEN_AROUND * limbus.semi_axes[0]
    rows, columns = pixels.shape[:2]
    box = [
        slice(max(0, int(c - reach)), min(n, int(c + reach) + 1))
        for c, n in ((y, rows), (x, columns))
    ]
    if any(b.stop - b.start < 16 for b in box):
        return None, np.zeros((0, 0)), None
    part = _Reduced((rows, columns), *box)
    at = [
        b.start + (np.arange(n) + 0.5) * (size / n) - 0.5
        for b, n, size in zip(box, part.small_size, part.size, strict=True)
    ]
    return part, limbus.relative_radius(at[1][None, :], at[0][:, None]), part.reduced(pixels)


def _beyond_edge(lid: np.ndarray, upper: bool) -> np.ndarray:
    """All pixels beyond the edge of a lid, which is continued as a parabola: at its ends the
    limbus's blur hides it.
    """
    columns = np.flatnonzero(lid.any(0))
    if len(columns) < 0.15 * lid.shape[1]:  # too short to be continued
        return lid
    rows = [np.flatnonzero(lid[:, c])[-1 if upper else 0] for c in columns]
    edge = np.poly1d(np.polyfit(columns, rows, 2))(np.arange(lid.shape[1]))
    row = np.arange(len(lid))[:, None]
    return row <= edge if upper else row >= edge


def _usual(streak: np.ndarray) -> float:
    """A contrast that all but the clearest streaks of a texture stay below."""
    return max(1.5 * float(np.quantile(streak, 0.75)), 0.08) if streak.size else 0.08


def _encoded(luminance: np.ndarray) -> np.ndarray:
    """Roughly encoded as for a screen, so that equal steps look equal."""
    return np.clip(luminance, 0, 1) ** np.float32(1 / 2.2)


def _median(values: np.ndarray, counted: np.ndarray, radius: int) -> np.ndarray:
    """Median of the counted pixels within a radius, to 1/255."""
    levels = np.round(255 * values).astype(np.uint8)
    disk = skimage.morphology.disk(radius)
    return skimage.filters.rank.median(levels, disk, mask=counted.astype(np.uint8)) / 255


def _colourless(excess: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Whether the excess over the usual brightness is about white, or cut off."""
    top = excess.max(-1)
    return (np.ptp(excess, axis=-1) < 0.6 * np.maximum(top, 1e-6)) | (pixels.min(-1) > 0.8)
