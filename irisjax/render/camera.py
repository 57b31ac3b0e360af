"""A pinhole camera that looks at the eye, and what each of its pixels sees."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from irisjax._types import Scalar, as_float
from irisjax.anatomy.eye import Eye
from irisjax.anatomy.media import TEAR
from irisjax.anatomy.sclera import meet_sclera, sphere
from irisjax.numerics.interpolation import smoothstep
from irisjax.numerics.portions import pixelwise
from irisjax.numerics.roots import safe_sqrt
from irisjax.optics.conicoid import (
    Parts,
    Vector,
    along,
    choose,
    dot,
    from_axis,
    norm,
    parts,
    reflect_vector,
    refract_vector,
)
from irisjax.render.refraction import enter

BLEND = 0.5
"""Half the width over which iris and sclera blend at the limbus, mm  [F09 Section 6.5: about 1 mm
in all].
"""
LARGEST = 16384
"""Most pixels along a side."""
_CLEAR = 40.0  # mm from the middle of the pupil: all of any eye is nearer
_PAD = 2048  # and an eighth of the pixels at most


def _number(default: float) -> Any:
    return eqx.field(default=default, converter=as_float)


class Camera(eqx.Module):
    """A pinhole camera in the eye's frame (mm; +z into the eye, x right and y up as the viewer
    sees).

    - `polar`, `azimuth`: of its place as seen from the eye, radians; 0 is straight ahead.
    - `distance`: to the centre of the pupil. `width`: of the field there, mm.
    - `size`: (width, height) in pixels. `first`, `rows`: the part of them it takes, see `taking`.
    """

    polar: Scalar = _number(0.0)
    azimuth: Scalar = _number(0.0)
    distance: Scalar = _number(250.0)
    width: Scalar = _number(15.0)
    size: tuple[int, int] = eqx.field(static=True, default=(800, 600))
    first: Int[Array, ""] | None = None
    rows: int | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        whole = self.rows is None  # the parts of a picture may be finer
        if not all(
            isinstance(n, int) and n >= 1 and (n <= LARGEST or not whole) for n in self.size
        ):
            raise ValueError(
                f"camera size {self.size} must be two whole numbers from 1 to {LARGEST}"
            )
        for name, low, high, unit in (
            ("distance", 30, 1e5, "mm"),
            ("width", 0.1, 100, "mm"),
            ("polar", 0, 3.15, ""),
        ):
            value = getattr(self, name)
            if not isinstance(value, Tracer) and not low <= float(value) <= high:
                raise ValueError(
                    f"camera {name} = {float(value):g} is outside [{low:g}, "
                    f"{high:g}] {unit}".rstrip()
                )

    def taking(self, first: int, rows: int, samples: int = 1) -> "Camera":
        """The same camera that takes only some rows of its picture, 0 being the top, and instead of
        each pixel samples × samples smaller ones."""
        if not (rows > 0 and 0 <= first <= self.size[1] - rows):
            raise ValueError(
                f"rows {first} to {first + rows - 1} are not in a picture of {self.size[1]}"
            )
        # A traced number: one program for all parts of a picture.
        start, size = jnp.asarray(first * samples, jnp.int32), tuple(n * samples for n in self.size)
        return dataclasses.replace(self, size=size, first=start, rows=rows * samples)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns that it takes."""
        return (self.size[1] if self.rows is None else self.rows), self.size[0]

    def rays(self, eye: Eye) -> tuple[Float[Array, "3"], Float[Array, "height width 3"]]:
        """The camera's place (3,) and unit directions (rows, columns, 3) from the top."""
        rows, columns = self.shape
        _, direction = self.towards(jnp.arange(rows * columns), eye)
        back, _, _ = self.axes()
        return _centre(eye) + self.distance * back, direction.reshape(rows, columns, 3)

    def axes(self) -> tuple[Vector, Vector, Vector]:
        """Unit vectors (3,) from the eye to the camera, to the right and up in the picture."""
        sin, cos = jnp.sin(self.polar), jnp.cos(self.polar)
        back = jnp.stack([sin * jnp.cos(self.azimuth), sin * jnp.sin(self.azimuth), -cos])
        # Upright wherever it stands: the eye's y, or its z for a camera straight above or below.
        y = jnp.asarray([0.0, 1.0, 0.0], back.dtype)
        up = y - dot(y, back) * back
        length = norm(up)
        up = jnp.where(
            length > 1e-6,
            up / jnp.where(length > 1e-6, length, 1.0),
            jnp.asarray([0, 0, 1.0], back.dtype),
        )
        return back, jnp.cross(up, -back), up

    def towards(self, index: Int[Array, " pixels"], eye: Eye) -> tuple[Vector, Vector]:
        """Where the lines of sight of some pixels, counted along its rows, begin near the eye
        (pixels, 3), and their unit directions (pixels, 3).

        They begin in front of all of the eye, or at the camera where that is nearer: counted from a
        camera metres away, single precision would lose the eye.
        """
        back, right, up = self.axes()
        w, h = self.size
        pitch = self.width / w
        row = index // w if self.first is None else index // w + self.first
        x = ((index % w).astype(back.dtype) + 0.5 - w / 2) * pitch
        y = -(row.astype(back.dtype) + 0.5 - h / 2) * pitch
        # Points aimed at, in the plane through the middle of the pupil; none of them is far.
        aim = [x * r + y * u for r, u in zip(right, up, strict=True)]
        aside = x * x + y * y
        length = safe_sqrt(aside + self.distance * self.distance)
        direction = [(a - self.distance * b) / length for a, b in zip(aim, back, strict=True)]
        # Back from there to the point nearest to the pupil's middle, then out of the eye.
        out = aside / length + jnp.minimum(_CLEAR, self.distance * (self.distance / length))
        origin = [c + a - out * d for c, a, d in zip(_centre(eye), aim, direction, strict=True)]
        return jnp.stack(origin, axis=-1), jnp.stack(direction, axis=-1)


