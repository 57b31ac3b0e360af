"""Dark rings and rising edges in a picture, and ellipses through such edges."""

import functools
from collections.abc import Callable
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from PIL import Image
from scipy import fft, ndimage

from irisjax.photo.photograph import Brightness, Ellipse

FINE, ROUGH = 250.0, 100.0
"""Radii in pixels at which outlines are measured, and at which candidates are compared."""
RAYS = np.arange(120) * (2 * np.pi / 120)  # parameters of the points at which rays cross ellipses
_FLANK = 0.04  # distance from the best score within which the best fit is sought
_ODDNESS_COST = 0.01  # mean score that outweighs one standard deviation of the centre, squared
_LEAST_SCORE = 0.15  # score of an edge that is used
_PRECISION = 0.005  # of an edge, relative to the radius
_RATIOS = (1.0, 0.93, 0.86)  # trial ratios of the semi-axes, for tilts up to about 30 degrees
_RINGS = np.geomspace(20, 40, 7)[:-1]  # px: radii of one octave
_INDEPENDENT = 18  # number of rays whose errors are independent
_WEAK = 0.05  # change of log brightness per pixel that has half the weight

_Picture = Float[np.ndarray, "rows columns channels"]
_Rays = Float[np.ndarray, " rays"]
_Profiles = Float[np.ndarray, "rays places"]


class Edges(NamedTuple):
    """Rising steps along rays through an ellipse.

    Attributes:
        place: Distances along a ray, relative to the ellipse.
        fit: Share of the brightness' variation that a rising step there explains, 0 to 1.
        rise: Height of the step in brightness.
    """

    place: Float[np.ndarray, " places"]
    fit: _Profiles
    rise: _Profiles

    def score(self) -> _Profiles:
        """Return how well a step fits and how strong it is among those of its ray, 0 to 1."""
        rise = np.maximum(self.rise, 0) * self.fit
        most = rise.max(1, keepdims=True)
        return self.fit**2 * np.sqrt(rise / (most + 0.1 * np.median(most) + 1e-9))

    def strongest(self, near: float) -> tuple[_Rays, _Rays]:
        """Return the score and the place of each ray's best edge within `near` of the ellipse.

        The score selects the edge. Its place is where the fit alone is best, for a step too far out
        with a line that falls behind it can have a strong rise, too.
        """
        part = np.where(abs(self.place - 1) <= near, self.score(), 0.0)
        index, rays = part.argmax(1), np.arange(len(part))
        value, pitch = part[rays, index], self.place[1] - self.place[0]
        close = abs(self.place - self.place[index][:, None]) <= _FLANK
        index = np.where(close, self.fit, 0.0).argmax(1)
        inner = np.clip(index, 1, self.place.size - 2)
        below, middle, above = (self.fit[rays, inner + k] for k in (-1, 0, 1))
        bend = np.maximum(2 * middle - below - above, 1e-12)
        place = self.place[index] + pitch * np.clip(0.5 * (above - below) / bend, -0.5, 0.5)
        # A maximum at an end of the range is the flank of an edge elsewhere.
        flank = abs(abs(place - 1) - near) < 1.5 * pitch
        return np.where(flank, 0.0, value), place


class Expected(NamedTuple):
    """A normal prior of an ellipse, before its edges are seen.

    Attributes:
        flattening: Mean of the components of `Ellipse.flattening`.
        flattening_sd: Standard deviation of each of them.
        centre: Mean of the centre, px; `None` if nothing is known of it.
        centre_sd: Standard deviation of each of its coordinates, relative to the ellipse's radius.
    """

    flattening: tuple[float, float] = (0.0, 0.0)
    flattening_sd: float = 0.1
    centre: tuple[float, float] | None = None
    centre_sd: float = np.inf


class FittedEllipse(NamedTuple):
    """An ellipse through edges.

    Attributes:
        outline: The ellipse.
        support: Share of it that edges support.
        flattening_sd: Standard deviation of either component of its flattening.
        place_sd: Standard deviation of centre and logarithm of the mean radius together, relative
            to the radius.
        margin: Of a pupil, whose iris may have a dark margin: width over which the brightness rises
            to the iris's, relative to the pupil's radius; 0 for a sharp edge, `None` if it is not
            known. A step and a smoothstep at one place count as the smoothstep that lets as much
            light by.
    """

    outline: Ellipse
    support: float
    flattening_sd: float = 0.0
    place_sd: float = 0.0
    margin: float | None = None


