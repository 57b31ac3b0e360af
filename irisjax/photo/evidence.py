"""Evidence that two outlines are limbus and pupil of an eye, and how probable that makes each."""

import warnings
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import special

from irisjax.photo.edges import RAYS, FittedEllipse, cut_around, sample_along_rays
from irisjax.photo.photograph import Brightness, Ellipse, Photograph

PUPIL_SHARE = (0.12, 0.85)
"""Range of pupil radii, relative to the limbus."""
_JUDGED_RADIUS = 60.0  # px of the limbus in the copy in which pairs are judged
_PLACE_SCALE = 0.01  # standard deviation of an outline that is known so well that it is half sure
_WIDE = 0.68  # pupil over limbus above which the pair is less plausible
_SIDE = 0.77  # cosine of the largest angle from the horizontal at which no lid is expected
# Constant and weights of the evidence in the logarithm of the odds: none negative, by logistic
# regression with a ridge of 0.2 on 230 photographs of experiments/outline_confidence.py (seed 0).
_LIMBUS_LOGIT = (-6.3, 3.6, 0.2, 1.2, 0.2, 1.1, 0.4, 0.0, 0.0, 0.0, 1.2, 5.1, 0.0)
_PUPIL_LOGIT = (-12.8, 0.1, 2.9, 1.2, 4.0, 1.6, 0.2, 1.4, 0.7, 0.0, 2.7, 1.5, 0.7)
_LEAST_DARKNESS = 0.2  # evidence of a dark pupil below which there may be no eye


class Evidence(NamedTuple):
    """Evidence that a pair of outlines is right, each number from 0 to 1.

    Attributes:
        limbus: Share of the limbus that edges support, where no lid hides it.
        pupil: Share of the pupil's outline that edges support.
        dark: By how much the pupil is darker than the iris around it.
        enclosed: Share of the pupil's outline beyond which it is brighter than within.
        white: How much brighter it is to the left and right of the limbus than within.
        colourless: How little these parts have the red of skin.
        radial: How much of the iris's contrast lies along circles: fibres run along the radius.
        shape: How usual the sizes and places of the two outlines are.
        whole: Whether the picture shows all of them.
        fine: Whether they have enough pixels.
        limbus_placed: How closely its edges place the limbus: 1/2 if its centre and radius are
            determined to 1 % of its radius.
        pupil_placed: The same for the pupil.
    """

    limbus: float
    pupil: float
    dark: float
    enclosed: float
    white: float
    colourless: float
    radial: float
    shape: float
    whole: float
    fine: float
    limbus_placed: float
    pupil_placed: float


def probabilities(evidence: Evidence) -> tuple[float, float]:
    """Return the probabilities that limbus and pupil are right, by logistic regression."""
    known = np.append(1.0, evidence)
    logits = np.array(_LIMBUS_LOGIT) @ known, np.array(_PUPIL_LOGIT) @ known
    possible = evidence.whole * evidence.shape * min(evidence.dark / _LEAST_DARKNESS, 1.0)
    limbus, pupil = (float(special.expit(logit) * possible) for logit in logits)
    return limbus, pupil


def weigh_outlines(photo: Photograph, limbus: FittedEllipse, pupil: FittedEllipse) -> Evidence:
    """Weigh two outlines by what a photograph shows along them and on both sides of them."""
    outer, inner = limbus.outline, pupil.outline
    half = np.array(photo.shape[::-1]) / 2
    within = [(abs(e.points(RAYS) + 0.5 - half) < half).all(1) for e in (outer, inner)]
    visible = min(points.mean() for points in within)
    (picture, redness), circle, _ = limbus_part(photo, outer, _JUDGED_RADIUS)
    span, steps = (0.02, 1.4), 70
    place = np.linspace(*span, steps)
    profile = sample_along_rays(picture, circle, span, steps)
    right = (circle.points(RAYS)[:, 0] - circle.centre[0]) / circle.mean_radius
    sides = [sign * right > _SIDE for sign in (-1, 1)]
    rim, beyond = (place > 0.8) & (place < 0.97), (place > 1.08) & (place < 1.25)
    rises = [_log_ratio(profile[s][:, beyond], profile[s][:, rim]) for s in sides]
    rises = np.clip(np.array(rises) / 1.5, 0, 1)
    colourless = 1.0
    if redness is not None:
        tint = sample_along_rays(redness, circle, span, steps)
        tint_of_whiter = min(_median_tint(tint[s][:, beyond]) for s in sides)
        colourless = float(special.expit((0.7 - tint_of_whiter) / 0.12))
    scale = circle.semi_axes[0] / outer.semi_axes[0]
    middle = scale * np.subtract(inner.centre, outer.centre) + circle.centre
    hole = inner.scaled(scale)._replace(centre=(float(middle[0]), float(middle[1])))
    # Yellow irides are black in blue light; what is burnt out shows neither iris nor pupil.
    mean = cut_around(photo.pixels, outer, 2.0, _JUDGED_RADIUS)[0].mean(-1)
    saturated = photo.saturated[..., None].astype(np.float32)
    burnt, *_ = cut_around(saturated, outer, 2.0, _JUDGED_RADIUS)
    dark, enclosed = darkness(np.where(burnt[..., 0] > 0.1, np.nan, mean), hole)
    texture = (place > 1.15 * inner.mean_radius / outer.mean_radius) & (place < 0.9)
    return Evidence(
        limbus=limbus.support,
        pupil=pupil.support,
        dark=dark,
        enclosed=enclosed,
        white=float(0.6 * rises.max() + 0.4 * rises.min()),
        colourless=colourless,
        radial=_radial(profile[:, texture], place[texture], float(place[1] - place[0])),
        shape=plausibility(outer, inner),
        whole=float(np.clip((visible - 0.5) / 0.15, 0, 1)),
        fine=min(1.0, outer.semi_axes[1] / 30),
        limbus_placed=1 / (1 + (limbus.place_sd / _PLACE_SCALE) ** 2),
        pupil_placed=1
        / (1 + (pupil.place_sd * inner.mean_radius / outer.mean_radius / _PLACE_SCALE) ** 2),
    )


