"""R-hat and effective sample sizes by arviz; the one place that knows arviz 0.x from 1.x."""

import warnings
from typing import NamedTuple

import numpy as np


class Diagnostics(NamedTuple):
    """Rank-normalised split R-hat, and effective sample sizes of bulk and tails [Vehtari et al.
    2021].
    """

    rhat: float
    ess_bulk: float
    ess_tail: float


def diagnostics(draws: np.ndarray) -> Diagnostics:
    """Of one quantity, shape (chains, draws)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # arviz announces its next version on import
        import arviz as az

        return Diagnostics(
            float(az.rhat(draws)),
            float(az.ess(draws, method="bulk")),
            # 1.x has no default for the tails' probabilities; these are 0.x's.
            float(az.ess(draws, method="tail", prob=(0.05, 0.95))),
        )
