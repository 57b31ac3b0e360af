"""`project`: the point of each surface that a pixel sees, and the share of its light that reaches
the pixel.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Int8, Shaped

from irisjax.anatomy.eye import Eye
from irisjax.anatomy.media import TEAR
from irisjax.numerics.chunks import pixelwise
from irisjax.numerics.interpolation import smoothstep
from irisjax.optics.conicoid import (
    Parts,
    Vector,
    choose,
    dot,
    from_axis,
    parts,
    reflect_vector,
    refract_vector,
)
from irisjax.render.camera import Camera
from irisjax.render.lids import LidPixels, lash_coverage, lid_pixels, meet_lids, meniscus_normal
from irisjax.render.refraction import cornea_point, refract_to_iris
from irisjax.render.surfaces import CorneaSurface, GlobeSurface, IrisSurface

IRIS, SCLERA, MIRROR, LIDS = 1, 2, 4, 8
"""What a pixel may see, to be added up."""
_PAD = 2048  # least block of pixels to which `look` pads a part; else an eighth of them at most


class IrisPixels(eqx.Module):
    """Pixels that may see the iris.

    Attributes:
        index: Number of each pixel in the picture; −1 for padding, `None` where they are all
            pixels.
        point: Point of the iris, mm.
        direction: Direction of the line of sight in the chamber, into the eye.
        cosine: Cosine of the exit angle to the flat iris.
        share: Share transmitted on the way out, over n² of the chamber, times the blend at the
            limbus; 0 where the iris is not seen.
        turn: Angle by which the maps are turned for each pixel, radians; `None` for none.
    """

    index: Int[Array, " pixels"] | None
    point: Parts
    direction: Parts
    cosine: Float[Array, " pixels"]
    share: Float[Array, " pixels"]
    turn: Float[Array, " pixels"] | None = None


class ScleraPixels(eqx.Module):
    """Pixels that may see the sclera.

    Attributes:
        index: As of `IrisPixels`.
        point: Point of the tear film, mm.
        normal: Normal of the globe there.
        reflectance: Reflectance of the film.
        share: Share of sclera, which blends with the iris at the limbus; 0 where it is not seen.
    """

    index: Int[Array, " pixels"] | None
    point: Parts
    normal: Parts
    reflectance: Float[Array, " pixels"]
    share: Float[Array, " pixels"]


class MirrorPixels(eqx.Module):
    """Pixels that may see the tear film, on the cornea and on the sclera.

    Attributes:
        index: As of `IrisPixels`.
        point: Point of the tear film, mm.
        mirror: Direction of the mirrored line of sight.
        reflectance: Reflectance of the film; 0 beside it.
    """

    index: Int[Array, " pixels"] | None
    point: Parts
    mirror: Parts
    reflectance: Float[Array, " pixels"]


SeenPart = IrisPixels | ScleraPixels | MirrorPixels | LidPixels
"""Pixels that may see a part of the eye, or its lids."""


class View(eqx.Module):
    """The parts of an eye that a camera sees; absent parts are `None`.

    Attributes:
        iris, sclera, mirror, lids: The pixels that see each part, less what lashes cover of them.
        size: Columns and rows of the picture.
        lashes: Share of each pixel of the picture that lashes cover.
    """

    iris: IrisPixels | None
    sclera: ScleraPixels | None
    mirror: MirrorPixels | None
    size: tuple[int, int] = eqx.field(static=True)
    lids: LidPixels | None = None
    lashes: Float[Array, " pixels"] | None = None


def pixel_numbers(part: SeenPart) -> Int[np.ndarray, " pixels"]:
    """Number of each pixel of a part, counted along the picture's rows; −1 for padding."""
    count = jax.tree.leaves(part)[-1].shape[-1]
    return np.arange(count) if part.index is None else np.asarray(part.index)


def onto_picture(
    part: SeenPart,
    values: Shaped[np.ndarray, "pixels *channels"],
    shape: tuple[int, int],
) -> Shaped[np.ndarray, "rows columns *channels"]:
    """Values of a part's pixels where these are in the picture, 0 elsewhere."""
    number = pixel_numbers(part)
    found = np.zeros((shape[0] * shape[1], *values.shape[1:]), values.dtype)
    found[number[number >= 0]] = values[number >= 0]
    return found.reshape(*shape, *values.shape[1:])


