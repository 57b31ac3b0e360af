"""Texel to pixel: where points of the eye appear in a camera.

`project` goes the other way, from pixels to points. Points of the iris appear where their light
leaves the cornea; Newton's search finds it, Fermat's principle has the same solution.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from irisjax.anatomy.eye import Eye
from irisjax.optics.conicoid import Vector, dot, norm
from irisjax.render.camera import Camera
from irisjax.render.refraction import cornea_point, newton_step, refract_to_iris, search_radius
from irisjax.render.surfaces import AbstractSurface, CorneaSurface, GlobeSurface, IrisSurface

_CLOSE = 1e-3  # mm by which a line of sight may miss the point it was searched for
_STEPS = 8  # polar angles from straight ahead to the camera's


class Pixels(NamedTuple):
    """Where points appear: `column` and `row`, whole numbers in the middles of pixels, and whether
    the camera sees them; they may lie outside the picture.
    """

    column: Float[Array, "*s"]
    row: Float[Array, "*s"]
    visible: Bool[Array, "*s"]


def project_points(surface: AbstractSurface, camera: Camera, point: Vector) -> Pixels:
    """Where points (…, 3) of a surface, mm in the eye's frame, appear in a camera.

    The iris is seen through the cornea, if there is one. Pure: works under `jit`, `vmap` and
    `grad`.
    """
    eye = surface.eye
    shape, flat = point.shape[:-1], point.reshape(-1, 3)
    if isinstance(surface, IrisSurface) and eye.cornea is not None:
        shown, visible = jax.vmap(lambda p: _through_cornea(eye, camera, p))(flat)
    else:
        shown, visible = flat, _in_sight(surface, camera, flat)
    column, row = camera.pixel(shown, eye)
    return Pixels(column.reshape(shape), row.reshape(shape), visible.reshape(shape))


def _towards(camera: Camera, eye: Eye, point: Vector, share=1.0) -> Vector:
    """Unit vectors from a camera that stands at a `share` of its polar angle to points."""
    way = point - camera.place(eye, share)
    return way / norm(way)[..., None]


def _through_cornea(eye: Eye, camera: Camera, target: Float[Array, "3"]):
    """The point of the cornea at which a point of the iris appears, and whether it does."""
    cornea = eye.cornea
    assert cornea is not None
    reach = search_radius(cornea)

    def landing(entry, share):
        front = cornea_point(cornea, entry)
        return refract_to_iris(eye, front, _towards(camera, eye, front, share))

    def newton(entry, share):
        return newton_step(lambda k: landing(k, share).point[:2], entry, target[:2], reach), None

    # From straight ahead, where the entry is near the point, to the side, step by step.
    shares = jnp.asarray([*np.repeat(np.linspace(0.0, 1.0, _STEPS), 2), *np.ones(6)], target.dtype)
    entry = jax.lax.scan(newton, 0.9 * target[:2], shares)[0]
    found, front = landing(entry, 1.0), cornea_point(cornea, entry)
    edge = eye.limbus_radius + (0.0 if eye.sclera is None else eye.limbus_width / 2)
    facing = dot(_towards(camera, eye, front), cornea.anterior.normal(front)) < 0
    close = norm(found.point[:2] - target[:2]) < _CLOSE
    return front, close & facing & (norm(entry) < edge) & (found.share > 0)


def _in_sight(surface: AbstractSurface, camera: Camera, point: Vector):
    """Whether points show their outer side to a camera, and the cornea does not hide them."""
    eye = surface.eye
    towards = _towards(camera, eye, point)
    facing = dot(towards, surface.normal(point)) < 0
    if eye.cornea is None or not isinstance(surface, GlobeSurface):
        return facing
    start = point - 60.0 * towards  # outside the eye
    hidden = CorneaSurface(eye).meet(start, towards)[1]
    return facing & ~hidden
