"""Where the camera stood: from the outlines of limbus and pupil  [F09 Section 4.1, Eqs. 1, 2].

Limbus and pupil are nearly circles that appear as ellipses. How flat both are tells the tilt, by a
joint fit, but not to which side; the pupil, seen through the cornea, moves towards the camera's
side and tells that. A whole photograph's camera is never needed: the one here looks at the middle
of the eye, and its picture is cut out of the photograph, which leaves out only the perspective of
an eye far from the picture's middle.
"""

from typing import Any, NamedTuple, cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Bool, Float

from irisjax.anatomy.eye import Eye
from irisjax.optics.conicoid import joined
from irisjax.photo.ellipse import Ellipse, ellipse_through
from irisjax.photo.tilt import LIMBUS_OVAL, PUPIL_OVAL, tilts_allowed
from irisjax.render.camera import Camera
from irisjax.render.points import project_points
from irisjax.render.surfaces import IrisSurface

_PEOPLE = [0, 2, 2, 0, 0, 4, 5, 12, 19, 23, 36, 44, 52, 41]
_PEOPLE += [39, 37, 43, 30, 28, 12, 15, 10, 4, 1, 0, 2, 0]
LIMBUS_RADII = tuple(
    (d / 2, n)
    for d, n in zip(
        np.linspace(10.5, 13.1, 27).round(1).tolist(),
        _PEOPLE,
        strict=True,
    )
)
"""Radii of the visible iris (mm) and how many of 461 people have them, as collected by
gkaModelEye (MIT).
"""
DECENTRED = 0.27
"""Of the pupil's middle from the limbus's, mm, root mean square in each direction: 0.27 ± 0.09 mm
to the nose and 0.20 ± 0.15 mm upwards  [Wyatt 1995], and a photograph need not say where the nose
is.
"""
SHARP = 0.002
"""Standard deviation of an outline's middle and size in a photograph, of its radius."""
PUPIL_RADII = (0.25, 4.75)
"""Of pupils that may be, mm."""
USUAL_DISTANCE = 300.0
"""Of the camera, mm, where no focal length is known: perspective hardly depends on it."""
_POINTS = 48
_STEEPEST = 1.0  # of a tilt's components, radians


class Pose(NamedTuple):
    """A camera whose picture is a part of the photograph, and the eye that it sees.

    - `camera`: of the part's size; `corner`: column and row of its first pixel in the photograph.
    - `eye`: with the pupil that was seen; `pupil_centre`: of it on the iris, mm, off the axis. The
        model's own pupil is in the middle.
    - `tilt`: between the eye's axis and the camera, radians; `tilt_sd` and `tilt_interval` (95 %):
        of what `tilts_allowed` leaves possible.
    - `distance`: to the limbus, mm, `None` without a focal length.
    - `side`: what told to which side the eye is tilted: `"pupil"` or `"given"`.
    - `residual`: of the limbus's outline, relative to its radius.
    """

    camera: Camera
    corner: tuple[int, int]
    eye: Eye
    pupil_centre: tuple[float, float]
    tilt: float
    tilt_sd: float
    tilt_interval: tuple[float, float]
    distance: float | None
    side: str
    residual: float


def limbus_spread() -> tuple[float, float]:
    """Mean and standard deviation of `LIMBUS_RADII`, mm: of one photograph every length has this
    relative spread.
    """
    radius, count = np.asarray(LIMBUS_RADII).T
    mean = (radius * count).sum() / count.sum()
    return float(mean), float(np.sqrt(((radius - mean) ** 2 * count).sum() / count.sum()))


