"""`Session`: a scene under settings, and the values that its pictures are made of."""

import abc
import dataclasses
import math
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from irisjax.measure.colour import srgb_encode
from irisjax.render.camera import Camera
from irisjax.render.environment import Environment
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.picture import LitView, Texels
from irisjax.render.project import View, look
from irisjax.render.scene import Scene
from irisjax.view.settings import (
    CAMERA,
    ENVIRONMENTS,
    GIVEN,
    LIGHT,
    CommonSettings,
    values_of,
)

T = TypeVar("T")
S = TypeVar("S", bound=CommonSettings)


class KeptValue(Generic[T]):
    """A value that is computed again only where its inputs have changed."""

    def __init__(self) -> None:
        self._found: tuple[Any, T] | None = None

    def of(self, inputs: Any, make: Callable[[], T]) -> T:
        """Return the value for these inputs."""
        if self._found is None or self._found[0] != inputs:
            self._found = inputs, make()
        return self._found[1]


class Values:
    """Values of the functions that make pictures of one size."""

    def __init__(self) -> None:
        self.view = KeptValue[View]()
        self.texels = KeptValue[Texels]()
        self.light = KeptValue[LitView]()
        self.picture = KeptValue[Any]()


class Session(abc.ABC, Generic[S]):
    """A scene, its settings, and what is already computed for them.

    Attributes:
        settings: Current settings.
    """

    settings: S

    def __init__(self, scene: Scene, tables_of: Callable[[Scene], Illumination | None]) -> None:
        self._base, self._tables_of = scene, tables_of
        self._tables = {grazing: KeptValue[Illumination | None]() for grazing in (False, True)}
        self._grazing, self._environment = KeptValue[bool](), KeptValue[Environment | None]()

    @abc.abstractmethod
    def update(self, *, draft: bool = False, **changes: Any) -> np.ndarray:
        """Return the picture after some changes: sRGB, 8 bits, (height, width, 3); a `draft` has
        half of either side.

        Raises:
            ValueError: A setting is unknown or cannot be drawn; the old settings are kept.
        """

    @abc.abstractmethod
    def scene(self) -> Scene:
        """The scene as it is set; `exposure` is no part of it."""

    def environments(self) -> tuple[str, ...]:
        """Environments to choose from."""
        given = (GIVEN,) if self.settings.environment == GIVEN else ()
        return given + tuple(ENVIRONMENTS)

    def _start(self) -> dict[str, Any]:
        """Settings of the scene as it was given."""
        scene = self._base
        start = {
            "camera_polar": _degrees(scene.camera.polar),
            "camera_azimuth": _degrees(scene.camera.azimuth),
            "width": float(scene.camera.width),
            "environment": "none" if scene.environment is None else GIVEN,
        }
        if scene.lights is not None:
            x, y, z = np.asarray(scene.lights.towards[0], np.float64)
            start |= {
                "light_polar": _degrees(math.atan2(math.hypot(x, y), -z)),
                "light_azimuth": _degrees(math.atan2(y, x)),
                "irradiance": float(scene.lights.irradiance[0]),
            }
        return start

    def _changed(self, changes: dict[str, Any]) -> S:
        if unknown := changes.keys() - {f.name for f in dataclasses.fields(self.settings)}:
            raise ValueError(f"no such setting: {', '.join(sorted(unknown))}")
        return dataclasses.replace(self.settings, **changes)

    def _size(self, draft: bool) -> tuple[int, int]:
        """Width and height of a picture; a draft has half of either."""
        width, height = self._base.camera.size
        return (max(width // 2, 1), max(height // 2, 1)) if draft else (width, height)

    def _view(self, kept: Values, s: S, scene: Scene) -> View:
        """What the camera sees: it depends neither on the pupil nor on light."""
        return kept.view.of(values_of(s, CAMERA), lambda: look(scene.eye, scene.camera))

    def _tables_for(self, s: S, scene: Scene) -> Illumination | None:
        grazing = self._grazing.of(values_of(s, LIGHT), scene.grazing)
        return self._tables[grazing].of(None, lambda: self._tables_of(scene))

    def _parts(self, s: S, size: tuple[int, int]) -> dict[str, Any]:
        """Lights, environment and camera of a scene."""
        around = self._environment.of((s.environment, s.strength), lambda: self._around(s))
        return {"lights": self._lamps(s), "environment": around, "camera": self._camera(s, size)}

    def _camera(self, s: S, size: tuple[int, int]) -> Camera:
        polar, azimuth = (
            jnp.asarray(math.radians(angle), float) for angle in (s.camera_polar, s.camera_azimuth)
        )
        return Camera(polar, azimuth, self._base.camera.distance, jnp.asarray(s.width, float), size)

    def _lamps(self, s: S) -> Lights:
        base = self._base
        lamp = Lights.distant(
            math.radians(s.light_polar), math.radians(s.light_azimuth), illuminant=base.illuminant
        )
        if base.lights is not None:
            lamp = dataclasses.replace(
                base.lights, towards=base.lights.towards.at[0].set(lamp.towards[0])
            )
        return dataclasses.replace(lamp, irradiance=lamp.irradiance.at[0].set(s.irradiance))

    def _around(self, s: S) -> Environment | None:
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


def encoded(picture: Any, exposure: float) -> np.ndarray:
    """Encode a linear picture as sRGB, 8 bits."""
    return np.asarray(_encoded(picture, jnp.asarray(exposure, picture.dtype)))


@eqx.filter_jit
def _encoded(picture: Any, exposure: Any) -> Any:
    return jnp.asarray(255 * jnp.clip(srgb_encode(exposure * picture), 0, 1) + 0.5, jnp.uint8)


def _degrees(angle: Any) -> float:
    return round(math.degrees(float(angle)), 4)
