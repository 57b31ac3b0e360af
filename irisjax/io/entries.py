"""Entries of a scene file: sections and keys, and what they may be."""

import math
from collections.abc import Callable
from typing import Any

from irisjax.anatomy import eye
from irisjax.anatomy.media import INDEX
from irisjax.grow.presets import PRESETS
from irisjax.io.sections import Check, boolean, one_of, text, whole, within
from irisjax.measure.colour import illuminant_power
from irisjax.numerics.checks import Range
from irisjax.render import camera, lights
from irisjax.render.environment import ENVIRONMENTS
from irisjax.render.integrators import INTEGRATORS
from irisjax.tissue.iris import LIMITS, MELANIN_LOAD

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
    return within(Range(low, high, unit))


def _illuminant(value):
    illuminant_power(text(value), [560.0])
    return value


def _size(value):
    if not (isinstance(value, list) and len(value) == 2):
        raise ValueError("must be [width, height]")
    return tuple(whole(1, camera.LARGEST)(v) for v in value)


def _three(form: str, allowed: Range) -> Callable[[Any], list[float]]:
    def check(value):
        if not (isinstance(value, list) and len(value) == 3):
            raise ValueError(f"must be {form}")
        return [within(allowed)(v) for v in value]

    return check


FEATURES: dict[str, Check] = {
    "fibres": _number(0, 4),
    "collarette": _number(0, 4),
    "crypts": whole(0, 200),
    "furrows": whole(0, 50),
    "freckles": whole(0, 200),
    "abl": _number(0, 2),
    "heterochromia": _number(0, 20),
    "relief": _number(0, 1),
}
_DEGREES = _number(-360, 360)
SECTIONS: dict[str, dict[str, Check]] = {
    "iris": {
        "preset": one_of(*PRESETS),
        "level": one_of(*_LEVELS),
        "melanin_load": within(MELANIN_LOAD),
        **{name: within(limits) for name, limits in LIMITS.items()},
    },
    "maps": {"seed": whole(0, 2**32 - 1), "file": text, "uniform": boolean, **FEATURES},
    "eye": {
        "cornea": one_of("two-surfaces", "f09", "none"),
        "sclera": boolean,
        **{name: within(limits) for name, limits in eye.LIMITS.items() if name in _OF_EYES},
        "aqueous_index": within(INDEX),
    },
    "camera": {
        "polar_deg": _number(0, 180),
        "azimuth_deg": _DEGREES,
        "distance": within(camera.LIMITS["distance"]),
        "width": within(camera.LIMITS["width"]),
        "size": _size,
    },
    "light": {
        "polar_deg": _number(0, 180),
        "azimuth_deg": _DEGREES,
        "position": _three("[x, y, z] in mm", Range(-math.inf, math.inf)),
        "irradiance": within(lights.LIMITS["irradiance"]),
        "radius_deg": _number(0.01, 60),
        "colour": _three("[red, green, blue]", lights.LIMITS["tint"]),
    },
    "environment": {
        "file": text,
        "kind": one_of(*ENVIRONMENTS),
        "lights": whole(1, 1000),
        "strength": _number(0, 1e6),
    },
    "picture": {
        "exposure": _number(1e-6, 1e6),
        "illuminant": _illuminant,
        "integrator": one_of(*INTEGRATORS),
    },
}
