"""Scene files: TOML in, a `Scene` out; every wrong entry named with its line."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from irisjax._types import PRNGKey
from irisjax.anatomy.eye import LIMITS as EYE_LIMITS
from irisjax.anatomy.eye import Cornea, Eye, Sclera
from irisjax.anatomy.media import INDEX
from irisjax.grow.presets import PRESETS, preset
from irisjax.grow.procedural import procedural
from irisjax.grow.vessels import veins
from irisjax.io.images import read_environment
from irisjax.io.maps import read_maps
from irisjax.io.sections import (
    EntryCheck,
    Where,
    boolean,
    check_sections,
    number_within,
    one_name,
    text,
    whole_number,
)
from irisjax.measure.colour import illuminant_power
from irisjax.numerics.checks import Range
from irisjax.render.camera import LARGEST, Camera
from irisjax.render.camera import LIMITS as CAMERA_LIMITS
from irisjax.render.environment import ENVIRONMENTS
from irisjax.render.integrators import INTEGRATORS
from irisjax.render.lights import LIMITS as LIGHT_LIMITS
from irisjax.render.lights import Lights
from irisjax.render.scene import ENVIRONMENT_LIGHTS, Scene
from irisjax.tissue.iris import LIMITS, MELANIN_LOAD, Iris
from irisjax.tissue.maps import IrisMaps
from irisjax.transport.process import AbstractProcess


class SceneError(ValueError):
    """What is wrong in a scene file, its line told."""


class SceneFile(Mapping[str, Any]):
    """A checked scene file: sections by name, and the scene they make."""

    def __init__(self, sections: Mapping[str, Any], where: Where, folder: Path):
        self._sections, self._where, self._folder = sections, where, folder

    def __getitem__(self, name):
        return self._sections[name]

    def __iter__(self):
        return iter(self._sections)

    def __len__(self):
        return len(self._sections)

    @property
    def exposure(self) -> float:
        """Factor on the picture."""
        return self._sections.get("picture", {}).get("exposure", 1.0)

    def scene(self, integrator: str | None = None) -> Scene:
        """Build it, with an integrator of `INTEGRATORS` other than its own if one is named.

        A preset has pigments of its own under radiative transfer.

        Raises:
            ValueError: For parts that do not go together; it names file and line.
        """
        own = self._sections.get("picture", {}).get("integrator", "separable")
        chosen = INTEGRATORS[own if integrator is None else integrator]()
        parts: dict[str, Any] = {"integrator": chosen}
        drawn = self._maps_of_file()
        makers = {
            "eye": self._eye,
            "iris": lambda: self._iris(parts["eye"], chosen.process),
            "camera": self._camera,
            "light": self._lights,
            "environment": self._environment,
        }
        for name, make in makers.items():
            try:
                parts |= make()
            except SceneError:
                raise
            except ValueError as error:
                key = next(
                    (k for k in self._sections.get(name, {}) if str(error).startswith(f"{k} ")),
                    None,
                )
                raise SceneError(f"{self._where(name, key)}: {name}: {error}") from None
        parts |= drawn
        return Scene(**parts)

    def _key(self, name: str):
        return stream(self._sections.get("maps", {}).get("seed", 0), name)

    def _maps_of_file(self) -> dict[str, IrisMaps]:
        name = self._sections.get("maps", {}).get("file")
        if name is None:
            return {}
        return {"maps": self._read(read_maps, "maps", name)}

    def _read(self, read: Callable[[Path], Any], section: str, name: str) -> Any:
        path = self._folder / name
        try:
            return read(path)
        except OSError as error:
            raise SceneError(f"{self._where(section, 'file')}: {path}: {error.strerror}") from None
        except ValueError as error:
            raise SceneError(f"{self._where(section, 'file')}: {error}") from None

    def _iris(self, eye: Eye, process: AbstractProcess):
        given = dict(self._sections.get("iris", {}))
        features = {k: v for k, v in self._sections.get("maps", {}).items() if k in FEATURES}
        # Maps from a file take the place of grown ones.
        uniform = self._sections.get("maps", {}).get(
            "uniform", False
        ) or "file" in self._sections.get("maps", {})
        if "preset" in given:
            if "level" in given:
                raise ValueError("give preset or level, not both")
            colour = given.pop("preset")
            shape = (16, 8) if uniform else (768, 256)  # maps that nobody asked for are grown small
            iris, maps = preset(
                colour,
                eye,
                process=process,
                shape=shape,
                pigments=given,
                features=features,
                key=self._key("maps"),
            )
        else:
            iris = Iris.of_level(given.pop("level", "moderate"))
            iris = iris.replace(**given) if given else iris
            maps = None if uniform else procedural(iris, eye, **features, key=self._key("maps"))
        return {"iris": iris, "maps": None if uniform else maps}

    def _eye(self):
        given = dict(self._sections.get("eye", {}))
        kind, white, density = (
            given.pop("cornea", "two-surfaces"),
            given.pop("sclera", True),
            given.pop("veins", 1.0),
        )
        if kind == "f09":
            given = {"aqueous_index": 1.376, **given}
        eye = Eye(
            cornea={"two-surfaces": Cornea(), "f09": Cornea.f09(), "none": None}[kind],
            sclera=Sclera(veins=density) if white and kind != "none" else None,
            **given,
        )
        drawn = None if eye.sclera is None else veins(eye, key=self._key("veins"))
        return {"eye": eye, "veins": drawn}

    def _camera(self):
        given = dict(self._sections.get("camera", {}))
        for name in ("polar", "azimuth"):
            if f"{name}_deg" in given:
                given[name] = math.radians(given.pop(f"{name}_deg"))
        return {"camera": Camera(**given)}

    def _lights(self):
        illuminant = self._sections.get("picture", {}).get("illuminant", "D65")
        lights = None
        for lamp in self._sections.get("light", []):
            options = {
                "irradiance": lamp.get("irradiance", math.pi),
                "illuminant": illuminant,
                "radius": math.radians(lamp.get("radius_deg", 1.7)),
            }
            if "position" in lamp:
                if "polar_deg" in lamp or "azimuth_deg" in lamp:
                    raise ValueError("give a light a position or angles, not both")
                one = Lights.points(lamp["position"], **options)
            else:
                polar, azimuth = (
                    math.radians(lamp.get(f"{n}_deg", d))
                    for n, d in (("polar", 35), ("azimuth", 120))
                )
                one = Lights.distant(polar, azimuth, **options)
            if "colour" in lamp:
                one = dataclasses.replace(
                    one, tint=jnp.asarray([lamp["colour"]], one.towards.dtype)
                )
            lights = one if lights is None else lights + one
        if lights is None and "environment" not in self._sections:
            lights = Lights.distant(0.6, 2.1, illuminant=illuminant)
        return {"lights": lights, "illuminant": illuminant}

    def _environment(self):
        given = self._sections.get("environment")
        if given is None:
            return {}
        if ("file" in given) == ("kind" in given):
            raise ValueError("needs file or kind")
        if "file" in given:
            around = self._read(read_environment, "environment", given["file"])
        else:
            around = ENVIRONMENTS[given["kind"]](rows=512)
        around = dataclasses.replace(around, radiance=around.radiance * given.get("strength", 1.0))
        return {
            "environment": around,
            "environment_lights": given.get("lights", ENVIRONMENT_LIGHTS),
        }


def stream(seed: int, name: str) -> PRNGKey:
    """The random key of a scene's `"maps"` or `"veins"`."""
    return jax.random.fold_in(
        jax.random.key(seed, impl="threefry2x32"), {"maps": 0, "veins": 1}[name]
    )


