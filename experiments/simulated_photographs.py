"""Simulated photographs of eyes with known truth: pigments, thickness, camera, light, outlines.

The renderer is Mitsuba 3 (`eye_in_mitsuba.py`), independent of the package's; from the package come
the albedo of each texel and the shapes of the eye.
"""

import dataclasses
import json
import math
import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from PIL import Image

from experiments.common import start
from irisjax.anatomy.eye import Eye, Sclera
from irisjax.grow.presets import preset
from irisjax.io import write_exr, write_maps
from irisjax.measure.colour import srgb_encode
from irisjax.photo.photograph import Ellipse, ellipse_through
from irisjax.render.albedo import Matt
from irisjax.render.bands import colour_bands
from irisjax.render.camera import Camera
from irisjax.render.lights import Lights
from irisjax.render.outside import Blood, colour_table
from irisjax.render.points import project_points
from irisjax.render.refraction import refract_to_iris
from irisjax.render.scene import Scene
from irisjax.render.separable import Separable
from irisjax.render.surfaces import IrisSurface
from irisjax.tissue.maps import Scales

FOLDER = Path(__file__).parent.parent / "data" / "photographs"
SIZE = (1300, 1080)
WIDTH, DISTANCE = 14.4, 250.0
"""Of the field at the pupil and of the camera, mm: a lens of 625 mm on 36 mm of film."""
LB06 = {"scattering_scale": 1.0, "hemoglobin": 0.084}
EYES = {
    "brown": {"eumelanin": 1.2, "pheomelanin": 0.5, "abl_fraction": 0.6, "fibril_radius": 72.0},
    "green": {"eumelanin": 0.1, "pheomelanin": 0.8, "abl_fraction": 0.6, "fibril_radius": 51.5},
    "blue": {"eumelanin": 0.015, "pheomelanin": 0.01, "abl_fraction": 0.5, "fibril_radius": 45.0},
}
"""Fields of `Iris`."""
FEATURES = {
    "brown": {"abl": 0, "crypts": 10},
    "green": {"heterochromia": 0, "freckles": 8},
    "blue": {},
}
"""Of their maps: the ABL as thick everywhere, so that thickness and freckles are all there is."""
PUPIL = {"brown": 1.9, "green": 1.7, "blue": 2.1}
TILT = math.radians(30), 0.35
"""Polar angle and azimuth of the camera that stands aside, radians."""
LAMP = {"polar_deg": 38.0, "azimuth_deg": 125.0, "irradiance": 2.2, "radius_deg": 3.5}
ROOM = 0.25
"""Radiance from everywhere else."""
GAINS = {"green": (1.08, 1.0, 0.94)}
"""White balance that is off, on linear red, green and blue."""
BRIGHTER = 1.2
"""Of dirty photographs: part of the white is burnt out."""
FULL, READ = 6000.0, 6.0
"""Electrons of a full pixel and noise of reading, electrons."""
ABOUT = "simulated photographs of eyes, rendered with Mitsuba 3; see README.md"
WHITE = 0.95
"""Linear value of the bright part of the sclera."""


def main(key, quick=False, out=FOLDER):
    """Write photographs, truth.json, and the maps, scenes and room they are of (quick: one of 80
    pixels).
    """
    import mitsuba as mi

    # Old versions of LLVM end the process: what tests run needs none.
    mi.set_variant("scalar_rgb" if quick else "llvm_ad_rgb")
    mi.set_log_level(mi.LogLevel.Warn)
    from experiments.eye_in_mitsuba import Effort, photograph
    from experiments.lids import face, lids

    out.mkdir(parents=True, exist_ok=True)
    size, shape = ((80, 66), (64, 24)) if quick else (SIZE, (512, 128))
    effort = Effort(4, 4, 20_000, 16, 16) if quick else Effort()
    write_exr(out / "room.exr", np.full((4, 8, 3), ROOM, np.float32))
    eyes, exposure, truths = {}, {}, []
    # The clean ones first: they tell the exposure of the others.
    for dirty, colour, tilted in [(d, c, t) for d in (False, True) for c in EYES for t in (0, 1)]:
        number = len(truths)
        if colour not in eyes:
            eyes[colour] = _eye(colour, shape, jax.random.fold_in(key, len(eyes)))
            write_maps(out / f"{colour}_maps.exr", eyes[colour][0].maps)
        scene, matt = eyes[colour]
        camera = Camera(*(TILT if tilted else (0.0, 0.0)), DISTANCE, WIDTH, size)
        scene = dataclasses.replace(scene, camera=camera)
        albedo = _towards(camera, matt)
        name = f"{colour}_tilted" if tilted else colour
        with tempfile.TemporaryDirectory() as made:
            folder = Path(made)
            before = lids(scene.eye, folder, number) if dirty else {}
            behind = face() if dirty else {}
            texels, white = np.clip(albedo, 0, 1), _white(scene.eye)
            light = photograph(scene, texels, white, ROOM, before, behind, effort, folder, number)
        if dirty:
            file, factor = f"{name}_dirty.jpg", BRIGHTER * exposure[name]
        else:
            file, factor = f"{name}.jpg", _exposure(light, scene)
            exposure[name] = factor
            text = _toml(scene, colour, factor)
            (out / f"{name}.toml").write_text(text, encoding="utf-8")
        gains = GAINS.get(colour, (1.0, 1.0, 1.0))
        light = light * factor * np.asarray(gains)
        _save(out / file, sensed(light, np.random.default_rng(number)) if dirty else light, size)
        of_file = {"file": file, "scene": f"{name}.toml", "dirty": dirty}
        camera = {"exposure": factor, "gains": list(gains)}
        truths.append(of_file | camera | _truth(scene, colour, albedo))
        text = json.dumps({"about": ABOUT, "photographs": truths}, indent=1)
        (out / "truth.json").write_text(text + "\n", encoding="utf-8")
        print(f"{file}: exposure {factor:.3f}", flush=True)
        if quick:
            break


