"""`Studio`: a scene of tissue under sliders. A change computes those values again whose inputs it
touches, and no others.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import UInt8

from irisjax.grow.presets import PRESETS
from irisjax.io.scenes import SceneFile, scene_text, stream
from irisjax.measure.colour import Colour, colour_of
from irisjax.measure.photometers import reflectance
from irisjax.numerics.checks import Range, check_known, check_range
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import AbstractIntegrator
from irisjax.render.integrators import INTEGRATORS, integrator_name
from irisjax.render.picture import prepare_scene
from irisjax.render.scene import Scene
from irisjax.tissue.iris import BLOOD, Iris
from irisjax.tissue.maps import IrisMaps
from irisjax.transport.defaults import exact_solver
from irisjax.transport.process import AbstractProcess
from irisjax.view.session import (
    CAMERA,
    GIVEN,
    SLIDER_PIGMENTS,
    KeptValue,
    Session,
    Settings,
    values_of,
)

SPECTRUM_NM = np.arange(400.0, 701.0, 5.0)
"""Wavelengths of the spectrum, nm."""
RgbPicture = UInt8[np.ndarray, "_ _ 3"]
"""sRGB, 8 bits, rows and columns of any number: two pictures need not agree."""
_SHARE = Range(0, 1, "of the width")
_LINE = 255
_PER_LINE = 400  # columns of the picture for each column of the line
_GROWN = ("preset", "seed", "integrator")


class Studio(Session[Settings]):
    """A scene of tissue, its settings, and what is already computed for them."""

    _SURFACES = (*_GROWN, "pupil_radius")
    _MATERIAL = (*SLIDER_PIGMENTS, "stroma", *_GROWN)

    def __init__(
        self,
        scene: Scene,
        tables_of: Callable[[Scene], Illumination | None] = Scene.tables,
        photograph: RgbPicture | None = None,
        file: SceneFile | None = None,
        **given: Any,
    ):
        """Begin with the settings of a scene.

        Args:
            scene: The scene.
            tables_of: Computes the illumination tables of a scene, or reads them.
            photograph: Photograph from the scene's camera, sRGB, 8 bits, sides in proportion to the
                picture's; the left half of the first picture shows it.
            file: The file of the scene, for `scene_text`.
            given: Settings that the scene does not hold, such as the name of its `preset`.
        """
        super().__init__(scene, tables_of)
        self.file: SceneFile | None = file
        self._photograph = None if photograph is None else resized(photograph, scene.camera.size)
        self._growth = KeptValue[tuple[Iris, IrisMaps | None]]()
        self._made = KeptValue[AbstractIntegrator]()
        self._ready = KeptValue[Scene]()
        start = {
            **self._start(),
            "pupil_radius": round(float(scene.eye.pupil_radius), 6),
            "integrator": integrator_name(scene.integrator),
            **_pigments(scene.tissue),
            "photograph": None if photograph is None else 0.5,
        }
        self.settings: Settings = Settings(**start | given)
        self._cameras = values_of(self.settings, CAMERA)

    @property
    def photographed(self) -> dict[str, float]:
        """Settings of the camera that the scene, and its photograph, began with."""
        return dict(zip(CAMERA, self._cameras, strict=True))

    def presets(self) -> tuple[str, ...]:
        """Eye colours to choose from."""
        return ((GIVEN,) if self.settings.preset == GIVEN else ()) + tuple(PRESETS)

    def _changed(self, changes: dict[str, Any]) -> Settings:
        """Other presets bring their pigments; another camera hides the photograph."""
        settings = super()._changed(changes)
        if self._look(settings) != self._look(self.settings):
            own = _pigments(self._grown(settings)[0]) | {"stroma": 1.0}
            settings = dataclasses.replace(settings, **{**own, **changes})
        if settings.photograph is not None and self._photograph is None:
            raise ValueError("no photograph to show")
        if settings.photograph and values_of(settings, CAMERA) != self._cameras:
            settings = dataclasses.replace(settings, photograph=0.0)
        return settings

    def _picture(self, s: Settings, draft: bool) -> tuple[np.ndarray, float | None]:
        picture, error = super()._picture(dataclasses.replace(s, photograph=None), draft)
        if s.photograph and self._photograph is not None:
            picture = wiped(resized(self._photograph, self._size(draft)), picture, s.photograph)
        return picture, error

    def spectrum(self) -> tuple[np.ndarray, Colour]:
        """Reflectance of the uniform iris on `SPECTRUM_NM`, without an eye, and its colour."""
        s = self.settings
        found = reflectance(self._iris(s), SPECTRUM_NM, solver=exact_solver(self._process(s)))
        colour = colour_of(SPECTRUM_NM, found.values, illuminant=self._base.illuminant)
        return np.asarray(found.values), colour

    def scene_text(self) -> str:
        """Text of a scene file of the present settings, for `irisjax render` and `irisjax view`;
        files that it names have absolute names. Needs the `file` that the scene was read from.
        """
        assert self.file is not None
        s, sections, scene = self.settings, self.file.sections, self.scene()
        named: dict[str, dict[str, Any]] = {
            name: dict(sections.get(name, {})) for name in ("maps", "environment")
        }
        preset = sections.get("iris", {}).get("preset")
        if s.preset != GIVEN:
            preset, named["maps"] = s.preset, {"seed": s.seed}
        if s.environment != GIVEN:
            named["environment"] = {"kind": s.environment}
        if scene.environment is None:
            del named["environment"]
        else:
            strength = named["environment"].get("strength", 1.0)
            named["environment"]["strength"] = s.strength * strength
        for entries in named.values():
            if "file" in entries:
                entries["file"] = str((self.file.folder / entries["file"]).resolve())
        named |= {"iris": {"preset": preset}, "picture": {"exposure": s.exposure}}
        if scene.environment is not None and self._base.lights is None and s.irradiance == 0:
            scene = scene.replace(lights=None)
        return scene_text(scene, named, "An eye as it is set in `irisjax view`.")

    def _look(self, s: Settings):
        """Settings that the pigments of a preset depend on."""
        return s.preset, s.preset != GIVEN and type(self._integrator(s).process)

    def _integrator(self, s: Settings) -> AbstractIntegrator:
        """The scene's own where its name is asked for."""
        check_known("integrator", s.integrator, INTEGRATORS)
        if integrator_name(self._base.integrator) == s.integrator:
            return self._base.integrator
        return self._made.of(s.integrator, INTEGRATORS[s.integrator])

    def _process(self, s: Settings) -> AbstractProcess:
        process = self._integrator(s).process
        assert process is not None  # none of INTEGRATORS paints
        return process

    def _grown(self, s: Settings) -> tuple[Iris, IrisMaps | None]:
        """Iris and maps before any slider is moved."""
        if s.preset == GIVEN:
            return self._base.tissue, self._base.maps
        check_known("eye colour", s.preset, PRESETS)

        def grow():
            process = self._process(s)
            return PRESETS[s.preset](self._base.eye, process=process, key=stream(s.seed, "maps"))

        return self._growth.of(values_of(s, _GROWN), grow)

    def _iris(self, s: Settings) -> Iris:
        iris = self._grown(s)[0]
        pigments = {name: getattr(s, name) for name in SLIDER_PIGMENTS}
        return iris.replace(**pigments, stroma_thickness=iris.stroma_thickness * s.stroma)

    def _set(self, s: Settings, size: tuple[int, int]) -> Scene:
        maps = self._grown(s)[1]
        if maps is not None and maps.stroma_depth is not None:
            maps = maps.replace(stroma_depth=maps.stroma_depth * s.stroma)
        scene = self._base.replace(
            iris=self._iris(s),
            maps=maps,
            integrator=self._integrator(s),
            eye=self._base.eye.replace(pupil_radius=s.pupil_radius),
            **self._parts(s, size),
        )
        # Maps are relative to the iris: pigments and thickness change the response alone.
        ready = self._ready.of(values_of(s, _GROWN), lambda: prepare_scene(scene))
        return scene.replace(integrator=ready.integrator)


