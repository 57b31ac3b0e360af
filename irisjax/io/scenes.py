"""Scene files: TOML in, a `Scene` out; every wrong entry named with its line."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, get_args

import jax
import jax.numpy as jnp
import numpy as np

from irisjax._types import PRNGKey
from irisjax.anatomy.eye import EYE_LIMITS, Cornea, Eye, LimbalRing, Sclera
from irisjax.anatomy.lids import LID_LIMITS
from irisjax.grow.lids import lids
from irisjax.grow.presets import PRESETS, preset
from irisjax.grow.procedural import procedural
from irisjax.grow.pupil import IRREGULARITY, irregular_pupil
from irisjax.grow.vessels import VEINS, veins
from irisjax.io.images import read_environment
from irisjax.io.maps import read_maps
from irisjax.io.sections import (
    EntryCheck,
    Where,
    check_sections,
    checked,
    listed,
    plain,
    toml_of,
)
from irisjax.io.text import read_text
from irisjax.measure.colour import illuminant_power
from irisjax.numerics.checks import Range
from irisjax.numerics.streams import key_of
from irisjax.render.camera import CAMERA_LIMITS, MAX_SIDE, Camera
from irisjax.render.environment import ENVIRONMENTS
from irisjax.render.integrators import INTEGRATORS, integrator_name, refine_table
from irisjax.render.lights import LIGHT_LIMITS, Lights
from irisjax.render.scene import ENVIRONMENT_LIGHTS, LAMP, Scene
from irisjax.tissue.iris import FRACTIONS, LIMITS, MELANIN_LOAD, Absorption, Iris
from irisjax.transport.process import AbstractProcess


@dataclasses.dataclass(frozen=True)
class SceneFile:
    """A checked scene file: its entries by the names of sections, where they are written, and the
    folder that files are named relative to.
    """

    sections: Mapping[str, Any]
    where: Where
    folder: Path

    @property
    def exposure(self) -> float:
        """Factor on the picture."""
        return self._of("picture").get("exposure", 1.0)

    def scene(self, integrator: str | None = None) -> Scene:
        """Build it, with an integrator of `INTEGRATORS` other than its own if one is named.

        A preset has pigments of its own under radiative transfer. A `ValueError` names file and
        line of parts that do not go together.
        """
        method = INTEGRATORS[integrator or self._of("picture").get("integrator", "separable")]()
        parts: dict[str, Any] = {"integrator": method}
        file = self._of("maps").get("file")
        maps = {} if file is None else {"maps": self._read(read_maps, "maps", file)}
        makers = {
            "eye": self._eye,
            "iris": lambda: self._iris(parts["eye"], method.process),
            "camera": self._camera,
            "light": self._lights,
            "environment": self._environment,
        }
        for name, make in makers.items():
            try:
                parts |= make()
            except _SceneError:
                raise
            except ValueError as error:
                keys = self.sections.get(name, {})
                key = next((k for k in keys if str(error).startswith(f"{k} ")), None)
                raise _SceneError(f"{self.where(name, key)}: {name}: {error}") from None
        if maps and maps["maps"].residual is not None:  # the maps of a photograph
            parts["integrator"] = refine_table(method)
            if not self._of("maps").get("residual", True):
                maps["maps"] = maps["maps"].replace(residual=None)
        return Scene(**parts | maps)

    def with_pupil(self, scene: Scene, radius: float) -> Scene:
        """Return a scene of this file with a pupil of another radius, mm: `Scene.with_pupil`, with
        maps grown anew where they are grown, so that furrows deepen, crypts close and cords bend.
        """
        wider, process = scene.with_pupil(radius), scene.integrator.process
        if process is None or wider.maps is None or "file" in self._of("maps"):
            return wider
        return wider.replace(maps=self._iris(wider.eye, process)["maps"])

    def with_entries(self, section: str, **entries: Any) -> "SceneFile":
        """Return the same scene with other entries of a section, which is added if it is absent."""
        table = self._of(section) | entries
        return dataclasses.replace(self, sections={**self.sections, section: table})

    def _of(self, section: str) -> dict[str, Any]:
        return dict(self.sections.get(section, {}))

    def _key(self, name: str) -> PRNGKey:
        return stream(self._of("maps").get("seed", 0), name)

    def _read(self, read: Callable[[Path], Any], section: str, name: str) -> Any:
        path = self.folder / name
        try:
            return read(path)
        except (OSError, ValueError) as error:
            reason = f"{path}: {error.strerror}" if isinstance(error, OSError) else error
            raise _SceneError(f"{self.where(section, 'file')}: {reason}") from None

    def _iris(self, eye: Eye, process: AbstractProcess) -> dict[str, Any]:
        entry, maps = self._of("iris"), self._of("maps")
        features = {k: v for k, v in maps.items() if k in FEATURES}
        # Maps from a file take the place of grown ones.
        grown = not maps.get("uniform", False) and "file" not in maps
        if "preset" not in entry:
            iris = Iris.of_level(entry.pop("level", "moderate")).replace(**entry)
            drawn = procedural(iris, eye, **features, key=self._key("maps")) if grown else None
        elif "level" in entry:
            raise ValueError("give preset or level, not both")
        else:
            name = entry.pop("preset")
            options: dict[str, Any] = {"process": process, "pigments": entry, "features": features}
            options["shape"] = (768, 256) if grown else (16, 8)  # small where nobody asked for maps
            iris, drawn = preset(name, eye, **options, key=self._key("maps"))
        return {"iris": iris, "maps": drawn if grown else None}

    def _eye(self) -> dict[str, Any]:
        entry = self._of("eye")
        kind, white = entry.pop("cornea", "two-surfaces"), entry.pop("sclera", True)
        density: Any = entry.pop("veins", "clear")
        density = VEINS.get(density, density)
        whiteness = {n: entry.pop(k) for k, n in _WHITE.items() if k in entry}
        ring = {name: entry.pop(key) for key, name in LIMBAL_RING.items() if key in entry}
        if irregularity := entry.pop("pupil_irregularity", 0.0):
            if "pupil_harmonics" in entry:
                raise ValueError("give pupil_irregularity or pupil_harmonics, not both")
            entry["pupil_harmonics"] = irregular_pupil(irregularity, key=self._key("pupil"))
        if "file" not in self._of("maps"):
            entry.setdefault("limbus_width", LIMBUS_WIDTH)
        elif "darkening" not in ring:  # as photographed: the maps hold it
            ring["darkening"] = 0
        if kind == "f09":
            entry = {"aqueous_index": 1.376, **entry}
        eye = Eye(
            cornea={"two-surfaces": Cornea(), "f09": Cornea.f09(), "none": None}[kind],
            limbal_ring=LimbalRing(**ring) if ring.get("darkening", 1) > 0 else None,
            sclera=Sclera(veins=density, **whiteness) if white and kind != "none" else None,
            **entry,
        )
        drawn = None if eye.sclera is None else veins(eye, key=self._key("veins"))
        if (section := self.sections.get("lids")) is not None:
            fields = section | {"nose": SIDES[section.get("nose", "left")]}
            eye = eye.replace(lids=lids(eye, **fields, key=self._key("lids")))
        return {"eye": eye, "veins": drawn}

    def _camera(self) -> dict[str, Any]:
        entry = self._of("camera")
        angles = {n: f"{n}_deg" for n in ("polar", "azimuth") if f"{n}_deg" in entry}
        entry |= {name: math.radians(entry.pop(key)) for name, key in angles.items()}
        return {"camera": Camera(**entry)}

    def _lights(self) -> dict[str, Any]:
        illuminant = self._of("picture").get("illuminant", "D65")
        lights = None
        for nth, lamp in enumerate(self.sections.get("light", [])):
            radius, power = lamp.get("radius_deg", 1.7), lamp.get("irradiance", math.pi)
            options = dict(irradiance=power, illuminant=illuminant, radius=math.radians(radius))
            if "position" not in lamp:
                angles = lamp.get("polar_deg", 35), lamp.get("azimuth_deg", 120)
                one = Lights.distant(*map(math.radians, angles), **options)
            elif lamp.keys() & {"polar_deg", "azimuth_deg"}:
                raise ValueError("give a light a position or angles, not both")
            else:
                try:
                    one = Lights.points(lamp["position"], **options)
                except ValueError as error:
                    place, entry = (self.where("light", key, nth) for key in (None, "position"))
                    message = f"{place}: light: {error}; change its position ({entry})"
                    raise _SceneError(message) from None
            if "colour" in lamp:
                tint = jnp.asarray([lamp["colour"]], one.towards.dtype)
                one = dataclasses.replace(one, tint=tint)
            lights = one if lights is None else lights + one
        if lights is None and "environment" not in self.sections:
            lights = Lights.distant(*LAMP, illuminant=illuminant)
        return {"lights": lights, "illuminant": illuminant}

    def _environment(self) -> dict[str, Any]:
        entry = self.sections.get("environment")
        if entry is None:
            return {}
        if ("file" in entry) == ("kind" in entry):
            both = "give file or kind, not both"
            raise ValueError(both if "file" in entry else "needs file or kind")
        if "file" in entry:
            sky = self._read(read_environment, "environment", entry["file"])
        else:
            sky = ENVIRONMENTS[entry["kind"]](rows=512)
        sky = dataclasses.replace(sky, radiance=sky.radiance * entry.get("strength", 1.0))
        lights = entry.get("lights", ENVIRONMENT_LIGHTS)
        return {"environment": sky, "environment_lights": lights}


def stream(seed: int, name: str) -> PRNGKey:
    """The random key of a scene's `"maps"`, `"veins"`, `"lids"` or `"pupil"`."""
    return jax.random.fold_in(key_of(seed), {"maps": 0, "veins": 1, "lids": 2, "pupil": 3}[name])


