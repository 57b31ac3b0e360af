"""`project`: the point of each surface that a pixel sees, and the share of its light that reaches
the pixel.
"""

import dataclasses
import functools
import math
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
from irisjax.render.camera import AnySize, Camera
from irisjax.render.lids import LidPixels, lash_coverage, meet_lids, meniscus_normal, trace_lids
from irisjax.render.refraction import cornea_point, refract_to_iris
from irisjax.render.surfaces import CorneaSurface, GlobeSurface, IrisSurface

IRIS, SCLERA, MIRROR, LIDS = 1, 2, 4, 8
"""Flags of the parts that a pixel sees; `MIRROR` is the tear film."""
# `project_visible` pads the pixels of a part to a multiple of this number or, if it is larger, of
# about a sixteenth to an eighth of them.
_PAD = 2048
LEAST_PADDED = 1 << 12
"""Least number of pixels that those of a picture drawn once are padded to."""
_MANY = 1 << 18  # pixels beyond which those of a picture drawn once are padded by less


class IrisPixels(eqx.Module):
    """Pixels that may see the iris.

    Attributes:
        index: Number of each pixel in the picture; −1 for padding, `None` where they are all
            pixels.
        point: Point of the iris, mm.
        direction: Direction of the line of sight in the chamber, into the eye.
        cosine: Cosine of the exit angle to the flat iris.
        share: Share transmitted on the way out, over n² of the chamber, times the share of the
            pixel that is iris at the limbus; 0 where the iris is not visible.
        turn: Angle by which the maps are rotated for each pixel, radians; `None` for none.
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
        share: Share of the pixel that is sclera, which blends with the iris at the limbus; 0 where
            it is not visible.
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
        reflectance: Reflectance of the film; 0 where it is not visible.
    """

    index: Int[Array, " pixels"] | None
    point: Parts
    mirror: Parts
    reflectance: Float[Array, " pixels"]


VisiblePart = IrisPixels | ScleraPixels | MirrorPixels | LidPixels
"""Pixels that may see a part of the eye, or its lids."""


class View(eqx.Module):
    """The parts of an eye that a camera sees; absent parts are `None`.

    Shares and reflectances of the parts include what lashes cover.

    Attributes:
        iris: The pixels that see the iris.
        sclera: The pixels that see the sclera.
        mirror: The pixels that see the tear film.
        size: Columns and rows of the picture.
        lids: The pixels that see lids.
        lashes: Share of each pixel of the picture that lashes cover.
    """

    iris: IrisPixels | None
    sclera: ScleraPixels | None
    mirror: MirrorPixels | None
    size: tuple[int, int] = eqx.field(static=True)
    lids: LidPixels | None = None
    lashes: Float[Array, " pixels"] | None = None


def pixel_numbers(part: VisiblePart) -> Int[np.ndarray, " pixels"]:
    """Return the number of each pixel of a part, counted along the picture's rows; −1 is
    padding.
    """
    count = jax.tree.leaves(part)[-1].shape[-1]
    return np.arange(count) if part.index is None else np.asarray(part.index)


def scatter_to_picture(
    part: VisiblePart, values: Shaped[np.ndarray, "pixels *channels"], shape: tuple[int, int]
) -> Shaped[np.ndarray, "rows columns *channels"]:
    """Write the values of a part's pixels into a picture that is 0 elsewhere."""
    index = pixel_numbers(part)
    picture = np.zeros((shape[0] * shape[1], *values.shape[1:]), values.dtype)
    picture[index[index >= 0]] = values[index >= 0]
    return picture.reshape(*shape, *values.shape[1:])


