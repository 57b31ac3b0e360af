"""A photograph's light by Mitsuba 3: an eye of triangles behind a refracting cornea, path traced.

The cornea has two dielectric surfaces. Light comes through it to the iris: a lamp's by particles
that start at the lamp, the room's by paths that start at the iris; both are counted on the iris
plane and smoothed there. The iris, matt, then sends it back through the cornea to the camera. What
cornea, lids and white send straight to the camera is traced apart: light adds up. Between iris and
cornea light passes once each way; what the cornea sends back to the iris, 2 % of 10 %, is left out.

Meshes stand in a right-handed frame: mm, x right, y up, z out of the eye.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from scipy import ndimage

from irisjax.anatomy.eye import Eye
from irisjax.export.mesh import eye_meshes, mesh_files, right_handed
from irisjax.render.camera import Camera
from irisjax.render.scene import Scene

FAR = 1e4
"""Distance of the lamp's disc, mm."""
SPACING = 0.06
"""Of the triangles, mm: a mirror image that facets would bend by less than a pixel."""
HALF = 5.7
"""Half the side of the square of the iris plane on which light is counted, mm."""
SPREAD = 0.2
"""Standard deviation of the Gaussian that smooths it, mm."""
_CHAMBER = -1.0  # z of the camera within the chamber that counts the light
_PATHS = 6_000_000
_GREY = 0.02  # albedo of the iris while it is counted


@dataclass(frozen=True)
class Effort:
    """How much is traced: samples a pixel (`seen` of the iris, `outside` of the rest), `particles`
    of the lamp, `cells` along the square of the iris plane, `samples` a cell of the room's light.
    """

    seen: int = 16
    outside: int = 8
    particles: int = 8_000_000
    cells: int = 96
    samples: int = 128


def photograph(
    scene: Scene,
    albedo: np.ndarray,
    white: np.ndarray,
    room: float,
    before: dict[str, Any],
    behind: dict[str, Any],
    effort: Effort,
    folder: Path,
    seed: int,
) -> np.ndarray:
    """Linear sRGB (rows, columns, 3) of an eye with one lamp in a room of even radiance.

    - `scene`: eye, camera and the lamp. `albedo` (angles, radii, 3) of the iris's texels, in linear
        sRGB; `white` (3,) of the sclera. `room`: radiance from everywhere, seen
        beside the globe.
    - `before`, `behind`: further Mitsuba shapes by name, such as lids, and those that keep no light
        from the iris. `folder`: for meshes.
    """
    meshes = {n: right_handed(m) for n, m in eye_meshes(scene.eye, SPACING).items()}
    for name, data in mesh_files(meshes).items():
        (folder / name).write_bytes(data)

    def ply(name, **more):
        return {"type": "ply", "filename": str(folder / f"{name}.ply"), **more}

    cornea, aqueous = scene.eye.cornea, float(scene.eye.aqueous_index)
    assert cornea is not None
    index = float(cornea.index)
    glass = {
        "anterior": ply("anterior", bsdf=dielectric(index, 1.0)),
        "posterior": ply("posterior", bsdf=dielectric(aqueous, index)),
    }
    near = {"sclera": ply("sclera", bsdf=matt(white)), **before}
    solid = {**near, **behind}
    black = {
        n: {**s, "bsdf": {"type": "twosided", "of": matt([0, 0, 0])}} for n, s in solid.items()
    }

    grey = {"iris": ply("iris", bsdf=matt([_GREY] * 3))}
    # Particles start on a disc as large as all there is: what is far behind would waste them.
    light = _light_on_iris({**glass, **near, **grey}, scene, room, effort, seed)
    radiance = _texture(scene, albedo, light)
    glowing = {
        "iris": ply("iris", bsdf=matt([0, 0, 0]), light={"type": "area", "radiance": radiance})
    }
    sensor = sensor_of(scene.camera, scene.eye)
    picture = traced({**glass, **black, **glowing}, sensor, effort.seen, seed + 2)

    # A conductor that does not absorb mirrors as the cornea does, and lets nothing through: no
    # sample is lost to the inside, which is in the picture already.
    mirror = {"type": "conductor", "eta": rgb([index] * 3), "k": rgb([0.0] * 3)}
    front = {"anterior": ply("anterior", bsdf=mirror)}
    sources = ({"lamp": _disc(scene)}, {"room": room_of(room)})
    for i, source in enumerate(sources):
        picture += traced({**front, **solid, **source}, sensor, effort.outside, seed + 3 + i)
    return picture


