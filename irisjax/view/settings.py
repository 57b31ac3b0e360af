"""What the viewer's sliders and menus set."""

import dataclasses
from collections.abc import Callable
from typing import Any

from irisjax.render.environment import Environment

GIVEN = "as given"
SURROUNDS: dict[str, Callable[[], Environment] | None] = {
    "none": None,
    "studio": Environment.studio,
    "sky": Environment.sky,
}


@dataclasses.dataclass(frozen=True)
class CommonSettings:
    """What can be changed whatever the iris is made of; a scene's own values are where it starts.
    `page.SLIDERS` says what the other fields are; those of light are the first lamp's.

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
    """What can be changed of an eye of tissue; `page.SLIDERS` says what the other fields are.

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
