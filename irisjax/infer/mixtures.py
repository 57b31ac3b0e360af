"""Mixtures of normal distributions, fitted to samples."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import gammaln, logsumexp

from irisjax.infer.moves import DEGREES

_REFINED = 2  # steps of expectation maximisation between two rounds
_LEAST = 1e-6  # variance that is added to every component


class Mixture(NamedTuple):
    """Normal distributions with their shares, which add up to one, in coordinates in which priors
    are of order one.
    """

    shares: Float[np.ndarray, " components"]
    means: Float[np.ndarray, "components free"]
    covariances: Float[np.ndarray, "components free free"]

    @classmethod
    def of_draws(
        cls, draws: Float[np.ndarray, "draws free"], components: int, random: np.random.RandomState
    ) -> "Mixture":
        """Fit a mixture to draws of equal weight."""
        count, free = draws.shape
        covariance = np.cov(draws.T).reshape(1, free, free) + _LEAST * np.eye(free)
        initial = cls(
            np.full(components, 1 / components),
            draws[random.choice(count, components, replace=False)],
            np.repeat(covariance / components ** (2 / free), components, axis=0),
        )
        return initial.refined(draws, np.full(count, 1 / count), 20)

    def refined(
        self, samples: Float[np.ndarray, "n free"], weights: Float[np.ndarray, " n"], steps: int
    ) -> "Mixture":
        """Fit it to weighted samples by expectation maximisation from here; components that too few
        effective samples support are left out  [Cappé et al. 2008].
        """
        shares, means, covariances = self
        free = samples.shape[1]
        for _ in range(steps):
            root, distance = _whiten(samples, means, covariances)
            log = np.log(shares / root)[:, None] - 0.5 * distance
            membership = weights * np.exp(log - logsumexp(log, axis=0))
            shares = membership.sum(axis=1)
            supported = shares**2 > 2 * free * (membership**2).sum(axis=1)
            supported[np.argmax(shares)] = True
            membership, shares = membership[supported], shares[supported]
            means = membership @ samples / shares[:, None]
            deviation = samples - means[:, None]
            spread = np.matmul(np.swapaxes(deviation * membership[:, :, None], 1, 2), deviation)
            covariances = spread / shares[:, None, None] + _LEAST * np.eye(free)
            shares = shares / shares.sum()
        return Mixture(shares, means, covariances)

    def adapted(
        self, samples: Float[np.ndarray, "n free"], weights: Float[np.ndarray, " n"]
    ) -> "Mixture":
        """Return the next proposal of importance sampling, refined on the draws that count."""
        relevant = weights > 1e-3 / len(weights)
        return self.refined(samples[relevant], weights[relevant], _REFINED)

    def draw(self, count: int, random: np.random.RandomState) -> Float[np.ndarray, "count free"]:
        """Draw places, each component as wide as Student's t of `DEGREES`."""
        component = random.choice(len(self.shares), count, p=self.shares)
        normal = random.standard_normal((count, self.means.shape[1]))
        scale = np.sqrt(random.chisquare(DEGREES, count) / DEGREES)
        root = np.linalg.cholesky(self.covariances)[component]
        return self.means[component] + np.einsum("nij,nj->ni", root, normal / scale[:, None])

    def log_density(self, z: Float[np.ndarray, "n free"]) -> Float[np.ndarray, " n"]:
        """Compute the log density of `draw`."""
        free = z.shape[1]
        root, distance = _whiten(z, self.means, self.covariances)
        power = 0.5 * (DEGREES + free)
        constant = gammaln(power) - gammaln(DEGREES / 2) - 0.5 * free * math.log(DEGREES * math.pi)
        terms = np.log(self.shares / root)[:, None] - power * np.log1p(distance / DEGREES)
        return constant + logsumexp(terms, axis=0)


def _whiten(x, means, covariances) -> tuple[np.ndarray, np.ndarray]:
    """Square roots of the determinants, and squared Mahalanobis distances (components, n)."""
    root = np.linalg.cholesky(covariances)
    residuals = np.linalg.solve(root, np.swapaxes(x - means[:, None], 1, 2))
    return np.diagonal(root, axis1=1, axis2=2).prod(axis=1), (residuals**2).sum(axis=1)