def read_scene(path: str | Path) -> SceneFile:
    """Read a scene file; a `ValueError` names the wrong entry, its line and what is allowed."""
    return parse_scene(read_text(path), str(path), Path(path).parent)


def parse_scene(text: str, name: str = "scene", folder: Path = Path()) -> SceneFile:
    """A scene from TOML text."""
    sections, where = check_sections(text, name, SECTIONS, "light")
    maps = sections.get("maps", {})
    of_files = "file", "seed", "residual"
    if "file" in maps and (grown := [key for key in maps if key not in of_files]):
        message = f"maps.{grown[0]} is for grown maps, and maps.file gives all of them"
        to_do = "give one or the other (seed still draws the veins)"
        raise ValueError(f"{where('maps', grown[0])}: {message}; {to_do}")
    return SceneFile(sections, where, folder)


def scene_text(
    scene: Scene, given: Mapping[str, Mapping[str, Any]] | None = None, remark: str = ""
) -> str:
    """Return the text of a scene file that is read back as an equal scene, angles to 1e-5 degrees.

    Args:
        scene: A scene whose cornea, integrator and optical models are those that files can name.
        given: Further entries by section: what the scene does not hold (its `exposure`, a `preset`,
            the `seed` of its maps and veins), and the `file` of maps and of an environment that is
            not uniform.
        remark: First line, a comment.
    """
    eye, camera, sky = scene.eye, scene.camera, scene.environment
    named, ring = {} if given is None else given, eye.limbal_ring
    two = eye.cornea is not None and eye.cornea.posterior is not None
    sections: dict[str, dict[str, Any]] = {
        "iris": {name: getattr(scene.tissue, name) for name in (*_IRIS, "absorption")},
        "maps": {"uniform": True} if scene.maps is None else {},
        "eye": {
            "cornea": "none" if eye.cornea is None else "two-surfaces" if two else "f09",
            "sclera": eye.sclera is not None,
            "veins": 0.0 if eye.sclera is None or scene.veins is None else eye.sclera.veins,
            **{k: getattr(eye.sclera, n, None) for k, n in _WHITE.items()},
            **{name: getattr(eye, name) for name in (*_EYE, "pupil_centre", "pupil_harmonics")},
            **{k: getattr(ring, n) if ring else None for k, n in LIMBAL_RING.items()},
            **({} if ring else {"limbal_ring": 0.0}),
        },
        "camera": {
            **{f"{name}_deg": in_degrees(getattr(camera, name)) for name in ("polar", "azimuth")},
            **{name: getattr(camera, name) for name in ("distance", "width", "images", "size")},
        },
        "picture": {
            "integrator": integrator_name(scene.integrator),
            "illuminant": scene.illuminant,
        },
    }
    if eye.lids is not None:
        side = next(name for name, sign in SIDES.items() if sign == eye.lids.nose)
        sections["lids"] = {n: getattr(eye.lids, n) for n in LID_LIMITS} | {"nose": side}
    if sky is not None:
        sections["environment"] = {"lights": scene.environment_lights}
        if "environment" not in named:
            assert sky.is_uniform()
            sections["environment"] |= {"kind": "uniform", "strength": sky.radiance[0, 0, 0]}
    for name, entries in named.items():
        sections[name] = sections.get(name, {}) | dict(entries)
    written: dict[str, Any] = {
        name: {key: value for key, value in entries.items() if value is not None}
        for name, entries in sections.items()
    }
    if scene.lights is not None:
        written["light"] = [_light(scene.lights, k) for k in range(len(scene.lights))]
    return f"# {remark}\n{toml_of(plain(written))}"