def find_pose(
    limbus: Ellipse,
    pupil: Ellipse,
    eye: Eye,
    *,
    focal_px: float | None = None,
    margin: float = 1.15,
    azimuth: float | None = None,
) -> Pose:
    """The pose of an eye whose outlines these are.

    Args:
        limbus: Outline of the cornea, in pixels of the photograph.
        pupil: Outline of the pupil as it appears through the cornea.
        eye: Everything but the pupil.
        focal_px: Focal length in pixels; without one the camera is `USUAL_DISTANCE` away and the
            distance is not known.
        margin: Half the side of the part that is cut out, over the limbus's larger semi-axis.
        azimuth: Of the camera as seen from the eye (radians, from the picture's right to its top),
            where it is known to which side the eye is tilted.

    **Raises:** `ValueError` where the pupil does not lie on the iris of such an eye.
    """
    ratio = min(limbus.semi_axes[1] / limbus.semi_axes[0], 1.0)
    radius_mm = float(eye.limbus_radius)
    known = focal_px is not None
    distance = radius_mm * focal_px / limbus.semi_axes[0] if focal_px else USUAL_DISTANCE
    _check_distance(distance)
    tilt = np.arccos(ratio)  # [F09 Eq. 1]
    # A camera's distance is counted from the pupil, the paper's from the limbus before it.
    behind = (float(eye.iris_depth) - float(_limbus_height(eye))) * ratio
    # The camera's azimuth is that of the smaller axis, to one side or the other.
    across = limbus.angle + np.pi / 2
    sides = [across, across + np.pi]
    if azimuth is not None:
        sides = [min(sides, key=lambda a: abs(np.angle(np.exp(1j * (a - azimuth)))))]
    pixels_per_mm = limbus.semi_axes[0] / radius_mm  # [F09 Eq. 2]
    x, y = limbus.centre

    def parts(v):
        return {"polar": np.hypot(*v[:2]), "azimuth": np.arctan2(v[1], v[0])}

    def residuals(v):
        open_ = eye.replace(pupil_radius=jnp.asarray(np.clip(v[5], *PUPIL_RADII), float))
        rim, hole = (np.asarray(p) for p in _outlines(open_, _square(parts(v), distance + behind)))
        scale = np.exp(v[4]) * pixels_per_mm
        edge, inner = (ellipse_through(v[2:4] + scale * p) for p in (rim, hole))
        larger = [
            np.log(np.prod(own.semi_axes) / np.prod(seen.semi_axes)) / (2 * SHARP)
            for own, seen in ((edge, limbus), (inner, pupil))
        ]
        middle = (np.array(edge.centre) - limbus.centre) / (SHARP * limbus.semi_axes[0])
        aside = (np.array(inner.centre) - pupil.centre) / (scale * DECENTRED)
        flatter = (
            (edge.flattening - limbus.flattening) / LIMBUS_OVAL,
            (inner.flattening - pupil.flattening) / PUPIL_OVAL,
        )
        return np.concatenate([*flatter, middle, larger, aside * (azimuth is None)])

    # The cornea magnifies the pupil by about 1.13.
    opening = np.clip(pupil.semi_axes[0] / pixels_per_mm / 1.13, *PUPIL_RADII)
    start = min(max(tilt, 0.05), 0.9 * _STEEPEST)
    found = min(
        (
            scipy.optimize.least_squares(
                residuals,
                [start * np.cos(a), start * np.sin(a), x, y, 0.0, opening],
                x_scale=[0.1, 0.1, 1.0, 1.0, 0.01, 0.1],
                diff_step=1e-5,
                bounds=([-_STEEPEST] * 2 + [-np.inf] * 4, [_STEEPEST] * 2 + [np.inf] * 4),
            )
            for a in sides
        ),
        key=lambda f: f.cost,
    )
    v, tilt = found.x, float(np.hypot(*found.x[:2]))
    tilt_sd, interval = tilts_allowed(tilt)
    scale = float(np.exp(v[4]) * pixels_per_mm)
    rim = np.asarray(_outlines(eye, _square(parts(v), distance + behind))[0])
    off = limbus.relative_radius(*(v[2:4] + scale * rim).T) - 1
    half = int(np.ceil(margin * limbus.semi_axes[0]))
    # Whole pixels: the middle of the camera's picture lies within half of one of the eye's.
    corner = int(np.round(v[2])) - half, int(np.round(v[3])) - half
    size = 2 * half + 1
    camera = Camera(
        distance=cast(Any, distance + behind),
        width=cast(Any, size / scale),
        size=(size, size),
        **parts(v),
    )
    moved = pupil._replace(
        centre=(pupil.centre[0] - (v[2] - half), pupil.centre[1] - (v[3] - half))
    )
    centre, radius = _pupil_on_iris(eye, camera, moved)
    return Pose(
        camera,
        corner,
        eye.replace(pupil_radius=radius),
        centre,
        tilt,
        tilt_sd,
        interval,
        distance if known else None,
        "pupil" if azimuth is None else "given",
        float(np.sqrt((off**2).mean())),
    )


def _check_distance(distance: float) -> None:
    if not 30 <= distance <= 1e5:
        raise ValueError(
            f"the focal length puts the camera {distance:g} mm from the eye; from 30 mm to 100 m "
            "are possible"
        )


def _square(parts, distance: float) -> Camera:
    """A camera one of whose pixels is one millimetre, the eye's middle in its corner."""
    return Camera(distance=cast(Any, distance), width=cast(Any, 2.0), size=(2, 2), **parts)


