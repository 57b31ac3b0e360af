"""`Staging`: lamps, surroundings and camera under settings, whatever the iris is made of."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from irisjax.measure.colour import srgb_encode
from irisjax.render.camera import Camera
from irisjax.render.environment import Environment
from irisjax.render.lights import Lights
from irisjax.render.scene import Scene
from irisjax.view.settings import CAMERA, ENVIRONMENTS, GIVEN, LAMP, Shown, values_of


class Staging:
    """Makes the parts of a scene that settings change, and keeps the last of each: `Memory` knows
    by the same objects what has not changed.
    """

    def __init__(self, scene: Scene):
        self._base = scene
        self._kept: dict[Any, tuple[Any, Any]] = {}

    def once(self, name: Any, inputs: Any, make: Callable[[], Any]) -> Any:
        """What `make` gave for the same inputs last time, or gives now."""
        if name not in self._kept or self._kept[name][0] != inputs:
            self._kept[name] = inputs, make()
        return self._kept[name][1]

    def start(self) -> dict[str, Any]:
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

    def size(self, draft: bool) -> tuple[int, int]:
        """Width and height of a picture; a draft has half of either."""
        width, height = self._base.camera.size
        return (max(width // 2, 1), max(height // 2, 1)) if draft else (width, height)

    def parts(self, s: Shown, size: tuple[int, int]) -> dict[str, Any]:
        """Lights, environment and camera of a `Scene`."""
        return {
            "lights": self.once("lights", values_of(s, LAMP), lambda: self._lamps(s)),
            "environment": self.once(
                "environment", (s.environment, s.strength), lambda: self._around(s)
            ),
            "camera": self.once(
                ("camera", size), values_of(s, CAMERA), lambda: self._camera(s, size)
            ),
        }

    def _camera(self, s: Shown, size: tuple[int, int]) -> Camera:
        polar, azimuth = (
            jnp.asarray(math.radians(angle), float) for angle in (s.camera_polar, s.camera_azimuth)
        )
        return Camera(polar, azimuth, self._base.camera.distance, jnp.asarray(s.width, float), size)

    def _lamps(self, s: Shown) -> Lights:
        base = self._base
        lamp = Lights.distant(
            math.radians(s.light_polar), math.radians(s.light_azimuth), illuminant=base.illuminant
        )
        if base.lights is not None:
            lamp = dataclasses.replace(
                base.lights, towards=base.lights.towards.at[0].set(lamp.towards[0])
            )
        return dataclasses.replace(lamp, irradiance=lamp.irradiance.at[0].set(s.irradiance))

    def _around(self, s: Shown) -> Environment | None:
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


def environments(settings: Shown) -> tuple[str, ...]:
    """Environments to choose from."""
    return ((GIVEN,) if settings.environment == GIVEN else ()) + tuple(ENVIRONMENTS)


def encoded(picture, exposure: float) -> np.ndarray:
    """A linear picture as sRGB, 8 bits."""
    return np.asarray(_encoded(picture, jnp.asarray(exposure, picture.dtype)))


@eqx.filter_jit
def _encoded(picture, exposure):
    return jnp.asarray(255 * jnp.clip(srgb_encode(exposure * picture), 0, 1) + 0.5, jnp.uint8)


def _degrees(angle) -> float:
    return round(math.degrees(float(angle)), 4)
