"""The limbus near a circle: the middle of the soft rise from iris to white."""

import numpy as np
from scipy import ndimage

from irisjax.photo.edges import (
    FINE,
    ROUGH,
    Edges,
    along_rays,
    around,
    best_outline,
    polished,
    ray_angles,
    steps_along,
)
from irisjax.photo.ellipse import Ellipse
from irisjax.photo.photograph import Photograph
from irisjax.photo.tilt import FLATTER, PUPIL_OVAL

_WIDTHS = (0.02, 0.05, 0.09)  # half widths of the rise, of the radius: about 1 mm in all
_SPAN = (0.6, 1.4)
_BLUR = 0.8  # standard deviation of a photograph's own blur, px
_BETWEEN_QUARTERS = 1.349  # standard deviations of a Gaussian's
_OF_SMOOTHSTEP = 0.3473  # of a smoothstep's width, between a quarter and three of its rise


def limbus_near(
    photo: Photograph, start: Ellipse, pupil: Ellipse | None = None, coarse: bool = True
) -> tuple[Ellipse, float]:
    """The limbus near a circle or, where that is not `coarse`, near an ellipse, and the share of
    what lids leave of it that edges support.

    A pupil that is known tells how flat it is.
    """
    size = ROUGH if coarse else FINE
    pixels, outline, back = around(photo.pixels, start, 2.0, size)
    picture = pixels.mean(-1)
    colour = None if photo.grey else _redness(pixels[..., 0], pixels[..., 2])
    lateral = 0.5 + 0.5 * np.cos(ray_angles()) ** 2
    flattening = (0.0, 0.0, 0.1)
    if pupil is not None:
        right, aslant = FLATTER * pupil.flattening
        flattening = (right, aslant, FLATTER * PUPIL_OVAL)
    if coarse:
        edges, white, _ = _limbus_edges(picture, colour, outline, (0.5, 1.65), 93, _WIDTHS[1:])
        score = edges.score() * white * lateral[:, None]
        outline, _ = best_outline(outline, edges.place, score)
    support = 0.0
    for near in (0.1, 0.06) if coarse else (0.06, 0.04, 0.04):
        edges, white, profile = _limbus_edges(picture, colour, outline, _SPAN, 161, _WIDTHS)
        value, place = _half_way(profile, edges, edges.score() * white, near)
        # Where a lid lies on it the limbus cannot show; outside the picture it is just missing.
        covered = 1 - white[:, int(np.argmin(abs(edges.place - 1)))]
        shown = 1 - 0.8 * np.where(np.isnan(profile[:, : profile.shape[1] // 2]).any(1), 0, covered)
        outline, support = polished(outline, value, place, lateral * shown, flattening)
    return back(outline), support


def width_of(photo: Photograph, limbus: Ellipse) -> float | None:
    """Width over which the brightness rises from the iris's to the white's, of the limbus's radius,
    if enough of the rise is seen: that of a smoothstep as steep between a quarter of it and three.
    """
    pixels, outline, _ = around(photo.pixels, limbus, 2.0, FINE)
    picture = pixels.mean(-1)
    colour = None if photo.grey else _redness(pixels[..., 0], pixels[..., 2])
    edges, white, profile = _limbus_edges(picture, colour, outline, _SPAN, 161, _WIDTHS)
    held, place = _half_way(profile, edges, edges.score() * white, 0.04)
    good = held > 0.3
    if good.sum() < 12:
        return None
    # Each ray about its own half-way point: what the outline is off by is no softness.
    x, aside = np.linspace(*_SPAN, profile.shape[1]), np.linspace(-0.2, 0.2, 401)
    rays = zip(place[good], profile[good], strict=True)
    moved = np.stack([np.interp(at + aside, x, ray) for at, ray in rays])
    dark = np.median(moved[:, (aside > -0.18) & (aside < -0.05)], 1)
    bright = np.median(moved[:, (aside > 0.06) & (aside < 0.13)], 1)
    rise = np.nanmedian((moved - dark[:, None]) / (bright - dark)[:, None], 0)
    low, high = (_crossed(aside, rise, share) for share in (0.25, 0.75))
    blur = _BLUR * _BETWEEN_QUARTERS / outline.semi_axes[0]
    return float(np.sqrt(max((high - low) ** 2 - blur**2, 0)) / _OF_SMOOTHSTEP)


def _crossed(x, rising, level: float) -> float:
    """Where a curve that rises through its middle crosses a level there."""
    middle = len(x) // 2
    if level < 0.5:
        at = np.flatnonzero(rising[:middle] <= level)
        return float(x[at[-1] if len(at) else 0])
    at = np.flatnonzero(rising[middle:] >= level)
    return float(x[middle + at[0] if len(at) else -1])


def _redness(red, blue):
    """Log ratio of red to blue: skin is far above the white of an eye."""
    floor = 0.02 * float(np.quantile(red, 0.98)) + 1e-6
    return np.log((np.maximum(red, 0) + floor) / (np.maximum(blue, 0) + floor))


def _half_way(profile, edges: Edges, score, near: float):
    """Of each ray the score and the place at which the brightness is half way from iris to white,
    nearest to the outline so far.
    """
    x = np.linspace(*_SPAN, profile.shape[1])
    # Beyond the picture's edge nothing rises: there is no edge.
    smooth = ndimage.gaussian_filter1d(np.nan_to_num(profile), 1.0, axis=1)
    dark = np.quantile(smooth[:, (x > 0.82) & (x < 0.95)], 0.2, axis=1)
    white = np.median(smooth[:, (x > 1.06) & (x < 1.13)], axis=1)
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
    # Nothing beyond the picture's edge is white.
    tint = np.nan_to_num(along_rays(colour, outline, span, steps), nan=9.0)
    pitch = edges.place[1] - edges.place[0]
    smooth = ndimage.uniform_filter1d(tint, max(1, round(0.05 / pitch)), axis=1)
    # The reddest from just beyond the middle of the rise to where the white is measured.
    width = max(1, round(0.13 / pitch))
    reddest = ndimage.maximum_filter1d(smooth, width, axis=1)
    skip = (steps - edges.place.size) // 2 + round(0.12 / pitch)
    outside = reddest[:, skip : skip + edges.place.size]
    # The white is what is least red just outside: the sides of an eye show it.
    at = int(np.argmin(abs(edges.place - 1)))
    least = np.quantile(outside[:, at], 0.15)
    white = 1 / (1 + np.exp(np.clip((outside - least - 0.4) / 0.08, -50, 50)))
    return edges, white, profile