@eqx.filter_jit
def _outlines(eye: Eye, camera: Camera):
    """Limbus and pupil in mm at the eye, columns and rows from the middle of the pupil."""
    turn = jnp.linspace(0.0, 2 * jnp.pi, _POINTS, endpoint=False)
    circle = jnp.cos(turn), jnp.sin(turn)
    r = eye.limbus_radius
    height = jnp.zeros_like(turn) + _limbus_height(eye)
    rim = camera.pixel(joined((r * circle[0], r * circle[1], height)), eye)
    some = turn[:: _POINTS // 16]
    r = eye.pupil_radius
    slope = 0.0 if eye.iris_slope is None else eye.iris_slope
    height = jnp.zeros_like(some) + eye.iris_depth + slope * r
    points = joined((r * jnp.cos(some), r * jnp.sin(some), height))
    hole = project_points(IrisSurface(eye), camera, points)
    # The middle of a picture of two pixels lies between them.
    return (
        jnp.stack(rim, -1) - 0.5,
        jnp.stack([hole.column, hole.row], -1) - 0.5,
    )


def _limbus_height(eye: Eye):
    """Of the limbus behind the corneal apex, mm."""
    if eye.cornea is None:
        return eye.iris_depth
    return eye.cornea.anterior.sagitta(eye.limbus_radius)


def iris_points(eye: Eye, x, y) -> Float[np.ndarray, "*s 3"]:
    """Points of the iris above places x, y (mm)."""
    slope = 0.0 if eye.iris_slope is None else float(eye.iris_slope)
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    return np.stack([x, y, float(eye.iris_depth) + slope * np.hypot(x, y)], -1)


def _pupil_on_iris(eye: Eye, camera: Camera, pupil: Ellipse):
    """Centre and radius (mm) of the circle on the iris whose picture is an outline."""
    # As many as `refraction.follow` asks for: one program for both.
    turn = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    # The outline may not go round the axis: it is met along rays from its own middle.
    radius = np.linspace(0.1, 0.95 * float(eye.iris_radius), 33)
    centre, towards = np.zeros(2), (np.cos(turn), np.sin(turn))
    for _ in range(2):
        x, y = (c + np.outer(d, radius) for c, d in zip(centre, towards, strict=True))
        seen = shown(eye, camera, iris_points(eye, x, y))
        place = pupil.relative_radius(seen.column, seen.row)
        place = np.where(seen.visible, place, np.inf)
        if not ((place[:, 0] < 1) & (place[:, -1] > 1)).all():
            raise ValueError(
                "the pupil's outline is not within the iris of such an eye; check both outlines"
            )
        met = [np.interp(1.0, np.maximum.accumulate(p), radius) for p in place]
        edge = centre + np.stack([met * np.cos(turn), met * np.sin(turn)], -1)
        system = np.column_stack([2 * edge, np.ones(len(edge))])
        solved = np.linalg.lstsq(system, (edge**2).sum(1), rcond=None)[0]
        centre = solved[:2]
    found = float(np.sqrt(solved[2] + centre @ centre))
    low, high = PUPIL_RADII[0], min(PUPIL_RADII[1], float(eye.iris_radius) - 0.3)
    if not low < found < high:
        raise ValueError(
            f"the outlines make the pupil's radius {found:.2f} mm; it must be within "
            f"{low:g} to {high:g} mm"
        )
    return (float(centre[0]), float(centre[1])), found


class Shown(NamedTuple):
    """Where points appear in a camera's picture: column and row, and whether they are seen."""

    column: Float[np.ndarray, "*s"]
    row: Float[np.ndarray, "*s"]
    visible: Bool[np.ndarray, "*s"]


def shown(eye: Eye, camera: Camera, points: Float[np.ndarray, "*s 3"]) -> Shown:
    """Where points of the iris (mm) appear in a camera, as `project_points` finds it."""
    # A camera of one size for all photographs, whose sizes would each compile a program.
    same = Camera(camera.polar, camera.azimuth, camera.distance, cast(Any, 2.0), (2, 2))
    found = _seen(eye, same, jnp.asarray(points))
    (columns, rows), pitch = camera.size, float(camera.width) / camera.size[0]
    return Shown(
        (np.asarray(found.column) - 0.5) / pitch + columns / 2 - 0.5,
        (np.asarray(found.row) - 0.5) / pitch + rows / 2 - 0.5,
        np.asarray(found.visible),
    )


@eqx.filter_jit
def _seen(eye: Eye, camera: Camera, points):
    return project_points(IrisSurface(eye), camera, points)
