"""Figures of fits and posteriors."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from irisjax.plot.style import PALETTE, figure_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def fit_figure(
    observations: Sequence[tuple[str, str, bool, np.ndarray, np.ndarray]],
    simulated: Sequence[np.ndarray],
    models: Sequence[np.ndarray],
) -> "Figure":
    """Draw measured spectra with the posterior predictive band, and their residuals in standard
    deviations below.

    Args:
        observations: Tuples (name, quantity, is_colour, wavelengths, values).
        simulated: Draws (draws, data) of the posterior predictive of each.
        models: Draws of the models without noise.
    """
    n = len(observations)
    figure = figure_of(1.4 + 5.0 * n, 5.2)
    axes = figure.subplots(2, n, squeeze=False, sharex="col", height_ratios=(3, 1))
    for k, (name, quantity, is_colour, grid, values) in enumerate(observations):
        x = np.arange(values.size) if is_colour else grid
        top, below = axes[0, k], axes[1, k]
        middle = np.median(models[k], axis=0)
        for low, high, alpha in ((2.5, 97.5, 0.2), (16, 84, 0.35)):
            band = np.percentile(simulated[k], [low, high], axis=0)
            if is_colour:
                bar = {"fmt": "none", "color": PALETTE[0], "alpha": alpha * 2, "lw": 6}
                top.errorbar(x, band.mean(0), np.diff(band, axis=0)[0] / 2, **bar)
            else:
                label = f"simulated, {'95' if low < 10 else '68'} %"
                top.fill_between(x, *band, color=PALETTE[0], alpha=alpha, linewidth=0, label=label)
        if not is_colour:
            top.plot(x, middle, color=PALETTE[0], linewidth=1, label="model, median")
        # Many points go behind the lines that they would hide.
        many = values.size > 500
        mark = {"marker": "o", "linestyle": "none", "color": PALETTE[1]}
        mark |= {"markersize": 1, "zorder": 0.5} if many else {"markersize": 3, "zorder": 2}
        top.plot(x, values, label="data", **mark)
        spread = np.std(simulated[k] - models[k], axis=0)
        residuals = (values - middle) / np.where(spread > 0, spread, 1)
        below.axhspan(-2, 2, color="0.9", linewidth=0)
        below.axhline(0, color="0.5", linewidth=0.8)
        below.plot(x, residuals, **mark)
        widest = max(3.0, 1.1 * float(np.abs(residuals).max()))
        below.set_ylim(-widest, widest)
        top.set_ylabel(quantity)
        below.set_ylabel("residual (sd)")
        if is_colour:
            axis_of = {"Lab": ("L*", "a*", "b*"), "XYZ": ("X", "Y", "Z")}
            below.set_xticks(x, axis_of.get(quantity, ("R", "G", "B")))
        else:
            below.set_xlabel("wavelength (nm)")
            top.legend(frameon=False, fontsize=8)
        top.set_title(name, fontsize=9)
        for ax in (top, below):
            ax.grid(alpha=0.25)
            ax.spines[["top", "right"]].set_visible(False)
    return figure


def corner_figure(samples: Mapping[str, np.ndarray]) -> "Figure":
    """Draw every pair of parameters with contours of 68 and 95 %.

    Args:
        samples: Samples of each parameter by its label.
    """
    from corner import corner

    n = len(samples)
    figure = figure_of(1.6 * n + 0.6, 1.6 * n + 0.6)
    figure.set_layout_engine(None)
    corner(
        np.stack(list(samples.values()), axis=1),
        labels=list(samples),
        fig=figure,
        levels=(0.68, 0.95),
        quantiles=(0.16, 0.5, 0.84),
        color=PALETTE[0],
        plot_datapoints=False,
        smooth=0.8,
        max_n_ticks=4,
        label_kwargs={"fontsize": 9},
        range=[0.998] * n,
    )
    return figure
