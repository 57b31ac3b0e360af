"""Figures of maps of an iris's pixels."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from irisjax.plot.pictures import figure_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NAMED = 8  # flags beyond which the scale has no words


def maps_figure(
    maps: Mapping[str, tuple[np.ndarray, str]], extent: tuple[int, int] | None = None
) -> "Figure":
    """Draw maps (rows, columns) beside each other, each with a scale; NaN is left white.

    Args:
        maps: Values and unit of each map by name.
        extent: Rows and columns of the cube, where the maps show every so many of them.
    """
    from matplotlib.colors import LogNorm

    across = min(len(maps), 4)
    down = -(-len(maps) // across)
    figure = figure_of(4.2 * across, 3.6 * down)
    axes = figure.subplots(down, across, squeeze=False).ravel()
    for ax in axes[len(maps) :]:
        ax.set_axis_off()
    for ax, (name, (values, unit)) in zip(axes, maps.items(), strict=False):
        rows, columns = values.shape if extent is None else extent
        seen = values[np.isfinite(values)]
        low, high = np.percentile(seen, (1, 99)) if seen.size else (0.0, 1.0)
        wide = low > 0 and high > 20 * low
        how: dict[str, Any] = {"norm": LogNorm(low, high)} if wide else {"vmin": low, "vmax": high}
        sides = (-0.5, columns - 0.5, rows - 0.5, -0.5)
        drawn = ax.imshow(values, extent=sides, interpolation="nearest", **how)
        title = name.replace("_", " ").replace("abl ", "ABL ").replace("hemo", "haemo")
        ax.set(title=title, xlabel="column", ylabel="row")
        label = unit.replace("ug/mm2", "µg/mm²")
        figure.colorbar(drawn, ax=ax, label=label, extend="both", shrink=0.9)
    return figure


def flags_figure(flags: np.ndarray, words: Mapping[int, str]) -> "Figure":
    """Draw flags (rows, columns), sums of the keys of `words`; 0 is left white."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    found = [int(v) for v in np.unique(flags) if v]
    figure = figure_of(7.0, 4.2)
    ax = figure.subplots()
    place = np.searchsorted(found, flags) if found else np.zeros(flags.shape)
    shown = np.where(flags > 0, place, np.nan)
    colours = [f"C{i}" for i in range(max(len(found), 1))]
    ax.imshow(shown, cmap=ListedColormap(colours), vmin=-0.5, vmax=len(colours) - 0.5)
    ax.set(title="flag", xlabel="column", ylabel="row")
    handles = [
        Patch(color=c, label=f"{v}: {', '.join(w for k, w in words.items() if v & k)}")
        for c, v in zip(colours, found[:_NAMED], strict=False)
    ]
    figure.legend(handles=handles or [Patch(label="none")], loc="outside right upper")
    return figure
