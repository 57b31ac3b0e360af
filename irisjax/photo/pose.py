"""The camera's pose, from the outlines of limbus and pupil  [F09 Section 4.1, Eqs. 1, 2]."""

import functools
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Float
from numpy.typing import ArrayLike

from irisjax.anatomy.eye import Eye, slope_of
from irisjax.anatomy.sclera import limbus_depth
from irisjax.optics.conicoid import from_parts
from irisjax.photo.photograph import Ellipse, ellipse_through
from irisjax.render.camera import Camera
from irisjax.render.points import project_points
from irisjax.render.surfaces import IrisSurface

LIMBUS_FLAT = 0.03
"""Mean of the horizontal component of the flattening ln(a / b) of limbi seen from straight ahead:
nine of ten well outlined frontal photographs are wider than high, by 2 to 8 %.
"""
LIMBUS_OVAL = 0.03
"""Standard deviation of either component of the flattening ln(a / b) of people's limbi seen from
straight ahead; assumed. Textbooks' 11.7 by 10.6 mm would be 0.1, but rest on no measurement
[Bergmanson & Martinez 2017].
"""
PUPIL_OVAL = 0.025
"""The same for pupils: they deviate from a circle by 0.0166 of their radius, about half of which an
ellipse explains  [Wyatt 1995].
"""
FLATTENING_RATIO = 1.25
"""Flattening of a tilted limbus over that of the pupil, which the cornea shows turned towards the
camera.
"""
_PEOPLE = [0, 2, 2, 0, 0, 4, 5, 12, 19, 23, 36, 44, 52, 41]
_PEOPLE += [39, 37, 43, 30, 28, 12, 15, 10, 4, 1, 0, 2, 0]
_DIAMETERS = np.linspace(10.5, 13.1, len(_PEOPLE)).round(1).tolist()
LIMBUS_RADII = tuple((d / 2, n) for d, n in zip(_DIAMETERS, _PEOPLE, strict=True))
"""Radii of the visible iris (mm) and how many of 461 people have them, as collected by gkaModelEye
(MIT).
"""
DECENTRED = 0.27
"""Distance of the pupil's middle from the limbus's, mm, root mean square in each direction: 0.27 ±
0.09 mm to the nose and 0.20 ± 0.15 mm upwards  [Wyatt 1995]; a photograph need not say where the
nose is.
"""
PUPIL_SHIFT = 0.12
"""Shift of the pupil's image towards the camera over sin(tilt), relative to the limbus's radius."""
_UPWARD = 0.2  # height of the pupil's middle above the limbus's, mm  [Wyatt 1995]
# Standard deviations (degrees) of the tilts of eyes that look at the camera and of others, and the
# share of the others; assumed.
_FRONTAL_TILT, _ASIDE_TILT, _ASIDE = 8.0, 35.0, 0.8
_STRETCHED, _STRETCH = 0.1, 0.12  # share of files that are, and the logarithm's spread; assumed
_RELEVANT_STRETCH = 0.06  # logarithm of a stretch that matters
_OUTLINE_SD = 0.002  # standard deviation of an outline's middle and size, relative to its radius
_PUPIL_RADII = (0.25, 4.75)  # allowed pupil radii, in mm
_USUAL_DISTANCE = 300.0  # mm, without a focal length: perspective hardly depends on it
_POINTS = 48
_STEEPEST = 1.0  # of a tilt's components, radians
_MARGIN = 1.15  # half the side of the part that is cut out, over the limbus's larger semi-axis
_STEP = 1e-5  # of finite differences
_MAX_STEPS = 60  # of the fit; it takes 5 to 30 for outlines that an eye may have


