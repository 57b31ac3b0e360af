"""Widgets of the viewer's page for an eye of tissue and for a painted one."""

import html
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from irisjax.render.integrators import INTEGRATORS
from irisjax.view.bench import Bench, Layer, LayerStack, edited, moved
from irisjax.view.page import colour_patch, plot_scales, sliders
from irisjax.view.studio import SPECTRUM_NM, Studio

if TYPE_CHECKING:
    import viser

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
        self.gui, self.studio = gui, studio

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
        """Plot and colour, and where the page tells how it stands."""
        from viser import uplot

        gui, grid = self.gui, uplot.Axis_Grid(stroke="#444444", width=1)
        self.plot = gui.add_uplot(
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
        self.colour = gui.add_html("")
        return gui.add_html("")

    def tell(self, first: bool) -> None:
        """Spectrum and colour after a picture; the `first` stays in the plot."""
        values, colour = self.studio.spectrum()
        before = values if first else self.plot.data[1]
        self.plot.data = (SPECTRUM_NM, before, values)
        self.plot.scales = plot_scales(max(before.max(), values.max()))
        self.colour.content = colour_patch(colour)

    def remarks(self) -> tuple[str, ...]:
        """Of the last picture."""
        error, beside = self.studio.error, self.studio.settings.photograph
        orders = "single scattering" if error is None else f"all orders, within {100 * error:.1g} %"
        return orders, "left: photograph; right: simulated" if beside else "simulated"


class CoatsPanel:
    """Widgets of a `Bench`; those of coats ask by `put` for settings."""

    TITLE = "Coats"

    def __init__(self, gui: "viser.GuiApi", bench: Bench, put: Callable[..., None]):
        self.gui, self.bench, self.put = gui, bench, put
        self.layers: LayerStack = bench.settings.layers  # as asked for, painted or not yet
        self._lock = threading.Lock()  # every event comes on a thread of viser's
        self.folders: dict[str, Any] = {}

    def widgets(self) -> dict[str, Any]:
        """None that shows a setting by itself."""
        return {}

    def results(self) -> "viser.GuiHtmlHandle":
        """How it stands, the button that saves, and the coats."""
        gui = self.gui
        status = gui.add_html("", order=0)
        save = gui.add_button(
            "save the recipe", hint="of the coats that are on, beside the recipe", order=1
        )
        self.saved = gui.add_html("", order=2)
        save.on_click(lambda event: self._save())
        for layer in self.layers:
            self.folders[layer.name] = self._coat(layer)
        self._sort()
        return status

    def tell(self, first: bool) -> None:
        """Nothing to read after a picture."""

    def remarks(self) -> tuple[str, ...]:
        """Of the last picture."""
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
        """The uppermost first, below what does not move."""
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
