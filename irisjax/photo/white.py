"""The white of an eye in a photograph, and what it tells of the light."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import ndimage
from skimage import measure

from irisjax.photo.masks import Part
from irisjax.photo.photograph import Brightness, Ellipse, Mask
from irisjax.photo.texture import LUMINANCE_WEIGHTS

# The white of people's eyes: logarithms of luminance, red over green and blue over green, linear
# sRGB. The medians are L*a*b* = (80, 3.5, 8), half-way between this package's white (82, 1, 4; see
# `irisjax.render.outside.bulk_reflectance`) and that of women's faces (a* 3.8 and b* 8.7 at L* 47,
# which is 5.8 and 13 at L* 80; varied from 5.5 to 11.9 along its change with age) [J. Cosmet. Sci.
# 73, 369, 2022]. Both lie within 95 %.
_WHITE = np.log(0.567), 0.17, -0.14
_WHITE_SD = 0.18, 0.12, 0.13
_WHITE_CORRELATION = -0.6  # of the two ratios: yellower whites are redder
# Light on a frontal sheet of paper at the eye's place over that on the white, which is turned aside
# and shaded by the face, decided: logarithm and standard deviation, with both sides and with one.
_TURNED_LIGHT, _TURNED_SD, _ONE_SIDE_SD = 0.15, 0.15, 0.3
_TINT_SD = 0.03  # of the light's tint between iris and white where only one side is seen
_CHANNEL_SD = 0.03  # of the channels of cameras that are not calibrated, decided

_RING = 1.08, 1.29  # radii between which the white is sought, relative to the limbus
_ASIDE = 0.64  # cosine of the largest angle from the horizontal
_BRIGHT, _REDDER = 0.5, 0.35  # of the white: least brightness, and most excess of ln R/B
_GAP = 3  # px, half the width of vessels and lashes in it
_LEAST = 0.05, 40  # share of a side, and pixels
_RED, _THAN_SKIN = 0.6, 0.3  # ln R/B: of a white without skin beside it; of skin above the white's
_OVER_IRIS = 1.3  # least brightness of the white over the iris's
_BURNT = 0.3  # share above which it may be much brighter than it looks


class WhiteOfEye(NamedTuple):
    """The white of an eye in a photograph.

    Attributes:
        pixels: Pixels that show it.
        sides: Linear colours to the left and to the right, of the sides that are seen.
        burnt: Share of its pixels that may be cut off.
    """

    pixels: Mask
    sides: Float[np.ndarray, "sides 3"]
    burnt: float

    @property
    def is_burnt(self) -> bool:
        """Whether much of it is overexposed."""
        return self.burnt > _BURNT

    def reflectances(self, normal: Float[np.ndarray, "draws 7"]) -> Float[np.ndarray, "draws 3"]:
        """Return draws of its colour, linear sRGB, where a white sheet of paper that faces the
        camera at the eye's place has 1, for standard normal numbers; zeros give the median.

        They allow for the spread among people, for light that differs between sheet and white, and
        for the channels of a camera.
        """
        light, tint = _ONE_SIDE_SD, np.full(3, _TINT_SD)
        if len(self.sides) > 1:
            log_ratio = np.log(self.sides[0] / self.sides[-1])
            mean = log_ratio @ LUMINANCE_WEIGHTS
            light, tint = np.hypot(_TURNED_SD, 0.1 * mean), 0.35 * abs(log_ratio - mean)
        log_light = light * normal[:, 3:4] - _TURNED_LIGHT
        log_light = log_light + np.hypot(tint, _CHANNEL_SD) * normal[:, 4:7]
        return whites_of_people(normal[:, :3]) * np.exp(log_light)

    def median_and_root(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
        """Return the median of `reflectances`, and the inverse root of the covariance of their
        logarithms, to first order.
        """
        logs = np.log(self.reflectances(np.concatenate([np.zeros((1, 7)), np.eye(7), -np.eye(7)])))
        slopes = (logs[1:8] - logs[8:]) / 2
        return np.exp(logs[0]), np.linalg.inv(np.linalg.cholesky(slopes.T @ slopes))


def whites_of_people(normal: Float[np.ndarray, "draws 3"]) -> Float[np.ndarray, "draws 3"]:
    """Return draws of the reflectance of people's whites, linear sRGB, for standard normal numbers;
    zeros give the median.
    """
    luminance, red, blue = normal.T
    blue = _WHITE_CORRELATION * red + np.sqrt(1 - _WHITE_CORRELATION**2) * blue
    both = zip(_WHITE, _WHITE_SD, (luminance, red, blue), strict=True)
    luminance, red, blue = (np.exp(median + sd * z) for median, sd, z in both)
    colour = np.stack([red, np.ones_like(red), blue], -1)
    return colour * (luminance / (colour @ LUMINANCE_WEIGHTS))[:, None]


def find_white(
    part: Part, limbus_width: float | None, iris: Float[np.ndarray, "pixels 3"]
) -> WhiteOfEye:
    """Find the white to the left and right of a limbus: bright, and less red than skin.

    Args:
        part: The part of a photograph about the limbus.
        limbus_width: Width over which iris and white blend, relative to the limbus's radius.
        iris: Linear colours of the iris.

    Raises:
        ValueError: If no white is seen.
    """
    shape, pixels = part.outside.shape, part.pixels
    radius, angle = part.limbus.radii(shape), angles_about(shape, part.limbus)
    inner = max(_RING[0], 1 + 0.6 * (limbus_width or 0))
    around = (radius > inner) & (radius < max(_RING[1], inner + 0.1)) & ~part.outside
    beside = around & (abs(np.cos(angle)) > _ASIDE)
    cut_off = np.asarray(ndimage.binary_dilation(part.saturated), bool)
    luminance = pixels @ LUMINANCE_WEIGHTS
    tint = np.log(np.maximum(pixels[..., 0], 1e-4) / np.maximum(pixels[..., 2], 1e-4))
    usable, white = beside & ~cut_off, np.zeros(shape, bool)
    message = "no white of the eye is seen beside the iris, by which the light could be corrected"
    if not usable.any():
        raise ValueError(message)
    bright = usable & (luminance > _BRIGHT * np.quantile(luminance[usable], 0.9))
    least_red = float(np.quantile(tint[bright], 0.2))
    skin_red = float(np.quantile(tint[around & ~cut_off & (luminance > 0)], 0.9))
    if least_red > _RED and skin_red - least_red < _THAN_SKIN:
        raise ValueError(message)
    least_luminance, sides = _OVER_IRIS * float(np.median(iris @ LUMINANCE_WEIGHTS)), []
    for side in (np.cos(angle) < 0, np.cos(angle) > 0):
        candidates = usable & side
        if not candidates.any():
            continue
        chosen = candidates & (tint < least_red + _REDDER)
        chosen &= luminance > _BRIGHT * np.quantile(luminance[candidates], 0.9)
        chosen = _largest_part(chosen)
        colour = np.median(pixels[chosen], axis=0) if chosen.any() else np.zeros(3)
        is_enough = chosen.sum() > max(_LEAST[0] * (beside & side).sum(), _LEAST[1])
        if is_enough and colour @ LUMINANCE_WEIGHTS > least_luminance:
            sides.append(colour)
            white |= chosen
    if not sides:
        raise ValueError(message)
    burnt = (beside & part.saturated).sum()
    return WhiteOfEye(white, np.array(sides, float), float(burnt / (burnt + white.sum())))


def angles_about(shape: tuple[int, ...], outline: Ellipse) -> Brightness:
    """Return the angle of every pixel about the middle of an outline, 0 to 2π, 0 to the right."""
    row, column = np.ogrid[: shape[0], : shape[1]]
    x, y = outline.centre
    return np.arctan2(y - row, column - x) % (2 * np.pi)


def _largest_part(mask: Mask) -> Mask:
    """The largest connected part of a mask, across thin gaps such as vessels, or nothing."""
    label = np.asarray(measure.label(ndimage.binary_closing(mask, iterations=_GAP)))
    sizes = np.bincount(label[mask], minlength=2)
    return mask & (label == 1 + int(np.argmax(sizes[1:])))
