"""A scene as Mitsuba 3 reads it: an XML file beside the meshes and textures of
`irisjax.export.handover`.

Mitsuba's frame is right-handed: x right, y up, +z out of the eye, so every z changes its sign.
"""

import math
from collections.abc import Iterable, Sequence
from xml.etree import ElementTree as Xml

import numpy as np

from irisjax.render.scene import Scene

WIDEST = math.radians(20.0)
"""Least angular radius of a lamp in front of a cornea. Paths meet a lamp by chance alone, and a
smaller one too seldom.
"""
_FAR = 1e4  # mm, distance of the discs that represent distant lamps

_Rgb = Sequence[float] | np.ndarray


def mitsuba_scene(
    scene: Scene,
    *,
    relief: bool,
    white: _Rgb | None,
    haze: _Rgb | None,
    environment: str | None,
    samples: int = 512,
) -> str:
    """The XML of a scene, for a folder with the files of `irisjax.export.handover`.

    Args:
        scene: The scene.
        relief: Whether relief.exr tilts the surface.
        white: Albedo of the sclera, linear sRGB, or `None`.
        haze: Transmittance of one passage of the cornea, linear sRGB; `None` for a clear one.
        environment: File of the panorama.
        samples: Per pixel; Mitsuba's option `-D spp=...` overrides them.
    """
    root = Xml.Element("scene", version="3.0.0")
    root.append(
        Xml.Comment(
            " simulated by irisjax; mm, x right, y up, z towards the viewer; see README.txt "
        )
    )
    _add(root, "default", "spp", samples)
    path = _add(root, "integrator", type="path")
    _add(path, "integer", "max_depth", 10)
    _add(path, "boolean", "hide_emitters", "true")
    _sensor(root, scene)
    _iris(root, relief)
    cornea = scene.eye.cornea
    if cornea is not None:
        chamber, behind = float(scene.eye.aqueous_index), cornea.posterior
        index = chamber if behind is None else float(cornea.index)
        _interface(root, "anterior", index, 1.0, haze)
        if behind is not None:
            _interface(root, "posterior", chamber, index, None)
    if white is not None:
        shape = _mesh(root, "sclera")
        _add(_add(shape, "bsdf", type="diffuse"), "rgb", "reflectance", _numbers(white))
    if environment is not None:
        _add(_add(root, "emitter", type="envmap"), "string", "filename", environment)
    _lamps(root, scene, wide=cornea is not None)
    Xml.indent(root)
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n' + Xml.tostring(root, encoding="unicode") + "\n"
    )


def _sensor(root: Xml.Element, scene: Scene) -> None:
    camera = scene.camera
    origin = np.asarray(camera.rays(scene.eye)[0], np.float64)
    target = np.array([0.0, 0.0, float(scene.eye.iris_depth)])
    # Like the camera itself: upright along the eye's y, or along z where it looks along y.
    sideways = np.hypot(*(target - origin)[[0, 2]]) < 1e-6 * float(camera.distance)
    sensor = _add(root, "sensor", type="perspective")
    _look(sensor, origin, target, [0, 0, 1] if sideways else [0, 1, 0])
    distance = float(camera.distance)
    _add(
        sensor,
        "float",
        "fov",
        f"{2 * math.degrees(math.atan(float(camera.width) / 2 / distance)):.12g}",
    )
    _add(sensor, "string", "fov_axis", "x")
    _add(sensor, "float", "near_clip", f"{distance / 100:g}")
    _add(sensor, "float", "far_clip", f"{10 * distance:g}")
    _add(_add(sensor, "sampler", type="independent"), "integer", "sample_count", "$spp")
    film = _add(sensor, "film", type="hdrfilm")
    for name, size in zip(("width", "height"), camera.size, strict=True):
        _add(film, "integer", name, size)
    _add(film, "string", "pixel_format", "rgb")
    _add(film, "rfilter", type="box")