class Pose(NamedTuple):
    """A camera whose picture is a part of the photograph, and the eye that it sees.

    Attributes:
        camera: The camera, whose picture has the size of the part.
        corner: Column and row of the part's first pixel in the photograph.
        eye: The eye with its pupil; a clone's begins to fade within it where the photograph is
            blurred.
        pupil_centre: Observed centre of the pupil on the iris, mm from the axis.
        pupil_radius: Observed radius of the pupil on the iris, mm.
        tilt: Angle between the eye's axis and the camera, radians.
        tilt_sd: Standard deviation of the tilt, see `tilts_of_people`.
        tilt_interval: Interval that holds 95 % of the tilts.
        distance: Distance to the limbus, mm; `None` without a focal length.
        side: What determines to which side the eye is tilted, `"pupil"` or `"given"`.
        stretched: Probability that the file is stretched and the eye is not tilted by that much.
    """

    camera: Camera
    corner: tuple[int, int]
    eye: Eye
    pupil_centre: tuple[float, float]
    pupil_radius: float
    tilt: float
    tilt_sd: float
    tilt_interval: tuple[float, float]
    distance: float | None
    side: str
    stretched: float = 0.0


def limbus_spread() -> tuple[float, float]:
    """Return mean and standard deviation of `LIMBUS_RADII`, mm; every length from one photograph
    has this relative spread.
    """
    radius, count = np.asarray(LIMBUS_RADII).T
    radii = np.repeat(radius, count.astype(int))
    return float(radii.mean()), float(radii.std())