def find_rings(
    brightness: Brightness, radii: tuple[float, float], number: int, sideways: float
) -> Float[np.ndarray, "rings 4"]:
    """Find circles that are dark inside and bright outside, by voting; return column, row, radius
    (px) and mean vote, at most 1, of each, best first.

    Daugman's integro-differential operator searches circles of the strongest radial change of
    brightness. Here each pixel votes by the direction of its gradient alone, so that a highlight or
    a burnt-out white counts no more than any other edge. Each octave of radii is searched in a copy
    of the picture in which they are 20 to 40 px.

    Args:
        brightness: The picture.
        radii: Smallest and largest radius, px.
        number: Most rings of an octave; those with the most votes are returned.
        sideways: By how much less top and bottom of a ring count, 0 to 1, because lids hide them.
    """
    rings = np.empty((0, 4))
    low, high = radii
    while low < high:
        scale = min(_RINGS[0] / low, 1.0)
        small = reduce_picture(brightness[..., None], scale)[..., 0]
        sizes = _RINGS * (low * scale / _RINGS[0])
        sizes = sizes[sizes / scale < 1.06 * high]
        margin = int(np.ceil(sizes[-1] + 5))
        # Rounded up, so that kernels are cached.
        lengths = ((max(n, margin + 1) + margin + 15) // 16 * 16 for n in small.shape)
        shape = tuple(fft.next_fast_len(n, real=True) for n in lengths)
        kernels: np.ndarray = np.asarray(_ring_kernels(shape, tuple(sizes.round(3)), sideways))
        parts = np.multiply(kernels, np.asarray(fft.rfft2(_directions(small), shape)))
        votes = np.asarray(fft.irfft2(parts.sum(1), shape))
        votes = votes[:, margin : margin + small.shape[0], margin : margin + small.shape[1]]
        candidates = [rings[:0]]
        for radius, vote in zip(sizes, votes, strict=True):
            peak = ndimage.maximum_filter(vote, max(3, int(radius / 3)))
            peaks = np.nonzero((vote == peak) & (vote > 0.15))
            centre = [(c + 0.5) / scale - 0.5 for c in peaks[::-1]]
            candidates.append(np.stack([*centre, 0 * peaks[0] + radius / scale, vote[peaks]], -1))
        limit = len(rings) + number
        for ring in sorted(np.concatenate(candidates), key=lambda ring: -ring[3]):
            distance, ratio = np.hypot(*(rings[:, :2] - ring[:2]).T), ring[2] / rings[:, 2]
            similar = (distance < 0.3 * rings[:, 2]) & (ratio > 0.75) & (ratio < 1.33)
            if len(rings) < limit and not similar.any():
                rings = np.vstack([rings, ring])
        low *= 2
    return rings[np.argsort(-rings[:, 3], kind="stable")]


def reduce_picture(
    picture: _Picture, scale: float
) -> Float[np.ndarray, "rows_1 columns_1 channels"]:
    """Return the picture with fewer pixels, each an average."""
    if scale >= 1:
        return picture
    rows, columns = (max(8, round(n * scale)) for n in picture.shape[:2])
    return map_channels(picture, lambda c: c.resize((columns, rows), Image.Resampling.BILINEAR))


def map_channels(
    picture: _Picture, change: Callable[[Image.Image], Image.Image]
) -> Float[np.ndarray, "rows_1 columns_1 channels"]:
    """Apply a function of Pillow, three to six times as fast as scikit-image, to each channel."""
    channels = np.ascontiguousarray(np.moveaxis(picture, -1, 0), np.float32)
    return np.stack([np.asarray(change(Image.fromarray(c))) for c in channels], axis=-1)


def cut_around(
    picture: _Picture, outline: Ellipse, margin: float, radius: float
) -> tuple[Float[np.ndarray, "rows_1 columns_1 channels"], Ellipse, Callable[[Ellipse], Ellipse]]:
    """Cut out the part of a picture around an outline, `margin` radii to each side, and reduce it
    until the outline's radius is at most `radius` (px); return it with the outline in it, and a
    function from ellipses in it to those in the picture.
    """
    reach = margin * outline.semi_axes[0]
    (x, y), shape = outline.centre, picture.shape
    left, right = (int(np.clip(v, 0, shape[1])) for v in (x - reach, x + reach + 1))
    top, bottom = (int(np.clip(v, 0, shape[0])) for v in (y - reach, y + reach + 1))
    scale = min(1.0, radius / outline.semi_axes[0])
    part = reduce_picture(picture[top:bottom, left:right], scale)
    moved = outline.moved(-left, -top).scaled(scale)
    return part, moved, lambda e: e.scaled(1 / scale).moved(left, top)


def sample_along_rays(
    brightness: Brightness, outline: Ellipse, span: tuple[float, float], steps: int
) -> _Profiles:
    """Return the brightness at `steps` distances over `span`, relative to an ellipse, along
    `RAYS`; NaN outside the picture.
    """
    middle = np.asarray(outline.centre)
    edge = outline.points(RAYS) - middle
    points = middle + np.linspace(*span, steps)[:, None] * edge[:, None, :]
    row, column = points[..., 1], points[..., 0]
    values = ndimage.map_coordinates(brightness, [row, column], order=1, mode="nearest")
    rows, columns = brightness.shape
    inside = (row > -0.5) & (row < rows - 0.5) & (column > -0.5) & (column < columns - 0.5)
    return np.where(inside, values, np.nan)


def fit_steps(
    profile: _Profiles, span: tuple[float, float], widths: tuple[float, ...], reach: float
) -> Edges:
    """Fit a soft step at each place of profiles over `span`.

    A step rises as a smoothstep of one of the half `widths` from a constant to a straight line; its
    place is the middle of the rise. It is fitted to the profile within `reach`.
    """
    x = np.linspace(*span, profile.shape[1])
    band, triangles, n = _step_kernels(span, x.size, widths, reach)
    count, window = x.size - 2 * n, 2 * n + 1

    def project(values: np.ndarray) -> np.ndarray:
        return (values @ band).reshape(len(values), count, -1)

    missing = np.isnan(profile)
    filled = np.where(missing, 0.0, profile)
    filled = filled - filled.mean(1, keepdims=True)  # against rounding in the sums of squares
    mean = band[:, :: band.shape[1] // count]
    squares, projected = filled**2 @ mean, project(filled)
    total = np.maximum(squares - projected[..., 0] ** 2, 0) + 1e-12
    fit, rise = np.zeros(total.shape), np.zeros(total.shape)
    incomplete = missing.astype(float) @ mean > 1e-9 if missing.any() else False
    for k, triangle in enumerate(triangles):
        parts = projected[..., 3 * k + 1 : 3 * k + 4]
        low, high = np.moveaxis(parts @ triangle[:, :2], -1, 0)
        explained = 1 - (squares - (parts**2).sum(-1) / window) / total
        better = (high > low) & (explained > fit) & np.logical_not(incomplete)
        fit, rise = np.where(better, explained, fit), np.where(better, high - low, rise)
    return Edges(x[n : x.size - n], np.minimum(fit, 1), rise)


@functools.lru_cache(16)
def _step_kernels(span: tuple[float, float], size: int, widths: tuple[float, ...], reach: float):
    """A matrix by which profiles give, for each window, their mean and their parts along three
    orthogonal functions for each width; the heights of the step of these; half the window.
    """
    pitch = (span[1] - span[0]) / (size - 1)
    n = max(3, round(reach / pitch))
    count, u = size - 2 * n, np.arange(-n, n + 1) * pitch
    triangles, kernels = [], [np.full((u.size, 1), 1 / u.size)]
    for width in widths:
        t = np.clip(u / (2 * width) + 0.5, 0, 1)
        s = t * t * (3 - 2 * t)
        orthogonal, triangle = np.linalg.qr(np.stack([1 - s, s, s * u], -1))
        kernels.append(orthogonal)
        triangles.append(np.linalg.inv(triangle).T)
    # All windows and kernels by one product of matrices.
    kernel, place = np.hstack(kernels), np.arange(count)
    band = np.zeros((size, count, kernel.shape[1]))
    band[place[:, None] + np.arange(u.size), place[:, None]] = kernel
    return band.reshape(size, -1), triangles, n


def best_outline(
    outline: Ellipse, place: Float[np.ndarray, " places"], score: _Profiles, expected: Expected
) -> Ellipse:
    """Return the ellipse about a circle along which the mean score is largest: all centres up to
    0.15 radii off, radii and ratios of the axes are tried in steps of a few per cent. Ellipses far
    from what is `expected` need a better score.
    """
    radius, score = outline.semi_axes[0], score[::3]
    direction = (outline.points(RAYS[::3]) - np.asarray(outline.centre)) / radius
    best, best_ellipse = -np.inf, outline
    dx, dy = (c.ravel() for c in np.meshgrid(*[np.linspace(-0.15, 0.15, 7)] * 2))
    sizes, centre_cost = np.linspace(0.82, 1.3, 13), np.zeros(dx.size)
    if expected.centre is not None:
        x, y = np.subtract(expected.centre, outline.centre) / radius
        oddness = ((dx - x) ** 2 + (dy - y) ** 2) / expected.centre_sd**2
        centre_cost = _ODDNESS_COST * np.minimum(oddness, 9)
    pitch, rays = place[1] - place[0], np.arange(len(score))
    for ratio, angle in [(1.0, 0.0), *product(_RATIOS[1:], np.arange(4) * np.pi / 4)]:
        axes = sizes / np.sqrt(ratio), sizes * np.sqrt(ratio)
        index = np.round((_distance_to_ellipse(dx, dy, *axes, angle, direction) - place[0]) / pitch)
        within = (index >= 0) & (index < place.size)
        index = np.clip(index, 0, place.size - 1).astype(int)
        flattening = -np.log(ratio) * np.array([np.cos(2 * angle), np.sin(2 * angle)])
        deviation = flattening - expected.flattening
        oddness = float(deviation @ deviation) / expected.flattening_sd**2
        flattening_cost = _ODDNESS_COST * min(oddness, 9.0)
        mean = np.where(within, score[rays, index], 0.0).mean(-1) - centre_cost - flattening_cost
        size, k = np.unravel_index(np.argmax(mean), mean.shape)
        if mean[size, k] > best:
            best, (a, b) = mean[size, k], (radius * axis[size] for axis in axes)
            best_ellipse = outline.moved(radius * dx[k], radius * dy[k])
            best_ellipse = best_ellipse._replace(semi_axes=(a, b), angle=float(angle))
    return best_ellipse


def refine_outline(
    outline: Ellipse, value: _Rays, place: _Rays, weight: _Rays, expected: Expected
) -> FittedEllipse:
    """Fit an ellipse through the edges of `Edges.strongest`, in which each ray has a `weight`.

    Where the edges lie at the sides alone, what is `expected` decides.
    """
    middle = np.asarray(outline.centre)
    points = middle + place[:, None] * (outline.points(RAYS) - middle)
    used = value > _LEAST_SCORE
    if used.sum() < 12:
        return FittedEllipse(outline, 0.0, expected.flattening_sd, 1.0)
    ellipse, sd, place_sd = _fit_ellipse(outline, points, weight * value**2 * used, expected)
    distance = abs(ellipse.relative_radius(points[:, 0], points[:, 1]) - 1)
    near = distance < 0.02 + 0.5 / ellipse.semi_axes[0]
    support = (weight * value * near).sum() / weight.sum()
    return FittedEllipse(ellipse, float(support), sd, place_sd)


def _fit_ellipse(
    start: Ellipse, points, weights, expected: Expected
) -> tuple[Ellipse, float, float]:
    """An ellipse by robust least squares: points off by more than about 1 % count little."""
    size, middle = start.mean_radius, np.asarray(start.centre)
    points, weights = points[weights > 0], weights[weights > 0]
    scaled, rank = (points - middle) / size * [1, -1], max(0, int(0.6 * len(points)) - 1)
    prior_mean, sd = np.zeros(5), np.full(5, np.inf)
    correlated = _INDEPENDENT / RAYS.size  # the errors of neighbouring rays are
    prior_mean[3:], sd[3:] = expected.flattening, expected.flattening_sd
    if expected.centre is not None:
        prior_mean[:2] = (np.asarray(expected.centre) - middle) / size * [1, -1]
        sd[:2] = expected.centre_sd

    def improve(parameters, outliers):
        """Fits from several beginnings at once, and what supports each."""
        normal = np.eye(5)
        for outlier in outliers:
            residuals, slopes = _residuals(parameters, scaled)
            share = 1 / (1 + (residuals / outlier) ** 2) ** 2
            if outlier == _PRECISION:  # least absolute distances
                share = 1 / (1 + abs(residuals) / outlier)
            # Sharp edges scatter less.
            near = np.partition(abs(residuals), rank, axis=1)[:, : rank + 1].mean(1, keepdims=True)
            precision = np.clip(2 * near, 0.2 * _PRECISION, _PRECISION)
            weight = correlated * weights * share / precision**2
            weighted = weight[:, None, :] * slopes
            normal = weighted @ slopes.swapaxes(1, 2) + np.diag(sd**-2.0)
            pull = (parameters - prior_mean) * sd**-2.0
            gradient = (weighted @ residuals[..., None])[..., 0] + pull
            change = np.linalg.solve(normal + 1e-6 * np.eye(5), gradient[..., None])[..., 0]
            parameters = parameters - np.clip(change, -0.1, 0.1)
        supported = (weights / (1 + (_residuals(parameters, scaled)[0] / 0.01) ** 2)).sum(1)
        oddness = (((parameters - prior_mean) / sd) ** 2).sum(1)
        merit = correlated * supported - _PRECISION**2 / 0.01**2 * oddness
        return merit, parameters, normal

    # A lid's edge attracts the ellipse: of several beginnings the one that most edges support.
    initial, scales = np.array([0, 0, 0, *start.flattening]), (0.02,) * 3 + (0.01,) * 6
    absolute = improve(initial[None], [_PRECISION] * 6)[1][0]
    starts = np.stack([initial, absolute, np.append(initial[:3], prior_mean[3:])])
    merit, fits, normals = improve(starts, scales)
    best = int(np.argmax(merit))
    parameters, spread = fits[best], np.linalg.inv(normals[best]).diagonal()
    (x, y), flattening = middle + size * parameters[:2] * [1, -1], parameters[3:]
    radius = size * np.exp(parameters[2])
    stretch, angle = np.hypot(*flattening), 0.5 * np.arctan2(flattening[1], flattening[0])
    axes = radius * np.exp(0.5 * stretch), radius * np.exp(-0.5 * stretch)
    flattening_sd, place_sd = np.sqrt(spread[3:].mean()), np.sqrt(spread[:3].sum())
    return Ellipse((x, y), axes, angle % np.pi), float(flattening_sd), float(place_sd)


def _residuals(p, points):
    """Distances of points (right, up) from ellipses of centre, logarithm of the mean radius and
    flattening, relative to the ellipse, and their derivatives by these five.
    """
    x, y, size, p3, p4 = np.moveaxis(p[..., None], -2, 0)
    flattening = np.maximum(np.hypot(p3, p4), 1e-4)
    even, uneven = np.cosh(flattening / 2), np.sinh(flattening / 2) / flattening
    bend, half = (even / 2 - uneven) / flattening**2, uneven / 2
    u, v = points[:, 0] - x, points[:, 1] - y
    stretched, across = p3 * u + p4 * v, p4 * u - p3 * v
    a, b = even * u - uneven * stretched, even * v - uneven * across
    distance = np.exp(-size) * np.hypot(a, b)
    a, b = (np.exp(-2 * size) * part / (distance + 1e-12) for part in (a, b))
    bending = a * (half * u - bend * stretched) + b * (half * v - bend * across)
    slopes = [
        -a * (even - uneven * p3) + b * uneven * p4,
        a * uneven * p4 - b * (even + uneven * p3),
        -distance,
        p3 * bending - uneven * (a * u - b * v),
        p4 * bending - uneven * (a * v + b * u),
    ]
    return distance - 1, np.stack(slopes, -2)


def _distance_to_ellipse(dx, dy, a, b, angle, direction):
    """From the origin to ellipses about (dx, dy): (semi-axes a and b, centres, unit directions)."""
    cos, sin = np.cos(angle), np.sin(angle)
    a, b = a[:, None, None], b[:, None, None]
    # No function within: the type checks of tests would decorate it anew at every call.
    (u, v), (cu, cv) = (
        ((x * cos - y * sin) / a, (-x * sin - y * cos) / b)
        for x, y in (direction.T, (dx[:, None], dy[:, None]))
    )
    square, mixed = u * u + v * v, u * cu + v * cv
    return (mixed + np.sqrt(np.maximum(mixed**2 - square * (cu**2 + cv**2 - 1), 0))) / square


def _directions(brightness):
    """Cosine and sine of the gradient of smoothed log brightness, less if it is weak."""
    floor = 0.02 * np.quantile(brightness, 0.98) + 1e-6
    smooth = ndimage.gaussian_filter(np.log(np.maximum(brightness, 0) + floor), 1.5)
    down, right = np.gradient(smooth)
    return np.stack([right, down]).astype(np.float32) / (np.hypot(down, right) + _WEAK)


@functools.lru_cache(12)
def _ring_kernels(shape: tuple[int, ...], radii: tuple[float, ...], sideways: float):
    """Transformed kernels (radii, 2, rows, columns) that give, about each pixel, the mean over a
    ring of the cosine between its normal and a gradient of these two components.
    """
    n, kernels = int(np.ceil(radii[-1] + 5)), []
    y, x = np.mgrid[-n : n + 1, -n : n + 1]
    distance = np.hypot(x, y) + 1e-9
    for radius in radii:
        ring = np.exp(-0.5 * ((distance - radius) / 2) ** 2) * (1 - sideways * (y / distance) ** 2)
        # This is a correlation, and the kernel is odd: its mirror image is its negative.
        kernels.append(-ring / ring.sum() / distance * np.stack([x, y]))
    return fft.rfft2(np.array(kernels, np.float32), shape)
