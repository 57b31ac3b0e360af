"""`find_boundaries`: limbus and pupil of the eye in a photograph, and how sure they are."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import ndimage
from skimage.transform import resize

from irisjax.photo.edges import (
    Edges,
    Ring,
    along_rays,
    best_outline,
    fitted,
    ray_angles,
    rings,
    steps_along,
)
from irisjax.photo.ellipse import Ellipse
from irisjax.photo.photograph import Photograph

MIN_CONFIDENCE = 0.4
"""Below this an outline is more likely wrong than right."""
PUPIL_SHARE = (0.12, 0.85)
"""Radii of pupils, of the limbus'."""
_LONG = 800  # px along the long side of the copy in which eyes are searched
_LEAST = 40  # of the long side: the smallest iris' radius
_CANDIDATES, _FINALISTS = 6, 6
_FINE = 250.0  # px: radius at which outlines are measured
_SOFT = (0.02, 0.05, 0.09)  # half widths of the limbus' rise, of its radius: about 1 mm in all
_ONSETS = (0.01, 0.02, 0.03, 0.04, 0.05, 0.065, 0.08, 0.1, 0.12)
_TRUSTED = 0.5  # support of a pupil that may tell of the limbus
_LIMBUS_FLATTER = 1.25  # than the pupil, which the cornea shows turned towards the camera
_ROUGH = 100.0  # px: the same while candidates are compared
_SHARP = (0.02, 0.05, 0.1)  # the same of the pupil's


class Boundaries(NamedTuple):
    """Outlines of limbus and pupil in pixels of the photograph.

    `limbus_confidence`, `pupil_confidence`: 0 to 1, from the share of each outline that edges
    support, how near to it they lie and how strong they are; 1 for an outline that was given. Below
    `MIN_CONFIDENCE` the outline is not to be trusted.
    """

    limbus: Ellipse
    pupil: Ellipse
    limbus_confidence: float
    pupil_confidence: float


def find_boundaries(
    photo: Photograph, limbus: Ellipse | None = None, pupil: Ellipse | None = None
) -> Boundaries:
    """The outlines of the eye in a photograph; those given are taken as they are.

    The limbus is the middle of the soft rise from iris to white. Irides of a fortieth of the
    picture's long side up to about half of its short side are found, tilted by up to 30 degrees; of
    two eyes the one whose outlines are better supported.

    **Raises:** `ValueError` where nothing resembles an iris.
    """
    if limbus is not None and pupil is not None:
        return Boundaries(limbus, pupil, 1.0, 1.0)
    brightness = photo.pixels.mean(-1)
    if limbus is not None:
        inner, inner_sure = _pupil(brightness, limbus, coarse=False)
        inner_sure *= _plausible(limbus, inner)
        return Boundaries(limbus, inner, 1.0, float(np.clip((inner_sure - 0.2) / 0.5, 0, 1)))
    redness = None if photo.grey else _redness(photo.pixels)
    best: tuple[float, Boundaries] | None = None
    tried = [_limbus(brightness, redness, c, pupil) for c in _starts(brightness, pupil)]
    tried = [(e, sure) for e, sure in tried if _within(e, photo.shape)]
    for outline, sure in sorted(tried, key=lambda t: -t[1])[:_FINALISTS]:
        inner, inner_sure = (pupil, 1.0) if pupil is not None else _pupil(brightness, outline)
        found = Boundaries(outline, inner, sure * _plausible(outline, inner), inner_sure)
        support = found.limbus_confidence * (0.3 + inner_sure)
        if best is None or support > best[0]:
            best = support, found
    if best is None:
        raise ValueError(
            f"{photo.name}: no iris found; give --limbus with its centre and semi-axes in pixels"
        )
    _, (outline, inner, sure, inner_sure) = best
    known = inner if inner_sure > _TRUSTED else None
    outline, sure = _limbus(brightness, redness, outline, known, coarse=False)
    if pupil is None:
        inner, inner_sure = _pupil(brightness, outline, coarse=False)
    sure *= _plausible(outline, inner)
    return _judged(outline, inner, sure, None if pupil is not None else inner_sure)


def _judged(limbus: Ellipse, pupil: Ellipse, limbus_support: float, pupil_support: float | None):
    """Confidences from the shares of the outlines that edges support; `None` for a given pupil.

    Chance edges of pictures without an eye support up to 0.3 of a pupil's outline where there is a
    dark disc for a limbus, and up to 0.35 of a limbus, tiny ones most; irides in the wild 0.4 of
    the limbus that lids leave, and half of the pupil.
    """
    limbus_sure = np.clip(limbus_support / 0.75, 0, 1) * min(1.0, limbus.semi_axes[1] / 30)
    if pupil_support is None:
        return Boundaries(limbus, pupil, float(limbus_sure), 1.0)
    limbus_sure *= np.clip((pupil_support - 0.2) / 0.2, 0, 1)
    pupil_sure = np.clip((pupil_support - 0.2) / 0.5, 0, 1) * min(1.0, limbus_sure / 0.4)
    return Boundaries(limbus, pupil, float(limbus_sure), float(pupil_sure))


