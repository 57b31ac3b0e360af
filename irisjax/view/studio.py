"""`Studio`: a scene under sliders. A change recomputes the stages whose inputs it touches, and no
others.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from irisjax.grow.presets import PRESETS
from irisjax.io.scenes import stream
from irisjax.measure.colour import Colour, colour_of
from irisjax.measure.spectrophotometer import reflectance
from irisjax.render.compose import Stage
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import AbstractIntegrator
from irisjax.render.integrators import INTEGRATORS, integrator_name
from irisjax.render.scene import Scene
from irisjax.render.stages import Memory
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps
from irisjax.transport.defaults import exact_solver
from irisjax.transport.process import AbstractProcess
from irisjax.view.settings import CAMERA, GIVEN, LIGHT, PIGMENTS, Settings, values_of
from irisjax.view.staging import Staging, encoded, environments
from irisjax.view.wipe import Picture, resized, wiped

GRID = np.arange(400.0, 701.0, 5.0)
"""Wavelengths of the spectrum, nm."""
_GROWN = ("preset", "seed", "integrator")


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
        self._staging = Staging(scene)
        self._photograph = None if photograph is None else resized(photograph, scene.camera.size)
        self._memory = {draft: Memory(threads) for draft in (False, True)}
        self.error = 0.0
        start = {
            **self._staging.start(),
            "pupil_radius": round(float(scene.eye.pupil_radius), 6),
            "integrator": integrator_name(scene.integrator),
            **_pigments(scene.tissue),
        }
        if photograph is not None:
            start["photograph"] = 0.5
        self.settings = Settings(**{**start, **given})
        self._cameras = values_of(self.settings, CAMERA)

    @property
    def photographed(self) -> dict[str, float]:
        """Settings of the camera that the scene, and its photograph, began with."""
        return dict(zip(CAMERA, self._cameras, strict=True))

    def presets(self) -> tuple[str, ...]:
        """Eye colours to choose from."""
        return ((GIVEN,) if self.settings.preset == GIVEN else ()) + tuple(PRESETS)

    def environments(self) -> tuple[str, ...]:
        """Environments to choose from."""
        return environments(self.settings)

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
        if settings.photograph and values_of(settings, CAMERA) != self._cameras:
            settings = dataclasses.replace(settings, photograph=0.0)
        drawn = dataclasses.replace(settings, photograph=None)
        picture, error = self._staging.once(
            ("picture", draft), drawn, lambda: self._rendered(drawn, draft)
        )
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
        found = reflectance(self.iris, GRID, solver=exact_solver(self._process(self.settings)))
        colour = colour_of(GRID, found.values, illuminant=self._base.illuminant)
        return np.asarray(found.values), colour

    def _rendered(self, s: Settings, draft: bool) -> tuple[np.ndarray, float | None]:
        """Picture, and the error of its response."""
        stage = self._stage(s, draft)
        asked = values_of(s, (*PIGMENTS, "stroma", *_GROWN))
        response = self._staging.once("response", asked, lambda: stage.response(self._iris(s)))
        shown = self._memory[draft].shown(stage, response)
        picture = encoded(shown, s.exposure)
        return picture, None if response.error is None else float(response.error)

    def _seen(self, draft: bool) -> Picture:
        """The photograph at the picture's size."""
        photograph = self._photograph
        assert photograph is not None
        size = self._staging.size(draft)
        return self._staging.once(("photograph", draft), None, lambda: resized(photograph, size))

    def _stage(self, s: Settings, draft: bool) -> Stage:
        size = self._staging.size(draft)
        seen, lit = values_of(s, CAMERA), values_of(s, LIGHT)
        memory = self._memory[draft]

        def make():
            scene = self._set(s, size)
            # Neither what a camera sees of the iris plane nor what light does there depends on the
            # pupil.
            view = self._staging.once(
                ("view", draft), seen, lambda: memory.look(scene.eye, scene.camera)
            )
            grazing = self._staging.once("grazing", lit, scene.grazing)
            tables = self._staging.once(("tables", grazing), None, lambda: self._tables_of(scene))
            return memory.prepare(scene, tables, view)

        return self._staging.once(
            ("stage", draft), (seen, lit, values_of(s, _GROWN), s.pupil_radius), make
        )

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
        return self._staging.once("integrator", s.integrator, INTEGRATORS[s.integrator])

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

        return self._staging.once("grown", values_of(s, _GROWN), grow)

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
            eye=self._staging.once("eye", s.pupil_radius, lambda: self._eye(s)),
            **self._staging.parts(s, size),
        )

    def _eye(self, s: Settings):
        return self._base.eye.replace(pupil_radius=s.pupil_radius)


def _pigments(iris: Iris) -> dict[str, float]:
    total = float(iris.oxyhemoglobin + iris.deoxyhemoglobin)
    given = iris.parameters()
    return {
        **{name: given[name] for name in ("eumelanin", "pheomelanin", "abl_fraction")},
        "hemoglobin": round(total, 6),
        "saturation": round(float(iris.oxyhemoglobin) / total, 6) if total else 0.5,
    }