def _pigments(iris: Iris) -> dict[str, float]:
    given = iris.parameters()
    return {
        **{name: given[name] for name in ("eumelanin", "pheomelanin", "abl_fraction")},
        **{name: round(float(getattr(iris, name)), 6) for name in BLOOD},
    }


def wiped(photograph: RgbPicture, rendered: RgbPicture, share: float) -> RgbPicture:
    """Columns of the photograph on the left up to `share` of the width, the rendering on the right,
    a thin white line between them; 0 and 1 show one of them alone.

    Raises:
        ValueError: The pictures have different sizes, or the share is not in 0 to 1.
    """
    if photograph.shape != rendered.shape:
        (rows, columns, _), (height, width, _) = photograph.shape, rendered.shape
        raise ValueError(
            f"the photograph has {columns} x {rows} pixels, the rendering {width} x {height}"
        )
    check_range("photograph", share, _SHARE)
    columns = rendered.shape[1]
    edge = round(share * columns)
    both = np.concatenate([photograph[:, :edge], rendered[:, edge:]], axis=1)
    if 0 < edge < columns:
        thick = max(1, round(columns / _PER_LINE))
        start = max(edge - (thick + 1) // 2, 0)
        both[:, start : start + thick] = _LINE
    return both


def resized(picture: RgbPicture, size: tuple[int, int]) -> RgbPicture:
    """The picture at another (width, height), each pixel the mean of what it covers, to one
    level; the same picture for its own size.

    Raises:
        ValueError: The sides are in another proportion, by more than rounding.
    """
    height, width = picture.shape[:2]
    if size == (width, height):
        return picture
    if abs(size[0] * height - size[1] * width) > max(width, height):
        raise ValueError(
            f"{size[0]}x{size[1]}: the photograph has {width}x{height} pixels, sides must be in "
            "that proportion"
        )
    from PIL import Image

    return np.array(Image.fromarray(picture).resize(size, Image.Resampling.BOX), np.uint8)
