"""Figures of fits, of posteriors and of the comparison of several models."""

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from irisjax.plot.pictures import PALETTE, bare_axes, figure_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_Observation = tuple[str, str, bool, np.ndarray, np.ndarray]
"""Name, quantity, whether it is a colour, wavelengths and values of a measurement."""
_DATA = PALETTE[6]


def fit_figure(
    observations: Sequence[_Observation],
    simulated: Sequence[np.ndarray],
    models: Sequence[np.ndarray],
) -> "Figure":
    """Draw measured spectra with the posterior predictive band, and their residuals in standard
    deviations below.

    Args:
        observations: The measurements.
        simulated: Draws (draws, data) of the posterior predictive of each.
        models: Draws of the models without noise.
    """
    n = len(observations)
    figure = figure_of(1.4 + 5.0 * n, 5.2)
    axes = figure.subplots(2, n, squeeze=False, sharex="col", height_ratios=(3, 1))
    for k, (_, quantity, is_colour, _, values) in enumerate(observations):
        top, below, x = _panels(axes, k, observations[k])
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
        below.plot(x, residuals, **mark)
        widest = max(3.0, 1.1 * float(np.abs(residuals).max()))
        below.set_ylim(-widest, widest)
        if is_colour:
            axis_of = {"Lab": ("L*", "a*", "b*"), "XYZ": ("X", "Y", "Z")}
            below.set_xticks(x, axis_of.get(quantity, ("R", "G", "B")))
        else:
            top.legend(frameon=False, fontsize=8)
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


def models_figure(
    observations: Sequence[_Observation],
    fits: Mapping[str, tuple[Sequence[np.ndarray], Sequence[np.ndarray]]],
    pigments: Mapping[str, Mapping[str, Sequence[float]]],
    title: str = "",
) -> "Figure":
    """Draw data with the fits of several models, their residuals below, and pigments side by side.

    Args:
        observations: The measurements.
        fits: Predictions and residuals (standard deviations) of each observation, by model.
        pigments: Value and 95 % interval by model, by the label of the axis.
        title: Title of the figure.
    """
    n, marks = len(observations), ("o", "s", "^", "D")
    figure = figure_of(3.2 + 4.6 * n, 5.4)
    parts: Any = figure.subfigures(1, 2, width_ratios=(4.6 * n, 2.6))
    left, right = parts
    figure.suptitle(title, fontsize=8, wrap=True)
    axes = left.subplots(2, n, squeeze=False, sharex="col", height_ratios=(2.2, 1))
    for k, (_, _, is_colour, _, values) in enumerate(observations):
        top, below, x = _panels(axes, k, observations[k])
        for i, (model, (lines, residuals)) in enumerate(fits.items()):
            colour, mark = PALETTE[i], marks[i % len(marks)]
            drawn = {"color": colour, "linestyle": "none" if is_colour else "-", "linewidth": 1.2}
            top.plot(x, lines[k], label=model, marker=mark if is_colour else "", **drawn)
            below.plot(x, residuals[k], mark, color=colour, markersize=3)
        top.plot(x, values, "o", color=_DATA, markersize=3, label="data", zorder=0.5)
        if is_colour:
            below.set_xticks(x)
    axes[0, 0].legend(frameon=False, fontsize=8)
    panels = right.subplots(len(pigments), 1, squeeze=False)[:, 0]
    for ax, (label, by_model) in zip(panels, pigments.items(), strict=True):
        for i, (value, low, high) in enumerate(by_model.values()):
            drawn = {"fmt": marks[i % len(marks)], "color": PALETTE[i], "capsize": 3}
            ax.errorbar(value, -i, xerr=[[value - low], [high - value]], **drawn)
        labels = [textwrap.fill(name, 18) for name in by_model]
        ax.set_yticks(-np.arange(len(labels)), labels, fontsize=7)
        ax.set_ylim(-len(labels) + 0.5, 0.5)
        ax.set_xlim(left=0)
        ax.set_xlabel(label, fontsize=8)
        bare_axes(ax)
    return figure


def _panels(axes: Any, k: int, observation: _Observation):
    """Panels of a measurement and of its residuals, and the places of its values."""
    name, quantity, is_colour, grid, values = observation
    top, below = axes[:, k]
    below.axhspan(-2, 2, color="0.9", linewidth=0)
    below.axhline(0, color="0.5", linewidth=0.8)
    top.set_ylabel(quantity)
    top.set_title(name, fontsize=9)
    below.set_ylabel("residual (sd)")
    if not is_colour:
        below.set_xlabel("wavelength (nm)")
    bare_axes(top)
    bare_axes(below)
    return top, below, np.arange(values.size) if is_colour else grid
