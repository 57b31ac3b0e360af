"""Figures of spectra."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from irisjax.plot.style import PALETTE, figure_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from irisjax.measure.measurement import Reading

_LINES = ("-", "--", "-.", ":")


def spectra_figure(measurements: "Mapping[str, Reading]", title: str = "") -> "Figure":
    """Draw spectra by name, with a band of one standard error where they are sampled."""
    figure = figure_of(6.4, 4.0)
    ax = figure.add_subplot()
    first = next(iter(measurements.values()))
    sampled = False
    for i, (name, m) in enumerate(measurements.items()):
        x, y = np.asarray(m.wavelengths), np.asarray(m.values)
        colour = PALETTE[i % len(PALETTE)]
        ax.plot(
            x,
            y,
            _LINES[i // len(PALETTE) % len(_LINES)],
            color=colour,
            label=name,
            marker="o" if x.size == 1 else "",
        )
        if m.standard_error is not None:
            error = np.asarray(m.standard_error)
            ax.fill_between(x, y - error, y + error, color=colour, alpha=0.3, linewidth=0)
            if x.size == 1:
                ax.errorbar(x, y, error, color=colour, capsize=3)
            sampled = True
    ax.set_xlabel("wavelength (nm)")
    label = f"{first.quantity} ({first.unit})" if first.unit else first.quantity
    ax.set_ylabel(label + (", band: ± 1 standard error" if sampled else ""))
    ax.set_ylim(bottom=0)
    if first.wavelengths.size > 1:
        ax.margins(x=0)
    ax.grid(alpha=0.25)
    if len(measurements) > 1:
        ax.legend(frameon=False)
    ax.set_title(title, fontsize=9)
    ax.spines[["top", "right"]].set_visible(False)
    return figure