def _starts(brightness, pupil: Ellipse | None) -> list[Ellipse]:
    """Circles near which a limbus may lie, in pixels of the photograph."""
    scale = min(1.0, _LONG / max(brightness.shape))
    small = _reduced(brightness, scale)
    shape = small.shape
    least = max(max(shape) / _LEAST, 8.0)
    found = rings(small, (0.4 * least, 0.58 * min(shape)), 8, sideways=0.6)

    def partner(ring: Ring) -> float:
        """Votes of the best pupil within."""
        inside = (
            other.votes
            for other in found
            if PUPIL_SHARE[0] < other.radius / ring.radius < PUPIL_SHARE[1]
            and np.hypot(other.column - ring.column, other.row - ring.row) < 0.25 * ring.radius
        )
        return max(inside, default=0.0)

    def worth(ring: Ring) -> float:
        return ring.votes * (0.5 + partner(ring))

    limbi = [ring for ring in found if ring.radius >= least]
    circles = [_circle(r).scaled(1 / scale) for r in sorted(limbi, key=worth, reverse=True)]
    if pupil is not None:
        circles = [c for c in circles if _plausible(c, pupil) > 0.5]
    inside = [c for c in circles if _within(c, brightness.shape)]
    return inside[:_CANDIDATES]


def _within(outline: Ellipse, shape) -> bool:
    """Whether the middle lies in the picture."""
    return all(-0.5 < v < n - 0.5 for v, n in zip(outline.centre, shape[::-1], strict=True))


def _circle(ring: Ring) -> Ellipse:
    return Ellipse((ring.column, ring.row), (ring.radius, ring.radius))


