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
_NARROW, _WIDE = 1.0, 3.5  # radii of the pupil at the turning points of `pupil`, mm
_TURN = math.radians(75.0)  # largest angle of the lamp off the axis in `light`
# `pigment` divides both melanins by the first number and multiplies them by it, or by more until
# they reach the second (mg/ml), which a brown eye has.
_FACTOR, _DARK = 8.0, 3.0


def frames(
    scene: Scene,
    change: str,
    count: int,
    tables_of: Callable[[Scene], Illumination | None] = Scene.tables,
) -> Iterator[np.ndarray]:
    """Linear sRGB pictures of one round: there and back again, the last leads to the first."""

    def lamp(s: float) -> Lights:
        side = 0.0 if s >= 0 else math.pi
        return Lights.distant(_TURN * abs(s), side, illuminant=scene.illuminant)

    swing = np.cos(2 * np.pi * np.arange(count) / count)  # 1 to −1 and back
    if change == "light":
        scene = scene.replace(lights=lamp(1.0), environment=None)
    # Neither tables nor view depend on what changes: the lamp stays below grazing.
    scene, tables, view = prepared_scene(scene), tables_of(scene), look(scene.eye, scene.camera)
    texels = texture(view, scene)
    light = illuminate(view, texels, scene, tables)
    response = respond(scene)
    melanin = float(scene.tissue.eumelanin + scene.tissue.pheomelanin)
    darkest = max(_FACTOR, _DARK / melanin) if melanin > 0 else _FACTOR
    for s in swing:
        if change == "pigment":
            iris, factor = scene.tissue, (darkest * _FACTOR) ** ((1 - s) / 2) / _FACTOR
            melanins = {n: factor * getattr(iris, n) for n in ("eumelanin", "pheomelanin")}
            response = respond(scene.replace(iris=iris.replace(**melanins)))
        elif change == "light":
            light = illuminate(view, texels, scene.replace(lights=lamp(s)), tables)
        else:
            radius = (_NARROW + _WIDE) / 2 - (_WIDE - _NARROW) / 2 * s
            wider = scene.replace(eye=dataclasses.replace(scene.eye, pupil_radius=radius))
            texels = texture(view, wider)
            light = illuminate(view, texels, wider, tables)
        yield np.asarray(shade(view, texels, light, response))


def sheet(pictures: list[np.ndarray]) -> np.ndarray:
    """All pictures side by side, as square as it goes, row by row."""
    columns = math.ceil(math.sqrt(len(pictures)))
    rows = math.ceil(len(pictures) / columns)
    padded = np.zeros((rows * columns, *pictures[0].shape), pictures[0].dtype)
    padded[: len(pictures)] = pictures
    height, width = pictures[0].shape[:2]
    grid = padded.reshape(rows, columns, height, width, -1).swapaxes(1, 2)
    return grid.reshape(rows * height, columns * width, -1)