def _centre(eye: Eye) -> Vector:
    """The middle of the pupil, (3,)."""
    zero = jnp.zeros_like(eye.iris_depth)
    return jnp.stack([zero, zero, eye.iris_depth])


class IrisPixels(eqx.Module):
    """Pixels that see the iris, as flat arrays; `index` is −1 for padding, `None` where all pixels
    of the picture do.

    - `point`: on the iris, mm; `direction`: of the line of sight in the chamber, into the eye.
    - `cosine`: of the exit angle to the flat iris; `share`: transmitted on the way out, over n² of
        the chamber, times the blend at the limbus.
    """

    index: Int[Array, " pixels"] | None
    point: Parts
    direction: Parts
    cosine: Float[Array, " pixels"]
    share: Float[Array, " pixels"]


class ScleraPixels(eqx.Module):
    """Pixels that see the white: `point` and `normal` (3, pixels), the `reflectance` of the tear
    film over it, and the `share` of sclera, which blends with the iris at the limbus."""

    index: Int[Array, " pixels"] | None
    point: Parts
    normal: Parts
    reflectance: Float[Array, " pixels"]
    share: Float[Array, " pixels"]


class MirrorPixels(eqx.Module):
    """Pixels that see the tear film, on cornea and white: its `mirror` direction and
    `reflectance`.
    """

    index: Int[Array, " pixels"] | None
    mirror: Parts
    reflectance: Float[Array, " pixels"]


class View(eqx.Module):
    """What a camera sees of an eye, part by part; absent parts are `None`."""

    iris: IrisPixels | None
    sclera: ScleraPixels | None
    mirror: MirrorPixels | None
    size: tuple[int, int] = eqx.field(static=True)


