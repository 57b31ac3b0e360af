"""Outlines of limbus and pupil in a photograph, and the confidence in each."""

from typing import NamedTuple

import numpy as np
from scipy import ndimage, optimize, special

from irisjax.photo import edges
from irisjax.photo.edges import RAYS, FittedEllipse, cut_around, sample_along_rays
from irisjax.photo.evidence import (
    PUPIL_SHARE,
    Evidence,
    darkness,
    limbus_part,
    plausibility,
    probabilities,
    weigh_outlines,
)
from irisjax.photo.photograph import Ellipse, Photograph
from irisjax.photo.pose import FLATTENING_RATIO, LIMBUS_FLAT, LIMBUS_OVAL, PUPIL_OVAL

MIN_CONFIDENCE = 0.5
"""Confidence below which an outline is more likely wrong than right, see `Boundaries`."""
SURE = 0.8
"""Confidence below which an outline that is used is doubtful."""
_LIMBUS_WIDTHS = (0.02, 0.05, 0.09)  # half widths of the rise, relative to the radius
_LIMBUS_SPAN = (0.6, 1.4)  # of profiles across the limbus, relative to it
_BLUR, _BLUR_SPREAD = 0.8, 0.4  # standard deviation of a photograph's own blur, px; of its log
_QUARTILES_OF_GAUSSIAN = 1.349  # distance between quartiles over the standard deviation
_QUARTILES_OF_SMOOTHSTEP = 0.3473  # distance between 1/4 and 3/4 of the rise, over its width
_PUPIL_WIDTHS = (0.02, 0.05, 0.1)  # half widths of the rise, relative to the radius
_PUPIL_SPAN = (0.8, 1.15)
_EQUAL_WEIGHTS = np.ones(RAYS.size)  # weights of the rays
_MISFIT = 0.02  # difference of irides from the fitted rise, relative to the rise
_LONG = 640  # px along the long side of the copy in which eyes are searched
_RING_LONG = 360  # the same of the copy in which rings are searched
_PUPIL_RADIUS = 40.0  # px of the limbus in the copy in which pupils are searched
_SMALLEST = 40  # long side over the radius of the smallest iris
_STARTS, _CANDIDATES = 10, 3  # circles that are weighed, and those of them that are refined
_SURE = 0.9  # worth of a pair of outlines above which the search ends
_TRUSTED = 0.5  # support above which a pupil is used to find the limbus
_FRONTAL = edges.Expected((LIMBUS_FLAT, 0.0), 0.08)
_CENTRE_SD = 0.07  # standard deviation of the pupil's middle in either direction, limbus radii
_ROUGH_CENTRE_SD = 0.15  # the same for limbi that are not yet known well
_NARROW = 0.16  # width of a highlight that is removed from a pupil, limbus radii
_PUPIL_DARK = 0.3  # brightness below which what is beside a highlight is pupil, in ceilings
_FLATTEST = 0.4  # semi-axes' ratio of outlines that are taken: a tilt of 66 degrees
_UPWARDS = 0.05  # its mean, above the limbus's middle
_WARMER = 0.5  # by how much redder the white of one side may be than that of the other


class Pair(NamedTuple):
    """Outlines of one eye, the evidence for them, and its weight from 0 to 1."""

    limbus: FittedEllipse
    pupil: FittedEllipse
    evidence: Evidence
    worth: float


class Boundaries(NamedTuple):
    """Outlines of limbus and pupil in pixels of the photograph.

    Attributes:
        limbus: Middle of the soft rise from iris to white.
        pupil: Outline at which the iris begins.
        limbus_confidence: Probability that centre and radius are within 4 % of the limbus's radius,
            calibrated on simulated photographs; 1 if given.
        pupil_confidence: The same for the pupil.
        pupil_margin: See `FittedEllipse.margin`.
        limbus_width: Width over which iris and white blend, relative to the limbus's radius; `None`
            if it is not known.
        flattening_sd: Standard deviations of the components of the flattening of limbus and pupil,
            from the scatter of their edges; 0 if given.
        eyes: Number of eyes that were found.
        evidence: The evidence for the outlines; `None` if both are given.
    """

    limbus: Ellipse
    pupil: Ellipse
    limbus_confidence: float
    pupil_confidence: float
    pupil_margin: float | None = None
    limbus_width: float | None = None
    flattening_sd: tuple[float, float] = (0.0, 0.0)
    eyes: int = 1
    evidence: Evidence | None = None

    def doubts(self) -> list[str]:
        """Return a sentence on each outline that is more likely right than wrong, but not sure."""
        confidences = ("limbus", self.limbus_confidence), ("pupil", self.pupil_confidence)
        return [
            f"the {name} may be wrong (confidence {sure:.2f}): look at outlines.png, and give "
            f"--{name} if it is"
            for name, sure in confidences
            if MIN_CONFIDENCE <= sure < SURE
        ]


