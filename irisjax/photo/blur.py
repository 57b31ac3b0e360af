"""How far light spreads in the tissue: the width with which a clone looks most like its photograph
[F09 Section 4.2.1]."""

from collections.abc import Callable

import numpy as np
from scipy import optimize

from irisjax.numerics.checks import Range
from irisjax.photo.cloned import Clone
from irisjax.photo.picture import compare

WIDTHS = Range(0.05, 2.0, "mm")
"""That are compared."""
_STEPS, _NEAR = 7, 0.1  # widths that are tried first, and how near it ends; of logarithms


def width_by_rendering(with_width: Callable[[float], Clone]) -> float:
    """Width of the deconvolution (mm) with whose thickness the picture differs least, in root mean
    square of all channels.

    The best of seven widths, then the best between its neighbours: where fibres are finer than the
    blur, the difference is flat over most widths, and has several minima.

    Args:
        with_width: A clone whose thickness was made with a width, its pigments known.
    """

    def off(logarithm) -> float:
        width = float(np.clip(np.exp(np.squeeze(logarithm)), WIDTHS.low, WIDTHS.high))
        return float(np.sqrt((compare(with_width(width)).rms ** 2).mean()))

    low, high = np.log([WIDTHS.low, WIDTHS.high])
    best = float(np.squeeze(optimize.brute(off, ((low, high),), Ns=_STEPS, finish=None)))
    step = (high - low) / (_STEPS - 1)
    bounds = max(best - step, low), min(best + step, high)
    found = optimize.minimize_scalar(off, bounds=bounds, method="bounded", options={"xatol": _NEAR})
    return float(np.exp(found.x if found.fun < off(best) else best))