def _iris(root: Xml.Element, relief: bool) -> None:
    shape = _mesh(root, "iris")
    # Mitsuba alone has v downwards.
    _add(shape, "boolean", "flip_tex_coords", "true")
    if relief:
        bump = _add(shape, "bsdf", type="bumpmap")
        _texture(bump, "relief.exr", None)
    matt = _add(bump if relief else shape, "bsdf", type="diffuse")
    _texture(matt, "albedo.exr", "reflectance")


def _texture(parent: Xml.Element, file: str, name: str | None) -> None:
    texture = _add(parent, "texture", name, type="bitmap")
    _add(texture, "string", "filename", file)
    _add(texture, "boolean", "raw", "true")
    _add(texture, "string", "wrap_mode", "clamp")


def _interface(
    root: Xml.Element, name: str, inside: float, outside: float, through: _Rgb | None
) -> None:
    glass = _add(_mesh(root, name), "bsdf", type="dielectric")
    _add(glass, "float", "int_ior", f"{inside:g}")
    _add(glass, "float", "ext_ior", f"{outside:g}")
    if through is not None:
        _add(glass, "rgb", "specular_transmittance", _numbers(through))


def _lamps(root: Xml.Element, scene: Scene, wide: bool) -> None:
    lights = scene.lights
    if lights is None:
        return
    for i in range(len(lights)):
        towards = np.asarray(lights.towards[i], np.float64)
        colour = np.ones(3) if lights.tint is None else np.asarray(lights.tint[i], np.float64)
        colour = colour * float(lights.irradiance[i])
        distance = math.inf if lights.distance is None else float(lights.distance[i])
        if wide:
            radius = max(float(lights.radius[i]), WIDEST)
            away = min(distance, _FAR)
            disc = _add(root, "shape", type="disk")
            _look(disc, away * towards, np.zeros(3), [0, 1, 0], scale=away * math.tan(radius))
            emitter = _add(disc, "emitter", type="area")
            _add(emitter, "rgb", "radiance", _numbers(colour / (math.pi * math.sin(radius) ** 2)))
        elif math.isfinite(distance):
            emitter = _add(root, "emitter", type="point")
            x, y, z = _turned(distance * towards)
            _add(emitter, "point", "position", x=x, y=y, z=z)
            _add(emitter, "rgb", "intensity", _numbers(colour * distance**2))
        else:
            emitter = _add(root, "emitter", type="directional")
            x, y, z = _turned(-towards)
            _add(emitter, "vector", "direction", x=x, y=y, z=z)
            _add(emitter, "rgb", "irradiance", _numbers(colour))


def _look(
    parent: Xml.Element,
    origin: np.ndarray,
    target: np.ndarray,
    up: Sequence[float],
    scale: float | None = None,
) -> None:
    if abs(np.dot(up, target - origin)) > (1 - 1e-9) * np.linalg.norm(target - origin):
        up = [1, 0, 0]  # only for discs, which have no upper side
    transform = _add(parent, "transform", "to_world")
    if scale is not None:
        _add(transform, "scale", x=f"{scale:.9g}", y=f"{scale:.9g}")
    places = {"origin": origin, "target": target, "up": up}
    _add(transform, "lookat", **{name: ", ".join(_turned(place)) for name, place in places.items()})


def _turned(point: Iterable[float]) -> tuple[str, str, str]:
    x, y, z = (float(v) for v in point)
    return f"{x:.12g}", f"{y:.12g}", f"{0.0 - z:.12g}"


def _mesh(root: Xml.Element, name: str) -> Xml.Element:
    shape = _add(root, "shape", type="ply", id=name)
    _add(shape, "string", "filename", f"{name}.ply")
    return shape


def _numbers(rgb: _Rgb) -> str:
    return ", ".join(f"{float(v):.9g}" for v in rgb)


def _add(
    parent: Xml.Element, tag: str, name: str | None = None, value: object = None, **attributes: str
) -> Xml.Element:
    given = {"name": name, "value": None if value is None else str(value), **attributes}
    return Xml.SubElement(parent, tag, {k: v for k, v in given.items() if v is not None})