def find_boundaries(
    photo: Photograph,
    limbus: Ellipse | None = None,
    pupil: Ellipse | None = None,
    eye: str | None = None,
) -> Boundaries:
    """Find the outlines of an eye in a photograph; given ones are kept.

    Irides from a fortieth of the picture's long side to about half of its short side are found,
    tilted by up to 30 degrees. Rings that are dark inside are paired, and pairs are compared by
    what lies on both sides of them, see `Evidence`. A picture without an eye gives outlines of low
    confidence.

    Args:
        photo: The photograph.
        limbus: Outline of the limbus that is kept.
        pupil: The same for the pupil.
        eye: Which of several eyes: `"left"` or `"right"` as the picture shows them, or a number
            from 1, counted from the left; `None` takes the one with the most evidence.

    Raises:
        ValueError: If nothing resembles an iris, a given outline lies outside the picture or is too
            flat, a given pupil is not within a given limbus, or there are not that many eyes.
    """
    if not (eye in (None, "left", "right") or (eye.isdecimal() and int(eye))):
        raise ValueError(f"--eye {eye}: write left, right or a number from 1")
    for name, outline in (("limbus", limbus), ("pupil", pupil)):
        if outline is None:
            continue
        if not _is_inside(outline, photo.shape):
            rows, columns = photo.shape
            raise ValueError(
                f"{photo.name}: the middle of the {name} given, {outline.centre}, is outside the "
                f"picture of {columns} x {rows} pixels"
            )
        if outline.semi_axes[1] < _FLATTEST * outline.semi_axes[0]:
            raise ValueError(
                f"{photo.name}: the {name} given is too flat for an eye: its semi-axes are "
                f"{' and '.join(f'{v:g}' for v in outline.semi_axes)} pixels, and the smaller one "
                f"must be at least {_FLATTEST} of the larger"
            )
    if limbus and pupil and (limbus.relative_radius(*pupil.points(RAYS).T) >= 1).any():
        raise ValueError(
            f"{photo.name}: the pupil given reaches outside the limbus given; it must lie within it"
        )
    fit, inner = (None if e is None else FittedEllipse(e, 1.0) for e in (limbus, pupil))
    if fit and inner:
        margin = refine_pupil(photo, fit, inner).margin
        width = measure_limbus_width(photo, fit.outline)
        return Boundaries(fit.outline, inner.outline, 1.0, 1.0, margin, width)
    scale = min(1.0, _LONG / max(photo.shape))
    layers = edges.reduce_picture(np.dstack([photo.pixels, photo.saturated]), scale)
    small = photo._replace(pixels=layers[..., :3], saturated=layers[..., 3] > 0.1)
    given = (e and e._replace(outline=e.outline.scaled(scale)) for e in (fit, inner))
    eyes = _find_eyes(small, *given, all_eyes=eye is not None)
    if not eyes:
        raise ValueError(
            f"{photo.name}: no iris found; give --limbus with its centre and semi-axes in pixels"
        )
    pair = _choose_eye(photo.name, eyes, eye)
    outer, hole = (e.outline.scaled(1 / scale) for e in pair[:2])
    rough_pair = pair.limbus._replace(outline=outer), pair.pupil._replace(outline=hole)
    return _measure_pair(photo, *rough_pair, fit, inner, len(eyes))


