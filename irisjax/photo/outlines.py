"""Outlines of limbus and pupil in a photograph, and the confidence in each."""

from typing import NamedTuple

import numpy as np
from scipy import ndimage, optimize, special

from irisjax.photo import edges
from irisjax.photo.edges import FINE, RAYS, ROUGH, along_rays, cut_around, refine_outline
from irisjax.photo.photograph import Ellipse, Photograph
from irisjax.photo.pose import FLATTER, PUPIL_OVAL

MIN_CONFIDENCE = 0.4  # below which an outline is more likely wrong than right
_PUPIL_SHARE = (0.12, 0.85)  # range of pupil radii, relative to the limbus
_LIMBUS_WIDTHS = (0.02, 0.05, 0.09)  # half widths of the rise, relative to the radius
_LIMBUS_SPAN = (0.6, 1.4)  # of profiles across the limbus, relative to it
_BLUR, _BLUR_SPREAD = 0.8, 0.4  # standard deviation of a photograph's own blur, px; of its log
_QUARTILES_OF_GAUSSIAN = 1.349  # distance between quartiles over the standard deviation
_QUARTILES_OF_SMOOTHSTEP = 0.3473  # distance between 1/4 and 3/4 of the rise, over its width
_PUPIL_WIDTHS = (0.02, 0.05, 0.1)  # half widths of the rise, relative to the radius
_PUPIL_SPAN = (0.8, 1.15)
_EVEN = np.ones(RAYS.size)  # weights of the rays
_MISFIT = 0.02  # difference of irides from the fitted rise, relative to the rise
_LONG = 800  # px along the long side of the copy in which eyes are searched
_SMALLEST = 40  # long side over the radius of the smallest iris
_CANDIDATES = 6
_SURE = 0.8  # worth of a pair of outlines, at most 1.3, above which the search ends
_WIDE = 0.68  # pupil over limbus above which the pair is less plausible
_TRUSTED = 0.5  # support above which a pupil is used to find the limbus


class PupilEdge(NamedTuple):
    """The outline at which the iris begins; the iris's margin may be dark.

    Attributes:
        outline: The outline, in pixels of the photograph.
        support: Share of the outline that edges support, reduced if the pupil is hardly darker than
            the iris.
        margin: Width over which the brightness rises to the iris's, relative to the pupil's radius:
            0 for a sharp edge, `None` if it is not known. A step and a smoothstep at one place
            count as the smoothstep that lets as much light by.
    """

    outline: Ellipse
    support: float
    margin: float | None = None


class Boundaries(NamedTuple):
    """Outlines of limbus and pupil in pixels of the photograph.

    Attributes:
        limbus: Middle of the soft rise from iris to white.
        pupil: Outline at which the iris begins.
        limbus_confidence: 0 to 1, from the share of the outline that edges support, their distance
            from it and their strength; 1 if given, not to be trusted below `MIN_CONFIDENCE`.
        pupil_confidence: The same for the pupil.
        pupil_margin: See `PupilEdge.margin`.
        limbus_width: Width over which iris and white blend, relative to the limbus's radius; `None`
            if it is not known.
    """

    limbus: Ellipse
    pupil: Ellipse
    limbus_confidence: float
    pupil_confidence: float
    pupil_margin: float | None = None
    limbus_width: float | None = None


def find_boundaries(
    photo: Photograph, limbus: Ellipse | None = None, pupil: Ellipse | None = None
) -> Boundaries:
    """Find the outlines of the eye in a photograph; given ones are kept.

    Irides from a fortieth of the picture's long side to about half of its short side are found,
    tilted by up to 30 degrees. Of two eyes the one whose outlines are better supported is found, or
    the first that is beyond doubt. A picture without an eye gives outlines of low confidence.

    Raises:
        ValueError: If nothing resembles an iris, or a given outline lies outside the picture.
    """
    for name, given in (("limbus", limbus), ("pupil", pupil)):
        if given is not None and not _within(given, photo.shape):
            rows, columns = photo.shape
            raise ValueError(
                f"{photo.name}: the middle of the {name} given, {given.centre}, is outside the "
                f"picture of {columns} x {rows} pixels"
            )
    outline, held = limbus, None
    if outline is None:
        outline, inner = _searched(photo, pupil)
        outline, held = limbus_near(photo, outline, inner, coarse=False)
    if pupil is not None:
        return _judged(photo, outline, PupilEdge(pupil, 1.0), held, None)
    found = pupil_within(photo, outline, coarse=False)
    if limbus is None and found.support > _TRUSTED:
        outline, held = limbus_near(photo, outline, found.outline, coarse=False)
    return _judged(photo, outline, found, held, found.support)


