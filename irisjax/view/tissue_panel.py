"""What the page has for an eye of tissue: photograph, eye and iris to set, spectrum and colour to
read.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from irisjax.render.integrators import INTEGRATORS
from irisjax.view.page import plot_scales, sliders, swatch
from irisjax.view.studio import GRID, Studio

if TYPE_CHECKING:
    import viser

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
        gui, studio, widgets = self.gui, self.studio, {}
        if studio.settings.photograph is not None:
            with gui.add_folder("Photograph"):
                widgets["photograph"] = gui.add_slider(
                    "photograph",
                    0.0,
                    1.0,
                    0.005,
                    studio.settings.photograph,
                    hint="share of the picture's width",
                )
                gui.add_html(f'<div style="padding:0 0.9em 0.5em;font-size:0.8em">{_NOTE}</div>')
        with gui.add_folder("Eye"):
            widgets["preset"] = gui.add_dropdown(
                "preset", studio.presets(), initial_value=studio.settings.preset
            )
            widgets["seed"] = gui.add_number(
                "seed",
                studio.settings.seed,
                min=0,
                max=2**32 - 1,
                step=1,
                hint="of a preset's maps",
            )
            widgets["integrator"] = gui.add_dropdown(
                "light transport",
                tuple(INTEGRATORS),
                initial_value=studio.settings.integrator,
                hint="separable: ILIT; presets have pigments of their own under radiative transfer",
            )
        with gui.add_folder("Iris"):
            widgets |= sliders(gui, "Iris", studio.settings)
        return widgets

    def asked(self, name: str, value: Any) -> dict[str, Any]:
        """Settings that a widget asks for: of the camera too, where it shows the photograph."""
        camera = self.studio.photographed if name == "photograph" and value > 0 else {}
        return {name: value, **camera}

    def results(self) -> "viser.GuiHtmlHandle":
        """Plot and colour, and where the page tells how it stands."""
        from viser import uplot

        gui, grid = self.gui, uplot.Axis_Grid(stroke="#444444", width=1)
        self.plot = gui.add_uplot(
            (GRID, np.zeros_like(GRID), np.zeros_like(GRID)),
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
        self.plot.data = (GRID, before, values)
        self.plot.scales = plot_scales(max(before.max(), values.max()))
        self.colour.content = swatch(colour)

    def remarks(self) -> tuple[str, ...]:
        """Of the last picture."""
        error = self.studio.error
        return (
            "single scattering" if error is None else f"all orders, within {100 * error:.1g} %",
            "left: photograph; right: simulated"
            if self.studio.settings.photograph
            else "simulated",
        )