def _eye(colour: str, shape: tuple[int, int], key) -> tuple[Scene, Matt]:
    """An eye and its lamp, and the iris behind the cornea's haze, twice passed."""
    eye = Eye(pupil_radius=jnp.asarray(PUPIL[colour]), sclera=Sclera(veins=jnp.asarray(0.0)))
    features = {**FEATURES[colour], "relief": 0}
    iris, maps = preset(
        colour, eye, shape=shape, pigments=LB06 | EYES[colour], features=features, key=key
    )
    # To whole micrometres: the file is smaller, and the truth is the file.
    maps = jax.tree.map(lambda m: jnp.round(m * 1000) / 1000, maps)
    polar, azimuth, radius = (
        math.radians(LAMP[f"{n}_deg"]) for n in ("polar", "azimuth", "radius")
    )
    lamp = Lights.distant(polar, azimuth, LAMP["irradiance"], radius=radius)
    matt = Matt.build(iris, maps, eye, colour_bands(cornea=eye.cornea), Separable())
    return Scene(iris, maps, eye, lamp), matt


def _towards(camera: Camera, matt: Matt) -> np.ndarray:
    """Albedo (angles, radii, 3) of the matt iris as bright as ILIT's in a camera's direction.

    Lines of sight behind the cornea stay within some 10 degrees of the one through its middle.
    """
    eye = matt.eye
    assert eye.cornea is not None
    width, height = camera.size
    middle = jnp.asarray([height // 2 * width + width // 2])
    origin, direction = camera.rays(middle, eye)
    distance, _ = eye.cornea.anterior.intersect(origin, direction)
    exits = refract_to_iris(eye, origin + distance[:, None] * direction, direction).direction[0, 2]
    texels = Scales(*(None if s is None else s.ravel() for s in matt.scales))
    one = jnp.ones(matt.shape[0] * matt.shape[1])
    found = jnp.pi * matt.response.brdf(texels, one, exits * one, 0 * one)
    return np.asarray(found.T.reshape(*matt.shape, 3), np.float64)


def _white(eye: Eye) -> np.ndarray:
    """Albedo of the sclera, linear sRGB."""
    assert eye.sclera is not None
    bands = colour_bands(all_wavelengths=True)
    table = colour_table(eye.sclera, np.asarray(bands.wavelengths), bands.weights)
    return np.asarray(table(Blood(jnp.zeros(1))))[0]


def outline(scene: Scene, radius: float, pupil: bool) -> tuple[Ellipse, float]:
    """Ellipse of a circle round the eye's axis in a picture, of the pupil through the cornea
    or of the limbus; and how far the outline is from it at most, px.
    """
    eye, angle = scene.eye, jnp.linspace(0, 2 * jnp.pi, 180, endpoint=False)
    assert eye.cornea is not None
    front = eye.cornea.anterior
    depth = eye.iris_depth if pupil else front.apex + front.sagitta(jnp.asarray(radius, float))
    ring = jnp.stack(
        [radius * jnp.cos(angle), radius * jnp.sin(angle), jnp.broadcast_to(depth, angle.shape)], -1
    )
    if pupil:
        found = jax.jit(project_points)(IrisSurface(eye), scene.camera, ring)
        column, row, visible = found
        assert bool(visible.all())
    else:
        column, row = scene.camera.pixel(ring, eye)
    column, row = np.asarray(column), np.asarray(row)
    points = np.stack([column, row], -1)
    found = ellipse_through(points)
    off = np.abs(found.relative_radius(column, row) - 1).max() * found.semi_axes[0]
    return found, float(off)


def sensed(linear: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """With the noise of photons and of reading; what the sensor cannot hold is cut off."""
    electrons = random.poisson(np.clip(linear, 0, 1.2) * FULL)
    return (electrons + random.normal(0, READ, linear.shape)) / FULL


def _exposure(linear: np.ndarray, scene: Scene) -> float:
    """What brings the bright part of the white, and hardly any of it, to `WHITE`."""
    limbus, _ = outline(scene, float(scene.eye.limbus_radius), False)
    rows, columns = np.indices(linear.shape[:2])
    (x, y), (a, _) = limbus.centre, limbus.semi_axes
    white = linear[np.hypot(columns - x, rows - y) > 1.03 * a].max(-1)
    return float(WHITE / np.quantile(white, 0.9))


def _save(path: Path, linear: np.ndarray, size: tuple[int, int]) -> None:
    """8 bits, with the focal length in the file's EXIF."""
    encoded = np.asarray(srgb_encode(jnp.asarray(np.clip(linear, 0, 1))))
    image = Image.fromarray(np.round(255 * encoded).astype(np.uint8))
    exif = Image.Exif()
    exif[0x010E] = "simulated by irisjax and Mitsuba 3"
    more = exif.get_ifd(0x8769)
    more[0x920A] = 100.0  # FocalLength, mm
    # FocalLengthIn35mmFilm: of the same angle across the diagonal, 43.27 mm.
    focal = DISTANCE / WIDTH * size[0]
    more[0xA405] = round(focal * 43.27 / np.hypot(*size))
    # Pixels per centimetre of a sensor on which 100 mm see this field.
    more[0xA20E] = more[0xA20F] = DISTANCE / WIDTH * size[0] / 100.0 * 10
    more[0xA210] = 3
    image.save(path, quality=92, subsampling="4:2:0", exif=exif)


def _concentrations(iris) -> dict[str, float]:
    """Melanins of each layer, mg/ml of that layer."""
    whole = float(iris.abl_thickness + iris.stroma_thickness)
    share = float(iris.abl_fraction)
    return {
        f"{pigment}_{layer}": float(getattr(iris, pigment)) * whole * part / float(thickness)
        for layer, part, thickness in (
            ("abl", share, iris.abl_thickness),
            ("stroma", 1 - share, iris.stroma_thickness),
        )
        for pigment in ("eumelanin", "pheomelanin")
    }


def _truth(scene: Scene, colour: str, albedo: np.ndarray) -> dict:
    camera, iris, eye = scene.camera, scene.iris, scene.eye
    return {
        "maps": f"{colour}_maps.exr",
        "size_px": list(camera.size),
        "iris": iris.parameters(),
        "concentrations": _concentrations(iris),
        "process": "ilit-2006",
        "texels_out_of_srgb": int((albedo.min(-1) < 0).sum()),
        "eye": {
            "limbus_radius": float(eye.limbus_radius),
            "iris_radius": float(eye.iris_radius),
            "pupil_radius": float(eye.pupil_radius),
            "iris_depth": float(eye.iris_depth),
        },
        "camera": {
            "polar": float(camera.polar),
            "azimuth": float(camera.azimuth),
            "distance": float(camera.distance),
            "width": float(camera.width),
            "focal_px": float(camera.distance) * camera.size[0] / float(camera.width),
        },
        "lamp": LAMP,
        "room_radiance": ROOM,
        "limbus": _in_file(*outline(scene, float(eye.limbus_radius), False)),
        "pupil": _in_file(*outline(scene, float(eye.pupil_radius), True)),
    }


def _in_file(ellipse: Ellipse, off: float) -> dict:
    return {
        "centre_px": list(ellipse.centre),
        "semi_axes_px": list(ellipse.semi_axes),
        "angle": ellipse.angle,
        "residual_px": off,
    }


def _toml(scene: Scene, colour: str, exposure: float) -> str:
    """The scene as `irisjax render` reads it."""
    camera = scene.camera
    lines = [
        "# Of a simulated photograph in this folder; see README.md.",
        "[iris]",
        'level = "low"',
    ]
    lines += [f"{k} = {v}" for k, v in EYES[colour].items()]
    lines += ["", "[maps]", f'file = "{colour}_maps.exr"']
    lines += ["", "[eye]", f"pupil_radius = {PUPIL[colour]}", "veins = 0.0"]
    lines += ["", "[camera]", f"polar_deg = {math.degrees(float(camera.polar)):.9g}"]
    lines += [f"azimuth_deg = {math.degrees(float(camera.azimuth)):.9g}"]
    lines += [f"distance = {DISTANCE}", f"width = {WIDTH}", f"size = {list(camera.size)}"]
    lines += ["", "[[light]]", *(f"{k} = {v}" for k, v in LAMP.items())]
    lines += ["", "[environment]", 'file = "room.exr"', "lights = 25"]
    lines += ["", "[picture]", f"exposure = {exposure:.6g}"]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    start(main, __doc__, FOLDER)
