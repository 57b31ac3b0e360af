"""Thickness of the simulated photographs' eyes, and how near a clone comes to it."""

import json
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from experiments.simulated_photographs import FOLDER
from irisjax.io import read_maps
from irisjax.photo.clone import FIBRILS, Given, Shaped
from irisjax.photo.texture import Unrefracted
from irisjax.photo.windows import MARGIN
from irisjax.render.environment import Environment
from irisjax.render.lights import Lights

STEP = 0.05
"""Of radii, mm."""


class Truth(NamedTuple):
    """Thickness (mm) at the texels of a clone's texture, and which of them are compared."""

    thickness: np.ndarray
    used: np.ndarray


def true_thickness(colour: str, texture: Unrefracted, folder: Path = FOLDER) -> Truth:
    """What the photograph was made with."""
    numbers = _numbers(colour, folder)
    depth = np.asarray(read_maps(folder / numbers["maps"]).stroma_depth)
    angles, radii = depth.shape
    inner, outer = (numbers["eye"][f"{n}_radius"] for n in ("pupil", "iris"))
    radius, turn = texture.radius(), texture.angle() % (2 * np.pi)
    place = turn / (2 * np.pi) * angles - 0.5, (radius - inner) / (outer - inner) * radii - 0.5
    around = np.concatenate([depth[-2:], depth, depth[:2]])
    found = ndimage.map_coordinates(around, [place[0] + 2, place[1]], order=1, mode="nearest")
    known = (radius > inner) & (radius < outer)
    rim = max(inner, texture.pupil_radius) + MARGIN
    used = texture.valid & (radius > rim) & (radius < texture.iris_radius - MARGIN)
    return Truth(np.where(known, found, 0), used)


def premises(colour: str, folder: Path = FOLDER) -> tuple[Given, dict[str, float]]:
    """Return what F09 measured before its search: the light; exposure, white balance and scattering
    by the names of `simplex`.
    """
    numbers = _numbers(colour, folder)
    lamp, (red, green, blue) = numbers["lamp"], numbers["gains"]
    polar, azimuth, radius = (
        math.radians(lamp[f"{n}_deg"]) for n in ("polar", "azimuth", "radius")
    )
    lights = Lights.distant(polar, azimuth, lamp["irradiance"], radius=radius)
    room = Environment.uniform(numbers["room_radiance"])
    iris = numbers["iris"]
    known = {
        "exposure": numbers["exposure"] * green,
        "red_gain": red / green,
        "blue_gain": blue / green,
        "hemoglobin": iris["oxyhemoglobin"] + iris["deoxyhemoglobin"],
        "scattering_scale": iris["scattering_scale"] * scattering_of(iris["fibril_radius"]),
    }
    return Given(lights=lights, environment=room), known


def scattering_of(radius: float) -> float:
    """Return how much fibrils of a radius (nm) scatter beside those of clones: LB06's coefficient
    grows as r³.
    """
    return (radius / FIBRILS) ** 3


def _numbers(colour: str, folder: Path) -> dict[str, Any]:
    every = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["photographs"]
    return next(p for p in every if p["file"] == f"{colour}.jpg")


def correlation(found: Shaped, thickness: np.ndarray, used: np.ndarray) -> tuple[float, float]:
    """Of a true and a clone's deviations from the mean at their radius; and the spread of the
    clone's over that of the true ones.
    """
    ring = (found.texture.radius()[used] / STEP).astype(int)
    count = np.maximum(np.bincount(ring), 1)
    pair = thickness[used], found.morphology.thickness[used]
    true, told = (v - (np.bincount(ring, v) / count)[ring] for v in pair)
    return float(np.corrcoef(true, told)[0, 1]), float(told.std() / true.std())