def find_pupil(photo: Photograph, limbus: FittedEllipse) -> FittedEllipse:
    """Find the pupil within a limbus, which suggests how flat it is if its edges are seen."""
    part = _cut_part(photo, limbus.outline, 1.1, edges.ROUGH)
    picture, clipped, ceiling = _without_highlights(part)
    outline, back = part[2:]
    if not (circles := _dark_rings(picture, outline)):
        a, b = limbus.outline.semi_axes  # in place of a pupil that is not found
        return FittedEllipse(limbus.outline._replace(semi_axes=(0.4 * a, 0.4 * b)), 0.0)
    rising = _first_rise(picture, ceiling)
    # A reflection in the pupil may leave a smaller dark circle beside its middle.
    middle = 0.5 * np.add(circles[0].centre, outline.centre)
    starts = circles[0], circles[0]._replace(centre=(middle[0], middle[1]))
    expected = _expected_pupil(limbus)
    fits = [_fit_pupil(rising, clipped, circle, expected) for circle in starts]
    fit = max(fits, key=lambda fit: fit.support * _place_plausibility(outline, fit.outline))
    return fit._replace(outline=back(fit.outline))


def _dark_rings(picture, limbus: Ellipse) -> list[Ellipse]:
    """Find circles within a limbus that may be its pupil, by votes, the most likely first."""
    radius = limbus.semi_axes[0]
    scale = min(1.0, _PUPIL_RADIUS / radius)
    copy = edges.reduce_picture(picture[..., None], scale)[..., 0]
    sizes = 0.13 * radius * scale, 0.8 * radius * scale
    rings = edges.find_rings(copy, sizes, 6, sideways=0.2)
    rings[:, :2] = (rings[:, :2] + 0.5) / scale - 0.5
    rings[:, 2] /= scale
    offset, share = limbus.relative_radius(*rings[:, :2].T), rings[:, 2] / radius
    possible = (PUPIL_SHARE[0] < share) & (share < PUPIL_SHARE[1])
    circles = list[tuple[float, Ellipse]]()
    for x, y, r, votes in rings[possible & (offset < np.minimum(0.3, 1.05 - share))]:
        circle = Ellipse((x, y), (r, r))
        dark, enclosed = darkness(picture, circle)
        worth = votes * dark * (0.3 + enclosed) * _place_plausibility(limbus, circle)
        circles.append((worth, circle))
    return [circle for _, circle in sorted(circles, key=lambda entry: -entry[0])]


def _expected_pupil(limbus: FittedEllipse) -> edges.Expected:
    """The flattening of the pupil, by that of its limbus."""
    if limbus.support <= _TRUSTED:
        return edges.Expected(flattening_sd=0.07)
    flattening = (limbus.outline.flattening - np.array([LIMBUS_FLAT, 0.0])) / FLATTENING_RATIO
    sd = np.hypot(PUPIL_OVAL, np.hypot(LIMBUS_OVAL, limbus.flattening_sd) / FLATTENING_RATIO)
    return edges.Expected((flattening[0], flattening[1]), float(sd))


def _place_plausibility(limbus: Ellipse, pupil: Ellipse) -> float:
    """How usual the place of a pupil is within a limbus, 0 to 1."""
    x, y = pupil.centre
    offset = limbus.relative_radius(x, y + _UPWARDS * limbus.mean_radius)
    return float(np.exp(-0.5 * (offset / _ROUGH_CENTRE_SD) ** 2))


def _fit_pupil(picture, clipped, circle: Ellipse, expected: edges.Expected) -> FittedEllipse:
    span = (0.5, 1.65)
    profile = _profile(picture, clipped, circle, span, 93)
    steps = edges.fit_steps(profile, span, _PUPIL_WIDTHS[1:], 0.2)
    fit = FittedEllipse(edges.best_outline(circle, steps.place, steps.score(), expected), 0.0, 0.1)
    span = (0.7, 1.3)
    for reach in (0.12, 0.08):
        profile = _profile(picture, clipped, fit.outline, span, 81)
        steps = edges.fit_steps(profile, span, _PUPIL_WIDTHS, 0.15)
        fit = edges.refine_outline(fit.outline, *steps.strongest(reach), _EQUAL_WEIGHTS, expected)
    return fit


