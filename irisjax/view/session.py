"""`Session`: a scene under the settings of sliders and menus, and the values that its pictures are
made of.
"""

import abc
import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from irisjax.anatomy.lids import SEEN_FROM
from irisjax.io.scenes import in_degrees
from irisjax.measure.colour import srgb_encode
from irisjax.numerics.checks import check_known
from irisjax.numerics.chunks import on_cores
from irisjax.render.camera import Camera
from irisjax.render.environment import ENVIRONMENTS, Environment
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import AbstractResponse
from irisjax.render.lights import Lights
from irisjax.render.picture import (
    Radiances,
    Texels,
    add_parts,
    black_picture,
    iris_model,
    iris_part,
    light_on_iris,
    lit_model,
    respond,
    surrounding_parts,
    texture,
    trace_shares,
)
from irisjax.render.project import View, project
from irisjax.render.scene import Scene
from irisjax.render.shading import IrisModel

GIVEN = "as given"
SURROUNDS = "none", "studio", "sky"


@dataclasses.dataclass(frozen=True)
class CommonSettings:
    """Settings of every kind of iris; they start with the scene's own values.

    `panels.SLIDERS` describes the other fields; those of light are the first lamp's.

    Attributes:
        environment: A name, or `GIVEN` for the scene's own.
        camera_polar: Angle of the camera from the axis, degrees.
        camera_azimuth: Its azimuth, degrees.
        width: Width of the field, mm.
    """

    light_polar: float = 35.0
    light_azimuth: float = 120.0
    irradiance: float = 0.0
    environment: str = GIVEN
    strength: float = 1.0
    exposure: float = 1.0
    camera_polar: float = 0.0
    camera_azimuth: float = 0.0
    width: float = 15.0


@dataclasses.dataclass(frozen=True)
class Settings(CommonSettings):
    """Settings of an eye of tissue; `panels.SLIDERS` describes the other fields.

    Attributes:
        preset: A name, or `GIVEN` for the scene's own iris.
        seed: Seed of a preset's maps.
        integrator: A name of `INTEGRATORS`.
        photograph: Share of the picture's width that shows the photograph, from the left; `None`
            where there is none.
    """

    preset: str = GIVEN
    seed: int = 0
    integrator: str = "separable"
    eumelanin: float = 0.0
    pheomelanin: float = 0.0
    abl_fraction: float = 0.5
    stroma: float = 1.0
    hemoglobin: float = 0.0
    saturation: float = 0.5
    pupil_radius: float = 1.9
    photograph: float | None = None


SLIDER_PIGMENTS = ("eumelanin", "pheomelanin", "abl_fraction", "hemoglobin", "saturation")
CAMERA = ("camera_polar", "camera_azimuth", "width")
LIGHT = ("light_polar", "light_azimuth", "irradiance", "environment", "strength")
QUICK = frozenset({*SLIDER_PIGMENTS, "stroma", "exposure", "layers"})
"""Settings that change neither the tables nor the view nor anything else that takes long."""


def values_of(settings: CommonSettings, names: tuple[str, ...]) -> tuple[Any, ...]:
    """Some of the settings, in this order."""
    return tuple(getattr(settings, name) for name in names)


V = TypeVar("V")
S = TypeVar("S", bound=CommonSettings)


class KeptValue(Generic[V]):
    """A value that is computed again only where its inputs have changed."""

    def __init__(self) -> None:
        self._found: tuple[object, V] | None = None

    def of(self, inputs: object, make: Callable[[], V]) -> V:
        """Return the value for these inputs."""
        if self._found is None or self._found[0] != inputs:
            self._found = inputs, make()
        return self._found[1]


class KeptShare:
    """Values of the functions that make pictures, at a share of the pixels."""

    def __init__(self) -> None:
        self.view: KeptValue[View] = KeptValue()
        self.texels: KeptValue[Texels] = KeptValue()
        self.parts: KeptValue[Radiances] = KeptValue()
        self.light: KeptValue[Any] = KeptValue()


