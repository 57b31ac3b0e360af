"""`find_boundaries`: limbus and pupil of the eye in a photograph, and how sure they are."""

from typing import NamedTuple

import numpy as np

from irisjax.photo.edges import ray_angles, reduced
from irisjax.photo.ellipse import Ellipse
from irisjax.photo.limbus import limbus_near, width_of
from irisjax.photo.photograph import Photograph
from irisjax.photo.pupil import PUPIL_SHARE, Pupil, beginning_of, pupil_within
from irisjax.photo.rings import Ring, rings

MIN_CONFIDENCE = 0.4
"""Below this an outline is more likely wrong than right."""
_LONG = 800  # px along the long side of the copy in which eyes are searched
_LEAST = 40  # of the long side: the smallest iris' radius
_CANDIDATES = 6
_SURE = 0.8  # worth of a pair of outlines, at most 1.3, from which on no other is searched
_WIDE = 0.68  # of the limbus: pupils above are doubted
_TRUSTED = 0.5  # support of a pupil that may tell of the limbus


class Boundaries(NamedTuple):
    """Outlines of limbus and pupil in pixels of the photograph.

    `limbus_confidence`, `pupil_confidence`: 0 to 1, from the share of each outline that edges
    support, how near to it they lie and how strong they are; 1 for an outline that was given. Below
    `MIN_CONFIDENCE` the outline is not to be trusted. `pupil_margin`: see `Pupil.margin`;
    `limbus_width`: over which iris and white blend, of the limbus's radius; `None`: not known.
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
    """The outlines of the eye in a photograph; those given are taken as they are.

    The limbus is the middle of the soft rise from iris to white. Irides of a fortieth of the
    picture's long side up to about half of its short side are found, tilted by up to 30 degrees; of
    two eyes the one whose outlines are better supported, or the first that is beyond doubt. A
    picture without an eye gives outlines of low confidence.

    **Raises:** `ValueError` where nothing resembles an iris, or an outline given lies elsewhere.
    """
    for name, given in (("limbus", limbus), ("pupil", pupil)):
        if given is not None and not _within(given, photo.shape):
            rows, columns = photo.shape
            raise ValueError(
                f"{photo.name}: the middle of the {name} given, {given.centre}, is outside the "
                f"picture of {columns} x {rows} pixels"
            )
    if limbus is not None and pupil is not None:
        return _with_widths(photo, Boundaries(limbus, pupil, 1.0, 1.0))
    if limbus is None:
        outline, inner = _searched(photo, pupil)
        outline, held = limbus_near(photo, outline, inner, coarse=False)
    else:
        outline, held = limbus, None
    if pupil is not None:
        return _with_widths(photo, _judged(photo, outline, pupil, held, None))
    inner, support, margin = pupil_within(photo, outline, coarse=False)
    if limbus is None and support > _TRUSTED:
        outline, held = limbus_near(photo, outline, inner, coarse=False)
    return _with_widths(photo, _judged(photo, outline, inner, held, support), margin)


def _with_widths(photo: Photograph, found: Boundaries, margin: float | None = None) -> Boundaries:
    """With how soft both edges are; `margin`: of a pupil that was found."""
    if margin is None:
        margin = beginning_of(photo, found.limbus, Pupil(found.pupil, 1.0)).margin
    return found._replace(pupil_margin=margin, limbus_width=width_of(photo, found.limbus))


def _searched(photo: Photograph, pupil: Ellipse | None) -> tuple[Ellipse, Ellipse | None]:
    """The best limbus found in a reduced copy, and its pupil where that can be relied upon."""
    scale = min(1.0, _LONG / max(photo.shape))
    small = photo
    if scale < 1:
        cut_off = reduced(photo.saturated[..., None].astype(float), scale)[..., 0] > 0.1
        small = photo._replace(pixels=reduced(photo.pixels, scale), saturated=cut_off)
    known = None if pupil is None else pupil.scaled(scale)
    best, found = -1.0, None
    seen: list[Ellipse] = []
    for start in _starts(small.pixels.mean(-1), known):
        outline, held = limbus_near(small, start, known)
        # From several starts the way may lead to one outline.
        if not _within(outline, small.shape) or any(_same(outline, other) for other in seen):
            continue
        seen.append(outline)
        inner, support, _ = pupil_within(small, outline) if known is None else Pupil(known, 1.0)
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
    photo: Photograph,
    limbus: Ellipse,
    pupil: Ellipse,
    limbus_support: float | None,
    pupil_support: float | None,
) -> Boundaries:
    """Confidences from the shares of the outlines that edges support; `None` for a given one.

    In pictures without an eye chance edges support up to 0.8 of a dark disc's outline and 0.35 of
    others, tiny ones most, but hardly 0.3 of a pupil's within; of simulated and real irides lids
    and lashes leave 0.4 of the limbus and half of the pupil.
    """
    likely = _plausible(limbus, pupil)
    for outline in (limbus, pupil):  # half an eye is none
        likely *= float(np.clip((_shown(outline, photo.shape) - 0.5) / 0.15, 0, 1))
    limbus_sure = pupil_sure = 1.0
    if limbus_support is not None:
        limbus_sure = likely * min(limbus_support / 0.75, 1.0) * min(1.0, limbus.semi_axes[1] / 30)
        if pupil_support is not None:
            limbus_sure *= float(np.clip((pupil_support - 0.2) / 0.2, 0, 1))
    if pupil_support is not None:
        pupil_sure = likely * float(np.clip((pupil_support - 0.2) / 0.5, 0, 1))
        pupil_sure *= min(1.0, limbus_sure / MIN_CONFIDENCE)
    return Boundaries(limbus, pupil, float(limbus_sure), float(pupil_sure))


def _starts(brightness, pupil: Ellipse | None) -> list[Ellipse]:
    """Circles near which a limbus may lie, best first."""
    shape = brightness.shape
    least = max(max(shape) / _LEAST, 8.0)
    found = rings(brightness, (0.4 * least, 0.58 * min(shape)), 8, sideways=0.6)

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
    circles = [r.circle() for r in sorted(limbi, key=worth, reverse=True)]
    if pupil is not None:
        circles = [c for c in circles if _plausible(c, pupil) > 0.5]
    inside = [c for c in circles if _within(c, shape)]
    return inside[:_CANDIDATES]


def _same(a: Ellipse, b: Ellipse) -> bool:
    """Whether two outlines are one, within a hundredth of the radius."""
    off = np.hypot(*np.subtract(a.centre, b.centre))
    return bool(max(off, *abs(np.subtract(a.semi_axes, b.semi_axes))) < 0.01 * a.semi_axes[0])


def _within(outline: Ellipse, shape) -> bool:
    """Whether the middle lies in the picture."""
    return all(-0.5 < v < n - 0.5 for v, n in zip(outline.centre, shape[::-1], strict=True))


def _shown(outline: Ellipse, shape) -> float:
    """The share of an outline that lies in the picture."""
    column, row = outline.points(ray_angles()).T
    inside = (abs(column + 0.5 - shape[1] / 2) < shape[1] / 2) & (
        abs(row + 0.5 - shape[0] / 2) < shape[0] / 2
    )
    return float(inside.mean())


def _plausible(limbus: Ellipse, pupil: Ellipse) -> float:
    """1 for a pair that an eye may have, less the odder it is."""
    size = pupil.semi_axes[0] / limbus.semi_axes[0]
    off = float(limbus.relative_radius(*pupil.centre))
    low, high = PUPIL_SHARE
    odd = max(low - size, 0) / 0.05 + max(size - high, 0) / 0.05
    # Of pupils that leave a narrow ring the white's edge is taken for the iris's: 3 to 12 % off.
    odd += max(size - _WIDE, 0) / 0.1
    odd += max(off - 0.15, 0) / 0.1
    odd += sum(max(0.82 - e.semi_axes[1] / e.semi_axes[0], 0) / 0.04 for e in (limbus, pupil))
    return float(np.exp(-odd))