def refine_pupil(photo: Photograph, limbus: FittedEllipse, near: FittedEllipse) -> FittedEllipse:
    """Move an outline to where the iris begins, and measure the width of its margin, if enough of
    it is seen.

    A sharp edge is placed half-way from black to bright, whatever the blur; if the brightness rises
    slowly, the outline is placed where the rise begins.
    """
    pixels, _, outline, _ = _cut_part(photo, limbus.outline, 1.1, edges.ROUGH)
    ceiling = _ceiling(pixels.mean(-1), outline)
    pixels, clipped, circle, back = _cut_part(photo, near.outline, 1.5, edges.FINE)
    radius = limbus.outline.semi_axes[0] * circle.semi_axes[0] / near.outline.semi_axes[0]
    picture, clipped = _darken(pixels.mean(-1), clipped, ceiling, radius)
    picture, span = np.maximum(picture, 0), (0.7, 1.3)
    smooth = ndimage.gaussian_filter(picture, 0.01 * circle.semi_axes[0])  # against noise
    score, expected = 0 * _EQUAL_WEIGHTS, _expected_pupil(limbus)
    for reach in (0.1, 0.08):
        profile = _profile(_first_rise(smooth, ceiling), clipped, circle, span, 241)
        score, place = edges.fit_steps(profile, span, _PUPIL_WIDTHS, 0.15).strongest(reach)
        circle = edges.refine_outline(circle, score, place, _EQUAL_WEIGHTS, expected).outline
    profiles = _profile(picture, clipped, circle, _PUPIL_SPAN, 241)[score > 0.3]
    profiles = profiles[np.isfinite(profiles).any(1)]
    if len(profiles):
        # Each above its own dark: a mirror image over the rim adds light to both sides.
        profiles = profiles - np.nanquantile(profiles, 0.1, axis=1, keepdims=True)
        rise = np.nanmax(profiles, 1)
        profiles = profiles[rise > 0.1 * np.quantile(rise, 0.75)]
    if len(profiles) < 12 or not np.isfinite(profiles).any(0).all():
        return near._replace(outline=back(circle))
    # The width of the rise comes from all rays together: one alone is too noisy in a dark iris. The
    # median of edges at slightly different places is as sharp as they are.
    typical = np.nanmedian(profiles, axis=0)
    rim, width = _fit_rise(np.linspace(*_PUPIL_SPAN, 241), typical, 1 / circle.semi_axes[0])
    axes = circle.semi_axes[0] * rim, circle.semi_axes[1] * rim
    return near._replace(outline=back(circle._replace(semi_axes=axes)), margin=width / rim)


