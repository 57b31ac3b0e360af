"""Windows of the iris whose colours are compared, and the renderer as a matrix for them  [F09
Section 5.2].

A picture is linear in the coefficients of the iris's response: what the lights, the cornea and the
thickness map make of them is worked out once, and a change of pigments costs a product with a small
matrix.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye
from irisjax.numerics.programs import program
from irisjax.photo.pose import Pose
from irisjax.photo.unrefracted import LUMINANCE
from irisjax.render.bands import Bands, colour_bands
from irisjax.render.environment import Environment
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import AbstractIntegrator
from irisjax.render.lights import Lights
from irisjax.render.project import IRIS, SCLERA, IrisPixels, MirrorPixels, seen_parts
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.separable import Separable
from irisjax.render.shading import ranges_of
from irisjax.render.stages import look
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, Scales

ANGLES, RINGS = 16, 4
"""Windows round the iris and across it."""
MARGIN = 0.35
"""Kept off the pupil's edge and off the root, mm."""
_COUNT = ANGLES * RINGS
_AROUND = 25  # lights that stand for a room
_MOST, _LEAST = 96, 24  # pixels of a window: so many are taken of it, or it is left out


class Windows(eqx.Module):
    """Windows of one photograph: their mean colours, and the same of the model as a matrix.

    - `colour`: mean linear values of the photograph, (windows, 3); `error`: standard deviation of
        each mean by the pixels' own spread. `present`: windows with enough pixels; the others stand
        empty, so that every photograph has the same shapes.
    - `matrix`: from the coefficients of a response to radiance, (windows, channels or 1, products ×
        functions). `room`: the same of a uniform room of radiance 1 in place of the lights, or
        `None` where nothing but the lights is thought of; `veil`: share of its radiance that the
        tear film mirrors.
    - `angle` (radians), `radius` (mm): of their middles.
    - `bands`, `ranges`, `integrator`, `aqueous_index`: what a response is made with.
    """

    colour: Float[np.ndarray, "windows 3"]
    error: Float[np.ndarray, "windows 3"]
    present: Bool[np.ndarray, " windows"]
    matrix: Float[Array, "windows tints terms"]
    room: Float[Array, "windows tints terms"] | None
    veil: Float[np.ndarray, " windows"]
    angle: Float[np.ndarray, " windows"]
    radius: Float[np.ndarray, " windows"]
    bands: Bands
    ranges: Scales
    integrator: AbstractIntegrator
    aqueous_index: Float[Array, ""]

    def radiance(self, iris: Iris, room: Scalar | float = 0.0) -> Float[Array, "windows 3"]:
        """Mean linear sRGB of an iris in each window, where a white sheet facing an irradiance of π
        has 1; `room`: radiance of the room beside the lights.
        """
        parts = self.aqueous_index, self.bands, self.ranges
        found: Any = self.integrator.response(iris, *parts)
        terms = found.coefficients.reshape(-1, 3)
        matrix = self.matrix if self.room is None else self.matrix + room * self.room
        full = (matrix.shape[0], 3, matrix.shape[2])
        shown = jnp.einsum("wtk,kt->wt", jnp.broadcast_to(matrix, full), terms)
        return shown if self.room is None else shown + room * self.veil[:, None]

    def thickness_response(self, iris: Iris) -> float:
        """d ln luminance / d ln stroma's thickness of an iris, about its mean thickness, seen and
        lit from the front.
        """
        found: Any = self.integrator.response(iris, self.aqueous_index, self.bands, self.ranges)
        scale = jnp.asarray([0.9, 1.1])
        one = jnp.ones_like(scale)
        scales = Scales(stroma=scale)
        seen = jnp.asarray(LUMINANCE, scale.dtype) @ found.brdf(scales, one, one, 0 * one)
        return float(jnp.log(seen[1] / seen[0]) / jnp.log(1.1 / 0.9))


def windows_of(
    pixels: Float[np.ndarray, "rows columns 3"],
    clear: Bool[np.ndarray, "rows columns"],
    pose: Pose,
    iris: Iris,
    maps: IrisMaps,
    lights: Lights,
    integrator: Separable | RadiativeIntegrator,
    tables: Illumination | None,
    room: bool = False,
) -> Windows:
    """Choose windows and make their matrix.

    Args:
        pixels: Linear, of the part of the photograph that the pose's camera shows.
        clear: Pixels that show the iris: no highlight, lash, lid or freckle.
        pose: Of `find_pose`.
        iris: Fixes everything but the melanins.
        maps: Thickness of the stroma.
        lights: All of them.
        integrator: ILIT's or that of radiative transfer.
        tables: Of the eye, `None` without a cornea.
        room: Whether there may be light from all round beside the lights.

    Raises:
        ValueError: If hardly any window is free.
    """
    view = look(pose.eye, pose.camera)
    seen = view.iris
    if seen is None:
        raise ValueError("the camera does not see the iris")
    index, window, place = _chosen(seen, clear & iris_alone(pose), pose.eye)
    share = np.bincount(window, minlength=_COUNT)[:_COUNT]
    present = share > 0
    if present.sum() < 6:
        raise ValueError(
            f"only {present.sum()} windows of the iris are free of highlights, lashes and lids; 6 "
            "are the least that pigments can be told from"
        )
    some = dataclasses.replace(
        jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)[index]), _unnumbered(seen)),
        index=None,
    )
    picture = pixels.reshape(-1, 3)[_numbers(seen)[index]]
    mean, spread = _moments(picture, window, np.maximum(share, 1))
    mirror = _mirrored(view.mirror, pixels.shape[0] * pixels.shape[1])
    veil = np.bincount(window, mirror[_numbers(seen)[index]])[:_COUNT] / np.maximum(share, 1)
    ranges = ranges_of(iris, maps)
    bands = colour_bands(lights.illuminant, cornea=pose.eye.cornea)
    made = integrator.prepare(iris, pose.eye.aqueous_index, bands, ranges)
    known = pose.eye, iris, maps, tables, ranges, bands, made

    def of(lamps: Lights):
        return _matrix(some, jnp.asarray(window), lamps, *known)

    around = Environment.uniform().to_lights(_AROUND) if room else None
    angle = np.arctan2(*(np.bincount(window, f(place[0]))[:_COUNT] for f in (np.sin, np.cos)))
    return Windows(
        mean,
        spread / np.sqrt(np.maximum(share, 1))[:, None],
        present,
        of(lights),
        None if around is None else of(around),
        veil,
        angle,
        np.bincount(window, place[1])[:_COUNT] / np.maximum(share, 1),
        bands,
        ranges,
        made,
        jnp.asarray(pose.eye.aqueous_index),
    )


