"""Moves of an ensemble of walkers, in coordinates in which the posterior's ridge is straight."""

import functools
from typing import Any, NamedTuple

import emcee
import numpy as np
from jaxtyping import Float
from scipy import stats

DEGREES = 5
"""Degrees of freedom of proposals, so that places far out are still proposed now and then."""
_REACH = 4.0  # standard deviations beyond which the quadratic polynomials are constant


class Straightening(NamedTuple):
    """Coordinates y = S(z) in which samples that lie along a curved ridge look normal.

    Principal axes from the `mean`, longest first, each as long as its standard deviation, less a
    quadratic polynomial of the longer ones (coefficients `bends`), over the `width` that this
    leaves: a triangular transport map [Parno & Marzouk 2018] of shears, so that its Jacobian is
    constant and densities carry over. Beyond `_REACH` standard deviations the polynomials keep
    their value there.
    """

    mean: Float[np.ndarray, " free"]
    axes: Float[np.ndarray, "free free"]
    bends: list[Float[np.ndarray, " terms"]]
    width: Float[np.ndarray, " free"]

    @classmethod
    def of_samples(cls, z: Float[np.ndarray, "n free"]) -> "Straightening":
        """Fit the coordinates to samples."""
        mean = z.mean(axis=0)
        variance, axes = np.linalg.eigh(np.cov(z.T).reshape(z.shape[1], z.shape[1]))
        axes = (axes * np.sqrt(np.maximum(variance, 1e-12 * variance.max())))[:, ::-1]
        w = np.linalg.solve(axes, (z - mean).T).T
        # Normal equations: well conditioned, as the coordinates have unit variance.
        terms = _quadratic(w[:, :-1])
        gram, sums = terms.T @ terms + 1e-9 * len(terms) * np.eye(terms.shape[1]), terms.T @ w
        counts = ((i + 1) * (i + 2) // 2 for i in range(len(mean)))
        bends = [np.linalg.solve(gram[:n, :n], sums[:n, i]) for i, n in enumerate(counts)]
        return cls(mean, axes, bends, np.std(w - _shifts(w, bends), axis=0))

    def linear(self) -> "Straightening":
        """Return the same axes without bends."""
        flat = [np.zeros_like(bend) for bend in self.bends]
        return self._replace(bends=flat, width=np.ones_like(self.width))

    def forward(self, z: Float[np.ndarray, "n free"]) -> Float[np.ndarray, "n free"]:
        """Compute y of z."""
        w = np.linalg.solve(self.axes, (z - self.mean).T).T
        return (w - _shifts(w, self.bends)) / self.width

    def inverse(self, y: Float[np.ndarray, "n free"]) -> Float[np.ndarray, "n free"]:
        """Compute z of y."""
        w = y * self.width
        for i, bend in enumerate(self.bends):
            w[:, i] += _quadratic(w[:, :i]) @ bend
        return self.mean + w @ self.axes.T


def _shifts(w, bends):
    """Return the polynomials of each column of w, which are of those before it."""
    terms = _quadratic(w[:, :-1])
    return np.stack([terms[:, : len(bend)] @ bend for bend in bends], axis=1)


def _quadratic(w):
    """Return the products of pairs of 1 and w, (n, terms); those of the first columns alone come
    first.
    """
    w = np.concatenate([np.ones((len(w), 1)), np.clip(w, -_REACH, _REACH)], axis=1)
    first, second = _pairs(w.shape[1])
    return w[:, first] * w[:, second]


_pairs = functools.lru_cache(np.tril_indices)


class Proposal:
    """A multivariate Student t in straightened coordinates, fitted to samples."""

    def __init__(self, straight: Straightening, samples: Float[np.ndarray, "n free"]):
        y = straight.forward(samples)
        spread: Any = np.cov(y.T)  # scipy's stub calls a matrix int
        self._straight = straight
        self._t = stats.multivariate_t(y.mean(axis=0), spread, df=DEGREES)
        # Shears keep volumes.
        self._volume = np.linalg.slogdet(straight.axes)[1] + np.log(straight.width).sum()

    def draw(self, count: int, random: np.random.RandomState) -> Float[np.ndarray, "count free"]:
        """Draw `count` places."""
        y = self._t.rvs(count, random_state=random).reshape(count, -1)
        return self._straight.inverse(y)

    def log_density(self, z: Float[np.ndarray, "n free"]) -> Float[np.ndarray, " n"]:
        """Compute the log density at places z."""
        return self._t.logpdf(self._straight.forward(z)) - self._volume


def independent_move(
    straight: Straightening, samples: Float[np.ndarray, "n free"]
) -> emcee.moves.Move:
    """Return Metropolis–Hastings with proposals that do not depend on a walker's place."""
    proposal = Proposal(straight, samples)

    def propose(z, random):
        new = proposal.draw(len(z), random)
        log_old, log_new = np.split(proposal.log_density(np.concatenate([z, new])), 2)
        return new, log_old - log_new

    return emcee.moves.MHMove(propose)


class _DifferenceMove(emcee.moves.DEMove):
    """Differential evolution in straightened coordinates."""

    def __init__(self, straight: Straightening):
        super().__init__()
        self._straight = straight

    def get_proposal(
        self, s: np.ndarray, c: list[np.ndarray], random: np.random.RandomState
    ) -> tuple[np.ndarray, np.ndarray]:
        """Propose places for walkers `s` from the differences of the others, `c`."""
        forward = self._straight.forward
        new, factors = super().get_proposal(forward(s), [forward(z) for z in c], random)
        return self._straight.inverse(new), factors


def mixture(
    samples: Float[np.ndarray, "n free"] | None = None,
) -> list[tuple[emcee.moves.Move, float]]:
    """Return moves and their shares: jumps adapted to samples, or differences of walkers alone.

    Independent jumps carry walkers along the ridge, thirty times faster than emcee's stretches
    (experiments/bench_inversion.py, which also chose the shares). Differences of walkers serve
    places where the t distribution fits badly.
    """
    if samples is None:
        return [(emcee.moves.DEMove(), 0.7), (emcee.moves.DESnookerMove(), 0.3)]
    straight = Straightening.of_samples(samples)
    return [(independent_move(straight, samples), 0.8), (_DifferenceMove(straight), 0.2)]
