"""Texel to pixel: where points of the eye appear in a camera.

`project` goes the other way, from pixels to points. A point of the iris appears where its light
leaves the cornea, which Newton's method finds; Fermat's principle has the same solution.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from irisjax.anatomy.eye import Eye, cornea_of
from irisjax.optics.conicoid import Vector, dot, norm
from irisjax.render.camera import Camera
from irisjax.render.refraction import cornea_point, newton_step, refract_to_iris, search_radius
from irisjax.render.surfaces import AbstractSurface, CorneaSurface, GlobeSurface, IrisSurface

_TOLERANCE = 1e-3  # mm by which a line of sight may miss its target
_STEPS = 8  # polar angles from straight ahead to the camera's, at which the search is continued


class Pixels(NamedTuple):
    """Places at which points appear in a camera's picture.

    Attributes:
        column: Columns, whole numbers in the middles of pixels; they may lie outside the picture.
        row: Rows, likewise.
        visible: Whether the camera sees the points.
    """

    column: Float[Array, "*s"]
    row: Float[Array, "*s"]
    visible: Bool[Array, "*s"]


def project_points(surface: AbstractSurface, camera: Camera, point: Vector) -> Pixels:
    """Project points (…, 3) of a surface, mm in the eye's frame, to a camera's pixels.

    The iris is seen through the cornea, if there is one. Pure: works under `jit`, `vmap` and
    `grad`.
    """
    eye = surface.eye
    shape, flat = point.shape[:-1], point.reshape(-1, 3)
    if isinstance(surface, IrisSurface) and eye.cornea is not None:
        apparent, visible = jax.vmap(lambda p: _through_cornea(eye, camera, p))(flat)
    else:
        apparent, visible = flat, _is_visible(surface, camera, flat)
    column, row = camera.pixel(apparent, eye)
    return Pixels(column.reshape(shape), row.reshape(shape), visible.reshape(shape))


def _view_directions(camera: Camera, eye: Eye, point: Vector, share=1.0) -> Vector:
    """Return unit vectors to points from a camera at a `share` of its polar angle."""
    offset = point - camera.position(eye, share)
    return offset / norm(offset)[..., None]


def _through_cornea(eye: Eye, camera: Camera, target: Float[Array, "3"]):
    """Find the point of the cornea at which a point of the iris appears, and whether it does."""
    cornea = cornea_of(eye)
    reach = search_radius(cornea)

    def landing(entry, share):
        entry_point = cornea_point(cornea, entry)
        return refract_to_iris(eye, entry_point, _view_directions(camera, eye, entry_point, share))

    def newton(entry, share):
        return newton_step(lambda k: landing(k, share).point[:2], entry, target[:2], reach), None

    # Continued from straight ahead, where the entry is near the target, to the camera's angle.
    shares = jnp.asarray([*np.repeat(np.linspace(0.0, 1.0, _STEPS), 2), *np.ones(6)], target.dtype)
    entry = jax.lax.scan(newton, 0.9 * target[:2], shares)[0]
    landed, entry_point = landing(entry, 1.0), cornea_point(cornea, entry)
    edge = eye.limbus_radius + (0.0 if eye.sclera is None else eye.limbus_width / 2)
    sight = _view_directions(camera, eye, entry_point)
    facing = dot(sight, cornea.anterior.normal(entry_point)) < 0
    close = norm(landed.point[:2] - target[:2]) < _TOLERANCE
    return entry_point, close & facing & (norm(entry) < edge) & (landed.share > 0)


def _is_visible(surface: AbstractSurface, camera: Camera, point: Vector):
    """Return whether points turn their outer side to a camera, and the cornea does not hide
    them.
    """
    eye = surface.eye
    towards = _view_directions(camera, eye, point)
    facing = dot(towards, surface.normal(point)) < 0
    if eye.cornea is None or not isinstance(surface, GlobeSurface):
        return facing
    start = point - 60.0 * towards  # outside the eye
    hidden = CorneaSurface(eye).intersect(start, towards)[1]
    return facing & ~hidden
