"""What the viewer's page shows: a picture amid black, a patch of colour, from where one looks."""

import math
from typing import Any

import numpy as np

from irisjax.measure.colour import Colour
from irisjax.view.settings import CommonSettings

_ABL = "share of the melanin in the anterior border layer"
_STROMA = "thickness relative to the preset's, at equal concentrations"
SLIDERS: dict[str, dict[str, tuple[str, float, float, float, str]]] = {
    "Photograph": {"photograph": ("photograph", 0, 1, 0.005, "share of the picture's width")},
    "Iris": {
        "eumelanin": ("eumelanin", 0, 4, 0.005, "mg/ml over the whole iris"),
        "pheomelanin": ("pheomelanin", 0, 2, 0.005, "mg/ml over the whole iris"),
        "abl_fraction": ("ABL fraction", 0, 1, 0.005, _ABL),
        "stroma": ("stroma", 0.3, 2, 0.01, _STROMA),
        "hemoglobin": ("blood", 0, 1, 0.002, "haemoglobin in the stroma, mmol/l"),
        "saturation": ("oxygen", 0, 1, 0.01, "saturation of the haemoglobin"),
        "pupil_radius": ("pupil", 0.5, 4.5, 0.05, "radius, mm"),
    },
    "Light": {
        "light_polar": ("lamp angle", 0, 90, 1, "degrees from the eye's axis"),
        "light_azimuth": ("lamp azimuth", -180, 180, 1, "degrees from the right over the top"),
        "irradiance": ("lamp power", 0, 10, 0.05, "irradiance; π lights a white sheet white"),
        "strength": ("surround ×", 0, 3, 0.05, "factor on the environment"),
        "exposure": ("exposure ×", 0.25, 4, 0.05, "factor on the picture"),
    },
}
"""Sliders by folder and setting: label, lowest and highest value, step, hint."""
ORBIT = 2.5  # of viser's camera, in units of its own
BLACK = 16  # round the picture


def framed(picture: np.ndarray, aspect: float) -> np.ndarray:
    """The picture amid black of the viewport's aspect: viser stretches its background."""
    height, width = picture.shape[:2]
    wide, high = max(width, round(height * aspect)), max(height, round(width / aspect))
    framed = np.full((high, wide, 3), BLACK, np.uint8)
    top, left = (high - height) // 2, (wide - width) // 2
    framed[top : top + height, left : left + width] = picture
    return framed


def colour_patch(colour: Colour) -> str:
    """A `Colour` as the page shows it: a patch beside its numbers."""
    red, green, blue = (int(v) for v in np.rint(255 * np.clip(np.asarray(colour.srgb), 0, 1)))
    lab = ", ".join(f"{v:.1f}" for v in np.asarray(colour.lab))
    clipped = "" if bool(colour.in_gamut) else " (clipped)"
    return (
        '<div style="display:flex;gap:0.8em;padding:0.4em 0.9em;font-size:0.85em;'
        'align-items:center"><div style="width:4.5em;height:4.5em;border-radius:4px;'
        f'background:rgb({red},{green},{blue})"></div><div>iris under {colour.illuminant}<br>'
        f"L*a*b* {lab}<br>sRGB {red}, {green}, {blue}{clipped}<br>"
        f"#{red:02x}{green:02x}{blue:02x}</div></div>"
    )


def sliders(gui: Any, folder: str, settings: CommonSettings) -> dict[str, Any]:
    """Sliders of a folder of `SLIDERS`, by the names of settings; values widen their ranges."""
    made = {}
    for name, (label, low, high, step, hint) in SLIDERS[folder].items():
        value = float(getattr(settings, name))
        low, high = float(min(low, value)), float(max(high, value))
        made[name] = gui.add_slider(label, low, high, float(step), value, hint=hint)
    return made


def plot_scales(largest: float) -> dict[str, Any]:
    """Of the plot: reflectance from 0, its top changing in few steps."""
    from viser import uplot

    top = next(t for t in (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0) if largest < t or t == 1.0)
    return {"x": uplot.Scale(time=False, auto=True), "y": uplot.Scale(auto=False, range=(0.0, top))}


def orbit(place: np.ndarray, width: float) -> dict[str, float]:
    """Camera settings of viser's camera at a place relative to what it looks at."""
    distance = float(np.linalg.norm(place))
    polar = math.degrees(math.atan2(math.hypot(place[0], place[1]), place[2]))
    return {
        "camera_polar": round(min(polar, 85.0), 2),
        "camera_azimuth": round(math.degrees(math.atan2(place[1], place[0])), 2),
        "width": round(float(np.clip(width * distance / ORBIT, 2.0, 60.0)), 2),
    }