def find_pose(
    limbus: Ellipse,
    pupil: Ellipse,
    eye: Eye,
    *,
    focal_px: float | None = None,
    azimuth: float | None = None,
    flattening_sd: tuple[float, float] = (0.0, 0.0),
) -> Pose:
    """Find the pose of an eye from its outlines  [F09 Eqs. 1, 2].

    Limbus and pupil are nearly circles that appear as ellipses. A joint fit of their flattening
    gives the tilt, but not its side. The pupil, seen through the cornea, moves towards the camera's
    side, which gives that. The camera looks at the middle of the eye and its picture is cut out of
    the photograph, which neglects only the perspective of an eye far from the picture's middle.

    Args:
        limbus: Outline of the cornea, in pixels of the photograph.
        pupil: Outline of the pupil as it appears through the cornea.
        eye: The eye apart from its pupil.
        focal_px: Focal length in pixels; without one the camera is 300 mm away.
        azimuth: Azimuth of the camera as seen from the eye (radians, from the picture's right to
            its top), if the side of the tilt is known.
        flattening_sd: Standard deviations of the components of the flattening of limbus and pupil,
            by which measured outlines err. Limbi are expected to be flat by `LIMBUS_FLAT`, tilts to
            be as usual in photographs, and the interval allows for files that are stretched.
    """
    # The eye that is drawn has a round limbus: half of what people have, in the middle.
    mean_flattening = np.array([0.5 * LIMBUS_FLAT, 0.0])
    spread = np.hypot([LIMBUS_OVAL, PUPIL_OVAL], flattening_sd)
    ratio = min(limbus.semi_axes[1] / limbus.semi_axes[0], 1.0)
    radius_mm = float(eye.limbus_radius)
    distance = radius_mm * focal_px / limbus.semi_axes[0] if focal_px else _USUAL_DISTANCE
    if not 30 <= distance <= 1e5:
        raise ValueError(
            f"the focal length puts the camera {distance:g} mm from the eye; from 30 mm to 100 m "
            "are possible"
        )
    tilt = np.arccos(ratio)  # [F09 Eq. 1]
    # A camera's distance is measured from the pupil, the paper's from the limbus in front of it.
    depth_offset = (float(eye.iris_depth) - float(limbus_depth(eye))) * ratio
    # The camera's azimuth is that of the smaller axis, to one side or the other.
    across = limbus.angle + np.pi / 2
    sides = [across, across + np.pi]
    if azimuth is not None:
        sides = [min(sides, key=lambda a: abs(np.angle(np.exp(1j * (a - azimuth)))))]
    pixels_per_mm = limbus.semi_axes[0] / radius_mm  # [F09 Eq. 2]

    def camera_at(v, width, size) -> Camera:
        numbers: Any = np.hypot(*v[:2]), np.arctan2(v[1], v[0]), distance + depth_offset, width
        return Camera(*numbers, size=size)

    def limbus_middle(v):
        """Middle of the limbus's flat picture, from its observed one in its radii."""
        return np.array(limbus.centre) + limbus.semi_axes[0] * v[2:4]

    def residuals(v, rim, hole):
        scale = np.exp(v[4]) * pixels_per_mm
        edge, inner = (ellipse_through(limbus_middle(v) + scale * p) for p in (rim, hole))
        flatter = (
            (edge.flattening + mean_flattening - limbus.flattening) / spread[0],
            (inner.flattening - pupil.flattening) / spread[1],
        )
        pairs = (edge, limbus), (inner, pupil)
        sizes = [np.prod(own.semi_axes) / np.prod(seen.semi_axes) for own, seen in pairs]
        middle = (np.array(edge.centre) - limbus.centre) / (_OUTLINE_SD * limbus.semi_axes[0])
        aside = (np.array(inner.centre) - pupil.centre) / (scale * DECENTRED)
        larger = np.log(sizes) / (2 * _OUTLINE_SD)
        # Two rows for the one cost of the tilt: its root alone has a kink straight ahead.
        size = max(np.hypot(*v[:2]), 1e-4)
        usual = np.sqrt(2 * _tilt_cost(size)) / size * v[:2]
        return np.concatenate([*flatter, middle, larger, aside * (azimuth is None), usual])

    front = camera_at(np.zeros(2), 2.0, (2, 2))  # with pixels of one millimetre

    @functools.cache
    def residual_rows(*near_one):
        """Residuals there and a step aside in each number, all by one call of the renderer."""
        steps = np.array(near_one) * (1 + _STEP * np.eye(7, 6, -1))
        shown = map(np.asarray, _project_outlines(eye, front, jnp.asarray(steps - 1, float)))
        return [residuals(*row) for row in zip(steps - 1, *shown, strict=True)]

    def slopes(near_one):
        base, *aside = residual_rows(*near_one)
        return np.stack([shifted - base for shifted in aside], -1) / (_STEP * near_one)

    # The cornea magnifies the pupil by about 1.13.
    opening = np.clip(pupil.semi_axes[0] / pixels_per_mm / 1.13, *_PUPIL_RADII)
    start = min(max(tilt, 0.05), 0.9 * _STEEPEST)
    limit = np.array([_STEEPEST] * 2 + [np.inf] * 4)
    solve: Any = scipy.optimize.least_squares  # its annotations know no function for the Jacobian

    def fit(a):
        # The numbers searched for are near one: finite differences are taken relative to them.
        return solve(
            lambda near_one: residual_rows(*near_one)[0],
            1 + np.array([start * np.cos(a), start * np.sin(a), 0.0, 0.0, 0.0, opening]),
            slopes,
            x_scale=[0.1, 0.1, 0.01, 0.01, 0.01, 0.1],
            bounds=(1 - limit, 1 + limit),
            ftol=1e-6,  # a millionth of a log likelihood
            max_nfev=_MAX_STEPS,
        )

    optimum = min(map(fit, sides), key=lambda f: f.cost)
    if optimum.status == 0:
        raise ValueError(
            f"no camera was found in {_MAX_STEPS} steps that sees an eye with these outlines of "
            "limbus and pupil; check them"
        )
    v = optimum.x - 1
    (x, y), tilt = limbus_middle(v), float(np.hypot(*v[:2]))
    scale = float(np.exp(v[4]) * pixels_per_mm)
    half = int(np.ceil(_MARGIN * limbus.semi_axes[0]))
    # Whole pixels: the middle of the camera's picture lies within half of one of the eye's.
    corner = int(np.round(x)) - half, int(np.round(y)) - half
    size = 2 * half + 1
    camera = camera_at(v, size / scale, (size, size))
    centre, radius = _pupil_on_iris(eye, camera, pupil.moved(half - x, half - y))
    stated_distance = None if focal_px is None else distance
    side = "pupil" if azimuth is None else "given"
    eye = eye.replace(pupil_radius=radius, pupil_centre=jnp.asarray(centre))
    sd, interval, stretched = tilts_of_people(limbus, pupil, spread, azimuth)
    interval = min(interval[0], tilt), max(interval[1], tilt)
    observed = camera, corner, eye, centre, float(radius)
    return Pose(*observed, tilt, sd, interval, stated_distance, side, stretched)


