"""Edges along rays through an ellipse that rise outwards, and ellipses through such edges."""

from collections.abc import Callable
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from PIL import Image
from scipy import ndimage, optimize

from irisjax.photo.ellipse import Ellipse

FINE, ROUGH = 250.0, 100.0
"""Radii in pixels at which outlines are measured, and at which candidates are compared."""
_RAYS = 180
_FLANK = 0.04  # from the best score to the best fit
_PRECISION = 0.005  # of an edge, of the radius
_RATIOS = (1.0, 0.93, 0.86)
"""Ratios of the semi-axes that are tried: down to a tilt of about 30 degrees."""


class Edges(NamedTuple):
    """Steps along rays through an ellipse: arrays (rays, places) of `place`, relative to the
    ellipse.

    - `fit`: the share of the brightness' variation that a rising step there explains, 0 to 1.
    - `rise`: of the brightness. `place`: (places,).
    """

    place: Float[np.ndarray, " places"]
    fit: Float[np.ndarray, "rays places"]
    rise: Float[np.ndarray, "rays places"]

    def score(self) -> Float[np.ndarray, "rays places"]:
        """How well the step fits, and how strong it is among those of its ray, 0 to 1."""
        rise = np.maximum(self.rise, 0) * self.fit
        most = rise.max(1, keepdims=True)
        return self.fit**2 * np.sqrt(rise / (most + 0.1 * np.median(most) + 1e-9))

    def strongest(
        self, near: float
    ) -> tuple[Float[np.ndarray, " rays"], Float[np.ndarray, " rays"]]:
        """Of each ray the score and the place of the best edge within `near` of the ellipse.

        The score says which edge; where it is, the fit alone, for a strong rise can also be had
        from a step too far out with a line that falls behind it.
        """
        part = np.where(abs(self.place - 1) <= near, self.score(), 0.0)
        at, rays = part.argmax(1), np.arange(len(part))
        value, pitch = part[rays, at], self.place[1] - self.place[0]
        close = abs(self.place - self.place[at][:, None]) <= _FLANK
        at = np.where(close, self.fit, 0.0).argmax(1)
        inner = np.clip(at, 1, self.place.size - 2)
        below, here, above = (self.fit[rays, inner + k] for k in (-1, 0, 1))
        bend = np.maximum(2 * here - below - above, 1e-12)
        place = self.place[at] + pitch * np.clip(0.5 * (above - below) / bend, -0.5, 0.5)
        # At an end of the range it is the flank of an edge elsewhere.
        flank = abs(abs(place - 1) - near) < 1.5 * pitch
        return np.where(flank, 0.0, value), place


def reduced(
    picture: Float[np.ndarray, "rows columns channels"], scale: float
) -> Float[np.ndarray, "rows_1 columns_1 channels"]:
    """A picture made smaller by averaging."""
    if scale >= 1:
        return picture
    rows, columns = (max(8, round(n * scale)) for n in picture.shape[:2])
    return by_channel(picture, lambda c: c.resize((columns, rows), Image.Resampling.BILINEAR))


def by_channel(
    picture: Float[np.ndarray, "rows columns channels"],
    change: Callable[[Image.Image], Image.Image],
) -> Float[np.ndarray, "rows_1 columns_1 channels"]:
    """A picture whose channels Pillow has changed: it makes 12 megapixels smaller in a third to a
    sixth of the time that scikit-image takes.
    """
    channels = np.ascontiguousarray(np.moveaxis(picture, -1, 0), np.float32)
    return np.stack([np.asarray(change(Image.fromarray(c))) for c in channels], axis=-1)


def around(
    picture: Float[np.ndarray, "rows columns channels"],
    outline: Ellipse,
    margin: float,
    radius: float,
) -> tuple[Float[np.ndarray, "rows_1 columns_1 channels"], Ellipse, Callable[[Ellipse], Ellipse]]:
    """The part of a picture within `margin` radii of an outline, reduced so that this has about
    `radius` pixels; and the outline there, with a function from there back to the picture.
    """
    reach = margin * outline.semi_axes[0]
    (x, y), shape = outline.centre, picture.shape
    left, right = (int(np.clip(v, 0, shape[1])) for v in (x - reach, x + reach + 1))
    top, bottom = (int(np.clip(v, 0, shape[0])) for v in (y - reach, y + reach + 1))
    part = picture[top:bottom, left:right]
    scale = min(1.0, radius / outline.semi_axes[0])
    small = reduced(part, scale)
    moved = outline._replace(centre=(x - left, y - top)).scaled(scale)

    def back(e: Ellipse) -> Ellipse:
        e = e.scaled(1 / scale)
        return e._replace(centre=(e.centre[0] + left, e.centre[1] + top))

    return small, moved, back


