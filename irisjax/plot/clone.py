"""Figures of a clone: photograph beside rendering, their differences, luminance along an arc  [F09
Figs. 19, 20]."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from irisjax.plot.pictures import PALETTE, figure_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Encoded = Float[np.ndarray, "rows columns 3"]
_CHANNELS = ("red", "green", "blue")
_COLOURS = (PALETTE[1], PALETTE[2], PALETTE[0])
_STYLES = ("-", "--", ":")


def side_by_side(photograph: Encoded, rendered: Encoded) -> "Figure":
    """Draw both pictures, sRGB-encoded in [0, 1]."""
    figure = figure_of(9, 4.6)
    both = ("photograph", photograph), ("rendered", rendered)
    for axes, (name, picture) in zip(figure.subplots(1, 2), both, strict=True):
        axes.imshow(np.clip(picture, 0, 1), interpolation="bilinear")
        axes.set_title(name)
        axes.set_axis_off()
    return figure


def differences(
    photograph: Encoded, rendered: Encoded, clear: Bool[np.ndarray, "rows columns"]
) -> "Figure":
    """Draw the share of pixels whose difference is at most so large, per channel  [F09 Fig. 19]."""
    figure = figure_of(5.5, 3.8)
    axes = figure.subplots()
    off = np.abs(photograph - rendered)[clear]
    steps = np.arange(256)
    for k, (name, colour, style) in enumerate(zip(_CHANNELS, _COLOURS, _STYLES, strict=True)):
        found = np.sort(255 * off[:, k])
        share = np.searchsorted(found, steps, side="right") / max(len(found), 1)
        rms = 100 * np.sqrt((off[:, k] ** 2).mean())
        axes.plot(steps, 100 * share, style, color=colour, label=f"{name}, RMS {rms:.1f} %")
    labels = {"xlabel": "difference, of 255 steps", "ylabel": "pixels, cumulative (%)"}
    axes.set(**labels, xlim=(0, 80), ylim=(0, 101))
    axes.legend(loc="lower right")
    return figure


def luminance_profile(
    angle: Float[np.ndarray, " points"],
    photograph: Float[np.ndarray, " points"],
    rendered: Float[np.ndarray, " points"],
    radius: float,
) -> "Figure":
    """Draw the luminance on an arc of the iris in both pictures  [F09 Fig. 20]; `angle` is in
    degrees.
    """
    figure = figure_of(7, 3.2)
    axes = figure.subplots()
    axes.plot(angle, photograph, color=PALETTE[1], label="photograph")
    axes.plot(angle, rendered, "--", color=PALETTE[0], label="rendered (simulated)")
    around = f"angle round the eye at {radius:.1f} mm from its axis (degrees)"
    axes.set(xlabel=around, ylabel="encoded luminance", xlim=(0, 360))
    axes.legend()
    return figure
