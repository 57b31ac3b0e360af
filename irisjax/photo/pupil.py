"""The pupil within a limbus: where the iris begins beyond its black."""

from typing import NamedTuple

import numpy as np
from scipy import ndimage, optimize, special

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
_RISE = (0.8, 1.15)
_BLUR, _BLUR_SPREAD = 0.8, 0.4  # standard deviation in px, and of its logarithm
_MISFIT = 0.02  # of the rise, by which irides differ from the fit


class Pupil(NamedTuple):
    """The outline where the iris begins, whose margin may be dark.

    - `support`: share of the outline that edges support, less where it is hardly darker than the
        iris.
    - `margin`: width over which the brightness rises to the iris's, of the pupil's radius: 0 of a
        sharp edge, `None` where it is not known. Of a step and a smoothstep at one place it is that
        of a smoothstep that lets as much light by.
    """

    outline: Ellipse
    support: float
    margin: float | None = None


def pupil_within(photo: Photograph, limbus: Ellipse, coarse: bool = True) -> Pupil:
    """The pupil within a limbus.

    Where it is not `coarse` and its edge is sharp, the outline is half-way from black to bright,
    whatever the blur; where the brightness takes long to rise, it is where the rise began.
    """
    picture, cut_off, outline, back = _part(photo, limbus, 1.1, ROUGH)
    radius = outline.semi_axes[0]
    row, column = np.ogrid[: picture.shape[0], : picture.shape[1]]
    relative = outline.relative_radius(column, row)
    if not (relative < 0.9).any():
        return Pupil(limbus._replace(semi_axes=tuple(0.4 * a for a in limbus.semi_axes)), 0.0)
    picture = np.minimum(picture, _ceiling(picture, relative))
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
        return Pupil(middle, 0.0)
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
        return Pupil(back(circle), sure)
    return beginning_of(photo, limbus, Pupil(back(circle), sure))


def beginning_of(photo: Photograph, limbus: Ellipse, near: Pupil) -> Pupil:
    """The outline moved to where the iris begins, and the width of its margin, if enough of it is
    seen.
    """
    picture, _, outline, _ = _part(photo, limbus, 1.1, ROUGH)
    row, column = np.ogrid[: picture.shape[0], : picture.shape[1]]
    ceiling = _ceiling(picture, outline.relative_radius(column, row))
    picture, cut_off, circle, back = _part(photo, near.outline, 1.5, FINE)
    picture, span = np.clip(picture, 0, ceiling), (0.7, 1.3)
    smooth = ndimage.gaussian_filter(picture, 0.01 * circle.semi_axes[0])  # against noise
    held = np.zeros(ray_angles().size)
    for reach in (0.1, 0.08):
        # The root shows the first rise.
        profile = np.sqrt(_profile(smooth, cut_off, circle, span, 241))
        held, place = steps_along(profile, span, _WIDTHS, 0.15).strongest(reach)
        circle, _ = polished(circle, held, place, np.ones(held.size))
    good = _profile(picture, cut_off, circle, _RISE, 241)[held > 0.3]
    if len(good) < 12 or not np.isfinite(good).any(0).all():
        return near._replace(outline=back(circle))
    # The width of the rise comes from all rays together: one alone is too noisy in a dark iris. Of
    # edges that are not all at one place the median is as sharp as they are.
    typical = np.nanmedian(good, axis=0)
    rim, width = _beginning(np.linspace(*_RISE, 241), typical, 1 / circle.semi_axes[0])
    axes = circle.semi_axes[0] * rim, circle.semi_axes[1] * rim
    return near._replace(outline=back(circle._replace(semi_axes=axes)), margin=width / rim)


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


def _ceiling(picture, relative) -> float:
    """Brightness within a limbus above which there are highlights alone."""
    return float(1.5 * np.quantile(picture[relative < 0.9], 0.75) + 1e-9)


def _beginning(x, brightness, pixel: float) -> tuple[float, float]:
    """Where the brightness rises from a constant, as it was before a Gaussian blurred it, and the
    width of the rise.

    Fitted are a step, the beginning of a smoothstep of some width, or both at one place, and a line
    behind; how wide the Gaussian is, is known to a factor. Both at once have to be better by one
    log likelihood, for they have one number more (Akaike). `pixel`: in x.
    """
    node, weight = np.polynomial.legendre.leggauss(32)
    node = (node + 1) / 2
    weight = 3 * weight * node * (1 - node)  # a smoothstep is as many steps as its slope says

    def blurred(away, blur):
        return 0.5 + 0.5 * special.erf(away / (np.sqrt(2) * blur))

    def parts(v, sharp, soft):
        """Constant, line up or down, and what rises; and how much of each there is."""
        start, width, factor = v
        blur = _BLUR * np.exp(_BLUR_SPREAD * factor) * pixel
        step = blurred(x - start, blur)
        line = step * (x - start)
        basis = [np.ones_like(x), line, -line]
        basis += [step] * sharp
        basis += [blurred(x[:, None] - start - width * node, blur) @ weight] * soft
        basis = np.stack(basis, -1)
        return basis, optimize.nnls(basis, brightness)[0]

    def misfit(v, sharp, soft):
        basis, much = parts(v, sharp, soft)
        # A tenth: neighbouring samples err alike.
        return np.append(np.sqrt(0.1) * (basis @ much - brightness) / noise, v[2])

    def fit(start, sharp, soft):
        found = optimize.least_squares(
            misfit, start, bounds=bounds, x_scale=[0.01, 0.01, 1.0], args=(sharp, soft)
        )
        rises = parts(found.x, sharp, soft)[1][3:]
        share = rises[-1] / (rises.sum() + 1e-30) if soft else 0.0
        return found.cost + (sharp and soft), float(found.x[0]), float(share * found.x[1])

    noise = _MISFIT * (np.quantile(brightness, 0.9) - np.quantile(brightness, 0.1)) + 1e-9
    bounds = ([0.85, 0.01, -3.0], [1.1, 2 * _WIDTHS[-1], 3.0])
    fits = [fit([1.0, 0.05, 0.0], True, False), fit([1.0, 0.05, 0.0], True, True)]
    fits += [fit([1 - width / 2, width, 0.0], False, True) for width in (0.04, 0.1)]
    return min(fits)[1:]


def _darkness(picture, relative, circle: Ellipse) -> float:
    """How much darker it is within a circle than in the iris around, 0 to 1."""
    row, column = np.ogrid[: picture.shape[0], : picture.shape[1]]
    own = circle.relative_radius(column, row)
    within, beside = own < 0.9, (own > 1.1) & (own < 1.6) & (relative < 0.95)
    if not within.any() or not beside.any():
        return 0.0
    inside, outside = np.median(picture[within]), np.median(picture[beside])
    return float(np.clip(1 - inside / (outside + 1e-9), 0, 1))
