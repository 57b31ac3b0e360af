"""Figure of a measurement and the fits of several models."""

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from irisjax.plot.style import PALETTE, figure_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DATA = PALETTE[6]


def models_figure(
    observations: Sequence[tuple[str, str, bool, np.ndarray, np.ndarray]],
    fits: Mapping[str, tuple[Sequence[np.ndarray], Sequence[np.ndarray]]],
    pigments: Mapping[str, Mapping[str, Sequence[float]]],
    title: str = "",
) -> "Figure":
    """Draw data with the fits of several models, their residuals below, and pigments side by side.

    Args:
        observations: Tuples (name, quantity, is_colour, wavelengths, values).
        fits: By model, predictions and residuals (standard deviations) of each observation.
        pigments: By the label of the axis, for each model its value and 95 % interval.
        title: Title of the figure.
    """
    n, marks = len(observations), ("o", "s", "^", "D")
    figure = figure_of(3.2 + 4.6 * n, 5.4)
    parts: Any = figure.subfigures(1, 2, width_ratios=(4.6 * n, 2.6))
    left, right = parts
    figure.suptitle(title, fontsize=8, wrap=True)
    axes = left.subplots(2, n, squeeze=False, sharex="col", height_ratios=(2.2, 1))
    for k, (name, quantity, is_colour, grid, values) in enumerate(observations):
        x = np.arange(values.size) if is_colour else grid
        top, below = axes[0, k], axes[1, k]
        below.axhspan(-2, 2, color="0.9", linewidth=0)
        below.axhline(0, color="0.5", linewidth=0.8)
        for i, (model, (lines, residuals)) in enumerate(fits.items()):
            colour, mark = PALETTE[i], marks[i % len(marks)]
            drawn = {"color": colour, "linestyle": "none" if is_colour else "-", "linewidth": 1.2}
            top.plot(x, lines[k], label=model, marker=mark if is_colour else "", **drawn)
            below.plot(x, residuals[k], mark, color=colour, markersize=3)
        top.plot(x, values, "o", color=_DATA, markersize=3, label="data", zorder=0.5)
        top.set(ylabel=quantity)
        top.set_title(name, fontsize=9)
        below.set(ylabel="residual (sd)")
        if is_colour:
            below.set_xticks(x)
        else:
            below.set(xlabel="wavelength (nm)")
    axes[0, 0].legend(frameon=False, fontsize=8)
    panels = right.subplots(len(pigments), 1, squeeze=False)[:, 0]
    for ax, (label, by_model) in zip(panels, pigments.items(), strict=True):
        names = list(by_model)
        for i, (value, low, high) in enumerate(by_model.values()):
            error = [[value - low], [high - value]]
            ax.errorbar(
                value, -i, xerr=error, fmt=marks[i % len(marks)], color=PALETTE[i], capsize=3
            )
        labels = [textwrap.fill(n, 18) for n in names]
        ax.set_yticks([-i for i in range(len(names))], labels, fontsize=7)
        ax.set_ylim(-len(names) + 0.5, 0.5)
        ax.set_xlim(left=0)
        ax.set_xlabel(label, fontsize=8)
    for ax in (*axes.flat, *panels):
        ax.grid(alpha=0.25)
        ax.spines[["top", "right"]].set_visible(False)
    return figure
