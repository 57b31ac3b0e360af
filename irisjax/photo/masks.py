"""The part of a photograph that shows the eye, and masks of what hides the iris in it."""

import itertools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from PIL import Image
from scipy import ndimage, spatial, stats
from skimage import filters, measure, morphology

from irisjax.photo.edges import map_channels
from irisjax.photo.photograph import Colours, Ellipse, Mask, Photograph
from irisjax.photo.texture import LUMINANCE_WEIGHTS, Unrefracted, masked_mean
from irisjax.render.project import MirrorPixels, scatter_to_picture

_MOST_ACROSS = 1100  # most pixels across the iris; larger pictures are averaged
_RESOLUTION = 400  # px along the longer side of the picture in which masks are sought
_NORMAL = 1 / 1.4826  # median absolute deviation over standard deviation of a normal distribution
_SEEN_AROUND = 1.35  # semi-axes of the limbus within which lashes begin
# Contrast of lashes: 99 % of the textures of simulated irides stay below 0.29.
_LASH_CLEAR = 0.15, 0.35
_DIRECTIONS = 8  # of lines along circles
# Lids:
_UNLIKE_IRIS = 3.0  # differences in units of the usual scatter
# Brightness, red against blue, green against both.
_OPPONENT = np.array([LUMINANCE_WEIGHTS, (1, 0, -1), (-1, 2, -1)])
_LIKE_SKIN, _MANY = 0.35, 8000  # difference of the logarithms; pixels of the skin compared
_LID_EDGES = (-0.15, 0.0, 0.15, 0.3, 0.45, 0.6), np.linspace(-0.3, 0.3, 7)  # bends and slopes
_LEAST_LID, _OF_A_LID = 0.012, 0.2  # least score, of the iris's pixels and of the lid's
# Shadows of lashes, in units of the limbus's radius:
_REACH = 0.33  # distance from a lid
_STREAK, _STREAK_AROUND = 0.004, 0.03  # widths of a streak and of its surroundings
_SHORTEST, _WIDEST = 0.04, 0.035  # crypts, which are as dark, are wider
_CLEAR = 0.025, 0.05  # encoded contrast
_NARROW = 0.025  # least half width of a part that is clear, in units of the limbus's radius
_ISLAND = 0.02  # share of the iris below which a separate part is dropped
# Wide mirror images:
_RINGS = 24  # within the limbus
_LEAST_SCATTER = 0.01  # of an encoded channel
_CLIPPED, _COMMON = 8, 3.5  # times that the scatter is estimated; strangeness that counts in it
_BRIGHTER = 0.06, 0.12  # least encoded differences of luminance, beside the pupil's and of others
_STRANGE = 3.0  # mean of a region, in units of the scatter
_FIBRES, _WIDE, _BESIDE = 0.007, 0.015, 0.08  # smoothing; least radius; reach of narrow parts, of
# the picture _SEEN_AROUND the limbus
# The mirror image of the face:
_FACE_ANGLE = 90.0  # degrees from the eye's axis beyond which a mirrored line ends on the face
_FACE_SHARE = 0.1  # share of a pixel's light above which the mirror image hides the iris
_AROUND = 1.03, 1.25  # of the limbus: white and skin, as bright as what is mirrored
_SMOOTH = 0.01  # of the limbus's radius, against noise
# Freckles:
_SMALLEST, _LARGEST = 0.05, 1.5  # mm, diameters
_SPOT_RING = 0.1  # mm, width of a ring with one median
_SPOT_AROUND = 1.0  # mm, standard deviation of the neighbourhood
_BROWNER, _DARKER = 0.2, 0.1  # least differences of the logarithms
_STRONG, _WEAK = 5.0, 2.5  # differences in units of the usual scatter
_COMPACT = 0.5  # least share of a spot in its convex hull


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

    pixels: Colours
    saturated: Mask
    outside: Mask
    limbus: Ellipse
    reduction: int
    corner: tuple[int, int]

    def moved(self, outline: Ellipse) -> Ellipse:
        """Return an outline of the photograph on these pixels."""
        return outline.moved(-self.corner[0], -self.corner[1]).scaled(1 / self.reduction)

    def clear(self, pupil: Ellipse) -> tuple[Mask, Mask, Mask]:
        """Return the pixels between a pupil (an outline on these pixels) and the limbus that show
        the iris, no highlight, lash or lid; the pixels within the limbus that lids cover; and those
        that a mirror image covers.
        """
        lids = find_lids(self.pixels, self.limbus, pupil)
        ring = self.limbus.mask(self.outside.shape) & ~pupil.mask(self.outside.shape)
        mirrored = find_highlights(self.pixels, self.saturated & ring, ring)
        mirrored |= find_reflections(self.pixels, self.limbus, pupil, ring & ~lids)
        hidden = mirrored | lids | find_lashes(self.pixels, self.limbus, lids)
        clear = ring & ~hidden & ~self.outside
        clear &= ~find_lash_shadows(self.pixels, self.limbus, lids, clear)
        # Strips between masked parts are part of these.
        narrow = _NARROW * self.limbus.semi_axes[0]
        broad = np.asarray(ndimage.distance_transform_edt(clear)) > narrow
        clear &= np.asarray(ndimage.distance_transform_edt(~broad)) < narrow + 1.5
        return remove_islands(clear), lids, mirrored


