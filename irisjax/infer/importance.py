"""Adaptive importance sampling of a posterior, before any walker takes a step.

Draws of a proposal are weighted by the posterior and teach the next proposal. All draws so far
count, each as a draw of the mixture of all proposals so far [adaptive multiple importance sampling,
Cornuet et al. 2012]. Weights too uneven to teach anything are tempered first, taken to a power
below one [Del Moral et al. 2006, Section 3.3].
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy import stats
from scipy.optimize import brentq

from irisjax.infer.moves import DEGREES, Proposal, Straightening

DRAWS, ROUNDS = 2048, 16
"""Draws a round, and most rounds."""
EFFECTIVE = 1000
"""Effective draws that are enough."""
_TEACHING = 256
_BENDING = 0.3
"""Weights tempered by less than this power know nothing yet of how a ridge bends."""


class ImportanceSample(NamedTuple):
    """What all rounds found.

    - `samples`: of equal weight, (`DRAWS`, free).
    - `effective`: effective draws [Kong 1992].
    - `log_integral`: logarithm of the density's integral, the mean weight; the evidence, of a
        density that is a likelihood times a prior.
    - `rounds`: how many there were, of `DRAWS` each.
    """

    samples: np.ndarray
    effective: float
    log_integral: float
    rounds: int

    @property
    def error(self) -> float:
        """Standard deviation of `log_integral`, by that of the weights."""
        return math.sqrt(1 / self.effective - 1 / (self.rounds * DRAWS))

    @property
    def enough(self) -> bool:
        """Whether the samples may stand for the posterior."""
        return self.effective >= EFFECTIVE


class _Drawn(Protocol):
    """What draws are proposed by, see `Proposal`."""

    def draw(self, count: int, random) -> np.ndarray: ...

    def log_density(self, z) -> np.ndarray: ...


def importance_sample(
    log_probability: Callable[[np.ndarray], np.ndarray],
    mean: np.ndarray,
    covariance: np.ndarray,
    random: np.random.RandomState,
    progress: Callable[[int], Any] = lambda rounds: None,
) -> ImportanceSample:
    """Samples of a density of z (n, free) whose priors are standard normal.

    Args:
        log_probability: Of z (n, free), (n,).
        mean: Where the normal approximation of the density lies, (free,).
        covariance: Its covariance, (free, free).
        random: For all draws.
        progress: Gets the number of rounds done.

    Raises:
        ValueError: If no draw at all has a probability.
    """
    proposals: list[_Drawn] = [_First(mean, covariance)]
    z, log_density = np.empty((0, len(mean))), np.empty(0)
    proposed = np.empty(0)  # log of the sum of all proposals' densities
    while True:
        proposed = np.logaddexp(proposed, proposals[-1].log_density(z)) if len(z) else proposed
        new = proposals[-1].draw(DRAWS, random)
        proposed_new = np.logaddexp.reduce([p.log_density(new) for p in proposals])
        z, proposed = np.concatenate([z, new]), np.concatenate([proposed, proposed_new])
        log_density = np.concatenate([log_density, log_probability(new)])
        progress(len(proposals))
        log_weight = log_density - proposed + math.log(len(proposals))
        if not np.isfinite(log_weight).any():
            raise ValueError("no draw round the least-squares fit has a probability above zero")
        log_weight = np.where(np.isfinite(log_weight), log_weight, -np.inf)
        effective = _effective(log_weight, 1.0)
        power = _tempered(log_weight)
        samples = z[_resampled(log_weight, power, random)]
        if effective >= EFFECTIVE or len(proposals) == ROUNDS:
            break
        straight = Straightening.of_samples(samples)
        proposals.append(Proposal(straight if power >= _BENDING else straight.level(), samples))
    log_integral = float(np.logaddexp.reduce(log_weight) - math.log(len(z)))
    return ImportanceSample(samples, effective, log_integral, len(proposals))


class _First:
    """Half the normal approximation, made wider, and half the priors: where the model cannot follow
    the data they are far apart, and the posterior is elsewhere.
    """

    def __init__(self, mean, covariance):
        two: Any = (mean, 4 * covariance), (np.zeros(len(mean)), 2 * np.eye(len(mean)))
        self._both = [stats.multivariate_t(m, c, df=DEGREES) for m, c in two]

    def draw(self, count: int, random) -> np.ndarray:
        each = [t.rvs(count // 2, random_state=random).reshape(count // 2, -1) for t in self._both]
        return np.concatenate(each)

    def log_density(self, z) -> np.ndarray:
        return np.logaddexp(*(t.logpdf(z) for t in self._both)) - math.log(2)


def _effective(log_weight, power: float) -> float:
    """Effective draws of weights to a power."""
    w = np.exp(power * (log_weight - log_weight.max()))
    return float(w.sum() ** 2 / (w**2).sum())


def _tempered(log_weight) -> float:
    """The largest power, up to 1, with enough effective draws to teach."""
    least = min(_TEACHING, 0.5 * float(np.isfinite(log_weight).sum()))
    if _effective(log_weight, 1.0) >= least:
        return 1.0
    found: Any = brentq(lambda power: _effective(log_weight, power) - least, 1e-12, 1.0)
    return float(found)


def _resampled(log_weight, power: float, random) -> np.ndarray:
    """Indices of `DRAWS` draws, systematically resampled [Carpenter et al. 1999]."""
    w = np.exp(power * (log_weight - log_weight.max()))
    at = (random.random_sample() + np.arange(DRAWS)) * (w.sum() / DRAWS)
    return np.minimum(np.searchsorted(np.cumsum(w), at), w.size - 1)
