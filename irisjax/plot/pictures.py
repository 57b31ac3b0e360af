"""Colours and axes that all figures share, and the bytes of picture files."""

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#F0E442")
"""Colours that colour-blind readers tell apart [Okabe & Ito 2008], the palest last."""
SUFFIXES = (".png", ".pdf", ".svg")
"""Kinds of picture that can be written."""


def figure_of(width: float, height: float) -> "Figure":
    """An empty figure, inches wide and high."""
    # Figure itself and not pyplot: no window system, nothing global to clean up.
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=150, layout="constrained")


def bare_axes(ax: "Axes") -> None:
    """A faint grid and no frame above and to the right."""
    ax.grid(alpha=0.25)
    ax.spines[["top", "right"]].set_visible(False)


def picture(figure: "Figure", suffix: str) -> bytes:
    """The figure as the bytes of a file; equal figures give equal bytes.

    Raises:
        ValueError: The suffix is not in `SUFFIXES`.
    """
    check_suffix(f"picture{suffix}")
    from matplotlib import rc_context

    # Left to itself, matplotlib stamps PDF and SVG with the hour and random names.
    undated = {".png": None, ".pdf": {"CreationDate": None}, ".svg": {"Date": None}}[suffix.lower()]
    out = io.BytesIO()
    with rc_context({"svg.hashsalt": "irisjax"}):
        figure.savefig(out, format=suffix[1:].lower(), metadata=undated, bbox_inches="tight")
    return out.getvalue()


def swatch(srgb8: tuple[int, int, int], remark: str = "") -> bytes:
    """PNG of one 8-bit sRGB colour; the remark goes into its description."""
    from matplotlib.image import imsave

    out = io.BytesIO()
    pixels = np.broadcast_to(np.asarray(srgb8, np.uint8), (256, 256, 3))
    imsave(out, pixels, format="png", metadata={"Description": remark, "Software": "irisjax"})
    return out.getvalue()


def check_suffix(path: str | Path, suffixes: tuple[str, ...] = SUFFIXES) -> None:
    """Raise `ValueError` unless the suffix is that of a picture."""
    if Path(path).suffix.lower() not in suffixes:
        raise ValueError(f"{path}: a picture's name must end in {' or '.join(suffixes)}")