def pupil_within(photo: Photograph, limbus: Ellipse, coarse: bool = True) -> PupilEdge:
    """Find the pupil within a limbus.

    Unless the search is `coarse`, a sharp edge is placed half-way from black to bright, whatever
    the blur; if the brightness rises slowly, the outline is placed where the rise begins.
    """
    pixels, cut_off, outline, back = _part_about(photo, limbus, 1.1, ROUGH)
    radius, picture = outline.semi_axes[0], pixels.mean(-1)
    relative, ceiling = _within_limbus(picture, outline)
    rings = np.empty((0, 4))
    if ceiling is not None:
        picture = np.minimum(picture, ceiling)
        rings = edges.find_rings(picture, (0.13 * radius, 0.8 * radius), 6, sideways=0.2)
        off, share = outline.relative_radius(*rings[:, :2].T), rings[:, 2] / radius
        possible = (_PUPIL_SHARE[0] < share) & (share < _PUPIL_SHARE[1])
        rings = rings[possible & (off < np.minimum(0.3, 1.05 - share))]
    circles = [Ellipse((x, y), (r, r)) for x, y, r, _ in rings]
    worth = [v * _darkness(picture, relative, c) for v, c in zip(rings[:, 3], circles, strict=True)]
    if not circles:  # in place of a pupil that is not found
        a, b = limbus.semi_axes
        return PupilEdge(limbus._replace(semi_axes=(0.4 * a, 0.4 * b)), 0.0)
    circle, span = circles[int(np.argmax(worth))], (0.5, 1.65)
    profile = _profile(picture, cut_off, circle, span, 93)
    steps = edges.steps_along(profile, span, _PUPIL_WIDTHS[1:], 0.2)
    circle = edges.best_outline(circle, steps.place, steps.score())
    support, span = 0.0, (0.7, 1.3)
    for near in (0.12, 0.08):
        profile = _profile(picture, cut_off, circle, span, 121)
        steps = edges.steps_along(profile, span, _PUPIL_WIDTHS, 0.15)
        circle, support = refine_outline(circle, *steps.strongest(near), _EVEN)
    sure = support * float(np.sqrt(_darkness(picture, relative, circle)))
    found = PupilEdge(back(circle), sure)
    return found if coarse or not support else beginning_of(photo, limbus, found)


def beginning_of(photo: Photograph, limbus: Ellipse, near: PupilEdge) -> PupilEdge:
    """Move an outline to where the iris begins, and measure the width of its margin, if enough of
    it is seen.
    """
    pixels, _, outline, _ = _part_about(photo, limbus, 1.1, ROUGH)
    _, ceiling = _within_limbus(pixels.mean(-1), outline)
    pixels, cut_off, circle, back = _part_about(photo, near.outline, 1.5, FINE)
    picture, span = np.clip(pixels.mean(-1), 0, ceiling), (0.7, 1.3)
    smooth = ndimage.gaussian_filter(picture, 0.01 * circle.semi_axes[0])  # against noise
    held = 0 * _EVEN
    for reach in (0.1, 0.08):
        # The root shows the first rise.
        profile = np.sqrt(_profile(smooth, cut_off, circle, span, 241))
        held, place = edges.steps_along(profile, span, _PUPIL_WIDTHS, 0.15).strongest(reach)
        circle, _ = refine_outline(circle, held, place, _EVEN)
    good = _profile(picture, cut_off, circle, _PUPIL_SPAN, 241)[held > 0.3]
    if len(good) < 12 or not np.isfinite(good).any(0).all():
        return near._replace(outline=back(circle))
    # The width of the rise comes from all rays together: one alone is too noisy in a dark iris. The
    # median of edges at slightly different places is as sharp as they are.
    typical = np.nanmedian(good, axis=0)
    rim, width = _beginning(np.linspace(*_PUPIL_SPAN, 241), typical, 1 / circle.semi_axes[0])
    axes = circle.semi_axes[0] * rim, circle.semi_axes[1] * rim
    return near._replace(outline=back(circle._replace(semi_axes=axes)), margin=width / rim)


