"""How walkers move: emcee's ensemble moves, and independent jumps drawn from a fitted t-distribution."""

from typing import NamedTuple

import emcee
import numpy as np


class Proposal(NamedTuple):
    """A multivariate Student t that resembles the posterior: mean (free,), root of its scale (free, free)."""

    mean: np.ndarray
    root: np.ndarray

    @classmethod
    def of_gaussian(cls, mean, covariance) -> "Proposal":
        """From a mean and a covariance."""
        return cls(np.asarray(mean, float), np.linalg.cholesky(np.asarray(covariance, float)))

    @classmethod
    def of_samples(cls, z) -> "Proposal":
        """From samples (n, free)."""
        return cls.of_gaussian(z.mean(axis=0), np.cov(z.T).reshape(z.shape[1], z.shape[1]))


_DEGREES = 3.0  # heavy tails: with 6, one walker in a thousand stood still for hundreds of steps


class IndependentMove(emcee.moves.MHMove):
    """Metropolis–Hastings with proposals that do not depend on where a walker stands.

    As good as the t-distribution resembles the posterior: where it does, one accepted jump forgets all.
    """

    def __init__(self, proposal: Proposal):
        mean, root = proposal
        inverse, free = np.linalg.inv(root), mean.size

        def log_density(z):
            square = (((z - mean) @ inverse.T) ** 2).sum(axis=1)
            return -0.5 * (_DEGREES + free) * np.log1p(square / _DEGREES)

        def propose(z, random):
            normal = random.standard_normal(z.shape)
            stretch = np.sqrt(_DEGREES / random.chisquare(_DEGREES, len(z)))
            new = mean + (stretch[:, None] * normal) @ root.T
            return new, log_density(z) - log_density(new)

        super().__init__(propose)


def mixture(proposal: Proposal | None):
    """Moves and their weights, as `emcee.EnsembleSampler` takes them.

    Shares by experiments/bench_inversion.py: independent jumps carry walkers along the ridge, three to six times
    faster than stretches; the differences of walkers are for places where the t-distribution fits badly.
    """
    if proposal is None:
        return [(emcee.moves.DEMove(), 0.7), (emcee.moves.DESnookerMove(), 0.3)]
    return [
        (IndependentMove(proposal), 0.85),
        (emcee.moves.DEMove(), 0.12),
        (emcee.moves.DESnookerMove(), 0.03),
    ]
