"""Colours of an iris in CIE L*a*b*, corrected for the light by the white of the eye."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import ndimage
from scipy.cluster.vq import kmeans2

from irisjax._types import PRNGKey
from irisjax.measure.colour import lab_of_srgb, srgb_encode
from irisjax.numerics.streams import words_of
from irisjax.photo.clone import Outlined
from irisjax.photo.masks import Part, cut_part, select_regions
from irisjax.photo.photograph import Brightness, Colours, Ellipse, Mask
from irisjax.photo.texture import masked_mean
from irisjax.photo.white import WhiteOfEye, angles_about, find_white

RINGS = {"pupillary ring": (0.06, 0.28), "collarette": (0.28, 0.45), "ciliary ring": (0.45, 0.9)}
"""Inner and outer borders of the rings, shares of the way from the pupil to the limbus."""
WHOLE_IRIS = "whole iris"
_DRAWS = 2000

_CONTRAST_SD = 0.1  # of the logarithm, of cameras that are not calibrated, decided
_VEIL_SD, _STEP = 0.4, 6e-4  # of the veil, relative and in steps of 8 bits near black
_BLOCK = 64  # pixels of a JPEG's block, whose errors go together
_SECTORS = 12

_LEAST_IRIS = 0.05, 200  # visible share of the iris, and pixels
_ALIKE, _SMALL = 4.0, 0.05  # distance and share below which dominant colours are one
_LIGHTNESS = 0.5  # weight of L* in that distance: shades are no other colours
_CLUSTERED = 20_000  # pixels
_BROAD = 0.02  # width of the mean in which reflections are sought, relative to the limbus
_LESS = 0.3  # quantile of a ring that no reflection reaches
_SKIN = 0.1  # red over all channels, above the ring's
_SHARP = 0.75  # share of a place that they fill: lit tissue fades
_MIRRORED, _NEUTRAL = 0.1, 0.4  # their least light, relative to the white; least over most channel
_VEILED, _HIDDEN = 0.35, 0.6  # shares above which it is doubtful


class RegionColour(NamedTuple):
    """The colour of a part of the iris, as it appears through the cornea.

    Attributes:
        lab: CIE 1976 L*a*b* under D65, relative to a perfect white that faces the camera at the
            eye's place.
        low: Lower ends of the 95 % intervals.
        high: Upper ends.
        srgb: The colour, sRGB-encoded, clipped to [0, 1].
        share: Visible share of a ring; share that a dominant colour has of what is visible.
    """

    lab: Float[np.ndarray, "3"]
    low: Float[np.ndarray, "3"]
    high: Float[np.ndarray, "3"]
    srgb: Float[np.ndarray, "3"]
    share: float


class EyeColour(NamedTuple):
    """The colours of an iris.

    Attributes:
        regions: Colours of the whole iris and of `RINGS`, by name; rings that are hidden are left
            out.
        dominant: One to three colours that make up the iris, the most frequent first.
        difference: Pupillary ring minus ciliary ring in L*a*b*, with the 95 % interval: the error
            of the white is common to both. `None` if one is hidden.
        white: The white of the eye.
        veil: Linear colour of the reflections that is subtracted, as the pupil shows it.
        visible: Pixels of the iris that are used.
        doubts: A sentence for each.
    """

    regions: dict[str, RegionColour]
    dominant: tuple[RegionColour, ...]
    difference: Float[np.ndarray, "3 lab"] | None
    white: WhiteOfEye
    veil: Float[np.ndarray, "3"]
    visible: Mask
    doubts: tuple[str, ...]


def colours_of(outlined: Outlined, *, key: PRNGKey) -> tuple[EyeColour, Part]:
    """Measure the colours of an outlined eye, as `measure_eye_colour` does; also return the part of
    the photograph whose pixels they are.

    Raises:
        ValueError: As of `measure_eye_colour`, and for a photograph without colours.
    """
    photograph, outlines = outlined.photograph, outlined.boundaries
    if photograph.grey:
        raise ValueError(f"{photograph.name}: the photograph has no colours")
    part = cut_part(photograph, outlines.limbus)
    pupil = part.moved(outlines.pupil)
    clear, *_ = part.clear(pupil)
    try:
        return measure_eye_colour(part, pupil, clear, outlines.limbus_width, key=key), part
    except ValueError as error:
        raise ValueError(f"{photograph.name}: {error}") from None


def measure_eye_colour(
    part: Part, pupil: Ellipse, clear: Mask, limbus_width: float | None = None, *, key: PRNGKey
) -> EyeColour:
    """Measure an iris's colours against the white of the eye, by rings.

    The light's tint and brightness are those of the white; its own colour is taken as the mean of
    people's. The intervals allow for the spread among people, for light that differs between iris
    and white, for reflections, for the camera's contrast and channels, and for hidden sectors.

    Args:
        part: The part of a photograph about the limbus.
        pupil: Outline of the pupil on its pixels.
        clear: Pixels that show the iris and nothing in front of it.
        limbus_width: Width over which iris and white blend, relative to the limbus's radius.
        key: Random key of the draws and of the search for dominant colours.

    Raises:
        ValueError: If no white is seen, or hardly any of the iris.
    """
    random = np.random.default_rng(words_of(key))
    depth = depth_in_iris(part.outside.shape, pupil, part.limbus)
    inner, outer = RINGS["pupillary ring"][0], RINGS["ciliary ring"][1]
    iris = (depth > inner) & (depth < outer)
    visible = iris & clear
    share = visible.sum() / max(iris.sum(), 1)
    if share < _LEAST_IRIS[0] or visible.sum() < _LEAST_IRIS[1]:
        raise ValueError(f"only {100 * share:.0f} % of the iris is visible, too little to measure")
    white = find_white(part, limbus_width, part.pixels[visible])
    light = part.pixels / white.sides.mean(0)
    clear = clear & ~_find_hidden(light, visible, depth, pupil, part.limbus)
    visible = iris & clear
    veil = _reflected_colour(part, pupil, visible)
    draws = _Draws.of(white, veil, random)
    angle = angles_about(part.outside.shape, part.limbus)
    borders = {WHOLE_IRIS: (inner, outer), **RINGS}
    regions, samples = {}, {}
    for name, (low, high) in borders.items():
        ring = (depth > low) & (depth < high)
        shown = ring & clear
        if shown.sum() < _LEAST_IRIS[0] * ring.sum() or shown.sum() < _LEAST_IRIS[1] / 4:
            continue
        hidden = 1 - shown.sum() / ring.sum()
        mean, covariance = _mean_and_error(part.pixels[shown], angle[shown], hidden)
        samples[name] = draws.lab(mean, covariance, random)
        regions[name] = _region_colour(samples[name], draws.colour(mean), 1 - hidden)
    difference = None
    if {"pupillary ring", "ciliary ring"} <= samples.keys():
        differences = samples["pupillary ring"] - samples["ciliary ring"]
        difference = np.quantile(differences, [0.5, 0.025, 0.975], axis=1)
    dominant = _dominant_colours(part.pixels, visible, part.limbus, draws, random)
    doubts = _doubts(white, veil, part.pixels[visible].mean(0), 1 - share)
    return EyeColour(regions, dominant, difference, white, veil, visible, doubts)


def depth_in_iris(shape: tuple[int, ...], pupil: Ellipse, limbus: Ellipse) -> Brightness:
    """Return how far each pixel lies on the way from the pupil (0) to the limbus (1)."""
    from_pupil = pupil.radii(shape) - 1
    to_limbus = (1 - limbus.radii(shape)) * (limbus.mean_radius / pupil.mean_radius)
    total = from_pupil + to_limbus
    return from_pupil / np.where(abs(total) < 1e-6, 1e-6, total)


class _Draws(NamedTuple):
    """Random draws of what stands between a photograph's pixel and a colour.

    `factor` (draws, 3) takes a pixel over the white's pixel to linear sRGB under D65; the first
    draw of each is its median, without an error.
    """

    white: np.ndarray
    factor: np.ndarray
    contrast: np.ndarray
    veil: np.ndarray

    @classmethod
    def of(cls, white: WhiteOfEye, veil: np.ndarray, random: np.random.Generator) -> "_Draws":
        normal = random.standard_normal((_DRAWS, 12))
        normal[0] = 0
        factor = white.reflectances(normal[:, :7])
        contrast = np.exp(_CONTRAST_SD * normal[:, 7:8])
        veils = veil * (1 + _VEIL_SD * normal[:, 8:9]) + _STEP * normal[:, 9:12]
        return cls(white.sides.mean(0), factor, contrast, np.maximum(veils, 0))

    def linear(self, pixel: np.ndarray) -> np.ndarray:
        """Linear sRGB under D65, a row a draw, of a pixel or of one for each draw."""
        ratio = np.maximum(pixel - self.veil, 1e-5) / self.white
        return ratio ** (1 / self.contrast) * self.factor

    def colour(self, pixel: np.ndarray) -> np.ndarray:
        """The median as sRGB-encoded colour."""
        return np.clip(np.asarray(srgb_encode(self.linear(pixel)[0])), 0, 1)

    def lab(self, mean: np.ndarray, covariance: np.ndarray, random: np.random.Generator):
        """Return L*a*b*, (3, draws), of a mean with an error of its own."""
        scatter = random.multivariate_normal(np.zeros(3), covariance, _DRAWS)
        return np.asarray(lab_of_srgb(self.linear(mean + scatter))).T


def _region_colour(samples: np.ndarray, srgb: np.ndarray, share: float) -> RegionColour:
    low, middle, high = np.quantile(samples, [0.025, 0.5, 0.975], axis=1)
    return RegionColour(middle, low, high, srgb, float(share))


def _mean_and_error(pixels: np.ndarray, angle: np.ndarray, hidden: float):
    """Mean colour of a ring and its covariance: hidden sectors may differ as the seen ones do."""
    sector = (angle / (2 * np.pi) * _SECTORS).astype(int) % _SECTORS
    count = np.bincount(sector, minlength=_SECTORS)
    used = count > 0.02 * len(pixels)
    sums = np.stack([np.bincount(sector, p, _SECTORS) for p in pixels.T], -1)
    means = sums[used] / count[used, None]
    covariance = np.cov(pixels.T) * _BLOCK / len(pixels)
    if len(means) > 1:
        covariance = covariance + np.cov(means.T) * hidden / len(means)
    return pixels.mean(0), covariance


def _dominant_colours(
    pixels: Colours, visible: Mask, limbus: Ellipse, draws: _Draws, random: np.random.Generator
) -> tuple[RegionColour, ...]:
    """Find the colours that make up the iris, by k-means in L*a*b*."""
    width, channels = 0.01 * limbus.mean_radius, np.moveaxis(pixels, -1, 0)
    smooth = np.stack([masked_mean(c, visible, width)[visible] for c in channels], -1)
    chosen = smooth[np.linspace(0, len(smooth) - 1, _CLUSTERED).astype(int)]
    middle = _Draws(draws.white, *(values[:1] for values in draws[1:]))
    lab = np.asarray(lab_of_srgb(middle.linear(chosen)))
    weighted = lab * (_LIGHTNESS, 1, 1)
    axis = np.linalg.eigh(np.cov(weighted.T))[1][:, -1]
    thirds = np.array_split(weighted[np.argsort(weighted @ axis, kind="stable")], 3)
    starts = np.stack([third.mean(0) for third in thirds])
    label = kmeans2(weighted, starts, minit="matrix", missing="warn")[1]
    while len(labels := np.unique(label)) > 1:
        size = np.array([np.mean(label == k) for k in labels])
        centres = np.stack([weighted[label == k].mean(0) for k in labels])
        distances = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
        np.fill_diagonal(distances, np.inf)
        small = int(size.argmin())
        one, other = np.unravel_index(int(distances.argmin()), distances.shape)
        if size[small] < _SMALL:
            one, other = small, int(distances[small].argmin())
        elif distances[one, other] > _ALIKE:
            break
        label[label == labels[one]] = labels[other]
    regions = []
    for k in np.unique(label):
        members = chosen[label == k]
        mean, zero = members.mean(0), np.zeros((3, 3))
        samples = draws.lab(mean, zero, random)
        regions.append(_region_colour(samples, draws.colour(mean), len(members) / len(chosen)))
    return tuple(sorted(regions, key=lambda region: -region.share))


def _find_hidden(
    light: Colours, visible: Mask, depth: Brightness, pupil: Ellipse, limbus: Ellipse
) -> Mask:
    """Find what else hides the iris, by light relative to the white: broad reflections that are not
    burnt out, and lids.
    """
    width, place = max(1, round(_BROAD * limbus.mean_radius)), visible.nonzero()
    # Between bright fibres it is dark; a reflection is bright throughout.
    masked = np.where(visible[..., None], light, np.inf)
    smooth = ndimage.minimum_filter(masked, (2 * width + 1, 2 * width + 1, 1))[place]
    ring = (depth[place] * 16).astype(int)
    usual = np.zeros((16, 3))
    for k in np.unique(ring):
        usual[k] = np.quantile(smooth[ring == k], _LESS, axis=0)
    excess = smooth - usual[ring]
    scatter = np.median(abs(excess), axis=0)
    # More of all channels, or as much more as in the pupil, which is black.
    least, high, low = excess.min(-1), np.zeros(visible.shape, bool), np.zeros(visible.shape, bool)
    limit = max(_MIRRORED, 4 * scatter.max())
    high[place] = (least > limit) & (least > _NEUTRAL * excess.max(-1))
    low[place] = least > 0.7 * limit
    inside = light[pupil.radii(visible.shape) < 0.9]
    if len(inside):
        contrast = np.quantile(inside, 0.9, axis=0) - np.quantile(inside, 0.1, axis=0)
        if (contrast > 2 * scatter).any():
            share = excess / np.maximum(contrast, 1e-6)
            high[place] |= (share.min(-1) > 0.3) & (share.max(-1) < 2)
    hidden = select_regions(lambda _, at: high[at].mean() > _SHARP, high | low)
    # Lids are redder than the rest of a ring, above and below.
    tint = smooth[:, 0] / np.maximum(smooth.sum(-1), 1e-4)
    tint -= np.asarray(ndimage.median(tint, ring, np.arange(16)))[ring]
    upright = abs(np.sin(angles_about(visible.shape, limbus)[place])) > 0.6
    red = np.zeros(visible.shape, bool)
    red[place] = upright & (tint > _SKIN)
    hidden |= np.asarray(ndimage.binary_propagation(red & (depth > 0.8), mask=red))
    return np.asarray(ndimage.binary_dilation(hidden, iterations=2 * width))


def _reflected_colour(part: Part, pupil: Ellipse, visible: Mask) -> np.ndarray:
    """Return the reflections' colour over the pupil, which is black, at most most of the iris's."""
    inside = (pupil.radii(visible.shape) < 0.8) & ~part.outside
    darkest = 0.9 * np.quantile(part.pixels[visible], 0.02, axis=0)
    if not inside.any():
        return 0 * darkest
    return np.clip(np.quantile(part.pixels[inside], 0.25, axis=0), 0, np.maximum(darkest, 0))


def _doubts(
    white: WhiteOfEye, veil: np.ndarray, iris: np.ndarray, hidden: float
) -> tuple[str, ...]:
    doubts = []
    if len(white.sides) < 2:
        doubts.append(
            "the white is seen on one side of the iris only, so that the light on the iris is less "
            "certain"
        )
    if white.is_burnt:
        doubts.append(
            f"{100 * white.burnt:.0f} % of the white is overexposed: the iris may be darker than "
            "is said"
        )
    if (veil / iris).max() > _VEILED:
        doubts.append(
            f"reflections make up to {100 * (veil / iris).max():.0f} % of the iris's light, as the "
            "pupil shows"
        )
    if hidden > _HIDDEN:
        doubts.append(f"{100 * hidden:.0f} % of the iris is hidden")
    return tuple(doubts)