def _reduced(picture, scale: float):
    if scale >= 1:
        return picture
    shape = tuple(max(8, round(n * scale)) for n in picture.shape[:2])
    # Boxes first: the smoothing filter of `resize` takes seconds on 12 megapixels.
    step = int(0.5 / scale)
    if step > 1:
        rows, columns = (n // step * step for n in picture.shape)
        blocks = picture[:rows, :columns].reshape(rows // step, step, columns // step, step)
        picture = blocks.mean((1, 3))
    return resize(picture, shape, anti_aliasing=True)


def _around(picture, outline: Ellipse, margin: float, radius: float):
    """The part of a picture within `margin` radii of an outline, reduced so that this has about
    `radius` pixels; and the outline there, with a function back to the photograph.
    """
    reach = margin * outline.semi_axes[0]
    (x, y), shape = outline.centre, picture.shape
    left, right = (int(np.clip(v, 0, shape[1])) for v in (x - reach, x + reach + 1))
    top, bottom = (int(np.clip(v, 0, shape[0])) for v in (y - reach, y + reach + 1))
    part = picture[top:bottom, left:right]
    scale = min(1.0, radius / outline.semi_axes[0])
    small = _reduced(part, scale)
    moved = outline._replace(centre=(x - left, y - top)).scaled(scale)

    def back(e: Ellipse) -> Ellipse:
        e = e.scaled(1 / scale)
        return e._replace(centre=(e.centre[0] + left, e.centre[1] + top))

    return small, moved, back


def _redness(pixels: Float[np.ndarray, "rows columns 3"]):
    """Log ratio of red to blue: skin is far above the white of an eye."""
    floor = 0.02 * float(np.quantile(pixels[::4, ::4], 0.98)) + 1e-6
    red, blue = (np.maximum(pixels[..., k], 0) + floor for k in (0, 2))
    return np.log(red / blue)


def _limbus(
    brightness, redness, start: Ellipse, pupil: Ellipse | None = None, coarse: bool = True
) -> tuple[Ellipse, float]:
    """The limbus near a circle, or near an ellipse where that is not `coarse`, and its confidence.
    A pupil that is known tells how flat it is.
    """
    picture, outline, back = _around(brightness, start, 2.0, _FINE if not coarse else _ROUGH)
    colour = (
        None
        if redness is None
        else _around(redness, start, 2.0, _FINE if not coarse else _ROUGH)[0]
    )
    lateral = 0.5 + 0.5 * np.cos(ray_angles()) ** 2
    flattening = (0.0, 0.0, 0.1)
    if pupil is not None:
        flat = _LIMBUS_FLATTER * np.log(pupil.semi_axes[0] / pupil.semi_axes[1])
        flattening = (flat * np.cos(2 * pupil.angle), flat * np.sin(2 * pupil.angle), 0.03)
    if coarse:
        edges, white, _ = _limbus_edges(picture, colour, outline, (0.5, 1.65), 93, _SOFT[1:])
        score = _score(edges) * white * lateral[:, None]
        outline, _ = best_outline(outline, edges.place, score)
    support = 0.0
    for near in (0.1, 0.06) if coarse else (0.06, 0.04, 0.04):
        edges, white, profile = _limbus_edges(picture, colour, outline, (0.6, 1.4), 161, _SOFT)
        value, place = _half_way(profile, edges, _score(edges) * white, near)
        # Where a lid lies on it the limbus cannot show.
        shown = 0.3 + 0.7 * white[:, int(np.argmin(abs(edges.place - 1)))]
        outline, support = _polished(outline, value, place, lateral * shown, flattening)
    return back(outline), support


def _half_way(profile, edges: Edges, score, near: float):
    """Of each ray the score and the place at which the brightness is half way from iris to white,
    nearest to the outline so far.
    """
    x = np.linspace(0.6, 1.4, profile.shape[1])
    smooth = ndimage.gaussian_filter1d(np.nan_to_num(profile), 1.0, axis=1)
    dark = np.quantile(smooth[:, (x > 0.82) & (x < 0.95)], 0.2, axis=1)
    white = np.median(smooth[:, (x > 1.08) & (x < 1.18)], axis=1)
    level = smooth - 0.5 * (dark + white)[:, None]
    rising = (level[:, :-1] < 0) & (level[:, 1:] >= 0)
    crossing = x[:-1] + (x[1] - x[0]) * level[:, :-1] / (level[:, :-1] - level[:, 1:] - 1e-12)
    away = np.where(rising, abs(crossing - 1), np.inf)
    at = away.argmin(1)
    rays = np.arange(at.size)
    place = np.where(rising[rays, at], crossing[rays, at], 1.0)
    column = np.searchsorted(edges.place, place).clip(0, edges.place.size - 1)
    good = (away[rays, at] < near) & (white > dark)
    return np.where(good, score[rays, column], 0.0), place


def _limbus_edges(picture, colour, outline, span, steps, widths):
    """Edges across the limbus, how white it is beyond each of them, 0 to 1, and the brightness."""
    profile = along_rays(picture, outline, span, steps)
    edges = steps_along(profile, span, widths, 0.2)
    if colour is None:
        return edges, np.ones(edges.fit.shape), profile
    tint = np.nan_to_num(along_rays(colour, outline, span, steps), nan=9.0)
    pitch = edges.place[1] - edges.place[0]
    smooth = ndimage.uniform_filter1d(tint, max(1, round(0.1 / pitch)), axis=1)
    skip = (steps - edges.place.size) // 2
    shift = round(0.12 / pitch)  # beyond the middle of the rise
    outside = smooth[:, skip + shift : skip + shift + edges.place.size]
    # The white is what is least red just outside: the sides of an eye show it.
    at = int(np.argmin(abs(edges.place - 1)))
    least = np.quantile(outside[:, at], 0.15)
    white = 1 / (1 + np.exp(np.clip((outside - least - 0.4) / 0.08, -50, 50)))
    return edges, white, profile


def _score(edges: Edges):
    """Of edges: how well the step fits, and how strong it is among those of its ray."""
    rise = np.maximum(edges.rise, 0) * edges.fit
    most = rise.max(1, keepdims=True)
    typical = np.median(most)
    return edges.fit**2 * np.sqrt(rise / (most + 0.1 * typical + 1e-9))


def _strongest(edges: Edges, near: float):
    """Of each ray the score and the place of the best edge within `near` of the outline."""
    part = np.where(abs(edges.place - 1) <= near, _score(edges), 0.0)
    at = part.argmax(1)
    value, place = part[np.arange(at.size), at], edges.place[at]
    # At an end of the range it is the flank of an edge elsewhere.
    flank = abs(abs(place - 1) - near) < 1.5 * (edges.place[1] - edges.place[0])
    return np.where(flank, 0.0, value), place


def _polished(outline: Ellipse, value, place, weight, flattening=(0.0, 0.0, 0.1)):
    """Least squares through edges of some value, one a ray; and the confidence."""
    middle = np.asarray(outline.centre)
    points = middle + place[:, None] * (outline.points(ray_angles()) - middle)
    if (value > 0.3).sum() < 12:
        return outline, 0.0
    better = fitted(outline, points, value * (value > 0.3), flattening)
    off = abs(better.relative_radius(points[:, 0], points[:, 1]) - 1)
    near = off < 0.02 + 0.5 / better.semi_axes[0]
    held = (weight * value * near).sum() / weight.sum()
    return better, float(held)


def _pupil(brightness, limbus: Ellipse, coarse: bool = True) -> tuple[Ellipse, float]:
    """The pupil within a limbus, and its confidence."""
    picture, outline, back = _around(brightness, limbus, 1.1, _ROUGH)
    radius = outline.semi_axes[0]
    row, column = np.ogrid[: picture.shape[0], : picture.shape[1]]
    relative = outline.relative_radius(column, row)
    if not (relative < 0.9).any():
        return limbus._replace(semi_axes=tuple(0.4 * a for a in limbus.semi_axes)), 0.0
    # Highlights are no brighter than bright tissue from here on.
    ceiling = 1.5 * np.quantile(picture[relative < 0.9], 0.75) + 1e-9
    picture = np.minimum(picture, ceiling)
    found = rings(picture, (0.13 * radius, 0.8 * radius), 6, sideways=0.2)
    best: tuple[float, Ellipse] | None = None
    for ring in found:
        circle = _circle(ring)
        share = circle.semi_axes[0] / radius
        off = outline.relative_radius(*circle.centre)
        if not (PUPIL_SHARE[0] < share < PUPIL_SHARE[1] and off < 0.3 and off + share < 1.05):
            continue
        worth = ring.votes * _darkness(picture, relative, circle)
        if best is None or worth > best[0]:
            best = worth, circle
    if best is None:
        middle = limbus._replace(semi_axes=tuple(0.4 * a for a in limbus.semi_axes))
        return middle, 0.0
    circle, span = best[1], (0.5, 1.65)
    even = np.ones(ray_angles().size)
    edges = steps_along(along_rays(picture, circle, span, 93), span, _SHARP[1:], 0.2)
    circle, _ = best_outline(circle, edges.place, _score(edges))
    support, span = 0.0, (0.7, 1.3)
    for near in (0.12, 0.08):
        edges = steps_along(along_rays(picture, circle, span, 121), span, _SHARP, 0.15)
        circle, support = _polished(circle, *_strongest(edges, near), even)
    sure = support * float(np.sqrt(_darkness(picture, relative, circle)))
    if coarse or not support:
        return back(circle), sure
    circle = _onset(brightness, ceiling, back(circle))
    return circle, sure


def _onset(brightness, ceiling: float, pupil: Ellipse) -> Ellipse:
    """The outline where the brightness begins to rise beyond the pupil: its margin is often dark."""
    picture, circle, back = _around(brightness, pupil, 1.5, _FINE)
    picture, span = np.clip(picture, 0, ceiling), (0.7, 1.3)
    picture = ndimage.gaussian_filter(picture, 0.01 * circle.semi_axes[0])  # against noise
    held = np.zeros(ray_angles().size)
    for near in (0.1, 0.08):
        # The root shows the first rise.
        profile = np.sqrt(along_rays(picture, circle, span, 241))
        held, place = _strongest(steps_along(profile, span, _SHARP, 0.15), near)
        circle, _ = _polished(circle, held, place, np.ones(held.size))
    good = along_rays(picture, circle, span, 241)[held > 0.3]
    if len(good) < 12:
        return back(circle)
    # The width of the rise comes from all rays together: one alone is too noisy in a dark iris.
    typical = np.sqrt(np.nanmedian(good, axis=0))[None]
    fits = [_strongest(steps_along(typical, span, (w,), 0.15), 0.1) for w in _ONSETS]
    best = int(np.argmax([value[0] for value, _ in fits]))
    blur = 1.0 / circle.semi_axes[0]
    rim = float(fits[best][1][0]) - max(_ONSETS[best] - blur, 0.0)
    axes = circle.semi_axes[0] * rim, circle.semi_axes[1] * rim
    return back(circle._replace(semi_axes=axes))


def _darkness(picture, relative, circle: Ellipse) -> float:
    """How much darker it is within a circle than in the iris around, 0 to 1."""
    row, column = np.ogrid[: picture.shape[0], : picture.shape[1]]
    own = circle.relative_radius(column, row)
    within, around = own < 0.9, (own > 1.1) & (own < 1.6) & (relative < 0.95)
    if not within.any() or not around.any():
        return 0.0
    inside, outside = np.median(picture[within]), np.median(picture[around])
    return float(np.clip(1 - inside / (outside + 1e-9), 0, 1))


def _plausible(limbus: Ellipse, pupil: Ellipse) -> float:
    """1 for a pair that an eye may have, less the odder it is."""
    size = pupil.semi_axes[0] / limbus.semi_axes[0]
    off = float(limbus.relative_radius(*pupil.centre))
    flat = limbus.semi_axes[1] / limbus.semi_axes[0]
    low, high = PUPIL_SHARE
    odd = max(low - size, 0) / 0.05 + max(size - high, 0) / 0.05
    odd += max(off - 0.2, 0) / 0.1 + max(0.8 - flat, 0) / 0.05
    return float(np.exp(-odd))
