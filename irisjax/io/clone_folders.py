"""Read the folder of a clone: its scene, and the photograph that its camera saw."""

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from irisjax.io.images import encode_png, read_image
from irisjax.io.scenes import SceneFile, read_scene
from irisjax.io.tables import naming

PHOTOGRAPH = "photograph.png"
"""The part of the photograph that the clone's camera shows."""


class CloneFolder(NamedTuple):
    """A clone's scene file, and the photograph at the size of its picture, sRGB-encoded."""

    scene: SceneFile
    photograph: UInt8[np.ndarray, "rows columns 3"]


def encode_photograph(encoded: Float[np.ndarray, "rows columns 3"]) -> bytes:
    """Return the bytes of `photograph.png` for sRGB-encoded values in [0, 1]."""
    remark = "part of a photograph; exposure, white balance and contrast taken off by irisjax"
    return encode_png(PHOTOGRAPH, encoded, remark=remark)[0]


def read_clone(folder: str | Path) -> CloneFolder:
    """Read the folder of a clone; `ValueError` where a file is missing or cannot be read, or the
    photograph has another size than the scene's picture.
    """
    folder = Path(folder)
    check_summary(folder)
    path = folder / PHOTOGRAPH
    for file, role in (
        ("scene.toml", "it was stopped before its pigments; run irisjax clone to the end"),
        (PHOTOGRAPH, "run irisjax clone again"),
    ):
        if not (folder / file).exists():
            raise ValueError(f"{folder}: the clone has no {file}: {role}")
    scene = read_scene(folder / "scene.toml")
    pixels = read_image(path).pixels
    width, height = scene.scene().camera.size
    if pixels.shape != (height, width, 3):
        rows, columns, channels = pixels.shape
        rule = f"must be {width} x {height} of 3, the size in scene.toml"
        raise ValueError(f"{path}: is {columns} x {rows} pixels of {channels} channels, {rule}")
    return CloneFolder(scene, np.rint(255 * pixels).astype(np.uint8))


def check_summary(folder: Path) -> dict[str, Any]:
    """Return the contents of a clone's `clone.json`; `ValueError` without a readable one."""
    path = folder / "clone.json"
    if not path.exists():
        raise ValueError(f"{folder}: has no clone.json, it is not the folder of a clone")
    with naming(f"{path}: broken"):
        summary = json.loads(path.read_text(encoding="utf-8"))
        if not (isinstance(summary, dict) and {"photograph", "limbus", "pupil"} <= summary.keys()):
            raise ValueError("photograph, limbus and pupil must be in it")
    return summary