def find_mirrored_face(
    pixels: Colours, outside: Mask, limbus: Ellipse, mirror: MirrorPixels | None
) -> Mask:
    """Find pixels in which the mirror image of the face makes more than a tenth of the light.

    The tear film mirrors more the more grazing it is seen, up to a sixth of the light at the rim of
    an eye that is turned by 30 degrees. An eye that looks into the camera has no such pixel.
    """
    if mirror is None:
        return np.zeros_like(outside)
    radius, luminance = limbus.radii(outside.shape), pixels @ LUMINANCE_WEIGHTS
    inside, around = radius < 1, (radius > _AROUND[0]) & (radius < _AROUND[1]) & ~outside
    parts = np.asarray(mirror.mirror[2]), np.asarray(mirror.reflectance)
    back, reflectance = (scatter_to_picture(mirror, part, outside.shape) for part in parts)
    face = inside & (back > -np.cos(np.radians(_FACE_ANGLE))) & (reflectance > 0)
    if not (face.any() and around.any()):
        return np.zeros_like(outside)
    luminance_of_iris = masked_mean(luminance, inside, _SMOOTH * limbus.semi_axes[0])
    return face & (reflectance * np.median(luminance[around]) > _FACE_SHARE * luminance_of_iris)


def find_lash_shadows(pixels: Colours, limbus: Ellipse, lids: Mask, clear: Mask) -> Mask:
    """Find thin dark streaks near a lid that are fainter than a lash in front of the iris.

    A furrow of the iris that looks like one is lost with them: the texture is filled there.
    """
    if not lids.any() or not clear.any():
        return np.zeros_like(clear)
    radius = limbus.semi_axes[0]
    encoded = _encode(pixels @ LUMINANCE_WEIGHTS).astype(np.float32)
    around, local = (masked_mean(encoded, clear, s * radius) for s in (_STREAK_AROUND, _STREAK))
    distance = np.asarray(ndimage.distance_transform_edt(~lids), np.float32)
    near, streak = distance < _REACH * radius, clear * (around - local) / np.maximum(around, 1e-3)
    # Furrows elsewhere are no shadows of lashes.
    furrows = np.quantile(streak[clear & ~near], 0.98) if (clear & ~near).any() else 0.0
    low, high = np.array(_CLEAR) * max(1.0, furrows / _CLEAR[0])
    dark = filters.apply_hysteresis_threshold(near * streak, low, high)

    def is_lash(region, at):
        length, width = region.axis_major_length, region.axis_minor_length
        slender = length > 4 * max(width, 1.0) and width < _WIDEST * radius
        # It runs away from the lid, not along it as fibres beside a pupil do.
        hangs = slender and np.ptp(distance[at]) > 0.5 * length
        return length > _SHORTEST * radius and (region.solidity < 0.4 or hangs)

    return _dilate(select_regions(is_lash, dark), max(1, round(0.008 * radius)))


def select_regions(predicate: Callable[[Any, tuple[np.ndarray, ...]], Any], mask: Mask) -> Mask:
    """Return the connected regions of a mask for which `predicate(region, indices)` is true."""
    selected = np.zeros_like(mask)
    for region in measure.regionprops(measure.label(mask)):
        at = tuple(region.coords.T)
        if predicate(region, at):
            selected[at] = True
    return selected


