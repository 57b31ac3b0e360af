"""Adaptive importance sampling of a posterior, before any walker takes a step  [Cappé et al. 2004].

Draws of a proposal are weighted by the posterior, and teach the next one. Weights too uneven to
teach anything are tempered first, taken to a power below one [Del Moral et al. 2006, Section 3.3].
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy import stats
from scipy.optimize import brentq

from irisjax.infer.moves import DEGREES, Proposal, Straightening

DRAWS, ROUNDS = 2048, 12
"""Draws a round, and most rounds."""
EFFICIENT = 0.35
"""Effective draws over draws, at which a proposal is good enough."""
_TEACHING = 1 / 8
_BENDING = 0.3
"""Weights tempered by less than this power know nothing yet of how a ridge bends."""


class ImportanceSample(NamedTuple):
    """What the last round found.

    - `samples`: of equal weight, (draws, free).
    - `efficiency`: effective draws [Kong 1992] over draws.
    - `log_integral`: logarithm of the density's integral, the mean weight; the evidence, of a
        density that is a likelihood times a prior.
    - `rounds`: how many there were.
    """

    samples: np.ndarray
    efficiency: float
    log_integral: float
    rounds: int

    @property
    def error(self) -> float:
        """Standard deviation of `log_integral`, by that of the weights."""
        return math.sqrt((1 / self.efficiency - 1) / len(self.samples))

    @property
    def efficient(self) -> bool:
        """Whether the samples may stand for the posterior."""
        return self.efficiency >= EFFICIENT


def importance_sample(
    log_probability: Callable[[np.ndarray], np.ndarray],
    mean: np.ndarray,
    covariance: np.ndarray,
    random: np.random.RandomState,
    progress: Callable[[int], Any] = lambda rounds: None,
) -> ImportanceSample:
    """Samples of a density of z (n, free) whose priors are standard normal.

    The first round draws from the normal approximation, made wider, and from the priors, half and
    half: where the model cannot follow the data they are far apart, and the posterior is elsewhere.

    Args:
        log_probability: Of z (n, free), (n,).
        mean: Where the approximation lies, (free,).
        covariance: Its covariance, (free, free).
        random: For all draws.
        progress: Gets the number of rounds done.

    Raises:
        ValueError: If no draw at all has a probability.
    """
    free = len(mean)
    two: Any = (mean, 4 * covariance), (np.zeros(free), 2 * np.eye(free))
    both = [stats.multivariate_t(m, c, df=DEGREES) for m, c in two]
    z = np.concatenate([t.rvs(DRAWS // 2, random_state=random).reshape(-1, free) for t in both])
    proposed = np.logaddexp(*(t.logpdf(z) for t in both)) - math.log(2)
    for rounds in range(ROUNDS):
        log_weight = log_probability(z) - proposed
        progress(rounds + 1)
        if not np.isfinite(log_weight).any():
            raise ValueError("no draw round the least-squares fit has a probability above zero")
        log_weight = np.where(np.isfinite(log_weight), log_weight, -np.inf)
        efficiency = _efficiency(log_weight, 1.0)
        power = _tempered(log_weight)
        samples = z[_resampled(log_weight, power, random)]
        if efficiency >= EFFICIENT or rounds == ROUNDS - 1:
            break
        straight = Straightening.of_samples(samples)
        taught = Proposal(straight if power >= _BENDING else straight.level(), samples)
        z = taught.draw(DRAWS, random)
        proposed = taught.log_density(z)
    log_integral = float(np.logaddexp.reduce(log_weight) - math.log(DRAWS))
    return ImportanceSample(samples, efficiency, log_integral, rounds + 1)


def _efficiency(log_weight, power: float) -> float:
    """Effective draws over draws of weights to a power."""
    w = np.exp(power * (log_weight - log_weight.max()))
    return float(w.sum() ** 2 / (w**2).sum() / w.size)


def _tempered(log_weight) -> float:
    """The largest power, up to 1, with enough effective draws."""
    least = min(_TEACHING, 0.5 * float(np.isfinite(log_weight).mean()))
    if _efficiency(log_weight, 1.0) >= least:
        return 1.0
    found: Any = brentq(lambda power: _efficiency(log_weight, power) - least, 1e-12, 1.0)
    return float(found)


def _resampled(log_weight, power: float, random) -> np.ndarray:
    """Indices of as many draws, systematically resampled [Carpenter et al. 1999]."""
    w = np.exp(power * (log_weight - log_weight.max()))
    at = (random.random_sample() + np.arange(w.size)) * (w.sum() / w.size)
    return np.minimum(np.searchsorted(np.cumsum(w), at), w.size - 1)
