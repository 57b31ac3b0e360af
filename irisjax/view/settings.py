"""What the viewer's sliders and menus set."""

import dataclasses
from collections.abc import Callable
from typing import Any

from irisjax.render.environment import Environment

GIVEN = "as given"
ENVIRONMENTS: dict[str, Callable[[], Environment] | None] = {
    "none": None,
    "studio": Environment.studio,
    "sky": Environment.sky,
}


@dataclasses.dataclass(frozen=True)
class Shown:
    """What can be changed whatever the iris is made of; a scene's own values are where it starts.

    - `light_*`: of the first lamp, degrees; `environment`: a name, or `GIVEN` for the scene's own;
        `strength`: factor on the environment; `exposure`: on the picture.
    - `camera_*`: degrees; `width` of the field, mm.
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
class Settings(Shown):
    """What can be changed of an eye of tissue.

    - `preset`: a name, or `GIVEN` for the scene's own iris. `seed`: of a preset's maps.
        `integrator`: a name of `INTEGRATORS`.
    - Concentrations as in `Iris`; `hemoglobin`: both forms together, mmol/l; `stroma`: thickness
        relative to the iris's own, at equal concentrations. `pupil_radius`: mm.
    - `photograph`: share of the picture's width that shows the photograph, from the left; `None`
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


PIGMENTS = ("eumelanin", "pheomelanin", "abl_fraction", "hemoglobin", "saturation")
CAMERA = ("camera_polar", "camera_azimuth", "width")
LAMP = ("light_polar", "light_azimuth", "irradiance")
LIGHT = (*LAMP, "environment", "strength")
QUICK = frozenset({*PIGMENTS, "stroma", "exposure", "layers"})
"""Settings that leave tables and view alone, and whatever else takes long."""


def values_of(settings: Shown, names: tuple[str, ...]) -> tuple[Any, ...]:
    """Some of the settings, in this order."""
    return tuple(getattr(settings, name) for name in names)
