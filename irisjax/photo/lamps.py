"""Lamps from their images on the cornea: a mirror whose shape is known tells where they stand."""

from typing import Any, cast

import numpy as np
import skimage.measure
from jaxtyping import Float

from irisjax.anatomy.eye import Eye
from irisjax.photo.pose import Pose
from irisjax.render.environment import Environment
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.shading import fluxes_of
from irisjax.render.stages import look

AROUND = 25
"""Lights that stand for a room of which nothing is known."""
_LEAST = 5  # pixels of a highlight
_MOST = 6  # lamps


def lamps_of(part: Float[np.ndarray, "rows columns 3"], pose: Pose) -> tuple[Lights, int]:
    """Lamps at infinity in the directions that highlights mirror, and how many.

    They share an irradiance of π by their areas on the picture: the highlights are cut off, so
    their brightness is not known. Without a highlight light comes from all round alike, and the
    count is 0.

    Args:
        part: Linear, of the size of the camera's picture.
        pose: Of `find_pose`.
    """
    seen = look(pose.eye, pose.camera).mirror
    spots = _spots(part)
    if seen is None or not spots:
        return Environment.uniform().to_lights(AROUND), 0
    mirror = np.stack([np.asarray(c) for c in seen.mirror], -1)
    number = np.arange(len(mirror)) if seen.index is None else np.asarray(seen.index)
    place = np.full(part.shape[0] * part.shape[1], -1)
    place[number[number >= 0]] = np.flatnonzero(number >= 0)
    place = place.reshape(part.shape[:2])
    towards, area = [], []
    for spot in spots:
        at = place[tuple(spot.coords.T)]
        if (at < 0).mean() > 0.5:
            continue
        mean = mirror[at[at >= 0]].mean(0)
        towards.append(mean / np.linalg.norm(mean))
        area.append(spot.area)
    if not towards:
        return Environment.uniform().to_lights(AROUND), 0
    towards, share = np.array(towards), np.array(area) / sum(area)
    polar = np.arccos(np.clip(-towards[:, 2], -1, 1))
    azimuth = np.arctan2(towards[:, 1], towards[:, 0])
    # As wide as the image: one on a mirror of half the cornea's radius.
    size = np.sqrt(np.array(area) / np.pi) * float(pose.camera.width) / pose.camera.size[0]
    assert pose.eye.cornea is not None
    radius = np.clip(2 * size / float(pose.eye.cornea.anterior.radius), 0.005, 0.5)
    found: list[Any] = [polar, azimuth, np.pi * share]
    return Lights.distant(*found, radius=cast(Any, radius)), len(towards)


def tangent_of(lights: Lights, eye: Eye, tables: Illumination | None) -> tuple[float, float]:
    """Horizontal over vertical part of the light that falls on the iris, along x and y, in the
    chamber: a mean over the iris weighted by irradiance.
    """
    flux = np.asarray(fluxes_of(lights, eye, tables, 41)).sum(0)
    line = np.linspace(-1, 1, flux.shape[-1])
    inside = np.hypot(line[None], line[:, None]) < 0.85
    x, y, z = (part[inside].sum() for part in flux)
    # Towards the light, which travels the other way.
    return float(-x / z), float(-y / z)


def _spots(part):
    """Highlights within the cornea, the largest first."""
    brightness = part.max(-1)
    rows, columns = brightness.shape
    row, column = np.ogrid[:rows, :columns]
    middle = np.hypot(row - rows / 2, column - columns / 2) < 0.37 * min(rows, columns)
    typical = np.median(brightness[middle])
    bright = middle & (brightness > max(0.97, 4 * typical))
    regions = skimage.measure.regionprops(skimage.measure.label(bright))
    large = sorted((r for r in regions if r.area >= _LEAST), key=lambda r: -r.area)
    return large[:_MOST]
