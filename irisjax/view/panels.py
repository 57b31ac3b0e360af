"""Widgets of the viewer's page for an eye of tissue and for a painted one, and what it shows: a
picture amid black, a patch of colour, from where one looks.
"""

import html
import math
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from irisjax.measure.colour import Colour
from irisjax.render.integrators import INTEGRATORS
from irisjax.view.bench import Bench, Layer, LayerStack, edited, moved
from irisjax.view.session import CommonSettings
from irisjax.view.studio import SPECTRUM_NM, Studio

if TYPE_CHECKING:
    import viser

_ABL = "share of the melanin in the anterior border layer"
_STROMA = "thickness relative to the preset's, at equal concentrations"
_MELANIN = "mg/ml over the whole iris, on a logarithmic scale; its lower end is none"
SLIDERS: dict[str, dict[str, tuple[str, float, float, float, str]]] = {
    "Photograph": {"photograph": ("photograph", 0, 1, 0.005, "share of the picture's width")},
    "Iris": {
        "eumelanin": ("log₁₀ eumelanin", -3, 1, 0.02, _MELANIN),
        "pheomelanin": ("log₁₀ pheomelanin", -3, 1, 0.02, _MELANIN),
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
LOGARITHMIC = "eumelanin", "pheomelanin"
"""Settings whose sliders show their decadic logarithm."""
ORBIT = 2.5  # of viser's camera, in units of its own
_UPRIGHT = 0.8  # largest width over height of an upright screen
BLACK = 16  # round the picture
UP, DOWN = "up", "down"
MIXTURE = "back to the mixture"
_NOTE = (
    "Left of the line is the photograph. It belongs to its own camera: turning or zooming the eye "
    "hides it, moving this slider brings both back."
)


class TissuePanel:
    """Widgets of a `Studio`; the page listens to them."""

    TITLE = "Spectrum and colour"

    def __init__(self, gui: "viser.GuiApi", studio: Studio):
        self.gui: viser.GuiApi = gui
        self.studio: Studio = studio

    def widgets(self) -> dict[str, Any]:
        """Widgets by the settings that they show."""
        gui, now, widgets = self.gui, self.studio.settings, {}
        if now.photograph is not None:
            with gui.add_folder("Photograph"):
                widgets |= sliders(gui, "Photograph", now)
                gui.add_html(f'<div style="padding:0 0.9em 0.5em;font-size:0.8em">{_NOTE}</div>')
        with gui.add_folder("Eye"):
            presets = self.studio.presets()
            widgets["preset"] = gui.add_dropdown("preset", presets, initial_value=now.preset)
            widgets["seed"] = gui.add_number(
                "seed", now.seed, min=0, max=2**32 - 1, step=1, hint="of a preset's maps"
            )
            widgets["integrator"] = gui.add_dropdown(
                "light transport",
                tuple(INTEGRATORS),
                initial_value=now.integrator,
                hint="separable: ILIT; presets have pigments of their own under radiative transfer",
            )
        with gui.add_folder("Iris"):
            widgets |= sliders(gui, "Iris", now)
        return widgets

    def results(self) -> "viser.GuiHtmlHandle":
        """Add the plot, the colour and the status; returns the status."""
        from viser import uplot

        gui, grid = self.gui, uplot.Axis_Grid(stroke="#444444", width=1)
        self.plot: viser.GuiUplotHandle = gui.add_uplot(
            (SPECTRUM_NM, np.zeros_like(SPECTRUM_NM), np.zeros_like(SPECTRUM_NM)),
            (
                uplot.Series(label="nm"),
                uplot.Series(label="at first", stroke="#888888", width=1, dash=(4, 4)),
                uplot.Series(label="reflectance", stroke="#56B4E9", width=2),
            ),
            scales=plot_scales(0.1),
            axes=tuple(
                uplot.Axis(label=label, stroke="#c0c0c0", grid=grid, size=60)
                for label in ("wavelength (nm)", "reflectance of the iris")
            ),
            legend=uplot.Legend(show=False),
            height=260,
            padding=(12, 16, 0, 0),
        )
        self.colour: viser.GuiHtmlHandle = gui.add_html("")
        return gui.add_html("")

    def show_result(self, first: bool) -> None:
        """Show spectrum and colour after a picture; the `first` spectrum stays in the plot."""
        values, colour = self.studio.spectrum()
        before = values if first else self.plot.data[1]
        self.plot.data = (SPECTRUM_NM, before, values)
        self.plot.scales = plot_scales(max(before.max(), values.max()))
        self.colour.content = colour_patch(colour)

    def remarks(self) -> tuple[str, ...]:
        """Return remarks on the last picture."""
        error, now = self.studio.error, self.studio.settings
        melanin = f"eumelanin {now.eumelanin:.3g}, pheomelanin {now.pheomelanin:.3g} mg/ml"
        orders = "single scattering" if error is None else f"all orders, within {100 * error:.1g} %"
        beside = "left: photograph; right: simulated" if now.photograph else "simulated"
        return melanin, orders, beside


class CoatsPanel:
    """Widgets of a `Bench`; those of coats request settings by `put`."""

    TITLE = "Coats"

    def __init__(self, gui: "viser.GuiApi", bench: Bench, put: Callable[..., None]):
        self.gui: viser.GuiApi = gui
        self.bench: Bench = bench
        self.put: Callable[..., None] = put
        self.layers: LayerStack = bench.settings.layers  # as asked for, painted or not yet
        self._lock = threading.Lock()  # every event comes on a thread of viser's
        self.folders: dict[str, Any] = {}

    def widgets(self) -> dict[str, Any]:
        """No widget shows a single setting."""
        return {}

    def results(self) -> "viser.GuiHtmlHandle":
        """Add the status, the button that saves, and the coats; returns the status."""
        gui = self.gui
        status = gui.add_html("", order=0)
        save = gui.add_button(
            "save the recipe", hint="of the coats that are on, beside the recipe", order=1
        )
        self.saved: viser.GuiHtmlHandle = gui.add_html("", order=2)
        save.on_click(lambda event: self._save())
        for layer in self.layers:
            self.folders[layer.name] = self._coat(layer)
        self._sort()
        return status

    def show_result(self, first: bool) -> None:
        """Nothing is shown after a picture."""

    def remarks(self) -> tuple[str, ...]:
        """Return remarks on the last picture."""
        layers = self.bench.settings.layers
        return (f"{sum(layer.on for layer in layers)} of {len(layers)} coats", "painted")

    def _coat(self, layer: Layer):
        gui, name = self.gui, layer.name
        folder = gui.add_folder(name, expand_by_default=False)
        with folder:
            on = gui.add_checkbox("on", layer.on)
            colour = gui.add_rgb("colour", self.bench.colour(name))
            mixture = gui.add_button(MIXTURE, hint="the colour that its paints make")
            opacity = gui.add_slider("opacity", 0.0, 1.0, 0.005, layer.opacity)
            place = gui.add_button_group("place", (UP, DOWN))
        on.on_update(lambda event: self._change(edited, name, on=event.target.value))
        colour.on_update(lambda event: self._picked(name, event))
        mixture.on_click(lambda event: self._mixed(name, colour))
        opacity.on_update(lambda event: self._change(edited, name, opacity=event.target.value))
        place.on_click(lambda event: self._change(moved, name, up=event.target.value == UP))
        return folder

    def _change(self, edit: Callable[..., LayerStack], name: str, **values: Any) -> None:
        with self._lock:
            before, self.layers = self.layers, edit(self.layers, name, **values)
            self.put(layers=self.layers)
            if [x.name for x in before] != [x.name for x in self.layers]:
                self._sort()

    def _picked(self, name: str, event: Any) -> None:
        if event.client is not None:  # by somebody, not by `_mixed`
            red, green, blue = event.target.value
            self._change(edited, name, colour=f"#{red:02x}{green:02x}{blue:02x}")

    def _mixed(self, name: str, colour: "viser.GuiRgbHandle") -> None:
        self._change(edited, name, colour=None)
        colour.value = self.bench.colour(name, mixed=True)

    def _sort(self) -> None:
        """Order the folders, the uppermost coat first."""
        for place, layer in enumerate(reversed(self.layers)):
            folder, order = self.folders[layer.name], 10.0 + place
            if folder.order != order:
                folder.order = order

    def _save(self) -> None:
        try:
            said = f"saved: {self.bench.save(self.layers)}"
        except (ValueError, OSError) as error:
            said = str(error)
        self.saved.content = (
            f'<div style="padding:0.4em 0.9em;font-size:0.8em">{html.escape(said)}</div>'
        )


def framed(picture: np.ndarray, aspect: float) -> np.ndarray:
    """The picture amid black of the viewport's aspect: viser stretches its background. On a
    telephone held upright it is at the top, where viser's panel does not hide it.
    """
    height, width = picture.shape[:2]
    wide, high = max(width, round(height * aspect)), max(height, round(width / aspect))
    framed = np.full((high, wide, 3), BLACK, np.uint8)
    top, left = (high - height) // 2 if aspect > _UPRIGHT else 0, (wide - width) // 2
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


def sliders(gui: "viser.GuiApi", folder: str, settings: CommonSettings) -> dict[str, Any]:
    """Sliders of a folder of `SLIDERS`, by the names of settings; values widen their ranges."""
    made = {}
    for name, (label, low, high, step, hint) in SLIDERS[folder].items():
        value = float(shown(name, getattr(settings, name)))
        low, high = float(min(low, value)), float(max(high, value))
        made[name] = gui.add_slider(label, low, high, float(step), value, hint=hint)
    return made


def shown(name: str, value: Any) -> Any:
    """Return the number that the widget of a setting shows: a logarithm for `LOGARITHMIC` ones."""
    if name not in LOGARITHMIC:
        return value
    lowest = SLIDERS["Iris"][name][1]
    return lowest if value <= 10.0**lowest else math.log10(value)


def meant(name: str, value: Any) -> Any:
    """Return the value of a setting from the number that its widget shows."""
    if name not in LOGARITHMIC:
        return value
    return 0.0 if value <= SLIDERS["Iris"][name][1] else 10.0**value


def plot_scales(largest: float) -> dict[str, Any]:
    """Return scales of the plot: reflectance from 0 to one of a few upper limits."""
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