def limbus_near(
    photo: Photograph, start: Ellipse, pupil: Ellipse | None = None, coarse: bool = True
) -> tuple[Ellipse, float]:
    """Refine a limbus near a circle (`coarse`) or near an ellipse; a reliable pupil determines how
    flat it is. Return it with the share of its part outside the lids that edges support.
    """
    seen, outline, back = _limbus_part(photo, start, ROUGH if coarse else FINE)
    lateral = 0.5 + 0.5 * np.cos(RAYS) ** 2
    flattening = (0.0, 0.0, 0.1)
    if pupil is not None:
        flattening = (*(FLATTER * pupil.flattening), FLATTER * PUPIL_OVAL)
    if coarse:
        steps, white, _ = _limbus_edges(*seen, outline, (0.5, 1.65), 93, _LIMBUS_WIDTHS[1:])
        score = steps.score() * white * lateral[:, None]
        outline = edges.best_outline(outline, steps.place, score)
    support = 0.0
    for near in (0.1, 0.06) if coarse else (0.06, 0.04, 0.04):
        steps, white, profile = _limbus_edges(*seen, outline)
        value, place = _half_way(profile, steps, white, near)
        # A lid hides the limbus; outside the picture it is just missing.
        covered = 1 - white[:, int(np.argmin(abs(steps.place - 1)))]
        shown = 1 - 0.8 * np.where(np.isnan(profile[:, : profile.shape[1] // 2]).any(1), 0, covered)
        outline, support = refine_outline(outline, value, place, lateral * shown, flattening)
    return back(outline), support


def limbus_width_of(photo: Photograph, limbus: Ellipse) -> float | None:
    """Return the width over which the brightness rises from the iris's to the white's, relative to
    the limbus's radius; `None` if too little of the rise is seen.

    It is the width of the smoothstep that is as steep between a quarter and three quarters.
    """
    seen, outline, _ = _limbus_part(photo, limbus, FINE)
    steps, white, profile = _limbus_edges(*seen, outline)
    held, place = _half_way(profile, steps, white, 0.04)
    good = held > 0.3
    if good.sum() < 12:
        return None
    # Each ray about its own half-way point: an error of the outline is not softness.
    x, aside = np.linspace(*_LIMBUS_SPAN, profile.shape[1]), np.linspace(-0.2, 0.2, 401)
    rays = zip(place[good], profile[good], strict=True)
    moved = np.stack([np.interp(at + aside, x, ray) for at, ray in rays])
    dark = np.median(moved[:, (aside > -0.18) & (aside < -0.05)], 1)
    bright = np.median(moved[:, (aside > 0.06) & (aside < 0.13)], 1)
    rise = np.nanmedian((moved - dark[:, None]) / (bright - dark)[:, None], 0)
    # The places nearest to the middle at which the rise is through a quarter and three quarters.
    low = aside[:200][rise[:200] <= 0.25].max(initial=aside[0])
    high = aside[200:][rise[200:] >= 0.75].min(initial=aside[-1])
    blur = _BLUR * _QUARTILES_OF_GAUSSIAN / outline.semi_axes[0]
    return float(np.sqrt(max((high - low) ** 2 - blur**2, 0)) / _QUARTILES_OF_SMOOTHSTEP)


def _searched(photo: Photograph, pupil: Ellipse | None) -> tuple[Ellipse, Ellipse | None]:
    """The best limbus in a reduced copy, and its pupil if that is reliable."""
    scale = min(1.0, _LONG / max(photo.shape))
    layers = edges.reduce_picture(np.dstack([photo.pixels, photo.saturated]), scale)
    small = photo._replace(pixels=layers[..., :3], saturated=layers[..., 3] > 0.1)
    known = None if pupil is None else pupil.scaled(scale)
    best, found, seen = -1.0, None, list[Ellipse]()
    for start in _starts(small.pixels.mean(-1), known):
        outline, held = limbus_near(small, start, known)
        numbers = *outline.centre, *outline.semi_axes
        off = [np.subtract(numbers, (*e.centre, *e.semi_axes)) for e in seen]
        # Several starts may lead to one outline: to within a hundredth of the radius.
        same = [max(np.hypot(*d[:2]), *abs(d[2:])) < 0.01 * numbers[2] for d in off]
        if any(same) or not _within(outline, small.shape):
            continue
        seen.append(outline)
        inner, support = known, 1.0
        if inner is None:
            inner, support, _ = pupil_within(small, outline)
        worth = held * _plausible(outline, inner) * (0.3 + support)
        if worth > best:
            trusted = inner.scaled(1 / scale) if support > _TRUSTED else None
            best, found = worth, (outline.scaled(1 / scale), trusted)
        if best > _SURE:
            break
    if found is None:
        raise ValueError(
            f"{photo.name}: no iris found; give --limbus with its centre and semi-axes in pixels"
        )
    return found


def _judged(
    photo: Photograph, limbus: Ellipse, pupil: PupilEdge, held: float | None, inner: float | None
) -> Boundaries:
    """Confidences from the shares that edges support, `None` for given outlines, and softness."""
    # In pictures without an eye, chance edges support up to 0.8 of a dark disc's outline and 0.35
    # of others, most of tiny ones, but hardly 0.3 of a pupil within. Lids and lashes leave 0.4 of
    # the limbus and half of the pupil in simulated and real eyes.
    likely = _plausible(limbus, pupil.outline)
    half = np.array(photo.shape[::-1]) / 2
    for outline in (limbus, pupil.outline):  # half an eye does not count
        shown = (abs(outline.points(RAYS) + 0.5 - half) < half).all(1).mean()
        likely *= float(np.clip((shown - 0.5) / 0.15, 0, 1))
    limbus_sure = pupil_sure = 1.0
    if held is not None:
        limbus_sure = likely * min(held / 0.75, 1.0) * min(1.0, limbus.semi_axes[1] / 30)
        if inner is not None:
            limbus_sure *= float(np.clip((inner - 0.2) / 0.2, 0, 1))
    if inner is not None:
        pupil_sure = likely * float(np.clip((inner - 0.2) / 0.5, 0, 1))
        pupil_sure *= min(1.0, limbus_sure / MIN_CONFIDENCE)
    margin = pupil.margin
    if margin is None:
        margin = beginning_of(photo, limbus, pupil).margin
    sure = float(limbus_sure), float(pupil_sure)
    return Boundaries(limbus, pupil.outline, *sure, margin, limbus_width_of(photo, limbus))


def _starts(brightness, pupil: Ellipse | None) -> list[Ellipse]:
    """Circles near which a limbus may lie, best first."""
    shape = brightness.shape
    least = max(max(shape) / _SMALLEST, 8.0)
    rings = edges.find_rings(brightness, (0.4 * least, 0.58 * min(shape)), 8, sideways=0.6)
    away = np.hypot(*(rings[:, None, :2] - rings[None, :, :2]).T)
    radius, votes = rings[:, 2:3], rings[:, 3]
    share = rings[:, 2] / radius
    # The votes of a ring, and those of the best pupil within.
    inside = (share > _PUPIL_SHARE[0]) & (share < _PUPIL_SHARE[1]) & (away < 0.25 * radius)
    worth = votes * (0.5 + np.where(inside, votes, 0).max(1, initial=0))
    best = [k for k in np.argsort(-worth, kind="stable") if rings[k, 2] >= least]
    circles = [Ellipse((x, y), (r, r)) for x, y, r, _ in rings[best]]
    circles = [c for c in circles if _within(c, shape)]
    if pupil is not None:
        circles = [c for c in circles if _plausible(c, pupil) > 0.5]
    return circles[:_CANDIDATES]


def _within(outline: Ellipse, shape) -> bool:
    """Whether an outline's middle lies in the picture."""
    return all(-0.5 < v < n - 0.5 for v, n in zip(outline.centre, shape[::-1], strict=True))


def _plausible(limbus: Ellipse, pupil: Ellipse) -> float:
    """1 for a pair of outlines that an eye may have, and less for odder ones."""
    size = pupil.semi_axes[0] / limbus.semi_axes[0]
    off = float(limbus.relative_radius(*pupil.centre))
    low, high = _PUPIL_SHARE
    odd = max(low - size, 0) / 0.05 + max(size - high, 0) / 0.05
    # If a pupil leaves a narrow ring, the white's edge is mistaken for the iris's: 3 to 12 % off.
    odd += max(size - _WIDE, 0) / 0.1
    odd += max(off - 0.15, 0) / 0.1
    odd += sum(max(0.82 - e.semi_axes[1] / e.semi_axes[0], 0) / 0.04 for e in (limbus, pupil))
    return float(np.exp(-odd))


def _part_about(photo: Photograph, outline: Ellipse, margin: float, radius: float):
    """`cut_around` of the pixels, with the share of saturated ones as second."""
    layers = np.dstack([photo.pixels, photo.saturated])
    layers, moved, back = cut_around(layers, outline, margin, radius)
    return layers[..., :3], layers[..., 3], moved, back


def _profile(picture, cut_off, circle: Ellipse, span, steps: int):
    """Brightness along rays; NaN in highlights, whose edges are not the pupil's."""
    hidden = along_rays(cut_off, circle, span, steps) > 0.05
    return np.where(hidden, np.nan, along_rays(picture, circle, span, steps))


def _within_limbus(picture, limbus: Ellipse) -> tuple[np.ndarray, float | None]:
    """Relative radii, and the brightness that only highlights exceed; `None` out of the picture."""
    relative = limbus.radii(picture.shape)
    within = picture[relative < 0.9]
    return relative, float(1.5 * np.quantile(within, 0.75) + 1e-9) if within.size else None


def _limbus_part(photo: Photograph, outline: Ellipse, radius: float):
    """`cut_around` of brightness and redness (`None` without colours)."""
    pixels, moved, back = cut_around(photo.pixels, outline, 2.0, radius)
    redness = None
    if not photo.grey:  # far larger for skin than for the white of an eye
        floor = 0.02 * float(np.quantile(pixels[..., 0], 0.98)) + 1e-6
        red, _, blue = np.moveaxis(np.maximum(pixels, 0) + floor, -1, 0)
        redness = np.log(red / blue)
    return (pixels.mean(-1), redness), moved, back


def _beginning(x, brightness, pixel: float) -> tuple[float, float]:
    """Where the brightness rises from a constant, before it was blurred, and the width of the rise.

    Fitted are a step, the beginning of a smoothstep, or both at one place if that is better by one
    log likelihood (Akaike), and a line behind; the width of the Gaussian is known to a factor.
    """
    node, weight = np.polynomial.legendre.leggauss(32)
    node = (node + 1) / 2
    weight = 3 * weight * node * (1 - node)  # a smoothstep is as many steps as its slope says

    def parts(v, sharp, soft):  # constant, line up or down, what rises; how much of each there is
        start, width, factor = v
        blur = _BLUR * np.exp(_BLUR_SPREAD * factor) * pixel
        step = special.ndtr((x - start) / blur)
        line = step * (x - start)
        basis = [np.ones_like(x), line, -line, *[step] * sharp]
        basis += [special.ndtr((x[:, None] - start - width * node) / blur) @ weight] * soft
        basis = np.stack(basis, -1)
        return basis, optimize.nnls(basis, brightness)[0]

    def misfit(v, *kinds):
        basis, much = parts(v, *kinds)
        # A tenth: neighbouring samples err alike.
        return np.append(np.sqrt(0.1) * (basis @ much - brightness) / noise, v[2])

    def fit(start, sharp, soft):
        scale, kinds = [0.01, 0.01, 1.0], (sharp, soft)
        found = optimize.least_squares(misfit, start, bounds=bounds, x_scale=scale, args=kinds)
        rises = parts(found.x, sharp, soft)[1][3:]
        share = rises[-1] / (rises.sum() + 1e-30) if soft else 0.0
        return found.cost + (sharp and soft), float(found.x[0]), float(share * found.x[1])

    noise = _MISFIT * (np.quantile(brightness, 0.9) - np.quantile(brightness, 0.1)) + 1e-9
    bounds = ([0.85, 0.01, -3.0], [1.1, 2 * _PUPIL_WIDTHS[-1], 3.0])
    fits = [fit([1.0, 0.05, 0.0], True, False), fit([1.0, 0.05, 0.0], True, True)]
    fits += [fit([1 - width / 2, width, 0.0], False, True) for width in (0.04, 0.1)]
    return min(fits)[1:]


def _darkness(picture, relative, circle: Ellipse) -> float:
    """How much darker a circle is inside than the iris around it, 0 to 1."""
    own = circle.radii(picture.shape)
    within, beside = own < 0.9, (own > 1.1) & (own < 1.6) & (relative < 0.95)
    if not within.any() or not beside.any():
        return 0.0
    inside, outside = np.median(picture[within]), np.median(picture[beside])
    return float(np.clip(1 - inside / (outside + 1e-9), 0, 1))


def _half_way(profile, steps: edges.Edges, white, near: float):
    """Score and place (nearest to the outline) where rays are half-way from iris to white."""
    x = np.linspace(*_LIMBUS_SPAN, profile.shape[1])
    # Beyond the picture's edge there is no edge.
    smooth = ndimage.gaussian_filter1d(np.nan_to_num(profile), 1.0, axis=1)
    dark = np.quantile(smooth[:, (x > 0.82) & (x < 0.95)], 0.2, axis=1)
    bright = np.median(smooth[:, (x > 1.06) & (x < 1.13)], axis=1)
    level = smooth - 0.5 * (dark + bright)[:, None]
    rising = (level[:, :-1] < 0) & (level[:, 1:] >= 0)
    crossing = x[:-1] + (x[1] - x[0]) * level[:, :-1] / (level[:, :-1] - level[:, 1:] - 1e-12)
    away = np.where(rising, abs(crossing - 1), np.inf)
    at, rays = away.argmin(1), np.arange(len(away))
    place = np.where(rising[rays, at], crossing[rays, at], 1.0)
    column = np.searchsorted(steps.place, place).clip(0, steps.place.size - 1)
    good = (away[rays, at] < near) & (bright > dark)
    return np.where(good, (steps.score() * white)[rays, column], 0.0), place


def _limbus_edges(picture, colour, outline, span=_LIMBUS_SPAN, count=161, widths=_LIMBUS_WIDTHS):
    """Edges across the limbus, how white it is beyond each of them (0 to 1), and the brightness."""
    profile = along_rays(picture, outline, span, count)
    steps = edges.steps_along(profile, span, widths, 0.2)
    if colour is None:
        return steps, np.ones(steps.fit.shape), profile
    # Beyond the picture's edge nothing is known: a tint of 9, far redder than tissue, is not white.
    tint = np.nan_to_num(along_rays(colour, outline, span, count), nan=9.0)
    pitch = steps.place[1] - steps.place[0]
    smooth = ndimage.uniform_filter1d(tint, max(1, round(0.05 / pitch)), axis=1)
    # The reddest from just beyond the middle of the rise to where the white is measured.
    width = max(1, round(0.13 / pitch))
    reddest = ndimage.maximum_filter1d(smooth, width, axis=1)
    skip = (count - steps.place.size) // 2 + round(0.12 / pitch)
    outside = reddest[:, skip : skip + steps.place.size]
    # The white is what is least red just outside: the sides of an eye show it.
    at = int(np.argmin(abs(steps.place - 1)))
    least = np.quantile(outside[:, at], 0.15)
    white = 1 / (1 + np.exp(np.clip((outside - least - 0.4) / 0.08, -50, 50)))
    return steps, white, profile
