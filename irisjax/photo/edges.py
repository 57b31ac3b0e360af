"""Outlines that are dark inside and bright outside: rings by voting, then ellipses by their edges.

Daugman's integro-differential operator searches circles of the strongest radial change of
brightness; here each pixel votes by the direction of its gradient alone, so that a highlight or a
burnt-out white counts no more than any other edge.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import fft, ndimage, optimize
from skimage.transform import resize

from irisjax.photo.ellipse import Ellipse

_RINGS = np.geomspace(20, 40, 9)[:-1]  # px: radii of one octave
_WEAK = 0.05  # change of log brightness per pixel that counts half
_RAYS = 180
_PRECISION = 0.005  # of an edge, of the radius
_RATIOS = (1.0, 0.93, 0.86)
"""Ratios of the semi-axes that are tried: down to a tilt of about 30 degrees."""


class Ring(NamedTuple):
    """A circle in pixels and the mean of its votes, at most 1."""

    column: float
    row: float
    radius: float
    votes: float


class Edges(NamedTuple):
    """Steps along rays through an ellipse: arrays (rays, places) of `place`, relative to the
    ellipse.

    - `fit`: the share of the brightness' variation that a rising step there explains, 0 to 1.
    - `rise`: of the brightness. `place`: (places,).
    """

    place: Float[np.ndarray, " places"]
    fit: Float[np.ndarray, "rays places"]
    rise: Float[np.ndarray, "rays places"]


def rings(
    brightness: Float[np.ndarray, "rows columns"],
    radii: tuple[float, float],
    number: int,
    sideways: float = 0.0,
) -> list[Ring]:
    """The rings of the most votes, up to `number` of each octave of radii, best first.

    Each octave is searched in a copy in which they are 20 to 40 px. `sideways`: how much
    less the top and the bottom of a ring count, 0 to 1: there lids are in the way.
    """
    kept: list[Ring] = []
    low, high = radii
    while low < high:
        found: list[Ring] = []
        scale = min(_RINGS[0] / low, 1.0)
        shape = tuple(max(8, round(n * scale)) for n in brightness.shape)
        small = resize(brightness, shape, anti_aliasing=scale < 1)
        size = tuple(fft.next_fast_len(n + 2 * int(_RINGS[-1] + 10)) for n in shape)
        transformed = fft.fft2(_directions(small), size)
        for radius in _RINGS * (low * scale / _RINGS[0]):
            if radius / scale < 1.06 * high:
                votes = _votes(transformed, shape, radius, sideways)
                peak = ndimage.maximum_filter(votes, max(3, int(radius / 3)))
                for row, column in np.argwhere((votes == peak) & (votes > 0.15)):
                    at = (column + 0.5) / scale - 0.5, (row + 0.5) / scale - 0.5
                    found.append(Ring(*at, radius / scale, float(votes[row, column])))
        fresh: list[Ring] = []
        for ring in sorted(found, key=lambda r: -r.votes):
            if len(fresh) < number and not any(_alike(ring, other) for other in kept + fresh):
                fresh.append(ring)
        kept += fresh
        low *= 2
    return sorted(kept, key=lambda r: -r.votes)


def _alike(a: Ring, b: Ring) -> bool:
    near = np.hypot(a.column - b.column, a.row - b.row) < 0.3 * b.radius
    return bool(near and 0.75 < a.radius / b.radius < 1.33)


def _directions(brightness):
    """Of the gradient of log brightness: cosine minus i sine, weak ones brought towards 0."""
    floor = 0.02 * np.quantile(brightness, 0.98) + 1e-6
    smooth = ndimage.gaussian_filter(np.log(np.maximum(brightness, 0) + floor), 1.5)
    down, right = np.gradient(smooth)
    return ((right - 1j * down) / (np.hypot(down, right) + _WEAK)).astype(np.complex64)


def _votes(transformed, shape, radius: float, sideways: float):
    """Of rings of one radius about each pixel: the mean over the ring of the cosine between its
    normal and the gradient, whose directions come Fourier transformed.
    """
    n = int(np.ceil(radius + 5))
    y, x = np.mgrid[-n : n + 1, -n : n + 1]
    away = np.hypot(x, y) + 1e-9
    ring = np.exp(-0.5 * ((away - radius) / 2) ** 2) * (1 - sideways * (y / away) ** 2)
    # Correlation, and the kernel is odd: its mirror image is its negative.
    kernel = (-ring / ring.sum() * (x + 1j * y) / away).astype(np.complex64)
    size = transformed.shape
    summed = fft.ifft2(transformed * fft.fft2(kernel, size)).real
    return summed[n : n + shape[0], n : n + shape[1]]


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


def _distance(dx, dy, a, b, angle, direction):
    """From the origin to ellipses about (dx, dy) along unit directions, (ellipses, directions)."""
    cos, sin = np.cos(angle), np.sin(angle)

    def turned(x, y):
        return (x * cos - y * sin) / a, (-x * sin - y * cos) / b

    u, v = turned(direction[:, 0], direction[:, 1])
    cu, cv = (c[:, None] for c in turned(dx, dy))
    square, mixed = u * u + v * v, u * cu + v * cv
    return (mixed + np.sqrt(np.maximum(mixed**2 - square * (cu**2 + cv**2 - 1), 0))) / square


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

    for outlier in (0.04, 0.02, 0.01, 0.01, 0.01, 0.01):
        # A tenth: neighbouring rays err alike.
        root = np.sqrt(0.1 * weights) / _PRECISION / (1 + (off(at) / outlier) ** 2)

        def miss(p, root=root):
            return np.concatenate([root * off(p), (p[3:] - expected) / spread])

        at = optimize.least_squares(miss, at).x
    e = ellipse(at)
    (x, y), (a, b) = middle + size * np.asarray(e.centre), size * np.asarray(e.semi_axes)
    return Ellipse((float(x), float(y)), (float(a), float(b)), float(e.angle % np.pi))


def ray_angles() -> Float[np.ndarray, " rays"]:
    """Of the rays: parameters of the ellipse they leave, radians."""
    return np.arange(_RAYS) * (2 * np.pi / _RAYS)