def read_scene(path: str | Path) -> SceneFile:
    """Read and check a scene file.

    Raises:
        ValueError: For a wrong entry; it names the file, the line and what is allowed.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise ValueError(f"{path}: not a text file (UTF-8)") from None
    return parse_scene(text, str(path), path.parent)


def parse_scene(text: str, name: str = "scene", folder: Path = Path()) -> SceneFile:
    """A scene from TOML text."""
    sections, where = check_sections(text, name, SECTIONS, "light")
    maps = sections.get("maps", {})
    if "file" in maps and (grown := [key for key in maps if key not in ("file", "seed")]):
        raise ValueError(
            f"{where('maps', grown[0])}: maps.{grown[0]} is for grown maps, and maps.file gives "
            f"all of them; "
            "give one or the other (seed still draws the veins)"
        )
    return SceneFile(sections, where, folder)


_LEVELS = ("low", "moderate", "high")
_OF_EYES = (
    "veins",
    "iris_depth",
    "iris_slope",
    "limbus_radius",
    "limbus_width",
    "iris_radius",
    "pupil_radius",
    "pupil_margin",
    "attenuation",
)


def _number(low: float = -math.inf, high: float = math.inf, unit="") -> Callable[[Any], float]:
    return number_within(Range(low, high, unit))


def _illuminant(value):
    illuminant_power(text(value), [560.0])
    return value


def _size(value):
    if not (isinstance(value, list) and len(value) == 2):
        raise ValueError("must be [width, height]")
    return tuple(whole_number(1, LARGEST)(v) for v in value)


def _three(form: str, allowed: Range) -> Callable[[Any], list[float]]:
    def check(value):
        if not (isinstance(value, list) and len(value) == 3):
            raise ValueError(f"must be {form}")
        return [number_within(allowed)(v) for v in value]

    return check


FEATURES: dict[str, EntryCheck] = {
    "fibres": _number(0, 4),
    "collarette": _number(0, 4),
    "crypts": whole_number(0, 200),
    "furrows": whole_number(0, 50),
    "freckles": whole_number(0, 200),
    "abl": _number(0, 2),
    "heterochromia": _number(0, 20),
    "relief": _number(0, 1),
}
_DEGREES = _number(-360, 360)
SECTIONS: dict[str, dict[str, EntryCheck]] = {
    "iris": {
        "preset": one_name(*PRESETS),
        "level": one_name(*_LEVELS),
        "melanin_load": number_within(MELANIN_LOAD),
        **{name: number_within(limits) for name, limits in LIMITS.items()},
    },
    "maps": {"seed": whole_number(0, 2**32 - 1), "file": text, "uniform": boolean, **FEATURES},
    "eye": {
        "cornea": one_name("two-surfaces", "f09", "none"),
        "sclera": boolean,
        **{name: number_within(limits) for name, limits in EYE_LIMITS.items() if name in _OF_EYES},
        "aqueous_index": number_within(INDEX),
    },
    "camera": {
        "polar_deg": _number(0, 180),
        "azimuth_deg": _DEGREES,
        "distance": number_within(CAMERA_LIMITS["distance"]),
        "width": number_within(CAMERA_LIMITS["width"]),
        "size": _size,
    },
    "light": {
        "polar_deg": _number(0, 180),
        "azimuth_deg": _DEGREES,
        "position": _three("[x, y, z] in mm", Range(-math.inf, math.inf)),
        "irradiance": number_within(LIGHT_LIMITS["irradiance"]),
        "radius_deg": _number(0.01, 60),
        "colour": _three("[red, green, blue]", LIGHT_LIMITS["tint"]),
    },
    "environment": {
        "file": text,
        "kind": one_name(*ENVIRONMENTS),
        "lights": whole_number(1, 1000),
        "strength": _number(0, 1e6),
    },
    "picture": {
        "exposure": _number(1e-6, 1e6),
        "illuminant": _illuminant,
        "integrator": one_name(*INTEGRATORS),
    },
}
