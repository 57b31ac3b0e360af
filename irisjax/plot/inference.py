"""Figures of fits and posteriors."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from irisjax.plot.style import PALETTE, figure_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def fit_figure(observations, simulated, models) -> "Figure":
    """Measured spectra with the posterior predictive band, and their residuals in standard
    deviations below.

    `observations`: tuples (name, quantity, is_colour, wavelengths, values); `simulated`, `models`:
    draws (draws, data) of each, with and without noise.
    """
    n = len(observations)
    figure = figure_of(1.4 + 5.0 * n, 5.2)
    axes = figure.subplots(2, n, squeeze=False, sharex="col", height_ratios=(3, 1))
    for k, (name, quantity, is_colour, grid, values) in enumerate(observations):
        x = np.arange(values.size) if is_colour else grid
        top, below = axes[0, k], axes[1, k]
        # Many points go behind what they would hide.
        many = values.size > 500
        mark = {
            "marker": "o",
            "markersize": 1 if many else 3,
            "linestyle": "none",
            "zorder": 0.5 if many else 2,
        }
        for low, high, alpha in ((2.5, 97.5, 0.2), (16, 84, 0.35)):
            band = np.percentile(simulated[k], [low, high], axis=0)
            label = f"simulated, {'95' if low < 10 else '68'} %"
            if is_colour:
                top.errorbar(
                    x,
                    band.mean(0),
                    np.diff(band, axis=0)[0] / 2,
                    fmt="none",
                    color=PALETTE[0],
                    alpha=alpha * 2,
                    lw=6,
                )
            else:
                top.fill_between(x, *band, color=PALETTE[0], alpha=alpha, linewidth=0, label=label)
        if not is_colour:
            top.plot(
                x,
                np.median(models[k], axis=0),
                color=PALETTE[0],
                linewidth=1,
                label="model, median",
            )
        top.plot(x, values, color=PALETTE[1], label="data", **mark)
        spread = np.std(simulated[k] - models[k], axis=0)
        below.axhspan(-2, 2, color="0.9", linewidth=0)
        below.axhline(0, color="0.5", linewidth=0.8)
        below.plot(
            x,
            (values - np.median(models[k], axis=0)) / np.where(spread > 0, spread, 1),
            color=PALETTE[1],
            **mark,
        )
        widest = max(
            3.0,
            1.1
            * float(
                np.abs(
                    (values - np.median(models[k], axis=0)) / np.where(spread > 0, spread, 1)
                ).max()
            ),
        )
        below.set_ylim(-widest, widest)
        top.set_ylabel(quantity)
        below.set_ylabel("residual (sd)")
        if is_colour:
            below.set_xticks(
                x,
                {"Lab": ("L*", "a*", "b*"), "XYZ": ("X", "Y", "Z")}.get(quantity, ("R", "G", "B")),
            )
        else:
            below.set_xlabel("wavelength (nm)")
            top.legend(frameon=False, fontsize=8)
        top.set_title(name, fontsize=9)
        for ax in (top, below):
            ax.grid(alpha=0.25)
            ax.spines[["top", "right"]].set_visible(False)
    return figure


def corner_figure(samples: Mapping[str, np.ndarray]) -> "Figure":
    """Every pair of parameters: samples by label, each of shape (n,); contours hold 68 and 95 %."""
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
