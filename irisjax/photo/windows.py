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

from irisjax.anatomy.eye import Eye
from irisjax.numerics.programs import program
from irisjax.photo.pose import Pose
from irisjax.photo.unrefracted import LUMINANCE
from irisjax.render.bands import Bands, colour_bands
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import AbstractIntegrator
from irisjax.render.lights import Lights
from irisjax.render.project import IRIS, SCLERA, IrisPixels, seen_parts
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
_MOST, _LEAST = 96, 24  # pixels of a window: so many are taken of it, or it is left out


class Windows(eqx.Module):
    """Windows of one photograph: their mean colours, and the same of the model as a matrix.

    - `colour`: mean linear values of the photograph, (windows, 3); `error`: standard deviation of
        each mean by the pixels' own spread.
    - `matrix`: from the coefficients of a response to radiance, (windows, channels or 1, products ×
        functions).
    - `angle` (radians), `radius` (mm): of their middles.
    - `bands`, `ranges`, `integrator`, `aqueous_index`: what a response is made with.
    """

    colour: Float[np.ndarray, "windows 3"]
    error: Float[np.ndarray, "windows 3"]
    matrix: Float[Array, "windows tints terms"]
    angle: Float[np.ndarray, " windows"]
    radius: Float[np.ndarray, " windows"]
    bands: Bands
    ranges: Scales
    integrator: AbstractIntegrator
    aqueous_index: Float[Array, ""]

    def radiance(self, iris: Iris) -> Float[Array, "windows 3"]:
        """Mean linear sRGB of an iris in each window, where a white sheet facing an irradiance of π
        has 1.
        """
        parts = self.aqueous_index, self.bands, self.ranges
        found: Any = self.integrator.response(iris, *parts)
        terms = found.coefficients.reshape(-1, 3)
        return jnp.einsum("wtk,kt->wt", jnp.broadcast_to(self.matrix, self._full), terms)

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

    @property
    def _full(self):
        return (self.matrix.shape[0], 3, self.matrix.shape[2])


def windows_of(
    pixels: Float[np.ndarray, "rows columns 3"],
    clear: Bool[np.ndarray, "rows columns"],
    pose: Pose,
    iris: Iris,
    maps: IrisMaps,
    lights: Lights,
    integrator: Separable | RadiativeIntegrator,
    tables: Illumination | None,
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

    Raises:
        ValueError: If hardly any window is free.
    """
    seen = look(pose.eye, pose.camera).iris
    if seen is None:
        raise ValueError("the camera does not see the iris")
    index, window, place = _chosen(seen, clear & iris_alone(pose), pose.eye)
    count = int(window.max()) + 1 if window.size else 0
    if count < 6:
        raise ValueError(
            f"only {count} windows of the iris are free of highlights, lashes and lids; 6 are the "
            "least that pigments can be told from"
        )
    some = dataclasses.replace(
        jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)[index]), _unnumbered(seen)),
        index=None,
    )
    picture = pixels.reshape(-1, 3)[_numbers(seen)[index]]
    share = np.bincount(window, minlength=count)
    mean, spread = _moments(picture, window, count, share)
    ranges = ranges_of(iris, maps)
    bands = colour_bands(lights.illuminant, cornea=pose.eye.cornea)
    made = integrator.prepare(iris, pose.eye.aqueous_index, bands, ranges)
    matrix = _matrix(
        some, jnp.asarray(window), count, lights, pose.eye, iris, maps, tables, ranges, bands, made
    )
    angle = np.arctan2(*(np.bincount(window, f(place[0]), count) for f in (np.sin, np.cos)))
    radius = np.bincount(window, place[1], count) / share
    return Windows(
        mean,
        spread / np.sqrt(share)[:, None],
        matrix,
        angle,
        radius,
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
    index, name = [], []
    for w in range(ANGLES * RINGS):
        of = np.flatnonzero(window == w)
        if len(of) < _LEAST:
            continue
        index.append(of[np.linspace(0, len(of) - 1, min(_MOST, len(of))).astype(int)])
        name.append(np.full(len(index[-1]), len(name)))
    if not index:
        return np.empty(0, int), np.empty(0, int), (np.empty(0), np.empty(0))
    chosen = np.concatenate(index)
    return chosen, np.concatenate(name), (around[chosen], r[chosen])


def _moments(values, window: Int[np.ndarray, " pixels"], count: int, share):
    """Mean and standard deviation of values (pixels, 3) in each window."""
    mean, square = (
        np.stack([np.bincount(window, v[:, k], count) for k in range(3)], -1) / share[:, None]
        for v in (values, values.astype(np.float64) ** 2)
    )
    return mean, np.sqrt(np.maximum(square - mean**2, 0))


@program
def _matrix(seen, window, count: int, lights, eye, iris, maps, tables, ranges, bands, integrator):
    texels, ground = integrator.place(seen, lights, eye, iris, maps, tables, ranges)
    response = integrator.response(iris, eye.aqueous_index, bands, ranges)
    one = response.coefficients[..., :1]
    share = jnp.zeros(count).at[window].add(1.0)

    def means(coefficients):
        held = eqx.tree_at(lambda r: r.coefficients, response, coefficients.reshape(one.shape))
        shaded = held.shade(texels, ground)
        return jnp.zeros((count, shaded.shape[0])).at[window].add(shaded.T) / share[:, None]

    flat = jnp.zeros(one.size, one.dtype)
    return jax.lax.map(
        lambda direction: jax.jvp(means, (flat,), (direction,))[1], jnp.eye(one.size)
    ).transpose(1, 2, 0)
