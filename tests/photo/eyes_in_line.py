"""Outlines that a camera's geometry gives, and pictures painted on an iris without a renderer."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from irisjax.anatomy.eye import Eye
from irisjax.photo.photograph import Ellipse, ellipse_through
from irisjax.photo.pose import project_iris_points
from irisjax.render.camera import Camera
from irisjax.render.project import trace_iris

_AROUND = np.linspace(0, 2 * np.pi, 64, endpoint=False)


def outlines(eye: Eye, camera: Camera) -> tuple[Ellipse, Ellipse]:
    """Limbus and pupil as a camera sees them."""
    assert eye.cornea is not None
    limbus = _circle(eye.limbus_radius, eye.cornea.anterior.sagitta(eye.limbus_radius))
    rim = _pixel(eye, camera, jnp.asarray(limbus))
    hole = seen(eye, camera, _circle(eye.pupil_radius, eye.iris_depth))
    return tuple(ellipse_through(np.stack([*map(np.asarray, p)], -1)) for p in (rim, hole[:2]))


def _circle(radius, depth):
    r, z = float(radius), float(depth)
    return np.stack([r * np.cos(_AROUND), r * np.sin(_AROUND), np.full_like(_AROUND, z)], -1)


@eqx.filter_jit
def _pixel(eye, camera, points):
    return camera.pixel(points, eye)


def seen(eye: Eye, camera: Camera, points):
    """Columns, rows and visibility of points of the iris, as many at a time as the package projects
    for a pose: one program serves both.
    """
    blocks = np.pad(points, ((0, -len(points) % (64 * 33)), (0, 0)), mode="edge")
    found = [project_iris_points(eye, camera, b) for b in blocks.reshape(-1, 64, 33, 3)]
    return tuple(np.ravel(part)[: len(points)] for part in zip(*found, strict=True))


def painted(eye: Eye, camera: Camera, paint: Callable) -> np.ndarray:
    """What a camera sees of an iris that has the values `paint(x, y)` (pixels,) at x, y (mm): each
    pixel those of its middle, (rows, columns, 3); 0 beside the iris.
    """
    count = camera.shape[0] * camera.shape[1]
    pixels = trace_iris(np.arange(count, dtype=np.int32), eye, camera)
    shown = np.asarray(pixels.share) > 0
    x, y = (np.asarray(c)[shown] for c in pixels.point[:2])
    flat = np.zeros(count, np.float32)
    flat[shown] = paint(x, y)
    return np.repeat(flat.reshape(*camera.shape, 1), 3, -1)
