"""A scene as Mitsuba 3 reads it: an XML file beside the meshes and textures of
`irisjax.export.handover`.

Mitsuba's frame is right-handed: x right, y up, +z out of the eye, so every z changes its sign.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from string import Template

import numpy as np

from irisjax.render.scene import Scene

WIDEST = math.radians(20.0)
"""Least angular radius of a lamp in front of a cornea. Paths meet a lamp by chance alone, and a
smaller one too seldom.
"""
_FAR = 1e4  # mm, distance of the discs that represent distant lamps

_Rgb = Sequence[float] | np.ndarray


def mitsuba_scene(scene: Scene, *, relief: bool, white: _Rgb | None, haze: _Rgb | None) -> str:
    """The XML of a scene, for a folder with the files of `irisjax.export.handover`.

    Args:
        scene: The scene.
        relief: Whether relief.exr tilts the surface.
        white: Albedo of the sclera, linear sRGB, or `None`.
        haze: Transmittance of one passage of the cornea, linear sRGB; `None` for a clear one.
    """
    eye, camera = scene.eye, scene.camera
    origin = np.asarray(camera.position(eye), np.float64)
    target = np.array([0.0, 0.0, float(eye.iris_depth)])
    distance, width = float(camera.distance), float(camera.width)
    # Like the camera itself: upright along the eye's y, or along z where it looks along y.
    sideways = np.hypot(*(target - origin)[[0, 2]]) < 1e-6 * distance
    solid = eye.cornea is None or eye.cornea.posterior is None
    index = eye.aqueous_index if eye.cornea is None or solid else eye.cornea.index
    parts = {
        "relief": relief,
        "flat": not relief,
        "anterior": eye.cornea is not None,
        "posterior": not solid,
        "environment": scene.environment is not None,
    }
    values = {
        **{name: "" for name, here in parts.items() if here},
        "origin": ", ".join(_turned(origin)),
        "target": ", ".join(_turned(target)),
        "up": ", ".join(_turned([0, 0, 1] if sideways else [0, 1, 0])),
        "field": f"{2 * math.degrees(math.atan(width / 2 / distance)):.12g}",
        "near": f"{distance / 100:g}",
        "far": f"{10 * distance:g}",
        "columns": str(camera.size[0]),
        "rows": str(camera.size[1]),
        "cornea": f"{float(index):g}",
        "chamber": f"{float(eye.aqueous_index):g}",
        "haze": None if haze is None else _numbers(haze),
        "white": None if white is None else _numbers(white),
        "lamps": "\n".join(_lamps(scene)) or None,
    }
    return filled("scene.xml", values)


def filled(name: str, values: Mapping[str, str | None]) -> str:
    """Fill in a template beside this module: `values` for its `$NAME`, without the lines that begin
    with the `?NAME` of a value that is absent.
    """
    lines = []
    for line in Path(__file__).with_name(name).read_text(encoding="utf-8").splitlines():
        if line.startswith("?"):
            needed, _, line = line[1:].partition(" ")
            if values.get(needed) is None:
                continue
        lines.append(line)
    return Template("\n".join(lines) + "\n").substitute(values)


def _lamps(scene: Scene) -> Iterator[str]:
    lights = scene.lights
    if lights is None:
        return
    for i in range(len(lights)):
        towards = np.asarray(lights.towards[i], np.float64)
        colour = np.ones(3) if lights.tint is None else np.asarray(lights.tint[i], np.float64)
        colour = colour * float(lights.irradiance[i])
        distance = math.inf if lights.distance is None else float(lights.distance[i])
        values: dict[str, str | None] = {}
        if scene.eye.cornea is not None:
            radius, away = max(float(lights.radius[i]), WIDEST), min(distance, _FAR)
            upright = abs(towards[1]) <= (1 - 1e-9) * np.linalg.norm(towards)
            place, colour = away * towards, colour / (math.pi * math.sin(radius) ** 2)
            size = f"{away * math.tan(radius):.9g}"
            values = {"disc": "", "size": size, "up": "0, 1, 0" if upright else "1, 0, 0"}
        elif math.isfinite(distance):
            values["point"], place, colour = "", distance * towards, colour * distance**2
        else:
            values["distant"], place = "", -towards
        x, y, z = _turned(place)
        values |= {"x": x, "y": y, "z": z, "colour": _numbers(colour)}
        yield filled("lamp.xml", values).removesuffix("\n")


def _turned(point: Iterable[float]) -> tuple[str, str, str]:
    x, y, z = (float(v) for v in point)
    return f"{x:.12g}", f"{y:.12g}", f"{0.0 - z:.12g}"


def _numbers(rgb: _Rgb) -> str:
    return ", ".join(f"{float(v):.9g}" for v in rgb)