def look(eye: Eye, camera: Camera) -> View:
    """Sort a camera's pixels by what they see. Runs on the host: the number of pixels decides the
    shapes.
    """
    rows, columns = camera.shape
    count = rows * columns
    sorts = np.asarray(_sorted(np.arange(count, dtype=np.int32), eye, camera))

    def of(part: int, pixelwise_of):
        index = np.flatnonzero(sorts & part)
        if not index.size:
            return None
        if index.size == count and camera.rows is None:
            return dataclasses.replace(
                pixelwise_of(np.arange(count, dtype=np.int32), eye, camera), index=None
            )
        # Few different lengths, few compiled programs: a camera that turns must not wait for XLA.
        # Parts of a picture see anything from nothing to iris all over: programs for one length
        # cost less than padding.
        length = count if camera.rows is not None else index.size
        block = max(_PAD, 1 << max(length.bit_length() - 4, 0)) if count >= _PAD else count
        padded = np.pad(
            index.astype(np.int32), (0, -(-length // block) * block - index.size), mode="edge"
        )
        found = pixelwise_of(padded, eye, camera)
        padded[index.size :] = -1
        return eqx.tree_at(lambda p: p.index, found, jnp.asarray(padded))

    return View(of(_IRIS, _iris), of(_SCLERA, _sclera), of(_MIRROR, _mirror), size=(columns, rows))


_IRIS, _SCLERA, _MIRROR = 1, 2, 4


@pixelwise
def _sorted(index, eye: Eye, camera: Camera):
    """What each pixel sees: a sum of `_IRIS`, `_SCLERA` and `_MIRROR`."""
    origin, direction = camera.towards(index, eye)
    if eye.cornea is None:
        return jnp.where(_on_bare_iris(eye, origin, direction)[2], _IRIS, 0).astype(jnp.int8)
    surface = _Surface.met(eye, origin, direction)
    sees = (
        surface.hit & surface.shown & (surface.blend < 1),
        surface.hit & (surface.blend > 0),
        surface.hit,
    )
    return sum(
        jnp.where(s, n, 0).astype(jnp.int8)
        for s, n in zip(sees, (_IRIS, _SCLERA, _MIRROR), strict=True)
    )


class _Surface(NamedTuple):
    """Where lines of sight meet the outer surface: on the cornea's conicoid (`front`, and whether
    that is `shown`) or, where they `hit` beside it, on the globe. `blend`: the share of sclera."""

    front: Vector
    shown: Bool[Array, " pixels"]
    point: Vector
    normal: Vector
    blend: Float[Array, " pixels"]
    hit: Bool[Array, " pixels"]

    @classmethod
    def met(cls, eye: Eye, origin, direction) -> "_Surface":
        assert eye.cornea is not None
        t, met = eye.cornea.anterior.intersect(origin, direction)
        front = along(origin, t, direction)
        normal = eye.cornea.anterior.normal(front)
        r = from_axis(front)
        shown = met & (t > 0) & (dot(direction, normal) < 0) & (normal[:, 2] < 0)
        on_cornea = shown & (
            r <= eye.limbus_radius * (1 + 1e-4)
        )  # the globe begins at the limbus itself
        if eye.sclera is None:
            return cls(front, shown, front, normal, jnp.zeros_like(r), on_cornea)
        distance, on_globe = meet_sclera(eye, origin, direction)
        globe = along(origin, distance, direction)
        point = choose(on_cornea, front, globe)
        normal = choose(on_cornea, normal, sphere(eye).normal(globe))
        behind = point[:, 2] > sphere(eye).apex + sphere(eye).radius
        blend = jnp.where(
            behind, 1.0, smoothstep((from_axis(point) - eye.limbus_radius) / (2 * BLEND) + 0.5)
        )
        return cls(front, shown, point, normal, blend, on_cornea | on_globe)


def _on_bare_iris(eye: Eye, origin, direction):
    t = eye.meet_iris(origin, direction)
    point = along(origin, t, direction)
    cosine = -dot(direction, eye.iris_normal(point))
    return point, cosine, (t > 0) & (from_axis(point) < eye.iris_radius) & (cosine > 0)


@pixelwise
def _iris(index, eye: Eye, camera: Camera) -> IrisPixels:
    origin, direction = camera.towards(index, eye)
    if eye.cornea is None:
        point, cosine, met = _on_bare_iris(eye, origin, direction)
        return IrisPixels(index, parts(point), parts(direction), cosine, jnp.where(met, 1.0, 0.0))
    surface = _Surface.met(eye, origin, direction)
    landing = enter(eye, surface.front, direction)
    cosine = -dot(landing.direction, eye.iris_normal(landing.point))
    share = (
        landing.share
        * jnp.where(surface.shown & (cosine > 0), 1 - surface.blend, 0.0)
        / eye.aqueous_index**2
    )
    return IrisPixels(
        index, parts(landing.point), parts(landing.direction), jnp.maximum(cosine, 0), share
    )


@pixelwise
def _sclera(index, eye: Eye, camera: Camera) -> ScleraPixels:
    origin, direction = camera.towards(index, eye)
    surface = _Surface.met(eye, origin, direction)
    passed = refract_vector(direction, surface.normal, 1.0, TEAR)[1]
    return ScleraPixels(
        index, parts(surface.point), parts(surface.normal), 1 - passed, surface.blend
    )


@pixelwise
def _mirror(index, eye: Eye, camera: Camera) -> MirrorPixels:
    origin, direction = camera.towards(index, eye)
    surface = _Surface.met(eye, origin, direction)
    passed = refract_vector(direction, surface.normal, 1.0, TEAR)[1]
    return MirrorPixels(index, parts(reflect_vector(direction, surface.normal)), 1 - passed)


def mirror_points(pixels: MirrorPixels, eye: Eye, camera: Camera) -> Parts:
    """Where pixels meet the tear film, mm: needed for lamps that are near, and for them alone."""
    index = (
        jnp.arange(pixels.reflectance.size, dtype=jnp.int32)
        if pixels.index is None
        else pixels.index
    )
    return _outer(jnp.maximum(index, 0), eye, camera)


@pixelwise
def _outer(index, eye: Eye, camera: Camera) -> Parts:
    return parts(_Surface.met(eye, *camera.towards(index, eye)).point)