def iris_points(eye: Eye, x: ArrayLike, y: ArrayLike) -> Float[np.ndarray, "*s 3"]:
    """Return points of the iris above places x, y (mm)."""
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    return np.stack([x, y, float(eye.iris_depth) + float(slope_of(eye)) * np.hypot(x, y)], -1)


def project_iris_points(
    eye: Eye, camera: Camera, points: Float[np.ndarray, "*s 3"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the columns and rows in which points of the iris (mm) appear, and whether they do."""
    # A camera of one size for all photographs, so that one compiled program serves them all.
    place = camera.polar, camera.azimuth, camera.distance
    camera_of_one_size = Camera(*place, cast(Any, 2.0), (2, 2))
    projected = _project(eye.replace(pupil_centre=None), camera_of_one_size, jnp.asarray(points))
    (columns, rows), pitch = camera.size, float(camera.width) / camera.size[0]
    column = (np.asarray(projected.column) - 0.5) / pitch + columns / 2 - 0.5
    row = (np.asarray(projected.row) - 0.5) / pitch + rows / 2 - 0.5
    return column, row, np.asarray(projected.visible)


def tilts_of_people(
    limbus: Ellipse, pupil: Ellipse, spread: Float[np.ndarray, "2"], azimuth: float | None = None
) -> tuple[float, tuple[float, float], float]:
    """Return the standard deviation and the 95 % interval (radians) of the tilts that outlines in a
    photograph are compatible with, and the probability that its file is stretched.

    The posterior is computed on a grid of tilts, azimuths and stretches. `spread` has the standard
    deviations of the components of the flattening of limbus and pupil, people's and the outlines'.
    """
    tilt = np.radians(np.linspace(0, 50, 201))
    azimuths = np.radians(np.arange(0, 360, 5)) if azimuth is None else np.array([azimuth])
    stretch = np.append(0.0, np.linspace(-0.3, 0.3, 60))
    prior = np.exp(-0.5 * (stretch / _STRETCH) ** 2)
    prior *= np.where(stretch == 0, 0, _STRETCHED) / prior[1:].sum()
    prior[0] = 1 - _STRETCHED
    t, a, s = tilt[:, None, None], azimuths[None, :, None], stretch
    flattening, wide = -np.log(np.cos(t)) * np.exp(2j * (a + np.pi / 2)), s + 0j
    observed = [complex(*outline.flattening) for outline in (limbus, pupil)]
    misfit = abs(flattening + LIMBUS_FLAT + wide - observed[0]) ** 2 / spread[0] ** 2
    misfit = misfit + abs(flattening / FLATTENING_RATIO + wide - observed[1]) ** 2 / spread[1] ** 2
    right, down = np.subtract(pupil.centre, limbus.centre) / limbus.mean_radius
    millimetre = 1 / limbus_spread()[0]
    shift = PUPIL_SHIFT * np.sin(t) * np.exp(1j * a) + 1j * _UPWARD * millimetre
    misfit = misfit + (abs(shift - complex(right, -down)) / (DECENTRED * millimetre)) ** 2
    posterior = np.sin(t) * np.exp(-_tilt_cost(t) - 0.5 * (misfit - misfit.min())) * prior
    posterior /= posterior.sum()
    of_tilt = posterior.sum((1, 2))
    mean = of_tilt @ tilt
    below = np.concatenate([[0.0], np.cumsum(of_tilt)])[:-1]
    low = tilt[below <= 0.05]
    high = np.interp(below[: low.size] + 0.95, np.cumsum(of_tilt), tilt)
    k = int(np.argmax(np.log(np.cos(high) / np.cos(low))))  # the shortest in the flattening
    sd = np.sqrt(of_tilt @ (tilt - mean) ** 2)
    interval = float(tilt[max(k - 1, 0)]), float(high[k])
    stretched = posterior[..., abs(stretch) > _RELEVANT_STRETCH].sum()
    return float(sd), interval, float(stretched)


def _tilt_cost(tilt):
    """Negative logarithm of the density of tilts in photographs over that of a frontal eye."""
    degrees = np.degrees(tilt)
    parts = (1 - _ASIDE, _FRONTAL_TILT), (_ASIDE, _ASIDE_TILT)
    density = sum(p / sd**2 * np.exp(-0.5 * (degrees / sd) ** 2) for p, sd in parts)
    return -np.log(density / sum(p / sd**2 for p, sd in parts))


@eqx.filter_jit
def _project_outlines(eye: Eye, front: Camera, v):
    """Columns and rows (mm) of limbus and pupil for rows v of what `find_pose` searches for."""
    turn = jnp.linspace(0.0, 2 * jnp.pi, _POINTS, endpoint=False)
    circle = jnp.stack([jnp.cos(turn), jnp.sin(turn)])

    def raised(points, depth):
        return from_parts((*points, jnp.full_like(points[0], depth)))

    def one(v):
        place = jnp.hypot(v[0], v[1]), jnp.arctan2(v[1], v[0])
        camera = eqx.tree_at(lambda c: (c.polar, c.azimuth), front, place)
        r = jnp.clip(v[5], *_PUPIL_RADII)
        open_ = eqx.tree_at(lambda e: e.pupil_radius, eye, r)  # not checked
        rim = camera.pixel(raised(eye.limbus_radius * circle, limbus_depth(eye)), open_)
        points = raised(r * circle[:, :: _POINTS // 16], eye.iris_depth + slope_of(eye) * r)
        hole = project_points(IrisSurface(open_), camera, points)
        # The middle of a picture of two pixels lies between them.
        return jnp.stack(rim, -1) - 0.5, jnp.stack([hole.column, hole.row], -1) - 0.5

    return jax.vmap(one)(v)


def _pupil_on_iris(eye: Eye, camera: Camera, pupil: Ellipse):
    """Centre and radius (mm) of the circle on the iris whose picture is an outline."""
    # As many points as `follow_refraction` has, so that one compiled program serves both.
    turn = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    # The outline need not enclose the axis: it is intersected by rays from its own middle.
    radius = np.linspace(0.1, 0.95 * float(eye.iris_radius), 33)
    solved, towards = np.zeros(3), (np.cos(turn), np.sin(turn))
    for _ in range(2):
        centre = solved[:2]
        x, y = (c + np.outer(d, radius) for c, d in zip(centre, towards, strict=True))
        column, row, visible = project_iris_points(eye, camera, iris_points(eye, x, y))
        place = np.where(visible, pupil.relative_radius(column, row), np.inf)
        if not ((place[:, 0] < 1) & (place[:, -1] > 1)).all():
            raise ValueError(
                "the pupil's outline is not within the iris of such an eye; check both outlines"
            )
        met = [np.interp(1.0, np.maximum.accumulate(p), radius) for p in place]
        edge = centre + np.stack([met * np.cos(turn), met * np.sin(turn)], -1)
        system = np.column_stack([2 * edge, np.ones(len(edge))])
        solved = np.linalg.lstsq(system, (edge**2).sum(1), rcond=None)[0]
    found = float(np.sqrt(solved[2] + solved[:2] @ solved[:2]))
    low, high = _PUPIL_RADII[0], min(_PUPIL_RADII[1], float(eye.iris_radius) - 0.3)
    if not low < found < high:
        raise ValueError(
            f"the outlines make the pupil's radius {found:.2f} mm; it must be within "
            f"{low:g} to {high:g} mm"
        )
    return (solved[0], solved[1]), found


@eqx.filter_jit
def _project(eye: Eye, camera: Camera, points):
    return project_points(IrisSurface(eye), camera, points)