def _light(lights: Lights, k: int) -> dict[str, Any]:
    x, y, z = np.asarray(lights.towards[k], np.float64)
    polar, azimuth = math.atan2(math.hypot(x, y), -z), math.atan2(y, x)
    place: dict[str, Any] = {"polar_deg": in_degrees(polar), "azimuth_deg": in_degrees(azimuth)}
    if lights.distance is not None and np.isfinite(distance := float(lights.distance[k])):
        place = {"position": [round(distance * v, 5) for v in (x, y, z)]}
    tint = {} if lights.tint is None else {"colour": lights.tint[k]}
    power = {"irradiance": lights.irradiance[k], "radius_deg": in_degrees(lights.radius[k])}
    return place | tint | power


def in_degrees(angle: Any) -> float:
    """An angle in radians as scenes state it, in degrees with five decimals."""
    return round(math.degrees(angle), 5)


class _SceneError(ValueError):
    """An error in a scene file, whose message names the line."""


def _density(value: Any) -> Any:
    return checked(value, tuple(VEINS) if isinstance(value, str) else EYE_LIMITS["veins"])


def _harmonics(value: Any) -> Any:
    pair = listed("pairs [cosine, sine]", EYE_LIMITS["pupil_harmonics"])
    return jnp.asarray([pair(entry) for entry in checked(value, list)])