class KeptPicture:
    """Values that make pictures of one size."""

    def __init__(self) -> None:
        self.tracers: KeptValue[list[Callable[[], View]]] = KeptValue()
        self.shares: list[KeptShare] = []
        self.around: KeptValue[Array] = KeptValue()
        self.picture: KeptValue[tuple[np.ndarray, float | None]] = KeptValue()


class Session(abc.ABC, Generic[S]):
    """A scene, its settings, and what is already computed for them.

    Attributes:
        settings: Current settings.
        error: Error of the last picture's response, see `AbstractResponse`.
    """

    settings: S
    error: float | None = None
    # Settings of the iris that its texels, and its response, depend on.
    _SURFACES: tuple[str, ...] = ()
    _MATERIAL: tuple[str, ...] = ()

    def __init__(self, scene: Scene, tables_of: Callable[[Scene], Illumination | None]) -> None:
        self._base, self._tables_of = scene, tables_of
        self._tables = {grazing: KeptValue[Illumination | None]() for grazing in (False, True)}
        self._grazing, self._environment = KeptValue[bool](), KeptValue[Environment | None]()
        self._response = KeptValue[AbstractResponse]()
        self._model, self._lit_model = KeptValue[IrisModel](), KeptValue[IrisModel]()
        self._kept = {draft: KeptPicture() for draft in (False, True)}

    def update(self, *, draft: bool = False, **changes: Any) -> np.ndarray:
        """Return the picture after some changes: sRGB, 8 bits, (height, width, 3); a `draft` has
        a quarter of either side.

        Raises:
            ValueError: A setting is unknown or cannot be drawn; the old settings are kept.
        """
        settings = self._changed(changes)
        picture, self.error = self._picture(settings, draft)
        self.settings = settings
        return picture

    def scene(self) -> Scene:
        """The scene as it is set; `exposure` is no part of it."""
        return self._set(self.settings, self._base.camera.size)

    @abc.abstractmethod
    def _set(self, s: S, size: tuple[int, int]) -> Scene:
        """The scene under some settings, its picture of this width and height."""

    def _light(self, kept: KeptShare, lit: object, view, texels, scene, tables, model) -> Any:
        """`light_on_iris`; `lit` is what it depends on, and `model` the `lit_model`."""
        return kept.light.of(lit, lambda: light_on_iris(view, texels, scene, tables, model))

    def _picture(self, s: S, draft: bool) -> tuple[np.ndarray, float | None]:
        """Picture, and the error of its response."""
        kept = self._kept[draft]
        return kept.picture.of(s, lambda: self._drawn(kept, s, draft))

    def _drawn(self, kept: KeptPicture, s: S, draft: bool) -> tuple[np.ndarray, float | None]:
        scene = self._set(s, self._size(draft))
        # The view depends neither on the pupil nor on light. A draft projects all pixels:
        # `trace_shares` selects those of each part, and a new number of them compiles a new
        # program, which would interrupt the dragging of the camera.
        seen = *values_of(s, CAMERA), scene.integrator.pixels_apart
        whole = functools.partial(_compiled_project, scene.eye, scene.camera)
        tracers = kept.tracers.of(seen, lambda: [whole] if draft else trace_shares(scene))
        kept.shares += [KeptShare() for _ in range(len(tracers) - len(kept.shares))]
        surfaces = values_of(s, (*CAMERA, "environment", "strength", *self._SURFACES))
        grazing = self._grazing.of(values_of(s, LIGHT), scene.grazing)
        tables = self._tables[grazing].of(None, lambda: self._tables_of(scene))
        response = self._response.of(values_of(s, self._MATERIAL), lambda: respond(scene))
        model = self._model.of(values_of(s, self._SURFACES), lambda: iris_model(scene))
        lit = surfaces, values_of(s, LIGHT)
        fixed = values_of(s, (*self._SURFACES, *LIGHT))
        lit_iris = self._lit_model.of(fixed, lambda: lit_model(scene, tables, model))

        def draw_share(own: KeptShare, trace: Callable[[], View]) -> tuple[Radiances, Radiances]:
            view = own.view.of(seen, trace)
            texels = own.texels.of(surfaces, lambda: texture(view, scene, model))
            parts = own.parts.of(lit, lambda: surrounding_parts(view, texels, scene))
            light = self._light(own, lit, view, texels, scene, tables, lit_iris)
            return parts, iris_part(view, texels, light, response)

        shares = on_cores(draw_share, kept.shares[: len(tracers)], tracers)
        outside, iris = ([share[i] for share in shares] for i in (0, 1))
        size = scene.camera.size
        surroundings = kept.around.of(lit, lambda: add_parts(black_picture(scene, size), outside))
        picture = add_parts(surroundings, iris, size)
        picture = np.asarray(_encoded(picture, jnp.asarray(s.exposure, picture.dtype)))
        return picture, None if response.error is None else float(response.error)

    def environments(self) -> tuple[str, ...]:
        """Environments to choose from."""
        given = (GIVEN,) if self.settings.environment == GIVEN else ()
        return given + SURROUNDS

    def _start(self) -> dict[str, Any]:
        """Settings of the scene as it was given."""
        scene = self._base
        start = {
            "camera_polar": in_degrees(scene.camera.polar),
            "camera_azimuth": in_degrees(scene.camera.azimuth),
            "width": float(scene.camera.width),
            "environment": "none" if scene.environment is None else GIVEN,
        }
        if scene.lights is not None:
            x, y, z = np.asarray(scene.lights.towards[0], np.float64)
            start |= {
                "light_polar": in_degrees(math.atan2(math.hypot(x, y), -z)),
                "light_azimuth": in_degrees(math.atan2(y, x)),
                "irradiance": float(scene.lights.irradiance[0]),
            }
        return start

    def _changed(self, changes: dict[str, Any]) -> S:
        if unknown := changes.keys() - {f.name for f in dataclasses.fields(self.settings)}:
            raise ValueError(f"no such setting: {', '.join(sorted(unknown))}")
        return dataclasses.replace(self.settings, **changes)

    def _size(self, draft: bool) -> tuple[int, int]:
        """Width and height of a picture; a draft has a quarter of either."""
        width, height = self._base.camera.size
        return (max(width // 4, 1), max(height // 4, 1)) if draft else (width, height)

    def _parts(self, s: S, size: tuple[int, int]) -> dict[str, Any]:
        """Lights, environment and camera of a scene."""
        angles = s.light_polar, s.light_azimuth, s.camera_polar, s.camera_azimuth
        light_polar, light_azimuth, *camera = map(math.radians, angles)
        base, around = self._base, (s.environment, s.strength)
        lamps = Lights.distant(light_polar, light_azimuth, illuminant=base.illuminant)
        if base.lights is not None:
            towards = base.lights.towards.at[0].set(lamps.towards[0])
            lamps = dataclasses.replace(base.lights, towards=towards)
        irradiance = lamps.irradiance.at[0].set(s.irradiance)
        if base.eye.lids is not None:
            camera[0] = min(camera[0], SEEN_FROM)
        polar, azimuth, width = (jnp.asarray(v, float) for v in (*camera, s.width))
        return {
            "lights": dataclasses.replace(lamps, irradiance=irradiance),
            "environment": self._environment.of(around, lambda: self._around(s)),
            "camera": Camera(polar, azimuth, base.camera.distance, width, size),
        }

    def _around(self, s: S) -> Environment | None:
        found = self._base.environment
        if s.environment != GIVEN:
            check_known("environment", s.environment, SURROUNDS)
            found = None if s.environment == "none" else ENVIRONMENTS[s.environment]()
        if found is None or s.strength == 0:
            return None
        return Environment(found.radiance * s.strength)


_compiled_project = eqx.filter_jit(project)


@eqx.filter_jit
def _encoded(picture: Array, exposure: Array) -> Array:
    """Encode a linear picture as sRGB, 8 bits."""
    return jnp.asarray(255 * jnp.clip(srgb_encode(exposure * picture), 0, 1) + 0.5, jnp.uint8)