def limbus_part(
    photo: Photograph, outline: Ellipse, radius: float
) -> tuple[tuple[Brightness, Brightness | None], Ellipse, Callable[[Ellipse], Ellipse]]:
    """Return `cut_around` of brightness and redness (`None` without colours).

    The brightness is that of the channel in which iris and white differ most at both sides: white
    in a warm shade is hardly brighter than a blue iris, but redder.
    """
    pixels, moved, back = cut_around(photo.pixels, outline, 2.0, radius)
    mean = pixels.mean(-1)
    if photo.grey:
        return (mean, None), moved, back
    floor = 0.02 * float(np.quantile(pixels[..., 0], 0.98)) + 1e-6
    logs = np.log(np.maximum(pixels, 0) + floor)
    right = (moved.points(RAYS)[:, 0] - moved.centre[0]) / moved.semi_axes[0]

    def contrast(channel) -> float:
        profile = sample_along_rays(channel, moved, (0.75, 1.25), 16)
        rise = profile[:, -6:].mean(1) - profile[:, :6].mean(1)
        return min(_median_tint(rise[sign * right > _SIDE]) for sign in (-1, 1))

    best = max(range(3), key=lambda k: contrast(logs[..., k]))
    # Redness is far larger for skin than for the white of an eye.
    return (pixels[..., best], logs[..., 0] - logs[..., 2]), moved, back


def darkness(picture: Brightness, hole: Ellipse) -> tuple[float, float]:
    """Return how much darker an ellipse is inside, where nothing is mirrored, than around it (from
    0.4 to 0.9 of the brightness around it), and the share of rays on which it is brighter around.
    """
    place = np.linspace(0.05, 1.4, 41)
    profile = sample_along_rays(picture, hole, (0.05, 1.4), place.size)
    inside = _finite(profile[:, place < 0.85])
    if not inside.size:
        return 0.0, 0.0
    level = float(np.quantile(inside, 0.25))
    # A ray of whose surrounding nothing is known has no median (NaN). It counts as dark as the
    # hole: no evidence of a brighter surrounding.
    surrounding = np.nan_to_num(_finite_median(profile[:, place > 1.12], 1), nan=level)
    iris = float(np.median(surrounding))
    dark = np.clip((1 - level / (iris + 1e-9) - 0.4) / 0.5, 0, 1)
    share = np.mean(surrounding > level + 0.35 * (iris - level))
    return float(dark), float(np.clip((share - 0.5) / 0.5, 0, 1))


def plausibility(limbus: Ellipse, pupil: Ellipse) -> float:
    """Return 1 for a pair of outlines that an eye may have, and less for odder ones."""
    size = pupil.semi_axes[0] / limbus.semi_axes[0]
    offset = float(limbus.relative_radius(*pupil.centre))
    low, high = PUPIL_SHARE
    oddness = max(low - size, 0) / 0.05 + max(size - high, 0) / 0.05
    # If a pupil leaves a narrow ring, the white's edge is mistaken for the iris's: 3 to 12 % off.
    oddness += max(size - _WIDE, 0) / 0.1
    oddness += max(offset - 0.15, 0) / 0.1
    oddness += sum(max(0.82 - e.semi_axes[1] / e.semi_axes[0], 0) / 0.04 for e in (limbus, pupil))
    return float(np.exp(-oddness))


def _radial(profile, place, pitch: float) -> float:
    """Contrast of neighbours along circles over that in all directions, from 1/4 to 1/2."""
    if profile.shape[1] < 4 or not np.isfinite(profile).any():
        return 0.0
    logs = np.log(profile + 0.02 * (_finite_median(profile) + 1e-3))
    logs = logs - _finite_median(logs, 0)
    around, along = (_finite_mean(abs(np.diff(logs, axis=axis)), axis) for axis in (0, 1))
    around = _finite_median(around / (place * (RAYS[1] - RAYS[0])))
    along = _finite_median(along) / pitch
    # Nothing is seen of some candidates beyond the picture's edge: no evidence either.
    share = np.nan_to_num(around / (around + along + 1e-9))
    return float(np.clip((share - 0.25) / 0.25, 0, 1))


def _log_ratio(beyond, inside) -> float:
    """ln of one part's median over the other's quantile of 30 %; 0 if one is not seen."""
    beyond, inside = _finite(beyond), _finite(inside)
    if not (beyond.size and inside.size):
        return 0.0
    return float(np.log((np.median(beyond) + 1e-3) / (np.quantile(inside, 0.3) + 1e-3)))


def _finite(values):
    """The values that are numbers: those in the picture."""
    return values[np.isfinite(values)]


def _median_tint(values) -> float:
    """The middle one of tints; 9, far redder than tissue, out of the picture."""
    return float(np.median(_finite(values))) if np.isfinite(values).any() else 9.0


def _finite_median(values, axis: int | None = None):
    """Median of the values that are numbers; NaN if there is none."""
    if not np.isnan(values).any():
        return np.median(values, axis)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.nanmedian(values, axis)


def _finite_mean(values, axis: int):
    count = np.isfinite(values).sum(axis)
    return np.nansum(values, axis) / np.where(count > 0, count, np.nan)