def _illuminant(value: Any) -> str:
    illuminant_power(checked(value, str), [560.0])
    return value


LIMBUS_WIDTH = 0.5
"""Width of the blend of iris and white where maps are grown, mm: narrower than F09's."""
SIDES = {"left": -1, "right": 1}
"""Sides of the nose in the picture, as signs of x."""
LIMBAL_RING = {
    "limbal_ring": "darkening",
    "limbal_ring_width": "width",
    "limbal_ring_fade": "fade",
    "limbal_ring_unevenness": "unevenness",
}
"""Entries of `[eye]` that are fields of its `LimbalRing`."""
# Entries of `[eye]` that are fields of its `Sclera`.
_WHITE = {"yellowing": "yellowing", "white_tint": "tint", "white_gloss": "gloss"}
# Numbers of `Eye` and `Iris` that are entries under their own names.
_EYE = (
    *("iris_depth", "iris_slope", "limbus_radius", "limbus_width", "iris_radius"),
    *("pupil_radius", "pupil_margin", "attenuation", "aqueous_index"),
)
# Behind the iris of a picture is nothing: its epithelium is black.
_IRIS = tuple(name for name in LIMITS if name != "ipe_melanin")
FEATURES: dict[str, EntryCheck] = {
    "fibres": Range(0, 4),
    "looseness": Range(0, 2),
    "clouds": Range(0, 4),
    "margins": Range(0, 2),
    "collarette": Range(0, 4),
    "crypts": range(201),
    "furrows": range(51),
    "freckles": range(201),
    "abl": Range(0, 2),
    "heterochromia": Range(0, 20),
    "amber": Range(0, 20),
    "patches": Range(0, 2),
    "ruff": Range(0, 2),
    "relief": Range(0, 1),
}
SECTIONS: dict[str, dict[str, EntryCheck]] = {
    "iris": {
        "preset": tuple(PRESETS),
        "level": ("low", "moderate", "high"),
        "melanin_load": MELANIN_LOAD,
        **{name: LIMITS[name] for name in _IRIS},
        "absorption": get_args(Absorption),
        **FRACTIONS,
    },
    "maps": {"seed": range(2**32), "file": str, "residual": bool, "uniform": bool, **FEATURES},
    "eye": {
        "cornea": ("two-surfaces", "f09", "none"),
        "sclera": bool,
        **{name: EYE_LIMITS[name] for name in _EYE},
        **{key: EYE_LIMITS[name] for key, name in LIMBAL_RING.items()},
        "veins": _density,
        "yellowing": EYE_LIMITS["yellowing"],
        "white_tint": listed("[red, green, blue]", EYE_LIMITS["tint"]),
        "white_gloss": EYE_LIMITS["gloss"],
        "pupil_centre": listed("[x, y] in mm", EYE_LIMITS["pupil_centre"]),
        "pupil_irregularity": IRREGULARITY,
        "pupil_harmonics": _harmonics,
    },
    "lids": {**LID_LIMITS, "nose": tuple(SIDES)},
    "camera": {
        "polar_deg": Range(0, 180),
        "azimuth_deg": Range(-360, 360),
        "distance": CAMERA_LIMITS["distance"],
        "width": CAMERA_LIMITS["width"],
        "images": CAMERA_LIMITS["images"],
        "size": listed("[width, height]", range(1, MAX_SIDE + 1)),
    },
    "light": {
        "polar_deg": Range(0, 180),
        "azimuth_deg": Range(-360, 360),
        "position": listed("[x, y, z] in mm", Range(-math.inf, math.inf)),
        "irradiance": LIGHT_LIMITS["irradiance"],
        "radius_deg": Range(0.01, 60),
        "colour": listed("[red, green, blue]", LIGHT_LIMITS["tint"]),
    },
    "environment": {
        "file": str,
        "kind": tuple(ENVIRONMENTS),
        "lights": range(1, 1001),
        "strength": Range(0, 1e6),
    },
    "picture": {
        "exposure": Range(1e-6, 1e6),
        "illuminant": _illuminant,
        "integrator": tuple(INTEGRATORS),
    },
}
