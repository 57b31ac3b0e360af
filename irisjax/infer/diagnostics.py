"""Predictive scores, by arviz-stats on plain arrays."""

from typing import Any

import numpy as np
from jaxtyping import Float


def predictive_score(
    log_likelihood: Float[np.ndarray, "chains draws data"], effective: float = 1.0
) -> tuple[float, float]:
    """Expected log predictive density of left-out values by PSIS-LOO [Vehtari et al. 2017], and its
    standard error.

    Compare it between processes fitted to the same data; differences of a few standard errors
    count. `effective`: effective samples a draw, at most 1.
    """
    each, _, _ = _array_stats().loo(
        np.moveaxis(log_likelihood, -1, 0), chain_axis=-2, draw_axis=-1, r_eff=min(effective, 1.0)
    )
    return float(np.sum(each)), float(np.sqrt(np.size(each)) * np.std(each))


def _array_stats() -> Any:  # it returns scalars where its annotations have tuples too
    from arviz_stats.base.array import array_stats

    return array_stats