def project(eye: Eye, camera: Camera) -> View:
    """Find what each pixel of a camera sees of an eye: all pixels for each part, in the order of
    the picture.

    Pure, of fixed shapes: works under `jit`, `vmap` and `grad`. A part that a pixel does not see
    has a share of 0 and finite values. Edges of the globe against nothing are sharp, and have no
    derivatives.
    """
    rows, columns = camera.shape
    index = jnp.arange(rows * columns, dtype=jnp.int32)
    film, white = eye.cornea is not None, eye.cornea is not None and eye.sclera is not None
    parts: Any = (iris_pixels, True), (sclera_pixels, white), (mirror_pixels, film)
    found = (pixels(index, eye, camera) if there else None for pixels, there in parts)
    every = [None if p is None else dataclasses.replace(p, index=None) for p in found]
    if eye.lids is None:
        return View(*every, size=(columns, rows))
    skin = jnp.where(seen_parts(index, eye, camera) == LIDS, 1.0, 0.0)
    every = [None if p is None else _dimmed(p, 1 - skin) for p in every]
    lids = _dimmed(dataclasses.replace(lid_pixels(index, eye, camera), index=None), skin)
    return _behind_lashes(View(*every, size=(columns, rows), lids=lids), eye, camera)


def look(eye: Eye, camera: Camera) -> View:
    """Compute `project` with only those pixels of each part that see it.

    Runs on the host, for speed: the number of pixels decides the shapes.
    """
    rows, columns = camera.shape
    count = rows * columns
    every = np.arange(count, dtype=np.int32)
    sees = np.asarray(seen_parts(jnp.asarray(every), eye, camera))

    def of(part: int, pixels: Callable[..., Any]) -> Any:
        index = np.flatnonzero(sees & part)
        if not index.size:
            return None
        if index.size == count and camera.rows is None:
            return dataclasses.replace(pixels(every, eye, camera), index=None)
        # Few different lengths, few compiled programs: a camera that turns must not wait for XLA.
        # Parts of a picture see anything from nothing to iris all over: programs for one length
        # cost less than padding.
        length = count if camera.rows is not None else index.size
        block = max(_PAD, 1 << max(length.bit_length() - 4, 0)) if count >= _PAD else count
        more = 0, -(-length // block) * block - index.size
        found = pixels(np.pad(index.astype(np.int32), more, mode="edge"), eye, camera)
        numbers = np.pad(index.astype(np.int32), more, constant_values=-1)
        return dataclasses.replace(found, index=jnp.asarray(numbers))

    parts = (IRIS, iris_pixels), (SCLERA, sclera_pixels), (MIRROR, mirror_pixels)
    view = View(*(of(*part) for part in parts), size=(columns, rows))
    if eye.lids is None:
        return view
    view = dataclasses.replace(view, lids=of(LIDS, lid_pixels))
    return _behind_lashes(view, eye, camera)


def _behind_lashes(view: View, eye: Eye, camera: Camera) -> View:
    """The view with what lashes leave of its parts."""
    lashes = lash_coverage(eye, camera)
    if lashes is None:
        return view
    names = "iris", "sclera", "mirror", "lids"
    shown: dict[str, Any] = {
        name: _dimmed(part, 1 - (lashes if part.index is None else lashes[part.index]))
        for name in names
        if (part := getattr(view, name)) is not None
    }
    return dataclasses.replace(view, **shown, lashes=lashes)


def _dimmed(part: Any, by: Float[Array, " pixels"]) -> Any:
    """A part with a factor on what pixels see of it."""
    name = "reflectance" if isinstance(part, MirrorPixels) else "share"
    return dataclasses.replace(part, **{name: getattr(part, name) * by})


@pixelwise
def seen_parts(index: Array, eye: Eye, camera: Camera) -> Int8[Array, " pixels"]:
    """What each pixel sees: a sum of `IRIS`, `SCLERA` and `MIRROR`."""
    origin, direction = camera.towards(index, eye)
    if eye.cornea is None:
        return jnp.where(IrisSurface(eye).meet(origin, direction)[1], IRIS, 0).astype(jnp.int8)
    outside = _Outside.met(eye, origin, direction)
    white = outside.hit & (outside.blend > 0)
    seen = IRIS * outside.iris + SCLERA * white + MIRROR * outside.hit
    if eye.lids is not None:
        there = jnp.where(outside.hit, dot(outside.point - origin, direction), jnp.inf)
        seen = jnp.where(meet_lids(eye, origin, direction) < there, LIDS, seen)
    return seen.astype(jnp.int8)


@pixelwise
def iris_pixels(index: Array, eye: Eye, camera: Camera) -> IrisPixels:
    """Pixels of these numbers as those that see the iris; those that do not get a share of 0."""
    origin, direction = camera.towards(index, eye)
    # Any line of sight to a point that is no edge instead: derivatives are finite there.
    aside, zero = 0.5 * eye.iris_radius, jnp.zeros_like(eye.iris_radius)
    ahead = jnp.stack([zero, zero, zero + 1])
    if eye.cornea is None:
        _, seen = IrisSurface(eye).meet(origin, direction)
        origin = choose(seen, origin, jnp.stack([aside, zero, zero]))
        direction = choose(seen, direction, ahead)
        point, _ = IrisSurface(eye).meet(origin, direction)
        share = jnp.where(seen, 1.0, 0.0)
    else:
        outside = _Outside.met(eye, origin, direction)
        front = choose(
            outside.iris, outside.front, cornea_point(eye.cornea, jnp.stack([aside, zero]))
        )
        direction = choose(outside.iris, direction, ahead)
        point, direction, passed = refract_to_iris(eye, front, direction)
        shown = (1 - outside.blend) * _past_ring(eye, from_axis(front))
        share = passed * jnp.where(outside.iris, shown, 0.0) / eye.aqueous_index**2
    cosine = -dot(direction, eye.iris_normal(point))
    share = jnp.where(cosine > 0, share, 0.0)
    return IrisPixels(index, parts(point), parts(direction), jnp.maximum(cosine, 0), share)


@pixelwise
def sclera_pixels(index: Array, eye: Eye, camera: Camera) -> ScleraPixels:
    """Pixels of these numbers as those that see the white."""
    outside, _, reflectance = _film(index, eye, camera)
    share = jnp.where(outside.hit, outside.blend, 0.0)
    # Within the limbus white lies under clear cornea and is lit as the globe goes on: by the
    # cornea's normal, some 16° steeper, it would end at a sharp line where light comes from aside.
    normal = GlobeSurface(eye).normal(outside.point)
    return ScleraPixels(index, parts(outside.point), parts(normal), reflectance, share)


@pixelwise
def mirror_pixels(index: Array, eye: Eye, camera: Camera) -> MirrorPixels:
    """Pixels of these numbers as those that see the tear film."""
    outside, direction, reflectance = _film(index, eye, camera)
    mirror = parts(reflect_vector(direction, outside.normal))
    share = jnp.where(outside.hit, reflectance, 0.0)
    return MirrorPixels(index, parts(outside.point), mirror, share)


def _past_ring(eye: Eye, radius):
    """Share of the iris's light that the limbal ring leaves, at radii of the cornea, mm."""
    ring = eye.limbal_ring
    if ring is None:
        return 1.0
    darkest = eye.limbus_radius - eye.limbus_width / 2 - ring.width
    return 1 - ring.darkening * smoothstep((radius - darkest) / ring.fade + 1)


def _film(index, eye: Eye, camera: Camera):
    """Where lines of sight meet the tear film, their directions, and its reflectance."""
    origin, direction = camera.towards(index, eye)
    outside = _Outside.met(eye, origin, direction)
    if eye.lids is not None:
        outside = outside._replace(normal=meniscus_normal(eye, outside.point, outside.normal))
    return outside, direction, 1 - refract_vector(direction, outside.normal, 1.0, TEAR)[1]


class _Outside(NamedTuple):
    """Where lines of sight meet the outer surface: on the cornea's conicoid (`front`) or, where
    they `hit` beside it, on the globe. `blend`: the share of sclera; `iris`: whether it shows."""

    front: Vector
    point: Vector
    normal: Vector
    blend: Float[Array, " pixels"]
    hit: Bool[Array, " pixels"]
    iris: Bool[Array, " pixels"]

    @classmethod
    def met(cls, eye: Eye, origin, direction) -> "_Outside":
        cornea, globe = CorneaSurface(eye), GlobeSurface(eye)
        front, shown, on_cornea = cornea.split(origin, direction)
        normal = cornea.normal(front)
        if eye.sclera is None:
            none = jnp.zeros_like(front[..., 0])
            return cls(front, front, normal, none, on_cornea, on_cornea)
        point, on_globe = globe.meet(origin, direction)
        normal = choose(on_cornea, normal, globe.normal(point))
        point = choose(on_cornea, front, point)
        hit = on_cornea | on_globe
        edge = smoothstep((from_axis(point) - eye.limbus_radius) / eye.limbus_width + 0.5)
        blend = jnp.where(globe.behind(point), 1.0, edge)
        return cls(front, point, normal, blend, hit, hit & shown & (blend < 1))