def along_rays(
    brightness: Float[np.ndarray, "rows columns"],
    outline: Ellipse,
    span: tuple[float, float],
    steps: int,
) -> Float[np.ndarray, "rays steps"]:
    """Brightness at `steps` distances over `span`, relative to an ellipse, of 180 directions; not a
    number outside the picture.
    """
    middle = np.asarray(outline.centre)
    edge = outline.points(ray_angles()) - middle
    at = middle + np.linspace(*span, steps)[:, None] * edge[:, None, :]
    row, column = at[..., 1], at[..., 0]
    values = ndimage.map_coordinates(brightness, [row, column], order=1, mode="nearest")
    rows, columns = brightness.shape
    inside = (row > -0.5) & (row < rows - 0.5) & (column > -0.5) & (column < columns - 0.5)
    return np.where(inside, values, np.nan)


def steps_along(
    profile: Float[np.ndarray, "rays steps"],
    span: tuple[float, float],
    widths: tuple[float, ...],
    reach: float,
) -> Edges:
    """How well a soft step fits at each place of profiles over `span`.

    A step rises as a smoothstep of one of the half `widths` from a constant to a straight line, the
    middle of the rise being its place; it is fitted to what lies within `reach`.
    """
    x = np.linspace(*span, profile.shape[1])
    pitch = x[1] - x[0]
    n = max(3, round(reach / pitch))
    missing = np.isnan(profile)
    filled = np.where(missing, 0.0, profile)
    filled = filled - filled.mean(1, keepdims=True)  # against rounding in the sums of squares
    view = np.lib.stride_tricks.sliding_window_view
    windows = view(filled, 2 * n + 1, axis=1)
    incomplete = view(missing, 2 * n + 1, axis=1).any(-1)
    even = np.full(2 * n + 1, 1 / (2 * n + 1))
    squares = view(filled**2, 2 * n + 1, axis=1) @ even
    total = np.maximum(squares - (windows @ even) ** 2, 0) + 1e-12
    u = np.arange(-n, n + 1) * pitch
    fit, rise = np.zeros(total.shape), np.zeros(total.shape)
    for width in widths:
        t = np.clip(u / (2 * width) + 0.5, 0, 1)
        s = t * t * (3 - 2 * t)
        basis = np.stack([1 - s, s, s * u], -1)
        orthogonal, triangle = np.linalg.qr(basis)
        projected = windows @ orthogonal
        coefficients = projected @ np.linalg.inv(triangle).T
        up = coefficients[..., 1] - coefficients[..., 0]
        explained = 1 - (squares - (projected**2).sum(-1) / (2 * n + 1)) / total
        better = (up > 0) & (explained > fit) & ~incomplete
        fit, rise = np.where(better, explained, fit), np.where(better, up, rise)
    return Edges(x[n : x.size - n], np.minimum(fit, 1), rise)


def best_outline(
    outline: Ellipse, place: Float[np.ndarray, " places"], score: Float[np.ndarray, "rays places"]
) -> tuple[Ellipse, float]:
    """Of ellipses about a circle the one along which the mean score is the largest, and that mean.

    Centres up to 0.15 radii off, radii and ratios of the axes in steps of a few per cent: all of
    them are tried.
    """
    radius = outline.semi_axes[0]
    score = score[::2]
    direction = outline.points(ray_angles()[::2]) - np.asarray(outline.centre)
    direction = direction / radius
    best, found = -np.inf, outline
    offsets = np.linspace(-0.15, 0.15, 7)
    shapes = [(1.0, 0.0)] + [(q, a) for q, a in product(_RATIOS[1:], np.arange(6) * np.pi / 6)]
    pitch = place[1] - place[0]
    rays = np.arange(len(score))
    for (ratio, angle), size in product(shapes, np.linspace(0.82, 1.3, 13)):
        a, b = size / np.sqrt(ratio), size * np.sqrt(ratio)
        dx, dy = np.meshgrid(offsets, offsets)
        away = _distance(dx.ravel(), dy.ravel(), a, b, angle, direction)
        index = np.round((away - place[0]) / pitch)
        within = (index >= 0) & (index < place.size)
        index = np.clip(index, 0, place.size - 1).astype(int)
        mean = np.where(within, score[rays, index], 0.0).mean(-1)
        k = int(np.argmax(mean))
        if mean[k] > best:
            best = float(mean[k])
            x = outline.centre[0] + radius * dx.ravel()[k]
            y = outline.centre[1] + radius * dy.ravel()[k]
            found = Ellipse((float(x), float(y)), (radius * a, radius * b), float(angle))
    return found, best


