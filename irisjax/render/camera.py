"""A pinhole camera that looks at the eye, and what each of its pixels sees."""

import dataclasses
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from irisjax._types import Scalar, as_float
from irisjax.optics.conicoid import dot, norm, reflect_vector, refract_vector
from irisjax.render.chunks import in_chunks, side_by_side
from irisjax.render.refraction import enter
from irisjax.render.sclera import meet_sclera, sphere
from irisjax.tissue.anatomy import Eye
from irisjax.tissue.eye import TEAR
from irisjax.tissue.noise import step

BLEND = 0.5
"""Half the width over which iris and sclera blend at the limbus, mm  [F09 Section 6.5: about 1 mm in all]."""
LARGEST = 16384
"""Most pixels along a side."""
_PAD = 2048  # and an eighth of the pixels at most


def _number(default: float) -> Any:
    return eqx.field(default=default, converter=as_float)


class Camera(eqx.Module):
    """A pinhole camera in the eye's frame (mm; +z into the eye, x right and y up as the viewer sees).

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
        if not all(isinstance(n, int) and n >= 1 and (n <= LARGEST or not whole) for n in self.size):
            raise ValueError(f"camera size {self.size} must be two whole numbers from 1 to {LARGEST}")
        for name, low, high, unit in (("distance", 30, 1e5, "mm"), ("width", 0.1, 100, "mm"), ("polar", 0, 3.15, "")):
            value = getattr(self, name)
            if not isinstance(value, Tracer) and not low <= float(value) <= high:
                raise ValueError(f"camera {name} = {float(value):g} is outside [{low:g}, {high:g}] {unit}".rstrip())

    def taking(self, first: int, rows: int, samples: int = 1) -> "Camera":
        """The same camera that takes only some rows of its picture, 0 being the top, and instead of each pixel
        samples × samples smaller ones."""
        if not (rows > 0 and 0 <= first <= self.size[1] - rows):
            raise ValueError(f"rows {first} to {first + rows - 1} are not in a picture of {self.size[1]}")
        # A traced number: one program for all parts of a picture.
        start, size = jnp.asarray(first * samples, jnp.int32), tuple(n * samples for n in self.size)
        return dataclasses.replace(self, size=size, first=start, rows=rows * samples)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns that it takes."""
        return (self.size[1] if self.rows is None else self.rows), self.size[0]

    def rays(self, eye: Eye) -> tuple[Float[Array, "3"], Float[Array, "height width 3"]]:
        """The camera's place (3,) and unit directions (rows, columns, 3) from the top."""
        sin, cos = jnp.sin(self.polar), jnp.cos(self.polar)
        back = jnp.stack([sin * jnp.cos(self.azimuth), sin * jnp.sin(self.azimuth), -cos])
        origin = jnp.stack([jnp.zeros_like(sin), jnp.zeros_like(sin), eye.iris_depth]) + self.distance * back
        # Upright wherever it stands: the eye's y, or its z for a camera straight above or below.
        y = jnp.asarray([0.0, 1.0, 0.0], back.dtype)
        up = y - dot(y, back) * back
        length = norm(up)
        up = jnp.where(length > 1e-6, up / jnp.where(length > 1e-6, length, 1.0), jnp.asarray([0, 0, 1.0], back.dtype))
        right = jnp.cross(up, -back)
        w, h = self.size
        pitch = self.width / w
        x = (jnp.arange(w, dtype=back.dtype) + 0.5 - w / 2) * pitch
        row = jnp.arange(self.shape[0], dtype=back.dtype)
        if self.first is not None:
            row = row + self.first.astype(back.dtype)  # whole numbers: exact
        y = -(row + 0.5 - h / 2) * pitch
        d = -self.distance * back + x[None, :, None] * right + y[:, None, None] * up
        return origin, d / norm(d)[..., None]


class IrisPixels(eqx.Module):
    """Pixels that see the iris, as flat arrays; `index` is −1 for padding.

    - `point`: (pixels, 3) on the iris, mm; `direction`: of the line of sight in the chamber, into the eye.
    - `cosine`: of the exit angle to the flat iris; `share`: transmitted on the way out, over n² of the chamber,
        times the blend at the limbus.
    """

    index: Int[Array, " pixels"]
    point: Float[Array, "pixels 3"]
    direction: Float[Array, "pixels 3"]
    cosine: Float[Array, " pixels"]
    share: Float[Array, " pixels"]


class SurfacePixels(eqx.Module):
    """Pixels that see the outer surface: `point`, `normal`, `mirror` direction (pixels, 3), `reflectance` of the
    tear film, and the `share` of sclera (0 over the clear cornea)."""

    index: Int[Array, " pixels"]
    point: Float[Array, "pixels 3"]
    normal: Float[Array, "pixels 3"]
    mirror: Float[Array, "pixels 3"]
    reflectance: Float[Array, " pixels"]
    share: Float[Array, " pixels"]