def project(eye: Eye, camera: Camera) -> View:
    """Find what each pixel of a camera sees of an eye. Each part has all pixels, in the order of
    the picture.

    Pure, with fixed shapes: works under `jit`, `vmap` and `grad`. Where a pixel does not see a
    part, its share is 0 and all values are finite. The globe's edge against the background is
    sharp, and has no derivatives.
    """
    rows, columns = camera.shape
    index = jnp.arange(rows * columns, dtype=jnp.int32)
    has_cornea = eye.cornea is not None
    has_sclera = has_cornea and eye.sclera is not None
    tracers: Any = (trace_iris, True), (trace_sclera, has_sclera), (trace_tear_film, has_cornea)
    projected = (trace(index, eye, camera) if present else None for trace, present in tracers)
    shown = [None if p is None else dataclasses.replace(p, index=None) for p in projected]
    if eye.lids is None:
        return View(*shown, size=(columns, rows))
    lid_share = jnp.where(visible_parts(index, eye, camera) == LIDS, 1.0, 0.0)
    shown = [None if p is None else _attenuate(p, 1 - lid_share) for p in shown]
    lids = _attenuate(dataclasses.replace(trace_lids(index, eye, camera), index=None), lid_share)
    view = View(*shown, size=(columns, rows), lids=lids)
    return _attenuate_by_lashes(view, lash_coverage(eye, camera))


def project_visible(eye: Eye, camera: Camera, *, once: bool = False) -> View:
    """Compute `project` with only those pixels of each part that see it, padded.

    It is faster, but their number decides the shapes: it runs on the host, not under `jit`.

    Args:
        eye: The eye.
        camera: The camera.
        once: Whether the view serves for one picture or two. Numbers of pixels are then padded to
            powers of four, at most to the power of two that the picture has room in, and large ones
            by less; and its programs do not depend on the picture's size. Most pictures share them,
            and to compile takes longer than to draw the padding.
    """
    (trace,) = project_shares(eye, camera, 1, once=once)
    return trace()


