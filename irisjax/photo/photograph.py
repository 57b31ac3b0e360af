"""Photographs, and ellipses in them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

Colours = Float[np.ndarray, "rows columns 3"]
"""A picture on sRGB's primaries, linear unless stated otherwise."""
Brightness = Float[np.ndarray, "rows columns"]
"""One number for each pixel or texel."""
Mask = Bool[np.ndarray, "rows columns"]
"""Pixels or texels that are meant."""


class Photograph(NamedTuple):
    """A colour photograph, top row first, held upright.

    Attributes:
        pixels: Linear values on sRGB's primaries; 1 is the brightest value that the file can hold.
        saturated: Pixels with a channel so close to that limit that it may be cut off.
        grey: Whether the photograph has no colours.
        focal_px: Focal length in pixels according to the file, `None` if it does not say.
        name: Name of the file, for messages.
        notes: Sentences on what was assumed in reading it.
    """

    pixels: Colours
    saturated: Mask
    grey: bool = False
    focal_px: float | None = None
    name: str = "photograph"
    notes: tuple[str, ...] = ()

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.saturated.shape


class Ellipse(NamedTuple):
    """An ellipse in pixels of a photograph.

    Attributes:
        centre: Column and row; whole numbers are the middles of pixels, row 0 is the top one.
        semi_axes: The larger, then the smaller one.
        angle: Angle of the larger axis (radians), from the columns' direction (right) towards the
            top of the picture.
    """

    centre: tuple[float, float]
    semi_axes: tuple[float, float]
    angle: float = 0.0

    def points(self, along: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """Return columns and rows at parameters of the ellipse, radians from its larger axis."""
        (x, y), (a, b) = self.centre, self.semi_axes
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        u, v = a * np.cos(along), b * np.sin(along)
        return np.stack([x + u * cos - v * sin, y - u * sin - v * cos], -1)

    def relative_radius(
        self, column: float | np.ndarray, row: float | np.ndarray
    ) -> Float[np.ndarray, "*s"]:
        """Return 0 at the centre, 1 on the ellipse, for points of the picture."""
        (x, y), (a, b) = self.centre, self.semi_axes
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        right, up = np.asarray(column) - x, y - np.asarray(row)
        return np.asarray(np.hypot((right * cos + up * sin) / a, (up * cos - right * sin) / b))

    def radii(self, shape: tuple[int, ...]) -> Brightness:
        """Return the relative radius of every pixel of a picture."""
        row, column = np.ogrid[: shape[0], : shape[1]]
        return self.relative_radius(column, row)

    def mask(self, shape: tuple[int, int]) -> Mask:
        """Return which pixels of a picture lie within the ellipse."""
        return self.radii(shape) < 1

    @property
    def flattening(self) -> Float[np.ndarray, "2"]:
        """ln(a / b) times cosine and sine of twice the angle: 0 for a circle."""
        (a, b), twice = self.semi_axes, 2 * self.angle
        return np.log(a / b) * np.array([np.cos(twice), np.sin(twice)])

    @property
    def mean_radius(self) -> float:
        """Geometric mean of the semi-axes."""
        return float(np.sqrt(np.prod(self.semi_axes)))

    def moved(self, right: float, down: float) -> "Ellipse":
        """Return the ellipse shifted by some pixels."""
        x, y = self.centre
        return self._replace(centre=(x + right, y + down))

    def scaled(self, factor: float) -> "Ellipse":
        """Return the ellipse in a picture with `factor` times as many pixels along each side."""
        x, y = ((c + 0.5) * factor - 0.5 for c in self.centre)
        a, b = (s * factor for s in self.semi_axes)
        return Ellipse((x, y), (a, b), self.angle)


def ellipse_through(points: Float[np.ndarray, "n 2"]) -> Ellipse:
    """Fit an ellipse to points (column, row) by linear least squares of the conic.

    scikit-image's fit divides by zero if the points lie on a circle.
    """
    middle = points.mean(0)
    size = np.sqrt(((points - middle) ** 2).sum(1).mean())
    x, y = ((points - middle) / size).T * [[1], [-1]]
    # x² + y² + A (x² - y²) + 2 B x y + C x + D y + E = 0
    system = np.stack([x * x - y * y, 2 * x * y, x, y, np.ones_like(x)], -1)
    a, b, c, d, e = np.linalg.lstsq(system, -(x * x + y * y), rcond=None)[0]
    u, v = -0.5 * np.linalg.solve([[1 + a, b], [b, 1 - a]], [c, d])
    level, uneven = -(e + 0.5 * (c * u + d * v)), np.hypot(a, b)
    axes = size * np.sqrt(level / (1 - uneven)), size * np.sqrt(level / (1 + uneven))
    centre = middle[0] + size * u, middle[1] - size * v
    return Ellipse(centre, axes, 0.5 * np.arctan2(-b, -a) % np.pi)