def remove_islands(clear: Mask) -> Mask:
    """Return the mask without small separate parts: slivers along the edge of a lid."""
    largest = _ISLAND * clear.sum()
    return np.asarray(morphology.remove_small_objects(clear, max_size=largest, connectivity=2))


def find_highlights(pixels: Colours, saturated: Mask, iris: Mask) -> Mask:
    """Find pixels of the iris that show a mirror image of lamps, wet spots or the like.

    These are saturated pixels, and pixels that are brighter than the median around them by more
    than the iris's own scatter, if the excess has the colour of the light; both with the glow
    around them. Nothing outside the iris, the ring between limbus and pupil, is marked.
    """
    if not iris.any():
        return np.zeros_like(iris)
    part = _ReducedPart(iris.shape, ndimage.find_objects(iris.astype(np.uint8))[0])
    small, ring = part.reduced(pixels), part.reduced(iris) > 0.5
    cut_off = part.reduced(saturated & iris) > 0.1
    encoded = _encode(small @ LUMINANCE_WEIGHTS)
    counted = ring & ~cut_off
    if not counted.any():
        return iris.copy()
    size, levels = max(ring.shape), np.round(255 * encoded).astype(np.uint8)
    disk = morphology.disk(max(3, round(0.06 * size)))
    usual = filters.rank.median(levels, disk, mask=counted.astype(np.uint8)) / 255
    excess = encoded - usual
    scatter = np.median(np.abs(excess[counted])) / _NORMAL
    # An excess of light that is about white, or cut off.
    added = small - usual[..., None] ** 2.2
    white = np.ptp(added, axis=-1) < 0.6 * np.maximum(added.max(-1), 1e-6)
    white |= small.min(-1) > 0.8
    bright = (excess > max(5 * scatter, 0.15)) & white & ring
    glow = (excess > max(2.5 * scatter, 0.06)) & ring
    seeds = bright | cut_off
    highlights = np.asarray(ndimage.binary_propagation(seeds, mask=glow | seeds), bool)
    # Fibres that touch a highlight are as bright as its glow; the glow itself is near.
    distance = np.asarray(ndimage.distance_transform_edt(~seeds))
    highlights &= distance <= max(2.0, 0.03 * size)
    highlights = _dilate(highlights, max(1, size // 200))
    return (part.enlarged(highlights) | saturated) & iris


def find_reflections(pixels: Colours, limbus: Ellipse, pupil: Ellipse, iris: Mask) -> Mask:
    """Find wide mirror images of a window, a soft box or the sky, burnt out or not.

    They add light to the iris: white, or bluer than the iris wherever they do not take light from
    it. Each pixel is compared with the median colour at its radius, where a ring of another colour
    is usual, in units of the colours' scatter over the iris. A tissue's colours vary along a line,
    which added light leaves. Over the pupil a mirror image is seen alone: what continues one over
    the iris may be fainter. A sector of a much paler colour looks the same and is marked.
    """
    part, radius, small = _around_limbus(pixels, limbus)
    counted = part.reduced(iris) > 0.9
    if not counted.any():
        return np.zeros_like(iris)
    size, ring = max(radius.shape), (radius * _RINGS).astype(int)
    least = max(1, round(_WIDE * size))
    channels = [masked_mean(c, counted, _FIBRES * size) for c in np.moveaxis(_encode(small), -1, 0)]
    encoded, usual = np.maximum(np.stack(channels, -1), 0), np.zeros_like(small)
    for k in np.unique(ring[counted]):
        usual[ring == k] = np.median(encoded[counted & (ring == k)], 0)
    deviation = encoded - usual
    strange, common = np.zeros(radius.shape), counted
    for _ in range(_CLIPPED):
        spread = np.cov(deviation[common].T, bias=True) + _LEAST_SCATTER**2 * np.eye(3)
        strange = np.sqrt(((deviation @ np.linalg.inv(spread)) * deviation).sum(-1))
        common = counted & (strange < _COMMON)
    excess, excess_light = deviation @ LUMINANCE_WEIGHTS, encoded**2.2 - usual**2.2
    most = np.maximum(excess_light.max(-1), 1e-6)
    white = np.ptp(excess_light, axis=-1) < 0.6 * most
    sky = (excess_light.argmax(-1) == 2) & (excess_light.min(-1) > -0.15 * most)
    glow = counted & (white | sky) & (excess > _BRIGHTER[0] / 2)
    # Over the black pupil.
    black = part.reduced(pupil.mask(iris.shape)) > 0.9
    light = morphology.opening(_encode(small @ LUMINANCE_WEIGHTS), morphology.disk(least))
    dark = np.quantile(light[black], 0.25) if black.any() else 0.0
    mirrored = _dilate(black & (light > dark + _BRIGHTER[0]), 2 + round(0.02 * size))

    def is_reflection(region, at):
        least = _BRIGHTER[0 if mirrored[at].sum() > math.sqrt(region.area) else 1]
        return excess[at].mean() > least and strange[at].mean() > _STRANGE

    # Fibres are as bright as some reflections, but not as wide.
    wide = select_regions(is_reflection, _open(glow & (strange > _STRANGE / 2), least))
    # Between mirrored lashes they are as narrow.
    near = np.asarray(ndimage.distance_transform_edt(~wide)) < max(2.0, _BESIDE * size)
    beside = glow & near & (strange > _STRANGE / 3)
    reflections = np.asarray(ndimage.binary_propagation(beside & wide, mask=beside | wide), bool)
    reflections = ~_open(~reflections, 2 * least) if reflections.any() else reflections
    return part.enlarged(_dilate(reflections, max(1, size // 200))) & iris


def find_lashes(pixels: Colours, limbus: Ellipse, lids: Mask) -> Mask:
    """Find thin dark or bright streaks that cross the limbus, and clear dark ones that hang from
    lids.

    Fibres and furrows of the iris end at the limbus and vessels of the white are faint, so a streak
    that is as clear outside as inside lies in front. The dark ring of a limbus runs along it.
    """
    part, radius, small = _around_limbus(pixels, limbus)
    encoded = _encode(small @ LUMINANCE_WEIGHTS)
    reach = max(2, round(0.02 * max(radius.shape)))
    lashes = np.zeros(radius.shape, bool)
    near, within = radius < _SEEN_AROUND, radius < 1
    hidden = part.reduced(lids) > 0.5
    beside = _dilate(hidden, 4)

    def crosses_limbus(region, at):
        return radius[at].min() < 0.95 and radius[at].max() > 1.12 and _is_streak(region)

    def hangs_from_lid(region, at):
        return beside[at].any() and _is_streak(region)

    dark, bright = (_streak_contrast(v, part.small(limbus), reach) for v in (encoded, -encoded))
    for streak in (dark, bright):
        # In units of what fibres, or vessels and skin, usually reach.
        inner, outer = _usual_contrast(streak[within]), _usual_contrast(streak[near & ~within])
        usual = np.where(within, inner, outer)
        clear = filters.apply_hysteresis_threshold(near * streak / usual, 1.0, 1.5)
        lashes |= select_regions(crosses_limbus, clear)
    iris = (radius > 0.6) & within & ~hidden
    if hidden.any() and iris.any():
        contrast = dark / max(float(np.median(encoded[iris])), 1e-3)
        clear = filters.apply_hysteresis_threshold(contrast, *_LASH_CLEAR) & ~hidden
        lashes |= near & select_regions(hangs_from_lid, clear)
    return part.enlarged(_dilate(lashes, 1))


def find_lids(pixels: Colours, limbus: Ellipse, pupil: Ellipse) -> Mask:
    """Find pixels within the limbus that lids cover, and those in their shadow.

    The sides of the iris, which lids never reach, give the usual brightness and colour at each
    radius. A lid differs from both sides, and its colours are those of the skin and lashes beyond
    the limbus. Its edge is the parabola above (or below) which most pixels are so and fewest are
    not. Dark parts of the iris beside a lid are its shadow. A lid of the iris's own colour is not
    found.
    """
    part, radius, small = _around_limbus(pixels, limbus)
    size = max(radius.shape)
    smooth = ndimage.gaussian_filter(small, (0.012 * size,) * 2 + (0,))
    light = np.log(np.maximum(smooth, 0) + 0.02 * max(float(np.median(smooth)), 1e-4))
    colours = light @ _OPPONENT.T
    row, column = np.mgrid[: radius.shape[0], : radius.shape[1]]
    x, y = part.small(limbus)
    across, down = ((c - m) * (2 * _SEEN_AROUND / size) for c, m in ((column, x), (row, y)))
    iris = (part.reduced(pupil.mask(pixels.shape[:2])) < 0.5) & (radius < 1)
    deviations = [
        _deviation_from_side(colours, radius, iris & side & (np.abs(down) < 0.5 * np.abs(across)))
        for side in (across < 0, across > 0)
    ]
    # Less unlike either side. A radius at which neither side shows iris tells nothing: no lid.
    unlike = np.fmin(*(np.linalg.norm(o, axis=-1) for o in deviations))
    strange = np.where(iris & np.isfinite(unlike), unlike, 0.0)
    lids = np.zeros_like(iris)
    for height in (-down, down):
        skin = (radius > 1.05) & (radius < _SEEN_AROUND) & (height > 0.7 * np.abs(across))
        if not skin.any():
            continue
        score, step = -1.0 * iris, max(1, int(skin.sum()) // _MANY)
        of_skin = spatial.KDTree(colours[skin][::step])
        skin_distance, _ = of_skin.query(colours[iris], distance_upper_bound=_LIKE_SKIN)
        score[iris] += np.isfinite(skin_distance) * np.minimum(strange[iris] / _UNLIKE_IRIS, 2)
        edges = itertools.product(*_LID_EDGES)
        above = [height + bend * across**2 + lean * across for bend, lean in edges]
        lid_score, lid = max((_best_cut(score, a) for a in above), key=lambda best: best[0])
        if lid_score > max(_LEAST_LID * iris.sum(), _OF_A_LID * (lid & iris).sum()):
            lids |= lid
    dark = (np.fmax(*deviations)[..., 0] < 0) & (strange > _UNLIKE_IRIS)
    dark = _open(dark, max(1, round(0.02 * size)))
    beside = _dilate(lids, max(1, round(0.02 * size)))
    near = np.asarray(ndimage.distance_transform_edt(~lids)) * 2 * _SEEN_AROUND < _REACH * size
    shadow = select_regions(lambda _, at: beside[at].any(), dark & iris & near)
    return part.enlarged(lids | shadow) & limbus.mask(pixels.shape[:2])


def find_freckles(texture: Unrefracted) -> Mask:
    """Find texels of spots that are darker and browner than their surroundings.

    Browner means more red against blue, a ratio that does not fall in shadows and crypts. Each
    texel is compared with the median at its radius, so that rings of pigment around the pupil are
    no freckles, and with a neighbourhood of 1 mm; the scatter of the texture itself sets the scale.
    Spots are 0.05 to 1.5 mm wide and compact. Without colours freckles cannot be distinguished from
    crypts: none are found.
    """
    valid = texture.valid
    pixels = texture.pixels.astype(np.float32)
    if not valid.any() or _is_grey(pixels[valid]):
        return np.zeros_like(valid)
    texel = texture.millimetres_per_texel
    smooth = ndimage.gaussian_filter(pixels, (0.3 * _SMALLEST / texel,) * 2 + (0,))
    luminance = texture._replace(pixels=smooth).luminance()
    dim = 0.02 * np.median(luminance[valid])
    if not dim > 0:
        return np.zeros_like(valid)
    red, _, blue = np.moveaxis(np.log(np.maximum(smooth, 0) + dim), -1, 0)
    dark = -np.log(np.maximum(luminance, 0) + dim)
    browner, usual_brown = _deviation(red - blue, texture)
    darker, usual_dark = _deviation(dark, texture)
    high = (browner > max(_BROWNER, _STRONG * usual_brown)) & (darker > max(_DARKER, usual_dark))
    low = (browner > max(_BROWNER / 2, _WEAK * usual_brown)) & (darker > 0)
    spots = np.asarray(ndimage.binary_propagation(high & valid, mask=low & valid))

    def is_freckle(region, _):
        width, length = region.equivalent_diameter_area * texel, region.axis_major_length * texel
        has_size = width >= _SMALLEST and max(width, length) <= _LARGEST
        return has_size and region.solidity >= _COMPACT

    freckles = select_regions(is_freckle, np.asarray(ndimage.binary_fill_holes(spots)))
    return _dilate(freckles, max(1, round(0.5 * _SMALLEST / texel)))


def cut_part(photograph: Photograph, limbus: Ellipse) -> Part:
    """Cut out the part about a limbus, wide enough for every pixel of the camera's picture."""
    (x, y), side, reduction = part_geometry(limbus)

    def cut(values, fill):
        inside = values[max(0, y) : y + side, max(0, x) : x + side]
        ends = zip(values.shape, (y, x), strict=False)
        beyond = [(max(0, -c), max(0, c + side - n)) for n, c in ends]
        return np.pad(inside, beyond + [(0, 0)] * (values.ndim - 2), constant_values=fill)

    pixels, saturated = cut(photograph.pixels, np.float32(0)), photograph.saturated
    masks = cut(saturated, True), cut(np.zeros_like(saturated), True)
    if reduction > 1:
        pixels = map_channels(pixels, lambda c: c.reduce(reduction))
        masks = [measure.block_reduce(m, reduction, np.max) for m in masks]
    part = Part(np.asarray(pixels, np.float32), *masks, limbus, reduction, (x, y))
    return part._replace(limbus=part.moved(limbus))


def part_geometry(limbus: Ellipse) -> tuple[tuple[int, int], int, int]:
    """Return column and row of the first pixel of the photograph's part about the limbus, its side
    in pixels, and how many of them along each side one of its own pixels has.
    """
    reduction = max(1, math.ceil(2 * limbus.semi_axes[0] / _MOST_ACROSS))
    half = math.ceil(1.3 * limbus.semi_axes[0] / reduction + 4) * reduction
    x, y = (int(np.floor(c)) - half for c in limbus.centre)
    return (x, y), 2 * half, reduction


class _ReducedPart:
    """A rectangle of the photograph and a smaller picture of it."""

    def __init__(self, shape: tuple[int, int], box: tuple[slice, ...]):
        self.shape, self.box = shape, box
        self.size = tuple(b.stop - b.start for b in box)
        factor = min(1.0, _RESOLUTION / max(self.size))
        self.small_size = tuple(max(1, round(n * factor)) for n in self.size)

    def small(self, outline: Ellipse) -> np.ndarray:
        """Column and row of an outline's middle in the smaller picture."""
        place = np.subtract(outline.centre, [b.start for b in self.box[::-1]])
        return (place + 0.5) * self.small_size[::-1] / self.size[::-1] - 0.5

    def reduced(self, picture: np.ndarray) -> np.ndarray:
        part, (rows, columns) = np.atleast_3d(picture[self.box]), self.small_size
        box = Image.Resampling.BOX  # the mean of what a pixel covers
        small = map_channels(part.astype(np.float32), lambda c: c.resize((columns, rows), box))
        return small.reshape(rows, columns, *picture.shape[2:])

    def enlarged(self, mask: np.ndarray) -> np.ndarray:
        sizes = zip(self.size, self.small_size, strict=True)
        whole = np.zeros(self.shape, bool)
        whole[self.box] = mask[np.ix_(*(np.arange(n) * m // n for n, m in sizes))]
        return whole


def _dilate(mask: np.ndarray, radius: int) -> np.ndarray:
    # scikit-image dilates an empty mask to one with pixels set.
    return np.asarray(morphology.isotropic_dilation(mask, radius)) if mask.any() else mask


def _open(mask: np.ndarray, radius: int) -> np.ndarray:
    return _dilate(np.asarray(morphology.isotropic_erosion(mask, radius)), radius)


def _is_streak(region) -> bool:
    """Whether a region is a streak or several that branch."""
    length, width = region.axis_major_length, region.axis_minor_length
    return bool(length > 4 * max(width, 1.0) or region.solidity < 0.4)


def _around_limbus(pixels: np.ndarray, limbus: Ellipse):
    """The part of the photograph around the limbus, the relative radius there and its pixels."""
    shape, reach = pixels.shape[:2], _SEEN_AROUND * limbus.semi_axes[0]
    ends = zip(limbus.centre[::-1], shape, strict=True)
    box = tuple(slice(max(0, int(c - reach)), min(n, int(c + reach) + 1)) for c, n in ends)
    part = _ReducedPart(shape, box)
    row, column = (
        b.start + (np.arange(n) + 0.5) * (size / n) - 0.5
        for b, n, size in zip(box, part.small_size, part.size, strict=True)
    )
    return part, limbus.relative_radius(column, row[:, None]), part.reduced(pixels)


def _deviation_from_side(colours: np.ndarray, radius: np.ndarray, side: Mask) -> np.ndarray:
    """Differences from the medians at each radius of a side of the iris, in units of its usual
    scatter.
    """
    ring, scatter = np.minimum((radius * 20).astype(int), 20), [np.full(3, 0.12)]
    usual = np.full((21, 3), np.nan)
    for k in np.unique(ring[side]):
        values = colours[side & (ring == k)]
        usual[k] = np.median(values, 0)
        scatter.append(stats.median_abs_deviation(values, scale=_NORMAL))
    return (colours - usual[ring]) / np.maximum(np.median(scatter, 0), scatter[0])


def _best_cut(score: np.ndarray, above: np.ndarray) -> tuple[float, Mask]:
    """The largest sum of a score over the places above some level, and these places."""
    level = np.clip(100 * above, 0, 150).astype(int)
    sums = np.bincount(level.ravel(), score.ravel(), 151)[::-1].cumsum()[::-1]
    best = 1 + int(np.argmax(sums[1:]))
    return float(sums[best]), level >= best


def _streak_contrast(values: np.ndarray, middle: np.ndarray, reach: int) -> np.ndarray:
    """How much lower values are than those on both sides, up to `reach` pixels away along circles
    about a middle (column, row): a streak along a circle is none.
    """
    row, column = np.indices(values.shape)
    along = np.arctan2(row - middle[1], column - middle[0]) + np.pi / 2
    nearest = np.round(along / np.pi * _DIRECTIONS).astype(int) % _DIRECTIONS
    contrast = np.zeros_like(values)
    for k in range(_DIRECTIONS):
        angle, line = np.pi * k / _DIRECTIONS, np.zeros((2 * reach + 1,) * 2, bool)
        step = np.linspace(-reach, reach, 4 * reach + 1)
        indices = [np.rint(reach + step * f(angle)).astype(int) for f in (np.sin, np.cos)]
        line[tuple(indices)] = True
        low = np.asarray(ndimage.black_tophat(values, footprint=line))
        contrast = np.where(nearest == k, low, contrast)
    return contrast


def _usual_contrast(streak: np.ndarray) -> float:
    """A contrast that all but the clearest streaks of a texture stay below."""
    return max(1.5 * float(np.quantile(streak, 0.75)), 0.08) if streak.size else 0.08


def _encode(luminance: np.ndarray) -> np.ndarray:
    """Roughly encoded as for a screen, so that equal steps look equal."""
    return np.clip(luminance, 0, 1) ** np.float32(1 / 2.2)


def _is_grey(pixels: np.ndarray) -> bool:
    """Whether the channels are in one proportion."""
    usual = np.median(pixels, 0)
    scale = np.maximum(pixels.max(-1, keepdims=True), 1e-6)
    return bool(np.median(np.ptp(pixels / scale, axis=-1)) < 0.01 or not usual.max() > 0)


def _deviation(values: np.ndarray, texture: Unrefracted) -> tuple[np.ndarray, float]:
    """Difference from the median at each radius and from the neighbourhood, and its scatter."""
    valid = texture.valid
    ring = (texture.radius() / _SPOT_RING).astype(np.int32)[valid]
    centre = np.unique(ring)
    median = np.asarray(ndimage.median(values[valid], ring, centre), float)
    profile = np.interp(texture.radius() / _SPOT_RING - 0.5, centre, median).astype(np.float32)
    deviation = values - profile
    scatter = _scatter(deviation[valid])
    # Clipped: a spot must not raise what it is compared with.
    width = _SPOT_AROUND / texture.millimetres_per_texel
    deviation = deviation - masked_mean(np.clip(deviation, -2 * scatter, 2 * scatter), valid, width)
    return deviation, _scatter(deviation[valid])


def _scatter(values: np.ndarray) -> float:
    return float(stats.median_abs_deviation(values, scale=_NORMAL))