def _light_on_iris(shapes, scene: Scene, room: float, effort: Effort, seed: int) -> np.ndarray:
    """Irradiance (rows from +y, columns from −x) on the square of the iris plane."""
    depth = float(scene.eye.iris_depth) + _CHAMBER
    sensor = {
        "type": "perspective",
        "to_world": look_at([0, 0, _CHAMBER], [0, 0, _CHAMBER - 1]),
        "fov": 2 * math.degrees(math.atan(HALF / depth)),
        "near_clip": 1e-3,
        "film": film_of(effort.cells, effort.cells),
    }
    assert scene.lights is not None
    away = -np.asarray(scene.lights.towards[0], float) * [1, 1, -1]
    lamp = {
        "type": "directional",
        "direction": away.tolist(),
        "irradiance": rgb([float(scene.lights.irradiance[0])] * 3),
    }
    each = max(1, effort.particles // effort.cells**2)
    by_lamp = traced({**shapes, "lamp": lamp}, sensor, each, seed, "ptracer", 5)
    by_room = traced({**shapes, "room": room_of(room)}, sensor, effort.samples, seed + 1, depth=5)
    found = (by_lamp + by_room) * (math.pi / _GREY)
    # Beyond the iris nothing is seen; only its own cells are averaged.
    line = (np.arange(effort.cells) + 0.5) * (2 * HALF / effort.cells) - HALF
    radius = np.hypot(*np.meshgrid(line, line))
    inside = (radius < float(scene.eye.iris_radius)) & (radius > float(scene.eye.pupil_radius))
    spread = SPREAD * effort.cells / (2 * HALF)
    weight = ndimage.gaussian_filter(inside.astype(float), spread)
    return np.stack(
        [
            ndimage.gaussian_filter(found[..., c] * inside, spread) / np.maximum(weight, 1e-6)
            for c in range(3)
        ],
        -1,
    )


def _texture(scene: Scene, albedo: np.ndarray, light: np.ndarray) -> dict[str, Any]:
    """Radiance of the iris as a texture of its mesh: rows radii, columns angles."""
    angles, radii = 3 * albedo.shape[0], 3 * albedo.shape[1]
    angle = (np.arange(angles) + 0.5) * (2 * math.pi / angles)
    share = (np.arange(radii)[:, None] + 0.5) / radii
    at = share * albedo.shape[1] - 0.5, np.arange(angles)[None] / 3 - 1 / 3 + 1
    at = np.stack(np.broadcast_arrays(at[1], at[0]))
    ring = np.concatenate([albedo[-1:], albedo, albedo[:1]])
    radius = np.asarray(scene.eye.from_axis(share), float)
    cell = 2 * HALF / light.shape[0]
    place = np.stack(
        [
            (HALF - radius * np.sin(angle)) / cell - 0.5,
            (HALF + radius * np.cos(angle)) / cell - 0.5,
        ]
    )
    radiance = [
        ndimage.map_coordinates(ring[..., c], at, order=1, mode="nearest")
        * ndimage.map_coordinates(light[..., c], place, order=1, mode="nearest")
        for c in range(3)
    ]
    # Mitsuba carries radiance over n² through the cornea, as physics does.
    values = (np.stack(radiance, -1) / math.pi).astype(np.float32)
    return {"type": "bitmap", "bitmap": mi.Bitmap(values), "raw": True, "wrap_mode": "clamp"}


def sensor_of(camera: Camera, eye: Eye) -> dict[str, Any]:
    """A pinhole camera of Mitsuba's that sees what `camera` sees."""
    origin = np.asarray(camera.position(eye), float) * [1, 1, -1]
    target = [0.0, 0.0, -float(eye.iris_depth)]
    half = math.atan(float(camera.width) / 2 / float(camera.distance))
    return {
        "type": "perspective",
        "to_world": look_at(origin.tolist(), target),
        "fov": 2 * math.degrees(half),
        "fov_axis": "x",
        "near_clip": float(camera.distance) / 100,
        "film": film_of(*camera.size),
    }


def look_at(origin: list[float], target: list[float]):
    """Transform of what looks from one point at another, +y up."""
    return mi.ScalarTransform4f().look_at(origin=origin, target=target, up=[0, 1, 0])


def film_of(width: int, height: int) -> dict[str, Any]:
    """A film without a filter across pixels."""
    size = {"width": width, "height": height}
    return {"type": "hdrfilm", **size, "pixel_format": "rgb", "rfilter": {"type": "box"}}


def _disc(scene: Scene) -> dict[str, Any]:
    assert scene.lights is not None
    towards = np.asarray(scene.lights.towards[0], float) * [1, 1, -1]
    radius = float(scene.lights.radius[0])
    place = look_at((FAR * towards).tolist(), [0, 0, 0])
    radiance = float(scene.lights.irradiance[0]) / (math.pi * math.sin(radius) ** 2)
    return {
        "type": "disk",
        "to_world": place @ mi.ScalarTransform4f().scale(FAR * math.tan(radius)),
        "emitter": {"type": "area", "radiance": rgb([radiance] * 3)},
    }


def traced(shapes, sensor, samples: int, seed: int, integrator="path", depth=3) -> np.ndarray:
    """Linear picture (rows, columns, 3) of shapes, with so many samples a pixel."""
    scene = mi.load_dict(
        {
            "type": "scene",
            **shapes,
            "integrator": {"type": integrator, "max_depth": depth},
            "sensor": {**sensor, "sampler": {"type": "independent", "sample_count": samples}},
        }
    )
    # Little by little: LLVM's programs hold all paths of a call at once.
    film = sensor["film"]
    most = max(1, _PATHS // (film["width"] * film["height"]))
    total, done = 0.0, 0
    while done < samples:
        now = min(most, samples - done)
        total += now * np.array(mi.render(scene, spp=now, seed=1000 * seed + done), np.float64)
        done += now
    return total / samples


def dielectric(inside: float, outside: float) -> dict[str, Any]:
    """A smooth interface between two refractive indices."""
    return {"type": "dielectric", "int_ior": inside, "ext_ior": outside}


def matt(albedo) -> dict[str, Any]:
    """A Lambertian surface."""
    return {"type": "diffuse", "reflectance": rgb([float(a) for a in albedo])}


def room_of(radiance: float) -> dict[str, Any]:
    """The same radiance from everywhere."""
    return {"type": "constant", "radiance": rgb([radiance] * 3)}


def rgb(value) -> dict[str, Any]:
    """Three channels."""
    return {"type": "rgb", "value": value}
