"""R-hat, effective sample sizes and predictive scores, by arviz-stats on plain arrays."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float


class Diagnostics(NamedTuple):
    """Rank-normalised split R-hat, and effective sample sizes of bulk and tails [Vehtari et al.
    2021].
    """

    rhat: float
    ess_bulk: float
    ess_tail: float


def diagnostics(draws: Float[np.ndarray, "chains draws"]) -> Diagnostics:
    """Of one quantity."""
    stats = _array_stats()
    return Diagnostics(
        float(stats.rhat(draws)),
        float(stats.ess(draws, method="bulk")),
        float(stats.ess(draws, method="tail", prob=(0.05, 0.95))),
    )


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