class View(eqx.Module):
    """What a camera sees of an eye, part by part; absent parts are `None`."""

    iris: IrisPixels | None
    sclera: SurfacePixels | None
    mirror: SurfacePixels | None
    size: tuple[int, int] = eqx.field(static=True)


def look(eye: Eye, camera: Camera) -> View:
    """Sort a camera's pixels by what they see. Runs on the host: the number of pixels decides the shapes."""
    rows, columns = camera.shape
    count = rows * columns
    found = side_by_side(lambda *share: _trace(eye, camera, *share), count, eye, camera)
    iris, surface, blend, met = found[0] if len(found) == 1 else _joined(found, count)
    blend, met = np.asarray(blend), np.asarray(met)
    sees_iris = met & (blend < 1) & (np.asarray(iris.share) > 0)
    pick = _picker(count, part=camera.rows is not None)
    views: list[Any] = [pick(iris, sees_iris)]
    if eye.cornea is None:
        views += [None, None]
    else:
        views += [pick(surface, met & (blend > 0)) if eye.sclera is not None else None, pick(surface, met)]
    return View(*views, size=(columns, rows))


def _picker(count: int, part: bool):
    def pick(pixels, mask):
        index = np.flatnonzero(mask)
        if not index.size:
            return None
        # Few different lengths, few compiled programs: a camera that turns must not wait for XLA.
        block = max(_PAD, 1 << max(index.size.bit_length() - 4, 0))
        # Parts of a picture see anything from nothing to iris all over: programs for one length cost less than padding.
        padded = count if part else min(-(-index.size // block) * block, max(count, index.size))
        source = np.concatenate([index, np.full(padded - index.size, index[-1])])
        where = np.where(np.arange(padded) < index.size, source, -1).astype(np.int32)
        return eqx.tree_at(lambda p: p.index, _picked(pixels, source.astype(np.int32)), jnp.asarray(where))

    return pick


@jax.jit
def _picked(pixels, source):
    return jax.tree.map(lambda x: x.at[source].get(mode="promise_in_bounds"), pixels)


@partial(jax.jit, static_argnums=3)
def _trace(eye: Eye, camera: Camera, share=0, shares: int = 1):
    origin, direction = camera.rays(eye)
    index = jnp.arange(camera.shape[0] * camera.shape[1], dtype=jnp.int32)
    rays = direction.reshape(-1, 3), index
    return in_chunks(lambda rays: _seen(eye, origin, *rays), rays, 0, share, shares)


@partial(jax.jit, static_argnums=1)
def _joined(found, count: int):
    return jax.tree.map(lambda *parts: jnp.concatenate(parts)[:count], *found)


def _seen(eye: Eye, origin, direction, index):
    origin = jnp.broadcast_to(origin, direction.shape)
    if eye.cornea is None:
        t = eye.meet_iris(origin, direction)
        point = origin + t[:, None] * direction
        cosine = -dot(direction, eye.iris_normal(point))
        met = (t > 0) & (norm(point[:, :2]) < eye.iris_radius) & (cosine > 0)
        zero = jnp.zeros_like(cosine)
        return IrisPixels(index, point, direction, cosine, jnp.where(met, 1.0, 0.0)), None, zero, met
    t, met = eye.cornea.anterior.intersect(origin, direction)
    front = origin + t[:, None] * direction
    normal = eye.cornea.anterior.normal(front)
    r = norm(front[:, :2])
    shown = met & (t > 0) & (dot(direction, normal) < 0) & (normal[:, 2] < 0)
    on_cornea = shown & (r <= eye.limbus_radius * (1 + 1e-4))  # the globe begins at the limbus itself
    landing = enter(eye, front, direction)
    cosine = -dot(landing.direction, eye.iris_normal(landing.point))
    surface, surface_normal, surface_r = front, normal, r
    hit = on_cornea
    if eye.sclera is not None:
        distance, on_globe = meet_sclera(eye, origin, direction)
        globe = origin + distance[:, None] * direction
        take = (~on_cornea)[:, None]
        surface = jnp.where(take, globe, front)
        surface_normal = jnp.where(take, sphere(eye).normal(globe), normal)
        surface_r = norm(surface[:, :2])
        hit = on_cornea | on_globe
        behind = surface[:, 2] > sphere(eye).apex + sphere(eye).radius
        blend = jnp.where(behind, 1.0, step((surface_r - eye.limbus_radius) / (2 * BLEND) + 0.5))
    else:
        blend = jnp.zeros_like(r)
    share = landing.share * jnp.where(shown & (cosine > 0), 1 - blend, 0.0) / eye.aqueous_index**2
    iris = IrisPixels(index, landing.point, landing.direction, jnp.maximum(cosine, 0), share)
    passed = refract_vector(direction, surface_normal, 1.0, TEAR)[1]
    outer = SurfacePixels(index, surface, surface_normal, reflect_vector(direction, surface_normal), 1 - passed, blend)
    return iris, outer, blend, hit