def polished(
    outline: Ellipse,
    value: Float[np.ndarray, " rays"],
    place: Float[np.ndarray, " rays"],
    weight: Float[np.ndarray, " rays"],
    flattening: tuple[float, float, float] = (0.0, 0.0, 0.1),
) -> tuple[Ellipse, float]:
    """Least squares through one edge a ray, of a `value` from `Edges.score` and a `place` relative
    to an outline; and the share of the outline, `weight`ed, that such edges support.
    """
    middle = np.asarray(outline.centre)
    points = middle + place[:, None] * (outline.points(ray_angles()) - middle)
    if (value > 0.3).sum() < 12:
        return outline, 0.0
    better = fitted(outline, points, value * (value > 0.3), flattening)
    off = abs(better.relative_radius(points[:, 0], points[:, 1]) - 1)
    near = off < 0.02 + 0.5 / better.semi_axes[0]
    held = (weight * value * near).sum() / weight.sum()
    return better, float(held)


def fitted(
    start: Ellipse,
    points: Float[np.ndarray, "n 2"],
    weights: Float[np.ndarray, " n"],
    flattening: tuple[float, float, float] = (0.0, 0.0, 0.1),
) -> Ellipse:
    """The ellipse that points (column, row) and an expected `flattening` suggest, by least squares
    in which points further off than about 1 % of the radius count little.

    `flattening`: the log ratio of the axes times cosine and sine of twice the angle, and the
    standard deviation of both; what arcs at the sides leave open is taken from it.
    """
    size = np.sqrt(start.semi_axes[0] * start.semi_axes[1])
    middle = np.asarray(start.centre)
    flat = np.log(start.semi_axes[0] / start.semi_axes[1])
    at = np.array([0, 0, 0, flat * np.cos(2 * start.angle), flat * np.sin(2 * start.angle)])
    scaled = (points - middle) / size
    expected, spread = np.asarray(flattening[:2]), flattening[2]

    def ellipse(p) -> Ellipse:
        flat, angle = np.hypot(p[3], p[4]), 0.5 * np.arctan2(p[4], p[3])
        axes = np.exp(p[2] + 0.5 * flat), np.exp(p[2] - 0.5 * flat)
        return Ellipse((p[0], p[1]), axes, angle)

    def off(p):
        return ellipse(p).relative_radius(scaled[:, 0], scaled[:, 1]) - 1

    for outlier in (0.04, 0.02, 0.01, 0.01, 0.01):
        # A tenth: neighbouring rays err alike.
        root = np.sqrt(0.1 * weights) / _PRECISION / (1 + (off(at) / outlier) ** 2)

        def miss(p, root=root):
            return np.concatenate([root * off(p), (p[3:] - expected) / spread])

        at = optimize.least_squares(miss, at, method="lm", xtol=1e-6).x
    e = ellipse(at)
    (x, y), (a, b) = middle + size * np.asarray(e.centre), size * np.asarray(e.semi_axes)
    return Ellipse((float(x), float(y)), (float(a), float(b)), float(e.angle % np.pi))


def ray_angles() -> Float[np.ndarray, " rays"]:
    """Of the rays: parameters of the ellipse they leave, radians."""
    return np.arange(_RAYS) * (2 * np.pi / _RAYS)


def _distance(dx, dy, a, b, angle, direction):
    """From the origin to ellipses about (dx, dy) along unit directions, (ellipses, directions)."""
    cos, sin = np.cos(angle), np.sin(angle)

    def turned(x, y):
        return (x * cos - y * sin) / a, (-x * sin - y * cos) / b

    u, v = turned(direction[:, 0], direction[:, 1])
    cu, cv = (c[:, None] for c in turned(dx, dy))
    square, mixed = u * u + v * v, u * cu + v * cv
    return (mixed + np.sqrt(np.maximum(mixed**2 - square * (cu**2 + cv**2 - 1), 0))) / square
