"""Adaptive importance sampling of a density, before any walker takes a step.

Draws of a proposal are weighted by the density, and the next proposal is fitted to them. All draws
so far count, each as a draw of the mixture of all proposals so far [adaptive multiple importance
sampling, Cornuet et al. 2012]. Where the weights are too uneven to fit a proposal to, they are
tempered first, that is taken to a power below one [Del Moral et al. 2006, Section 3.3].
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Array, Float, Int
from scipy import stats
from scipy.optimize import brentq
from scipy.special import softmax

from irisjax.infer.mixtures import Mixture
from irisjax.infer.moves import DEGREES, Proposal, Straightening

DRAWS, ROUNDS = 2048, 16
"""Draws of a round, and largest number of rounds."""
EFFECTIVE = 1000
"""Number of effective draws at which sampling ends."""
_FITTED_TO = 256  # effective draws that a proposal needs
_BENDING = 0.3  # power of tempered weights below which proposals have no bent coordinates yet


@runtime_checkable
class Approximation(Protocol):
    """A normal approximation of a density, such as a least-squares fit: mean (free,) and covariance
    (free, free). A coordinate whose variance is zero was not fitted; its mean and variance are
    taken from the density along its axis.
    """

    @property
    def z(self) -> Float[Array | np.ndarray, " free"]: ...

    @property
    def covariance(self) -> Float[Array | np.ndarray, "free free"]: ...


class Start(NamedTuple):
    """An `Approximation` of plain numbers."""

    z: Float[np.ndarray, " free"]
    covariance: Float[np.ndarray, "free free"]


class ImportanceSample(NamedTuple):
    """Weighted draws of all rounds, `DRAWS` in each.

    Attributes:
        effective: Number of effective draws [Kong 1992]; the `samples` have equal weights.
        log_integral: Logarithm of the mean weight: of a likelihood times a prior, the evidence.
        wanted: Number of effective draws at which sampling was to end.
    """

    samples: Float[np.ndarray, "draws free"]
    effective: float
    log_integral: float
    rounds: int
    wanted: int = EFFECTIVE

    @property
    def error(self) -> float:
        """Standard deviation of `log_integral`, from that of the weights."""
        return math.sqrt(1 / self.effective - 1 / (self.rounds * DRAWS))

    @property
    def enough(self) -> bool:
        """Whether the samples represent the density."""
        return self.effective >= self.wanted


def importance_sample(
    log_density: Callable[[np.ndarray], np.ndarray],
    start: Approximation | Mixture,
    random: np.random.RandomState,
    progress: Callable[[int], object] = lambda rounds: None,
    *,
    others: Sequence[Approximation] = (),
    rounds: int = ROUNDS,
    effective: int = EFFECTIVE,
) -> ImportanceSample:
    """Sample a density of z whose priors are standard normal; it can miss a second, far mode of
    which no approximation is given.

    Args:
        log_density: Function of z (n, free) that returns (n,).
        start: Normal approximation of the density, or a mixture that has a component wherever the
            density may be large and is itself refined [Cappé et al. 2008].
        random: Source of all draws.
        progress: Called with the number of rounds done.
        others: Approximations at other maxima of the density.
        rounds: Largest number of rounds.
        effective: Number of effective draws at which sampling ends.

    Raises:
        ValueError: If no draw at all has a density above zero.
    """
    if isinstance(start, Mixture):
        first = start
    else:
        first = _InitialProposal([complete(log_density, known) for known in (start, *others)])
    proposals: list[Mixture | _InitialProposal | Proposal] = [first]
    new = first.draw(DRAWS, random)
    z, values, proposed = new, log_density(new), first.log_density(new)
    while True:
        progress(len(proposals))
        log_weight = values - proposed + math.log(len(proposals))
        if not np.isfinite(log_weight).any():
            raise ValueError("no draw round the least-squares fit has a probability above zero")
        log_weight = np.where(np.isfinite(log_weight), log_weight, -np.inf)
        found, power = _effective(log_weight, 1.0), _tempering_power(log_weight)
        weights, last = softmax(power * log_weight), proposals[-1]
        if found >= effective or len(proposals) == rounds:
            break
        if isinstance(last, Mixture):
            proposals.append(last.adapted(z, weights))
        else:
            samples = z[resample(weights, DRAWS, random)]
            straight = Straightening.of_samples(samples)
            straight = straight if power >= _BENDING else straight.linear()
            proposals.append(Proposal(straight, samples))
        new = proposals[-1].draw(DRAWS, random)
        proposed = np.logaddexp(proposed, proposals[-1].log_density(z))
        proposed = np.append(proposed, np.logaddexp.reduce([p.log_density(new) for p in proposals]))
        z, values = np.concatenate([z, new]), np.append(values, log_density(new))
    count = max(DRAWS, effective) if found >= effective else DRAWS
    samples = z[resample(weights, count, random)]
    log_integral = float(np.logaddexp.reduce(log_weight) - math.log(len(z)))
    return ImportanceSample(samples, found, log_integral, len(proposals), effective)


def complete(
    log_density: Callable[[np.ndarray], np.ndarray], start: Approximation
) -> tuple[Float[np.ndarray, " free"], Float[np.ndarray, "free free"]]:
    """Return mean and covariance of the approximation, unfitted coordinates filled in."""
    mean, covariance = np.array(start.z, float), np.array(start.covariance, float)
    nodes = np.linspace(-4.0, 4.0, 64)
    for i in np.flatnonzero(np.diag(covariance) == 0):
        points = np.repeat(mean[None], nodes.size, axis=0)
        points[:, i] = nodes
        values = log_density(points)
        covariance[i, i] = 1.0
        if np.isfinite(values).any():
            weights = softmax(values)
            mean[i] = weights @ nodes
            # No narrower than the nodes are apart, between which the peak may lie.
            covariance[i, i] = weights @ (nodes - mean[i]) ** 2 + (nodes[1] - nodes[0]) ** 2
    # Rounding, in single precision above all, must not make it indefinite.
    covariance = 0.5 * (covariance + covariance.T)
    least = float(np.linalg.eigvalsh(covariance)[0])
    return mean, covariance + max(1e-10, -2 * least) * np.eye(mean.size)


class _InitialProposal:
    """Wide t distributions about the approximations and the priors, which may be far apart."""

    def __init__(self, approximations: list[tuple[np.ndarray, np.ndarray]]):
        free = len(approximations[0][0])
        moments: list[Any] = [(mean, 4 * covariance) for mean, covariance in approximations]
        moments.append((np.zeros(free), 2 * np.eye(free)))
        self._all = [stats.multivariate_t(m, c, df=DEGREES) for m, c in moments]

    def draw(self, count: int, random: np.random.RandomState) -> np.ndarray:
        counts = map(len, np.array_split(np.arange(count), len(self._all)))
        each = zip(self._all, counts, strict=True)
        return np.concatenate([t.rvs(n, random_state=random).reshape(n, -1) for t, n in each])

    def log_density(self, z: np.ndarray) -> np.ndarray:
        return np.logaddexp.reduce([t.logpdf(z) for t in self._all]) - math.log(len(self._all))


def _effective(log_weight, power: float) -> float:
    """Number of effective draws of weights to a power."""
    w = np.exp(power * (log_weight - log_weight.max()))
    return float(w.sum() ** 2 / (w**2).sum())


def _tempering_power(log_weight: Float[np.ndarray, " n"]) -> float:
    """Return the largest power, up to 1, with enough effective draws to fit a proposal to."""
    minimum = min(_FITTED_TO, 0.5 * float(np.isfinite(log_weight).sum()))
    if _effective(log_weight, 1.0) >= minimum:
        return 1.0
    root: Any = brentq(lambda power: _effective(log_weight, power) - minimum, 1e-12, 1.0)
    return float(root)


def resample(
    weights: Float[np.ndarray, " n"],
    count: int,
    random: np.random.RandomState | np.random.Generator,
) -> Int[np.ndarray, " count"]:
    """Return the indices of draws by systematic resampling [Carpenter et al. 1999]."""
    total = np.cumsum(weights)
    positions = (random.random() + np.arange(count)) * (total[-1] / count)
    return np.minimum(np.searchsorted(total, positions), total.size - 1)