def refine_limbus(
    photo: Photograph, start: Ellipse, pupil: FittedEllipse | None = None, coarse: bool = True
) -> FittedEllipse:
    """Refine a limbus near a circle (`coarse`) or near an ellipse.

    A pupil suggests where the limbus's centre is and how flat it is. The support is the share of
    the limbus's part outside the lids.
    """
    pictures, outline, back = limbus_part(photo, start, edges.ROUGH if coarse else edges.FINE)
    expected, ratio = _FRONTAL, outline.semi_axes[0] / start.semi_axes[0]
    if pupil is not None and pupil.support > _TRUSTED:
        frontal = 0.25 * np.array(_FRONTAL.flattening)
        flattening = FLATTENING_RATIO * pupil.outline.flattening + frontal
        sd = FLATTENING_RATIO * np.hypot(PUPIL_OVAL, pupil.flattening_sd)
        x, y = ratio * np.subtract(pupil.outline.centre, start.centre) + outline.centre
        middle = x, y + _UPWARDS * outline.semi_axes[0]
        expected = edges.Expected((flattening[0], flattening[1]), float(sd), middle, _CENTRE_SD)
    if coarse:
        steps, white, _ = _limbus_edges(*pictures, outline, (0.5, 1.65), 93, _LIMBUS_WIDTHS[1:])
        score = steps.score() * white * _beside_lids(outline)[:, None]
        outline = edges.best_outline(outline, steps.place, score, expected)
    fit = FittedEllipse(outline, 0.0, expected.flattening_sd)
    for reach in (0.1, 0.06) if coarse else (0.06, 0.04, 0.04):
        steps, white, profile = _limbus_edges(*pictures, fit.outline)
        value, place = _half_way_edges(profile, steps, white, reach)
        # A lid hides the limbus; outside the picture it is just missing.
        hidden = 1 - white[:, int(np.argmin(abs(steps.place - 1)))]
        shown = 1 - 0.8 * np.where(np.isnan(profile[:, : profile.shape[1] // 2]).any(1), 0, hidden)
        weight = _beside_lids(fit.outline) * shown
        fit = edges.refine_outline(fit.outline, value, place, weight, expected)
    return fit._replace(outline=back(fit.outline))


def measure_limbus_width(photo: Photograph, limbus: Ellipse) -> float | None:
    """Return the width over which the brightness rises from the iris's to the white's, relative to
    the limbus's radius; `None` if too little of the rise is seen.

    It is the width of the smoothstep that is as steep between a quarter and three quarters.
    """
    pictures, outline, _ = limbus_part(photo, limbus, edges.FINE)
    steps, white, profile = _limbus_edges(*pictures, outline)
    score, place = _half_way_edges(profile, steps, white, 0.04)
    used = score > 0.3
    if used.sum() < 12:
        return None
    # Each ray about its own half-way point: an error of the outline is not softness.
    x, distance = np.linspace(*_LIMBUS_SPAN, profile.shape[1]), np.linspace(-0.2, 0.2, 401)
    rays = zip(place[used], profile[used], strict=True)
    centred = np.stack([np.interp(at + distance, x, ray) for at, ray in rays])
    dark = np.median(centred[:, (distance > -0.18) & (distance < -0.05)], 1)
    bright = np.median(centred[:, (distance > 0.06) & (distance < 0.13)], 1)
    rise = np.nanmedian((centred - dark[:, None]) / (bright - dark)[:, None], 0)
    # The places nearest to the middle at which the rise is through a quarter and three quarters.
    low = distance[:200][rise[:200] <= 0.25].max(initial=distance[0])
    high = distance[200:][rise[200:] >= 0.75].min(initial=distance[-1])
    blur = _BLUR * _QUARTILES_OF_GAUSSIAN / outline.semi_axes[0]
    return float(np.sqrt(max((high - low) ** 2 - blur**2, 0)) / _QUARTILES_OF_SMOOTHSTEP)


def _find_eyes(
    photo: Photograph, limbus: FittedEllipse | None, pupil: FittedEllipse | None, all_eyes: bool
):
    """The eyes of a picture, the one with the most evidence first."""
    pairs = list[Pair]()
    starts = [limbus.outline] if limbus else _limbus_candidates(photo.pixels.mean(-1), pupil)
    rough = [_rough_pair(photo, start, limbus, pupil) for start in starts]
    rough = sorted(rough, key=_plausible_worth, reverse=True)
    for near in rough[: 2 * _CANDIDATES if all_eyes else _CANDIDATES]:
        if pairs and not all_eyes and _plausible_worth(near) < 0.01 * _plausible_worth(pairs[0]):
            break
        pair = _refine_pair(photo, near, limbus, pupil)
        outline = pair.limbus.outline
        known = any(_similar(outline, p.limbus.outline) for p in pairs)
        if known or not _is_inside(outline, photo.shape):
            continue
        pairs.append(pair)
        if pair.worth > _SURE and not all_eyes:
            break
    # An eye's pupil holds no other eye: the outer pair is a socket.
    pairs = [p._replace(worth=p.worth * (1 - _inner_worth(p, pairs))) for p in pairs]
    eyes = list[Pair]()
    for pair in sorted(pairs, key=lambda p: -p.worth):
        is_separate = [_separate(pair.limbus.outline, e.limbus.outline) for e in eyes]
        if not eyes or (all(is_separate) and pair.worth > MIN_CONFIDENCE):
            eyes.append(pair)
    return eyes


def _rough_pair(
    photo: Photograph, start: Ellipse, limbus: FittedEllipse | None, pupil: FittedEllipse | None
) -> Pair:
    """A circle as limbus with the circle within that is most likely the pupil."""
    fit = limbus or FittedEllipse(start, _TRUSTED)
    if pupil is None:
        part = _cut_part(photo, start, 1.1, _PUPIL_RADIUS)
        outline, back = part[2:]
        circles = _dark_rings(_without_highlights(part)[0], outline)
        a, b = start.semi_axes
        pupil = FittedEllipse(start._replace(semi_axes=(0.4 * a, 0.4 * b)), 0.0)
        if circles:
            pupil = FittedEllipse(back(circles[0]), _TRUSTED, 0.1)
    return _weigh(photo, fit, pupil)


def _plausible_worth(pair: Pair) -> float:
    return float(np.sqrt(np.prod(probabilities(pair.evidence))))


def _refine_pair(
    photo: Photograph, near: Pair, limbus: FittedEllipse | None, pupil: FittedEllipse | None
) -> Pair:
    """Fit the outlines near a rough pair, and weigh the evidence for them."""
    inner, fit = pupil or find_pupil(photo, near.limbus), limbus
    if fit is None:
        fit = refine_limbus(photo, near.limbus.outline, inner)
        if pupil is None:  # within the better limbus, which may be another
            second = find_pupil(photo, fit)
            if not _similar(second.outline, inner.outline, 0.05):
                fit = refine_limbus(photo, fit.outline, second)
            inner = second
    return _weigh(photo, fit, inner)


def _weigh(photo: Photograph, limbus: FittedEllipse, pupil: FittedEllipse) -> Pair:
    evidence = weigh_outlines(photo, limbus, pupil)
    return Pair(limbus, pupil, evidence, min(probabilities(evidence)))


def _measure_pair(
    photo: Photograph,
    near: FittedEllipse,
    near_pupil: FittedEllipse,
    limbus: FittedEllipse | None,
    pupil: FittedEllipse | None,
    eyes: int,
) -> Boundaries:
    """Measure a pair on the whole photograph, and keep what was given."""
    inner = pupil or (refine_pupil(photo, near, near_pupil) if near_pupil.support else near_pupil)
    fit = limbus or refine_limbus(photo, near.outline, inner, coarse=False)
    evidence = weigh_outlines(photo, fit, inner)
    limbus_sure, pupil_sure = probabilities(evidence)
    return Boundaries(
        fit.outline,
        inner.outline,
        1.0 if limbus else limbus_sure,
        1.0 if pupil else pupil_sure,
        refine_pupil(photo, fit, inner).margin if pupil else inner.margin,
        measure_limbus_width(photo, fit.outline),
        (fit.flattening_sd, inner.flattening_sd),
        eyes,
        evidence,
    )


def _similar(one: Ellipse, other: Ellipse, within: float = 0.01) -> bool:
    difference = np.subtract((*one.centre, *one.semi_axes), (*other.centre, *other.semi_axes))
    return bool(abs(difference).max() < within * one.semi_axes[0])


def _separate(one: Ellipse, other: Ellipse) -> bool:
    distance = np.hypot(*np.subtract(one.centre, other.centre))
    return bool(distance > one.semi_axes[0] + other.semi_axes[0])


def _inner_worth(pair: Pair, pairs: list[Pair]) -> float:
    hole = pair.pupil.outline
    inner = [p for p in pairs if hole.relative_radius(*p.limbus.outline.centre) < 0.5]
    fitting = [p.worth for p in inner if p.limbus.outline.mean_radius < 1.3 * hole.mean_radius]
    return max(fitting, default=0.0)


def _choose_eye(name: str, eyes: list[Pair], eye: str | None) -> Pair:
    if eye is None:
        return eyes[0]
    across = sorted(eyes, key=lambda p: p.limbus.outline.centre[0])
    number = {"left": 1, "right": len(eyes)}.get(eye) or int(eye)
    if not 1 <= number <= len(eyes):
        raise ValueError(f"{name}: --eye {eye}, but the picture shows {len(eyes)} in all")
    return across[number - 1]


def _beside_lids(outline: Ellipse):
    """Weights of the rays: lids hide the top, and often the bottom."""
    right, down = (outline.points(RAYS) - outline.centre).T
    cosine = abs(right) / np.hypot(right, down)
    above = np.clip((cosine - 0.65) / 0.3, 0.03, 1)
    return np.where(down < 0, above, np.clip(cosine + 0.35, 0.5, 1))


def _limbus_candidates(brightness, pupil: FittedEllipse | None) -> list[Ellipse]:
    """Circles near which a limbus may lie, best first."""
    scale = min(1.0, _RING_LONG / max(brightness.shape))
    copy = edges.reduce_picture(brightness[..., None], scale)[..., 0]
    shape = brightness.shape
    smallest = max(max(copy.shape) / _SMALLEST, 8.0)
    rings = edges.find_rings(copy, (0.4 * smallest, 0.58 * min(copy.shape)), 10, sideways=0.6)
    distance = np.hypot(*(rings[:, None, :2] - rings[None, :, :2]).T)
    radius, votes = rings[:, 2:3], rings[:, 3]
    share = rings[:, 2] / radius
    # The votes of a ring, and those of the best pupil within.
    inside = (share > PUPIL_SHARE[0]) & (share < PUPIL_SHARE[1]) & (distance < 0.25 * radius)
    worth = votes * (0.5 + np.where(inside, votes, 0).max(1, initial=0))
    best = [k for k in np.argsort(-worth, kind="stable") if rings[k, 2] >= smallest]
    circles = [Ellipse((x, y), (r, r)).scaled(1 / scale) for x, y, r, _ in rings[best]]
    circles = [c for c in circles if _is_inside(c, shape)]
    if pupil is not None:
        hole = pupil.outline
        circles = [c for c in circles if plausibility(c, hole) > 0.5]
        middle, size = hole.centre, hole.mean_radius
        circles += [Ellipse(middle, (size / s, size / s)) for s in (0.25, 0.35, 0.5)]
    return circles[:_STARTS]


def _is_inside(outline: Ellipse, shape) -> bool:
    """Whether an outline's middle lies in the picture."""
    return all(-0.5 < v < n - 0.5 for v, n in zip(outline.centre, shape[::-1], strict=True))


def _cut_part(photo: Photograph, outline: Ellipse, margin: float, radius: float):
    """`cut_around` of the pixels, with the share of saturated ones as second."""
    pixels, outline_in_part, back = cut_around(photo.pixels, outline, margin, radius)
    clipped, *_ = cut_around(photo.saturated[..., None].astype(np.float32), outline, margin, radius)
    return pixels, clipped[..., 0], outline_in_part, back


def _profile(picture, clipped, circle: Ellipse, span, steps: int):
    """Brightness along rays; NaN in highlights, whose edges are not the pupil's."""
    hidden = sample_along_rays(clipped, circle, span, steps) > 0.05
    return np.where(hidden, np.nan, sample_along_rays(picture, circle, span, steps))


def _first_rise(picture, ceiling: float):
    """Brightness on a scale on which the first rise from black is the largest: irides are often
    darker beside the pupil.
    """
    return np.log(np.maximum(picture, 0) + 0.04 * ceiling)


def _without_highlights(part):
    """Apply `_darken` to a part cut out round a limbus; the ceiling comes last."""
    pixels, clipped, limbus, _ = part
    picture = pixels.mean(-1)
    ceiling = _ceiling(picture, limbus)
    return *_darken(picture, clipped, ceiling, limbus.semi_axes[0]), ceiling


def _ceiling(picture, limbus: Ellipse) -> float:
    """Brightness within a limbus that only highlights exceed; white's if none of it is seen."""
    within = picture[limbus.radii(picture.shape) < 0.9]
    return float(1.5 * np.quantile(within, 0.75) + 1e-9) if within.size else 1.0


def _darken(picture, clipped, ceiling: float, limbus_radius: float):
    """A picture without its highlights, and its saturated pixels but for those that hide nothing.

    Highlights are cut at a ceiling. Narrow ones in the pupil, as a ring lamp's, whose inner edge
    resembles a pupil's, become as dark as what is beside them.
    """
    half = max(1, round(_NARROW / 2 * limbus_radius))
    beside = ndimage.grey_opening(picture, 2 * half + 1)
    narrow = (picture > ceiling) & (beside < ceiling)
    narrow = ndimage.binary_dilation(narrow, iterations=max(1, half // 2))
    in_pupil = np.logical_and(narrow, beside < _PUPIL_DARK * ceiling)
    return np.where(in_pupil, beside, np.minimum(picture, ceiling)), np.where(in_pupil, 0, clipped)


def _fit_rise(x, brightness, pixel: float) -> tuple[float, float]:
    """Where the brightness rises from a constant, before it was blurred, and the width of the rise.

    Fitted are a step, the beginning of a smoothstep, or both at one place if that is better by one
    log likelihood (Akaike), and a line behind; the width of the Gaussian is known to a factor.
    """
    node, weight = np.polynomial.legendre.leggauss(16)
    node = (node + 1) / 2
    weight = 3 * weight * node * (1 - node)  # a smoothstep is as many steps as its slope says

    def components(v, sharp, soft):
        """Constant, line up or down, and what rises; how much of each there is."""
        start, width, factor = v
        blur = _BLUR * np.exp(_BLUR_SPREAD * factor) * pixel
        step = special.ndtr((x - start) / blur)
        line = step * (x - start)
        basis = [np.ones_like(x), line, -line, *[step] * sharp]
        basis += [special.ndtr((x[:, None] - start - width * node) / blur) @ weight] * soft
        basis = np.stack(basis, -1)
        return basis, optimize.nnls(basis, brightness)[0]

    def residuals(v, *kinds):
        basis, amounts = components(v, *kinds)
        # A tenth: neighbouring samples err alike.
        return np.append(np.sqrt(0.1) * (basis @ amounts - brightness) / noise, v[2])

    def fit_model(start, sharp, soft):
        scale, kinds = [0.01, 0.01, 1.0], (sharp, soft)
        optimum = optimize.least_squares(
            residuals, start, bounds=bounds, x_scale=scale, args=kinds, ftol=1e-5, xtol=1e-5
        )
        rises = components(optimum.x, sharp, soft)[1][3:]
        share = rises[-1] / (rises.sum() + 1e-30) if soft else 0.0
        return optimum.cost + (sharp and soft), float(optimum.x[0]), float(share * optimum.x[1])

    noise = _MISFIT * (np.quantile(brightness, 0.9) - np.quantile(brightness, 0.1)) + 1e-9
    bounds = ([0.85, 0.01, -3.0], [1.1, 2 * _PUPIL_WIDTHS[-1], 3.0])
    fits = [fit_model([1.0, 0.05, 0.0], True, False), fit_model([1.0, 0.05, 0.0], True, True)]
    fits += [fit_model([1 - width / 2, width, 0.0], False, True) for width in (0.04, 0.1)]
    return min(fits)[1:]


def _half_way_edges(profile, steps: edges.Edges, white, reach: float):
    """Score and place (nearest to the outline) where rays are half-way from iris to white."""
    x = np.linspace(*_LIMBUS_SPAN, profile.shape[1])
    # Beyond the picture's edge there is no edge.
    smooth = ndimage.gaussian_filter1d(np.nan_to_num(profile), 1.0, axis=1)
    dark = np.quantile(smooth[:, (x > 0.82) & (x < 0.95)], 0.2, axis=1)
    bright = np.median(smooth[:, (x > 1.06) & (x < 1.13)], axis=1)
    level = smooth - 0.5 * (dark + bright)[:, None]
    rising = (level[:, :-1] < 0) & (level[:, 1:] >= 0)
    crossing = x[:-1] + (x[1] - x[0]) * level[:, :-1] / (level[:, :-1] - level[:, 1:] - 1e-12)
    distance = np.where(rising, abs(crossing - 1), np.inf)
    index, rays = distance.argmin(1), np.arange(len(distance))
    place = np.where(rising[rays, index], crossing[rays, index], 1.0)
    column = np.searchsorted(steps.place, place).clip(0, steps.place.size - 1)
    is_edge = (distance[rays, index] < reach) & (bright > dark)
    return np.where(is_edge, (steps.score() * white)[rays, column], 0.0), place


def _limbus_edges(picture, colour, outline, span=_LIMBUS_SPAN, count=161, widths=_LIMBUS_WIDTHS):
    """Edges across the limbus, how white it is beyond each of them (0 to 1), and the brightness."""
    profile = sample_along_rays(picture, outline, span, count)
    steps = edges.fit_steps(profile, span, widths, 0.2)
    if colour is None:
        return steps, np.ones(steps.fit.shape), profile
    # Beyond the picture's edge the tint is NaN, and no white may be found there: 9 is far redder
    # than any tissue.
    tint = np.nan_to_num(sample_along_rays(colour, outline, span, count), nan=9.0)
    pitch = steps.place[1] - steps.place[0]
    smooth = ndimage.uniform_filter1d(tint, max(1, round(0.05 / pitch)), axis=1)
    # Just beyond the rise: behind a thin strip of white there may be a lid.
    skip = (count - steps.place.size) // 2 + round(0.08 / pitch)
    outside = smooth[:, skip : skip + steps.place.size]
    # The white is what is least red just outside. At the sides it may be in a shade as red as skin.
    index = int(np.argmin(abs(steps.place - 1)))
    right, down = (outline.points(RAYS) - outline.centre).T
    reds = [float(np.quantile(outside[side, index], 0.2)) for side in (right < 0, right > 0)]
    least_red = np.where(right > 0, *reds[::-1])[:, None]
    least_red = np.minimum(least_red, min(reds) + _WARMER)
    white = 1 / (1 + np.exp(np.clip((outside - least_red - 0.4) / 0.08, -50, 50)))
    sideways = np.clip((abs(right) / np.hypot(right, down) - 0.8) / 0.15, 0, 0.7)
    return steps, np.maximum(white, sideways[:, None]), profile
