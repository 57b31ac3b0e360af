"""What all figures share."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#F0E442")
"""Colours that colour-blind readers tell apart [Okabe & Ito 2008], the palest last."""


def figure_of(width: float, height: float) -> "Figure":
    """An empty figure, inches wide and high."""
    # Figure itself and not pyplot: no window system, nothing global to clean up.
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=150, layout="constrained")