def project_shares(
    eye: Eye, camera: Camera, shares: int, *, once: bool = False
) -> list[Callable[[], View]]:
    """Find what each pixel of a camera sees, and divide the pixels of each part evenly.

    Args:
        eye: The eye.
        camera: The camera.
        shares: Number of shares.
        once: As of `project_visible`.

    Returns:
        Functions that trace a share; radiances in these views add up to those of `project_visible`.
    """
    rows, columns = camera.shape
    count, is_band = rows * columns, camera.rows is not None
    all_pixels = np.arange(count, dtype=np.int32)

    def padded_length(length: int) -> int:
        if not once:
            block = max(_PAD, 1 << max(length.bit_length() - 4, 0)) if count >= _PAD else count
            return -(-length // block) * block
        bits, most = ((max(n, LEAST_PADDED) - 1).bit_length() for n in (length, count))
        if length > _MANY:  # by a quarter at most
            return -(-length >> (bits - 3)) << (bits - 3)
        return 1 << min(bits + bits % 2, most)

    padding = 0, (padded_length(count) if once else count) - count
    rays = AnySize.of(camera) if once else camera
    seen = visible_parts(jnp.asarray(np.pad(all_pixels, padding, mode="edge")), eye, rays)
    visible = np.asarray(seen)[:count]
    tracers = {IRIS: trace_iris, SCLERA: trace_sclera, MIRROR: trace_tear_film, LIDS: trace_lids}
    indices = {
        part: np.array_split(np.flatnonzero(visible & part).astype(np.int32), shares)
        for part in tracers
    }

    def select(part: int, share: int) -> Any:
        index = indices[part][share]
        trace: Callable[..., Any] = tracers[part]
        if not index.size:
            return None
        if index.size == count and not is_band and not once:
            return dataclasses.replace(trace(all_pixels, eye, camera), index=None)
        # Padding to few different lengths saves compilations, for which a camera that turns would
        # wait. A band of a picture may see anything from no iris to iris alone: all bands are
        # padded to one length.
        length = -(-count // shares) if is_band else index.size
        padding = 0, padded_length(length) - index.size
        traced = trace(np.pad(index, padding, mode="edge"), eye, rays)
        numbers = np.pad(index, padding, constant_values=-1)
        return dataclasses.replace(traced, index=jnp.asarray(numbers))

    lashes = lash_coverage(eye, camera)

    def trace_share(share: int) -> View:
        iris, sclera, mirror, lids = (select(part, share) for part in tracers)
        view = View(iris, sclera, mirror, size=(columns, rows), lids=lids)
        view = _attenuate_by_lashes(view, lashes)
        return view if share == 0 else dataclasses.replace(view, lashes=None)

    return [functools.partial(trace_share, k) for k in range(shares)]


def _attenuate_by_lashes(view: View, lashes: Float[Array, " pixels"] | None) -> View:
    """Reduce the parts of a view by what lashes cover of each pixel of the picture."""
    if lashes is None:
        return view
    shown: dict[str, Any] = {
        name: _attenuate(part, 1 - (lashes if part.index is None else lashes[part.index]))
        for name in ("iris", "sclera", "mirror", "lids")
        if (part := getattr(view, name)) is not None
    }
    return dataclasses.replace(view, **shown, lashes=lashes)


def _attenuate(part: Any, factor: Float[Array, " pixels"]) -> Any:
    """Multiply what pixels see of a part by a factor."""
    name = "reflectance" if isinstance(part, MirrorPixels) else "share"
    return dataclasses.replace(part, **{name: getattr(part, name) * factor})


@pixelwise
def visible_parts(index: Array, eye: Eye, camera: Camera | AnySize) -> Int8[Array, " pixels"]:
    """Find what each pixel sees: a sum of `IRIS`, `SCLERA` and `MIRROR`, or `LIDS`."""
    origin, direction = camera.rays(index, eye)
    if eye.cornea is None:
        return jnp.where(IrisSurface(eye).intersect(origin, direction)[1], IRIS, 0).astype(jnp.int8)
    surface = _OuterSurface.trace(eye, origin, direction)
    sees_sclera = surface.hit & (surface.blend > 0)
    visible = IRIS * surface.iris + SCLERA * sees_sclera + MIRROR * surface.hit
    if eye.lids is not None:
        distance = jnp.where(surface.hit, dot(surface.point - origin, direction), jnp.inf)
        visible = jnp.where(meet_lids(eye, origin, direction) < distance, LIDS, visible)
    return visible.astype(jnp.int8)


@pixelwise
def trace_iris(index: Array, eye: Eye, camera: Camera | AnySize) -> IrisPixels:
    """Trace pixels of these numbers to the iris; those that do not see it get a share of 0."""
    origin, direction = camera.rays(index, eye)
    # Pixels without iris get a line of sight to a point away from all edges, where derivatives are
    # finite.
    aside, zero = 0.5 * eye.iris_radius, jnp.zeros_like(eye.iris_radius)
    ahead = jnp.stack([zero, zero, zero + 1])
    if eye.cornea is None:
        _, visible = IrisSurface(eye).intersect(origin, direction)
        origin = choose(visible, origin, jnp.stack([aside, zero, zero]))
        direction = choose(visible, direction, ahead)
        point, _ = IrisSurface(eye).intersect(origin, direction)
        share = jnp.where(visible, 1.0, 0.0)
    else:
        surface = _OuterSurface.trace(eye, origin, direction)
        elsewhere = cornea_point(eye.cornea, jnp.stack([aside, zero]))
        front = choose(surface.iris, surface.front, elsewhere)
        direction = choose(surface.iris, direction, ahead)
        point, direction, transmitted = refract_to_iris(eye, front, direction)
        iris_share = (1 - surface.blend) * _limbal_ring_share(eye, front)
        share = transmitted * jnp.where(surface.iris, iris_share, 0.0) / eye.aqueous_index**2
    cosine = -dot(direction, eye.iris_normal(point))
    share = jnp.where(cosine > 0, share, 0.0)
    return IrisPixels(index, parts(point), parts(direction), jnp.maximum(cosine, 0), share)


@pixelwise
def trace_sclera(index: Array, eye: Eye, camera: Camera | AnySize) -> ScleraPixels:
    """Trace pixels of these numbers to the sclera."""
    surface, _, reflectance = _tear_film(index, eye, camera)
    share = jnp.where(surface.hit, surface.blend, 0.0)
    # Within the limbus, sclera lies under clear cornea and is lit as if the globe went on: with the
    # cornea's normal, some 16° steeper, it would end at a sharp line in light from the side.
    normal = GlobeSurface(eye).normal(surface.point)
    return ScleraPixels(index, parts(surface.point), parts(normal), reflectance, share)


@pixelwise
def trace_tear_film(index: Array, eye: Eye, camera: Camera | AnySize) -> MirrorPixels:
    """Trace pixels of these numbers to the tear film."""
    surface, direction, reflectance = _tear_film(index, eye, camera)
    mirror = parts(reflect_vector(direction, surface.normal))
    share = jnp.where(surface.hit, reflectance, 0.0)
    if eye.sclera is not None:
        share *= 1 - (1 - eye.sclera.gloss) * surface.blend
    return MirrorPixels(index, parts(surface.point), mirror, share)


def _limbal_ring_share(eye: Eye, front: Vector):
    """Compute the share of the iris's light that the limbal ring transmits, at points of the
    cornea.
    """
    ring = eye.limbal_ring
    if ring is None:
        return 1.0
    radius = from_axis(front)
    x, y, _ = parts(front)
    scale = 1 + ring.unevenness * _waves(x, y, radius)
    darkest = eye.limbus_radius - eye.limbus_width / 2 - ring.width * scale
    return 1 - ring.darkening * smoothstep((radius - darkest) / (ring.fade * scale) + 1)


def _waves(x, y, radius):
    """Compute a sum of waves round the axis, between −1 and 1 and 0 on average.

    The waves go round 1, 2, 3, 5, 8, 13 and 21 times: each of these Fibonacci numbers is the sum of
    the two before, so that a product of complex numbers replaces a cosine. Their heights fall with
    the root of the number.
    """
    inverse = 1 / jnp.where(radius > 0, radius, 1.0)
    before, now, number = (1.0, 0.0), (x * inverse, y * inverse), (0, 1)
    total, most = 0.0, 0.0
    for k in range(7):
        (a, b), (c, d) = before, now
        before, now = now, (a * c - b * d, a * d + b * c)
        number = number[1], sum(number)
        height = number[1] ** -0.5
        total += height * (now[0] * math.cos(k * k) - now[1] * math.sin(k * k))
        most += height
    return total / most


def _tear_film(index, eye: Eye, camera: Camera | AnySize):
    """Return where lines of sight meet the tear film, their directions, and its reflectance."""
    origin, direction = camera.rays(index, eye)
    surface = _OuterSurface.trace(eye, origin, direction)
    if eye.lids is not None:
        surface = surface._replace(normal=meniscus_normal(eye, surface.point, surface.normal))
    return surface, direction, 1 - refract_vector(direction, surface.normal, 1.0, TEAR)[1]


class _OuterSurface(NamedTuple):
    """Intersections of lines of sight with the outer surface of the eye, one a pixel.

    Attributes:
        front: Point on the cornea's conicoid, mm.
        point: Point of the outer surface: on the cornea or, beside it, on the globe.
        normal: Unit normal there.
        blend: Share of sclera, which rises from 0 to 1 across the limbus.
        hit: Whether the line of sight meets the surface at all.
        iris: Whether the iris is visible through it.
    """

    front: Vector
    point: Vector
    normal: Vector
    blend: Float[Array, " pixels"]
    hit: Bool[Array, " pixels"]
    iris: Bool[Array, " pixels"]

    @classmethod
    def trace(cls, eye: Eye, origin, direction) -> "_OuterSurface":
        cornea, globe = CorneaSurface(eye), GlobeSurface(eye)
        front, in_front, hits_cornea = cornea.intersect_conicoid(origin, direction)
        normal = cornea.normal(front)
        if eye.sclera is None:
            zero = jnp.zeros_like(front[..., 0])
            return cls(front, front, normal, zero, hits_cornea, hits_cornea)
        point, hits_globe = globe.intersect(origin, direction)
        normal = choose(hits_cornea, normal, globe.normal(point))
        point = choose(hits_cornea, front, point)
        hit = hits_cornea | hits_globe
        edge = smoothstep((from_axis(point) - eye.limbus_radius) / eye.limbus_width + 0.5)
        blend = jnp.where(globe.behind(point), 1.0, edge)
        return cls(front, point, normal, blend, hit, hit & in_front & (blend < 1))
