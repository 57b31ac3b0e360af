"""From the photograph to the iris's own plane: refraction undone  [F09 Section 4.1].

Where a point of the iris appears is the renderer's to say (`render.points`: Newton on the path
whose entry Fermat's principle picks out). It is a smooth function, so it is asked on a polar grid
and interpolated in between.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage
from scipy.interpolate import RectBivariateSpline

from irisjax.photo.pose import Pose, iris_points, shown
from irisjax.photo.unrefracted import Unrefracted

SIZE = 1024
"""Texels along a side of the texture."""
GRID = 64, 33
"""Angles and radii at which refraction is followed."""


class Refraction(NamedTuple):
    """Where the texels appear in a part of a photograph: column and row, and whether they are
    seen."""

    column: Float[np.ndarray, "size size"]
    row: Float[np.ndarray, "size size"]
    visible: Bool[np.ndarray, "size size"]


def follow(pose: Pose, size: int = SIZE, grid: tuple[int, int] = GRID) -> Refraction:
    """Where the texels of an iris appear in the picture of its camera  [F09 Eqs. 3, 4].

    Refraction is followed on a polar grid of (angles, radii) and interpolated by cubic splines.
    """
    eye = pose.eye
    angles, radii = grid
    reach = float(eye.iris_radius)
    turn = np.linspace(0, 2 * np.pi, angles, endpoint=False)
    # Closer together towards the root, where the cornea is steepest.
    radius = reach * np.sin(np.pi / 2 * np.linspace(0, 1, radii))
    points = iris_points(eye, np.outer(np.cos(turn), radius), np.outer(np.sin(turn), radius))
    seen = shown(eye, pose.camera, points)
    visible = seen.visible
    # Each line from the middle ends where the iris is no longer seen.
    last = np.where(visible, radius, 0).max(1)
    nothing = np.zeros((size, size), bool)
    texture = Unrefracted(np.zeros((size, size, 3), np.float32), nothing, 0.0, reach)
    around, out = texture.angle() % (2 * np.pi), texture.radius()
    pad = 4
    wide = np.concatenate([turn[-pad:] - 2 * np.pi, turn, turn[:pad] + 2 * np.pi])
    where = []
    for values in (seen.column, seen.row):
        held = np.stack(
            [_continued(v, radius, seen) for v, seen in zip(values, visible, strict=True)]
        )
        held = np.concatenate([held[-pad:], held, held[:pad]])
        spline = RectBivariateSpline(wide, radius, held, kx=3, ky=3)
        where.append(spline.ev(around, np.minimum(out, reach)))
    edge = np.interp(around, wide, np.concatenate([last[-pad:], last, last[:pad]]))
    return Refraction(where[0], where[1], out < np.minimum(edge, reach))


def _continued(values, radius, visible):
    """Values along a line from the middle, those out of sight set forth in a straight line."""
    if visible.all():
        return values
    n = int(np.argmin(visible))
    slope = (values[n - 1] - values[n - 2]) / (radius[n - 1] - radius[n - 2])
    beyond = np.arange(len(radius)) >= n
    return np.where(beyond, values[n - 1] + slope * (radius - radius[n - 1]), values)


def unrefract(
    pixels: Float[np.ndarray, "rows columns 3"],
    clear: Bool[np.ndarray, "rows columns"],
    pose: Pose,
    where: Refraction,
) -> Unrefracted:
    """The texture of an iris from the part of a photograph that its camera shows.

    Linear interpolation: the photograph is to be about as fine as the texture. Finer ones are to be
    reduced before, for every pixel shall count.

    Args:
        pixels: Linear, of the size of the camera's picture.
        clear: Pixels that show what lies there: no highlight, no lash, no lid.
        pose: Of `find_pose`.
        where: Of `follow`, which decides the texture's size.
    """
    places = np.stack([where.row, where.column])
    found = np.stack(
        [
            ndimage.map_coordinates(pixels[..., k], places, order=1, mode="nearest")
            for k in range(3)
        ],
        -1,
    ).astype(np.float32)
    rows, columns = clear.shape
    within = (
        (where.row >= 0)
        & (where.row <= rows - 1)
        & (where.column >= 0)
        & (where.column <= columns - 1)
    )
    sure = ndimage.map_coordinates(clear.astype(np.float32), places, order=1, mode="nearest")
    eye = pose.eye
    texture = Unrefracted(found, within, float(eye.pupil_radius), float(eye.iris_radius))
    radius, angle = texture.radius(), texture.angle()
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    off_pupil = np.hypot(x - pose.pupil_centre[0], y - pose.pupil_centre[1]) > texture.pupil_radius
    valid = where.visible & within & off_pupil & (sure > 0.999)
    shown = (where.visible & within)[..., None]
    return texture._replace(pixels=np.where(shown, found, np.float32(0)), valid=valid)
