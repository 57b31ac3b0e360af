"""`Studio`: a scene under sliders. A change recomputes the stages whose inputs it touches, and no
others.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from irisjax.grow.presets import PRESETS
from irisjax.io.scenes import stream
from irisjax.measure.colour import Colour, colour_of, srgb_encode
from irisjax.measure.spectrophotometer import reflectance
from irisjax.render.camera import Camera
from irisjax.render.compose import Stage
from irisjax.render.environment import Environment
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import AbstractIntegrator
from irisjax.render.integrators import INTEGRATORS, integrator_name
from irisjax.render.lights import Lights
from irisjax.render.scene import Scene
from irisjax.render.stages import Memory
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps
from irisjax.transport.process import AbstractProcess
from irisjax.view.settings import CAMERA, ENVIRONMENTS, GIVEN, PIGMENTS, Settings
from irisjax.view.wipe import Picture, resized, wiped

GRID = np.arange(400.0, 701.0, 5.0)
"""Wavelengths of the spectrum, nm."""
_GROWN = ("preset", "seed", "integrator")
_LAMP = ("light_polar", "light_azimuth", "irradiance")
_LIGHT = (*_LAMP, "environment", "strength")


class Studio:
    """A scene, its settings, and what is already computed for them.

    - `tables_of`: makes the illumination tables of a scene, or finds them. `threads`: that share
        the pixels of a picture.
    - `photograph`: what the scene's camera saw, sRGB, 8 bits, sides in proportion to the picture's;
        the left half of the first picture shows it.
    - `given`: settings that the scene does not tell, such as the name of its `preset`.
    - `error`: of the last picture's response, see `AbstractResponse`.
    """

    def __init__(
        self,
        scene: Scene,
        tables_of: Callable[[Scene], Illumination | None] = Scene.tables,
        threads: int = 1,
        photograph: Picture | None = None,
        **given: Any,
    ):
        self._base, self._tables_of = scene, tables_of
        self._photograph = None if photograph is None else resized(photograph, scene.camera.size)
        self._kept: dict[Any, tuple[Any, Any]] = {}
        self._memory = {draft: Memory(threads) for draft in (False, True)}
        self.error = 0.0
        camera = scene.camera
        start = {
            "pupil_radius": round(float(scene.eye.pupil_radius), 6),
            "camera_polar": _degrees(camera.polar),
            "camera_azimuth": _degrees(camera.azimuth),
            "width": float(camera.width),
            "environment": "none" if scene.environment is None else GIVEN,
            "integrator": integrator_name(scene.integrator),
            **_pigments(scene.tissue),
        }
        if scene.lights is not None:
            x, y, z = np.asarray(scene.lights.towards[0], np.float64)
            start |= {
                "light_polar": _degrees(math.atan2(math.hypot(x, y), -z)),
                "light_azimuth": _degrees(math.atan2(y, x)),
                "irradiance": float(scene.lights.irradiance[0]),
            }
        if photograph is not None:
            start["photograph"] = 0.5
        self.settings = Settings(**{**start, **given})
        self._cameras = _of(self.settings, CAMERA)

    @property
    def photographed(self) -> dict[str, float]:
        """Settings of the camera that the scene, and its photograph, began with."""
        return dict(zip(CAMERA, self._cameras, strict=True))

    def presets(self) -> tuple[str, ...]:
        """Eye colours to choose from."""
        return ((GIVEN,) if self.settings.preset == GIVEN else ()) + tuple(PRESETS)

    def environments(self) -> tuple[str, ...]:
        """Environments to choose from."""
        return ((GIVEN,) if self.settings.environment == GIVEN else ()) + tuple(ENVIRONMENTS)

    def update(self, *, draft: bool = False, **changes: Any) -> np.ndarray:
        """The picture after some changes: sRGB, 8 bits, (height, width, 3); a `draft` has half of
        either side.

        Another preset brings its own pigments, and so does a preset under another integrator. Any
        camera but the photograph's hides the photograph. **Raises:** `ValueError` and keeps the old
        settings.
        """
        if unknown := changes.keys() - {f.name for f in dataclasses.fields(Settings)}:
            raise ValueError(f"no such setting: {', '.join(sorted(unknown))}")
        settings = dataclasses.replace(self.settings, **changes)
        if self._look(settings) != self._look(self.settings):
            own = _pigments(self._grown(settings)[0]) | {"stroma": 1.0}
            settings = dataclasses.replace(settings, **{**own, **changes})
        if settings.photograph is not None and self._photograph is None:
            raise ValueError("no photograph to show")
        if settings.photograph and _of(settings, CAMERA) != self._cameras:
            settings = dataclasses.replace(settings, photograph=0.0)
        drawn = dataclasses.replace(settings, photograph=None)
        picture, error = self._once(("picture", draft), drawn, lambda: self._rendered(drawn, draft))
        if settings.photograph:
            picture = wiped(self._seen(draft), picture, settings.photograph)
        self.settings, self.error = settings, error
        return picture

    @property
    def iris(self) -> Iris:
        """The iris as it is set."""
        return self._iris(self.settings)

    def scene(self) -> Scene:
        """The scene as it is set; `exposure` is no part of it."""
        s = self.settings
        scene = self._set(s, self._base.camera.size)
        maps = scene.maps
        if maps is not None and maps.stroma_depth is not None:
            maps = maps.replace(stroma_depth=maps.stroma_depth * s.stroma)
        return scene.replace(iris=self._iris(s), maps=maps)

    def spectrum(self) -> tuple[np.ndarray, Colour]:
        """Reflectance of the uniform iris, without an eye round it, on `GRID`; and its colour."""
        found = reflectance(self.iris, GRID, process=self._process(self.settings))
        colour = colour_of(GRID, found.values, illuminant=self._base.illuminant)
        return np.asarray(found.values), colour

    def _once(self, name: Any, inputs: Any, make: Callable[[], Any]) -> Any:
        """What `make` gave for the same inputs last time, or gives now."""
        if name not in self._kept or self._kept[name][0] != inputs:
            self._kept[name] = inputs, make()
        return self._kept[name][1]

    def _rendered(self, s: Settings, draft: bool) -> tuple[np.ndarray, float | None]:
        """Picture, and the error of its response."""
        stage = self._stage(s, draft)
        asked = _of(s, (*PIGMENTS, "stroma", *_GROWN))
        response = self._once("response", asked, lambda: stage.response(self._iris(s)))
        shown = self._memory[draft].shown(stage, response)
        picture = _encoded(shown, jnp.asarray(s.exposure, shown.dtype))
        return np.asarray(picture), None if response.error is None else float(response.error)

    def _seen(self, draft: bool) -> Picture:
        """The photograph at the picture's size."""
        photograph = self._photograph
        assert photograph is not None
        size = self._size(draft)
        return self._once(("photograph", draft), None, lambda: resized(photograph, size))

    def _size(self, draft: bool) -> tuple[int, int]:
        width, height = self._base.camera.size
        return (max(width // 2, 1), max(height // 2, 1)) if draft else (width, height)

    def _stage(self, s: Settings, draft: bool) -> Stage:
        size = self._size(draft)
        seen, lit = _of(s, CAMERA), _of(s, _LIGHT)
        memory = self._memory[draft]

        def make():
            scene = self._set(s, size)
            # Neither what a camera sees of the iris plane nor what light does there depends on the
            # pupil.
            view = self._once(("view", draft), seen, lambda: memory.look(scene.eye, scene.camera))
            grazing = self._once("grazing", lit, scene.grazing)
            tables = self._once(("tables", grazing), None, lambda: self._tables_of(scene))
            return memory.prepare(scene, tables, view)

        return self._once(("stage", draft), (seen, lit, _of(s, _GROWN), s.pupil_radius), make)

    def _look(self, s: Settings):
        """What an iris's own pigments depend on."""
        return s.preset, s.preset != GIVEN and type(self._integrator(s).process)

    def _integrator(self, s: Settings) -> AbstractIntegrator:
        """The scene's own where its name is asked for."""
        if s.integrator not in INTEGRATORS:
            raise ValueError(
                f"unknown integrator {s.integrator!r}; known: {', '.join(INTEGRATORS)}"
            )
        if integrator_name(self._base.integrator) == s.integrator:
            return self._base.integrator
        return self._once("integrator", s.integrator, INTEGRATORS[s.integrator])

    def _process(self, s: Settings) -> AbstractProcess:
        process = self._integrator(s).process
        assert process is not None  # none of INTEGRATORS paints
        return process

    def _grown(self, s: Settings) -> tuple[Iris, IrisMaps | None]:
        """Iris and maps before any slider is moved."""
        if s.preset == GIVEN:
            return self._base.tissue, self._base.maps
        if s.preset not in PRESETS:
            raise ValueError(f"unknown eye colour {s.preset!r}; known: {', '.join(PRESETS)}")

        def grow():
            process = self._process(s)
            return PRESETS[s.preset](self._base.eye, process=process, key=stream(s.seed, "maps"))

        return self._once("grown", _of(s, _GROWN), grow)

    def _iris(self, s: Settings) -> Iris:
        iris = self._grown(s)[0]
        return iris.replace(
            eumelanin=s.eumelanin,
            pheomelanin=s.pheomelanin,
            abl_fraction=s.abl_fraction,
            oxyhemoglobin=s.hemoglobin * s.saturation,
            deoxyhemoglobin=s.hemoglobin * (1 - s.saturation),
            stroma_thickness=iris.stroma_thickness * s.stroma,
        )

    def _set(self, s: Settings, size: tuple[int, int]) -> Scene:
        """The scene but for the pigments: maps are relative to its iris, whatever its thickness."""
        iris, maps = self._grown(s)
        base = self._base
        # The same objects for the same settings: by them `Memory` knows what has not changed.
        return base.replace(
            iris=iris,
            maps=maps,
            integrator=self._integrator(s),
            eye=self._once("eye", s.pupil_radius, lambda: self._eye(s)),
            lights=self._once("lights", _of(s, _LAMP), lambda: self._lamps(s)),
            environment=self._once(
                "environment", (s.environment, s.strength), lambda: self._around(s)
            ),
            camera=self._once(("camera", size), _of(s, CAMERA), lambda: self._camera(s, size)),
        )

    def _eye(self, s: Settings):
        return self._base.eye.replace(pupil_radius=s.pupil_radius)

    def _camera(self, s: Settings, size: tuple[int, int]) -> Camera:
        polar, azimuth = (
            jnp.asarray(math.radians(angle), float) for angle in (s.camera_polar, s.camera_azimuth)
        )
        return Camera(polar, azimuth, self._base.camera.distance, jnp.asarray(s.width, float), size)

    def _lamps(self, s: Settings) -> Lights:
        base = self._base
        lamp = Lights.distant(
            math.radians(s.light_polar), math.radians(s.light_azimuth), illuminant=base.illuminant
        )
        if base.lights is not None:
            lamp = dataclasses.replace(
                base.lights, towards=base.lights.towards.at[0].set(lamp.towards[0])
            )
        return dataclasses.replace(lamp, irradiance=lamp.irradiance.at[0].set(s.irradiance))

    def _around(self, s: Settings) -> Environment | None:
        if s.environment not in (GIVEN, *ENVIRONMENTS):
            raise ValueError(
                f"unknown environment {s.environment!r}; known: {', '.join(ENVIRONMENTS)}"
            )
        make = ENVIRONMENTS.get(s.environment)
        given = s.environment == GIVEN
        found = self._base.environment if given else None if make is None else make()
        if found is None or s.strength == 0:
            return None
        return Environment(found.radiance * s.strength)


def _of(settings: Settings, names: tuple[str, ...]) -> tuple[Any, ...]:
    return tuple(getattr(settings, name) for name in names)


def _degrees(angle) -> float:
    return round(math.degrees(float(angle)), 4)


def _pigments(iris: Iris) -> dict[str, float]:
    total = float(iris.oxyhemoglobin + iris.deoxyhemoglobin)
    given = iris.parameters()
    return {
        **{name: given[name] for name in ("eumelanin", "pheomelanin", "abl_fraction")},
        "hemoglobin": round(total, 6),
        "saturation": round(float(iris.oxyhemoglobin) / total, 6) if total else 0.5,
    }


@eqx.filter_jit
def _encoded(picture, exposure):
    return jnp.asarray(255 * jnp.clip(srgb_encode(exposure * picture), 0, 1) + 0.5, jnp.uint8)