def iris_alone(pose: Pose) -> Bool[np.ndarray, "rows columns"]:
    """Pixels of the camera's picture that see the iris and none of the white, which shines through
    at the limbus.
    """
    rows, columns = pose.camera.shape
    every = np.arange(rows * columns, dtype=np.int32)
    seen = np.asarray(seen_parts(every, pose.eye, pose.camera))
    return (seen & (IRIS | SCLERA) == IRIS).reshape(rows, columns)


def _mirrored(mirror: MirrorPixels | None, count: int) -> np.ndarray:
    """Reflectance of the tear film at every pixel of the camera's picture."""
    found = np.zeros(count)
    if mirror is not None:
        reflectance = np.asarray(mirror.reflectance)
        number = np.arange(count) if mirror.index is None else np.asarray(mirror.index)
        found[number[number >= 0]] = reflectance[number >= 0]
    return found


def _unnumbered(seen: IrisPixels) -> IrisPixels:
    return dataclasses.replace(seen, index=None)


def _numbers(seen: IrisPixels) -> np.ndarray:
    count = seen.cosine.size
    return np.arange(count) if seen.index is None else np.asarray(seen.index)


def _chosen(seen: IrisPixels, clear, eye: Eye):
    """Places of pixels among `seen`, the number of each one's window, and its angle and radius."""
    number = _numbers(seen)
    x, y = (np.asarray(c) for c in seen.point[:2])
    r, around = np.hypot(x, y), np.arctan2(y, x) % (2 * np.pi)
    inner = float(eye.pupil_radius) + MARGIN
    outer = min(float(eye.iris_radius), float(eye.limbus_radius)) - MARGIN
    usable = (number >= 0) & (r > inner) & (r < outer) & clear.reshape(-1)[number]
    ring = np.minimum((r - inner) / (outer - inner) * RINGS, RINGS - 1).astype(int)
    sector = np.minimum(around / (2 * np.pi) * ANGLES, ANGLES - 1).astype(int)
    window = np.where(usable, ring * ANGLES + sector, -1)
    # As many of each, those that are missing under the number of no window: one program for all.
    index, name = np.zeros((_COUNT, _MOST), int), np.full((_COUNT, _MOST), _COUNT)
    for w in range(_COUNT):
        of = np.flatnonzero(window == w)
        if len(of) < _LEAST:
            continue
        taken = of[np.linspace(0, len(of) - 1, min(_MOST, len(of))).astype(int)]
        index[w, : len(taken)], name[w, : len(taken)] = taken, w
    # Padding repeats a pixel that is seen.
    index[name == _COUNT] = index[name < _COUNT][0] if (name < _COUNT).any() else 0
    chosen = index.ravel()
    return chosen, name.ravel(), (around[chosen], r[chosen])


def _moments(values, window: Int[np.ndarray, " pixels"], share):
    """Mean and standard deviation of values (pixels, 3) in each window."""
    mean, square = (
        np.stack([np.bincount(window, v[:, k])[:_COUNT] for k in range(3)], -1) / share[:, None]
        for v in (values, values.astype(np.float64) ** 2)
    )
    return mean, np.sqrt(np.maximum(square - mean**2, 0))


@program
def _matrix(seen, window, lights, eye, iris, maps, tables, ranges, bands, integrator):
    texels, ground = integrator.place(seen, lights, eye, iris, maps, tables, ranges)
    response = integrator.response(iris, eye.aqueous_index, bands, ranges)
    one = response.coefficients[..., :1]
    share = jnp.maximum(jnp.zeros(_COUNT).at[window].add(1.0, mode="drop"), 1.0)

    def means(coefficients):
        held = eqx.tree_at(lambda r: r.coefficients, response, coefficients.reshape(one.shape))
        shaded = held.shade(texels, ground)
        added = jnp.zeros((_COUNT, shaded.shape[0])).at[window].add(shaded.T, mode="drop")
        return added / share[:, None]

    flat = jnp.zeros(one.size, one.dtype)
    return jax.lax.map(
        lambda direction: jax.jvp(means, (flat,), (direction,))[1], jnp.eye(one.size)
    ).transpose(1, 2, 0)
