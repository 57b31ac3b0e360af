"""Frames of a scene in which one thing changes."""

import dataclasses
import math
from collections.abc import Callable, Iterator

import numpy as np

from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.picture import illuminate, prepared_scene, respond, shade, texture
from irisjax.render.project import look
from irisjax.render.scene import Scene

CHANGES = ("pupil", "light", "pigment")
NARROW, WIDE = 1.0, 3.5
"""Radii of the pupil at the turning points of `pupil`, mm."""
TURN = math.radians(75.0)
"""Largest angle of the lamp off the axis in `light`, from the picture's right to its left and back.
"""
FACTOR = 8.0
"""By which `pigment` divides both melanins, and multiplies them, or by more where that stays below
`DARK`.
"""
DARK = 3.0
"""Concentration of both melanins together in a brown eye, mg/ml."""


def frames(
    scene: Scene,
    change: str,
    count: int,
    tables_of: Callable[[Scene], Illumination | None] = Scene.tables,
) -> Iterator[np.ndarray]:
    """Linear sRGB pictures of one round: there and back again, the last leads to the first."""
    swing = np.cos(2 * np.pi * np.arange(count) / count)  # 1 to −1 and back
    if change == "light":
        scene = scene.replace(
            lights=Lights.distant(TURN, 0.0, illuminant=scene.illuminant), environment=None
        )
    # Neither tables nor view depend on what changes: the lamp stays below grazing.
    scene, tables, view = prepared_scene(scene), tables_of(scene), look(scene.eye, scene.camera)
    texels = texture(view, scene)
    light = illuminate(view, texels, scene, tables)
    response = respond(scene)
    melanin = float(scene.tissue.eumelanin + scene.tissue.pheomelanin)
    darkest = max(FACTOR, DARK / melanin) if melanin > 0 else FACTOR
    for s in swing:
        if change == "pigment":
            iris, factor = scene.tissue, (darkest * FACTOR) ** ((1 - s) / 2) / FACTOR
            iris = iris.replace(
                eumelanin=iris.eumelanin * factor, pheomelanin=iris.pheomelanin * factor
            )
            response = respond(scene.replace(iris=iris))
        elif change == "light":
            lamp = Lights.distant(
                TURN * abs(s), 0.0 if s >= 0 else math.pi, illuminant=scene.illuminant
            )
            light = illuminate(view, texels, scene.replace(lights=lamp), tables)
        else:
            radius = (NARROW + WIDE) / 2 - (WIDE - NARROW) / 2 * s
            wider = scene.replace(eye=dataclasses.replace(scene.eye, pupil_radius=radius))
            texels = texture(view, wider)
            light = illuminate(view, texels, wider, tables)
        yield np.asarray(shade(view, texels, light, response))


def sheet(pictures: list[np.ndarray]) -> np.ndarray:
    """All pictures side by side, as square as it goes, row by row."""
    columns = math.ceil(math.sqrt(len(pictures)))
    rows = math.ceil(len(pictures) / columns)
    blank = np.zeros_like(pictures[0])
    padded = pictures + [blank] * (rows * columns - len(pictures))
    return np.concatenate(
        [np.concatenate(padded[i * columns : (i + 1) * columns], axis=1) for i in range(rows)]
    )
