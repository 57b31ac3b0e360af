"""The pupil within a limbus: where the brightness begins to rise beyond its black."""

import numpy as np
from scipy import ndimage

from irisjax.photo.edges import (
    FINE,
    ROUGH,
    along_rays,
    around,
    best_outline,
    polished,
    ray_angles,
    steps_along,
)
from irisjax.photo.ellipse import Ellipse
from irisjax.photo.photograph import Photograph
from irisjax.photo.rings import rings

PUPIL_SHARE = (0.12, 0.85)
"""Radii of pupils, of the limbus'."""
_WIDTHS = (0.02, 0.05, 0.1)  # half widths of the rise, of the radius
_ONSETS = (0.01, 0.02, 0.03, 0.04, 0.05, 0.065, 0.08, 0.1, 0.12)


def pupil_within(photo: Photograph, limbus: Ellipse, coarse: bool = True) -> tuple[Ellipse, float]:
    """The pupil within a limbus, and the share of its outline that edges support, less where it is
    hardly darker than the iris.
    """
    picture, cut_off, outline, back = _part(photo, limbus, 1.1, ROUGH)
    radius = outline.semi_axes[0]
    row, column = np.ogrid[: picture.shape[0], : picture.shape[1]]
    relative = outline.relative_radius(column, row)
    if not (relative < 0.9).any():
        return limbus._replace(semi_axes=tuple(0.4 * a for a in limbus.semi_axes)), 0.0
    # Highlights are no brighter than bright tissue from here on.
    ceiling = float(1.5 * np.quantile(picture[relative < 0.9], 0.75) + 1e-9)
    picture = np.minimum(picture, ceiling)
    found = rings(picture, (0.13 * radius, 0.8 * radius), 6, sideways=0.2)
    best: tuple[float, Ellipse] | None = None
    for ring in found:
        circle = ring.circle()
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
    edges = steps_along(_profile(picture, cut_off, circle, span, 93), span, _WIDTHS[1:], 0.2)
    circle, _ = best_outline(circle, edges.place, edges.score())
    support, span = 0.0, (0.7, 1.3)
    for near in (0.12, 0.08):
        edges = steps_along(_profile(picture, cut_off, circle, span, 121), span, _WIDTHS, 0.15)
        circle, support = polished(circle, *edges.strongest(near), even)
    sure = support * float(np.sqrt(_darkness(picture, relative, circle)))
    if coarse or not support:
        return back(circle), sure
    return _onset(photo, ceiling, back(circle)), sure


def _part(photo: Photograph, outline: Ellipse, margin: float, radius: float):
    """Brightness around an outline and the share of pixels that are cut off, reduced; the outline
    there and the way back.
    """
    pixels, moved, back = around(photo.pixels, outline, margin, radius)
    cut_off = around(photo.saturated[..., None].astype(float), outline, margin, radius)[0]
    return pixels.mean(-1), cut_off[..., 0], moved, back


def _profile(picture, cut_off, circle: Ellipse, span, steps: int):
    """Brightness along rays; not a number in highlights, whose edges are none of the pupil's."""
    hidden = along_rays(cut_off, circle, span, steps) > 0.05
    return np.where(hidden, np.nan, along_rays(picture, circle, span, steps))


def _onset(photo: Photograph, ceiling: float, pupil: Ellipse) -> Ellipse:
    """The outline where the brightness begins to rise; the margin of the iris is often dark."""
    picture, cut_off, circle, back = _part(photo, pupil, 1.5, FINE)
    picture, span = np.clip(picture, 0, ceiling), (0.7, 1.3)
    picture = ndimage.gaussian_filter(picture, 0.01 * circle.semi_axes[0])  # against noise
    held = np.zeros(ray_angles().size)
    for near in (0.1, 0.08):
        # The root shows the first rise.
        profile = np.sqrt(_profile(picture, cut_off, circle, span, 241))
        held, place = steps_along(profile, span, _WIDTHS, 0.15).strongest(near)
        circle, _ = polished(circle, held, place, np.ones(held.size))
    good = _profile(picture, cut_off, circle, span, 241)[held > 0.3]
    seen = np.isfinite(good).any(0)
    if len(good) < 12 or not seen.all():
        return back(circle)
    # The width of the rise comes from all rays together: one alone is too noisy in a dark iris.
    typical = np.sqrt(np.nanmedian(good, axis=0))[None]
    fits = [steps_along(typical, span, (w,), 0.15).strongest(0.1) for w in _ONSETS]
    best = int(np.argmax([value[0] for value, _ in fits]))
    blur = 1.0 / circle.semi_axes[0]
    rim = float(fits[best][1][0]) - max(_ONSETS[best] - blur, 0.0)
    axes = circle.semi_axes[0] * rim, circle.semi_axes[1] * rim
    return back(circle._replace(semi_axes=axes))


def _darkness(picture, relative, circle: Ellipse) -> float:
    """How much darker it is within a circle than in the iris around, 0 to 1."""
    row, column = np.ogrid[: picture.shape[0], : picture.shape[1]]
    own = circle.relative_radius(column, row)
    within, beside = own < 0.9, (own > 1.1) & (own < 1.6) & (relative < 0.95)
    if not within.any() or not beside.any():
        return 0.0
    inside, outside = np.median(picture[within]), np.median(picture[beside])
    return float(np.clip(1 - inside / (outside + 1e-9), 0, 1))
