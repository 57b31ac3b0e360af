"""A pinhole camera that looks at the eye: its rays, and the pixels of points."""

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from irisjax._types import Scalar, float_field
from irisjax.anatomy.eye import Eye
from irisjax.numerics.checks import Range, check_range
from irisjax.numerics.fusion import materialise
from irisjax.numerics.roots import safe_sqrt
from irisjax.optics.conicoid import Vector, dot, from_parts, norm, parts
from irisjax.render.refraction import direction_of

CAMERA_LIMITS = {
    "distance": Range(30, 1e5, "mm"),
    "width": Range(0.1, 100, "mm"),
    "polar": Range(0, 3.15),
    "images": Range(0, 10),
}
"""Allowed range of each number of a camera."""
MAX_SIDE = 16384
"""Largest number of pixels along a side."""
_CLEARANCE = 40.0  # mm from the middle of the pupil; every part of an eye is nearer


class Camera(eqx.Module):
    """A pinhole camera in the eye's frame (mm; +z into the eye, x right and y up as the viewer
    sees).

    Attributes:
        polar: Polar angle of its position as seen from the eye, radians; 0 is straight ahead.
        azimuth: Azimuth of its position, radians.
        distance: Distance to the centre of the pupil, mm.
        width: Width of the field there, mm.
        size: Width and height of the picture, pixels.
        first: First row of a band of the picture, see `crop_rows`.
        rows: Number of rows of the band; `None` for the whole picture.
        images: Share of the images in the tear film that it receives: 0 through crossed polarisers;
            above 1 for pictures that show them brighter than they are.

    Raises:
        ValueError: A number is out of range.
    """

    polar: Scalar = float_field(0.0)
    azimuth: Scalar = float_field(0.0)
    distance: Scalar = float_field(250.0)
    width: Scalar = float_field(15.0)
    size: tuple[int, int] = eqx.field(static=True, default=(800, 600))
    first: Int[Array, ""] | None = None
    rows: int | None = eqx.field(static=True, default=None)
    images: Scalar = float_field(1.0)

    def __check_init__(self) -> None:
        largest = MAX_SIDE if self.rows is None else np.inf  # the parts of a picture may be finer
        if not all(isinstance(n, int) and 1 <= n <= largest for n in self.size):
            raise ValueError(
                f"camera size {self.size} must be two whole numbers from 1 to {MAX_SIDE}"
            )
        for name, allowed in CAMERA_LIMITS.items():
            check_range(f"camera {name}", getattr(self, name), allowed)
        check_range("camera azimuth", self.azimuth, Range(-np.inf, np.inf))

    def crop_rows(self, first: int, rows: int, samples: int = 1) -> "Camera":
        """Return the camera of a band of rows of its picture, counted from 0 at the top, in which
        each pixel is replaced by samples × samples smaller ones.

        Raises:
            ValueError: The picture has no such rows.
        """
        if not (rows > 0 and 0 <= first <= self.size[1] - rows):
            raise ValueError(
                f"rows {first} to {first + rows - 1} are not in a picture of {self.size[1]}"
            )
        # An array, so that one compiled program serves all bands of a picture.
        start, size = jnp.asarray(first * samples, jnp.int32), tuple(n * samples for n in self.size)
        return dataclasses.replace(self, size=size, first=start, rows=rows * samples)

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of rows and columns of the picture or its band."""
        return (self.size[1] if self.rows is None else self.rows), self.size[0]

    def axes(self) -> tuple[Vector, Vector, Vector]:
        """Return unit vectors (3,) from the eye to the camera, to the right and up in the
        picture.
        """
        back = direction_of(self.polar, self.azimuth)
        # Up is the eye's y, or its z for a camera straight above or below.
        y = jnp.asarray([0.0, 1.0, 0.0], back.dtype)
        up = y - dot(y, back) * back
        length = norm(up)
        upright = length > 1e-6
        z = jnp.asarray([0.0, 0.0, 1.0], back.dtype)
        up = jnp.where(upright, up / jnp.where(upright, length, 1.0), z)
        return back, jnp.cross(up, -back), up

    def position(self, eye: Eye, share: Scalar | float = 1.0) -> Vector:
        """Return the camera's position (3,), mm, or that at a `share` of its polar angle."""
        return _pupil_centre(eye) + self.distance * direction_of(share * self.polar, self.azimuth)

    def rays(
        self, index: Int[Array, " pixels"], eye: Eye, size: tuple[Any, Any] | None = None
    ) -> tuple[Vector, Vector]:
        """Return the origins (pixels, 3), mm, and unit directions (pixels, 3) of the rays of pixels
        that are numbered along the rows, of another `size` than the camera's where it is given.

        Origins lie in front of the whole eye, or at the camera where that is nearer: measured from
        a camera metres away, points of the eye would be lost to single precision.
        """
        back, right, up = self.axes()
        w, h = self.size if size is None else size
        pitch = self.width / w
        row = index // w
        column = index - w * row
        row = row if self.first is None else row + self.first
        x = (column.astype(back.dtype) + 0.5 - w / 2) * pitch
        y = -(row.astype(back.dtype) + 0.5 - h / 2) * pitch
        x, y = materialise((x, y))
        # Points of the rays in the plane through the middle of the pupil, which are all near.
        aim = [x * r + y * u for r, u in zip(right, up, strict=True)]
        aside = x * x + y * y
        length = safe_sqrt(aside + self.distance * self.distance)
        direction = [(a - self.distance * b) / length for a, b in zip(aim, back, strict=True)]
        # From there to the point nearest to the pupil's middle, then out of the eye.
        out = aside / length + jnp.minimum(_CLEARANCE, self.distance * (self.distance / length))
        origin = [
            c + a - out * d for c, a, d in zip(_pupil_centre(eye), aim, direction, strict=True)
        ]
        return from_parts(materialise(origin)), from_parts(direction)

    def pixel(self, point: Vector, eye: Eye) -> tuple[Float[Array, "*s"], Float[Array, "*s"]]:
        """Project points (…, 3), mm, in front of the camera along straight lines to columns and
        rows; whole numbers are the middles of pixels.
        """
        back, right, up = self.axes()
        near = [p - c for p, c in zip(parts(point), _pupil_centre(eye), strict=True)]
        depth, x, y = (
            sum(n * a for n, a in zip(near, axis, strict=True)) for axis in (back, right, up)
        )
        w, h = self.size
        scale = (w / self.width) / (1 - depth / self.distance)
        row = h / 2 - 0.5 - y * scale
        return x * scale + w / 2 - 0.5, row if self.first is None else row - self.first


class AnySize(eqx.Module):
    """The rays of a camera whose size is no part of a program, so that pictures of all sizes share
    it.
    """

    camera: Camera
    size: tuple[Int[Array, ""], Int[Array, ""]]

    @classmethod
    def of(cls, camera: Camera) -> "AnySize":
        """Return the rays of a camera."""
        width, height = camera.size
        size = jnp.asarray(width, jnp.int32), jnp.asarray(height, jnp.int32)
        return cls(dataclasses.replace(camera, size=(1, 1), rows=None), size)

    def rays(self, index: Int[Array, " pixels"], eye: Eye) -> tuple[Vector, Vector]:
        """Return the result of `Camera.rays`."""
        return self.camera.rays(index, eye, self.size)


def _pupil_centre(eye: Eye) -> Vector:
    """Return the middle of a centred pupil, (3,)."""
    zero = jnp.zeros_like(eye.iris_depth)
    return jnp.stack([zero, zero, eye.iris_depth])
