"""The distribution of parameters in a group of eyes, from the fit of each.

Every eye has its own parameters z_i, normal about the group's mean μ with the spreads τ, in the
coordinates in which the fits' priors are standard normal [Gelman et al. 2013, Section 5.5]. The
posterior of an eye, divided by its prior, is the eye's likelihood. A least-squares fit gives a
normal posterior; draws give a sum of normal kernels with their mean and covariance [West 1993]. In
either case z_i is integrated exactly; μ and τ are sampled by importance.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import log_ndtr, ndtri_exp
from scipy.stats import norm

from irisjax._types import PRNGKey
from irisjax.infer.importance import DRAWS, Approximation, Start, importance_sample
from irisjax.infer.posterior import Density
from irisjax.numerics.streams import words_of

PRIOR = "each mean as an eye in the fits; each spread half-normal, as wide as the fits' prior"
"""The prior of a group, in words."""
KERNELS = 256
"""Number of draws of an eye's posterior that are used."""


WIDTH = 2.0
"""Standard deviation of the priors of `likelihood_draws`: those of the fits, 1, leave hardly a draw
where the eyes of a group far out in the prior lie."""


class Population(NamedTuple):
    """Draws of the distribution of a group, and what it does to its eyes.

    Attributes:
        mean: Means of the parameters' normal coordinates.
        spread: Their standard deviations between eyes.
        shrinkage: Share by which an eye's own value is drawn towards the mean, on average.
        effective: Number of effective draws.
        fewest: Smallest effective number of draws of an eye's posterior that the group's
            distribution leaves; 1 without draws.
    """

    mean: Float[np.ndarray, "draws parameters"]
    spread: Float[np.ndarray, "draws parameters"]
    shrinkage: Float[np.ndarray, " parameters"]
    effective: float
    fewest: float


def population(
    z: Float[np.ndarray, "eyes parameters"],
    covariance: Float[np.ndarray, "eyes parameters parameters"],
    draws: Float[np.ndarray, "eyes kernels parameters"] | None = None,
    width: float = 1.0,
    *,
    key: PRNGKey,
) -> Population:
    """Infer the distribution of a group of eyes from their fits.

    Args:
        z: Most probable values, in the coordinates in which priors are standard normal.
        covariance: Of the fits, the prior's part included.
        draws: Of the posteriors, in the same coordinates; they replace the normal approximation.
        width: Standard deviation of the normal priors of `draws` (the fits' is 1).
        key: Source of the draws.
    """
    free, kernels, each = z.shape[1], z[:, None], covariance
    if draws is not None:
        z = draws.mean(axis=1)
        off = draws - z[:, None]
        covariance = np.einsum("nki,nkj->nij", off, off) / (draws.shape[1] - 1)
        # Silverman's width, in units of the whole covariance; kernels are drawn to the mean.
        share = (4 / (free + 2) / draws.shape[1]) ** (2 / (free + 4))
        kernels, each = z[:, None] + np.sqrt(1 - share) * off, share * covariance
    random = np.random.RandomState(words_of(key))
    eyes = [_likelihood(m, c, width) for m, c in zip(kernels, each, strict=True)]

    def log_density(x):
        found = (eye(x[:, :free], _spread(x[:, free:]))[0] for eye in eyes)
        return sum(found) - 0.5 * (x**2).sum(axis=1)

    found = importance_sample(log_density, _moments(z, covariance), random)
    mean, spread = found.samples[:, :free], _spread(found.samples[:, free:])
    typical = np.median(mean, axis=0, keepdims=True), np.median(spread, axis=0, keepdims=True)
    precision = [_precision(c, width) for c in covariance]
    own = np.mean([np.diag(_shared(typical[1], p)[0][0]) for p in precision], axis=0)
    fewest = min(float(eye(*typical)[1][0]) for eye in eyes)
    return Population(mean, spread, 1 - own, found.effective, fewest)


def likelihood_draws(
    target: Density, start: Approximation, names: Sequence[str], *, key: PRNGKey
) -> Float[np.ndarray, "kernels parameters"]:
    """Draw some parameters of an eye from its likelihood times normal priors of `WIDTH`.

    Args:
        target: The eye's posterior under its own priors, such as a `Problem`.
        start: Normal approximation of it.
        names: Of the parameters; the others keep their own priors and are left out.
        key: Source of the draws.
    """
    kept = [list(target.names).index(name) for name in names]

    def log_density(z):
        return np.asarray(target.log_density(z)) + 0.5 * (1 - WIDTH**-2) * (z[:, kept] ** 2).sum(1)

    found = importance_sample(log_density, start, np.random.RandomState(words_of(key)))
    return found.samples[np.linspace(0, DRAWS - 1, KERNELS).astype(int)][:, kept]


def _spread(x: np.ndarray) -> np.ndarray:
    """Spreads whose half-normal prior is standard normal in x."""
    return -ndtri_exp(np.log(0.5) + log_ndtr(-x))


def _moments(z, covariance) -> Start:
    """A first guess of means and spreads."""
    between = np.cov(z.T).reshape(covariance.shape[1:])
    spread = np.sqrt(np.diag(between)).clip(0.02, 2.5)
    guess = np.concatenate([z.mean(axis=0), norm.isf(2 * norm.sf(spread))])
    free, wide = len(spread), 0.09 * np.eye(len(guess))
    wide[:free, :free] = (between + covariance.mean(axis=0)) / len(z)
    return Start(guess, wide)


def _precision(covariance: np.ndarray, width: float) -> np.ndarray:
    """L = C⁻¹ − 1/w² of a likelihood; rounding must not leave less than no information."""
    prior = np.eye(len(covariance)) / width**2
    values, vectors = np.linalg.eigh(np.linalg.inv(covariance) - prior)
    return (vectors * np.maximum(values, 0)) @ vectors.T


def _shared(spread, precision) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """B L, B = (T⁻¹ + L)⁻¹ and log det(1 + T L) for each row of spreads."""
    root = np.eye(len(precision)) + spread[:, :, None] * precision * spread[:, None, :]
    between = spread[:, :, None] * np.linalg.inv(root) * spread[:, None, :]
    return between @ precision, between, np.linalg.slogdet(root)[1]


def _likelihood(kernels: np.ndarray, covariance: np.ndarray, width: float) -> Callable[..., Any]:
    """An eye's log likelihood of means and spreads, and the effective number of its kernels.

    A kernel has the information h = C⁻¹ m; the integral of exp(h z − ½ z L z) over z ~ N(μ, T) is
    exp(½ h B h + h (1 − B L) μ − ½ μ (L − L B L) μ) / √det(1 + T L).
    """
    precision, inverse = _precision(covariance, width), np.linalg.inv(covariance)
    information = kernels @ inverse
    a, b = np.triu_indices(len(covariance))
    products = information[:, a] * information[:, b] * np.where(a == b, 0.5, 1.0)
    constant = -0.5 * (information * kernels).sum(axis=1)

    def likelihood(mean, spread):
        taken, between, volume = _shared(spread, precision)
        moved = mean - np.einsum("rij,rj->ri", taken, mean)
        rest = -0.5 * (np.einsum("ri,ij,rj->r", mean, precision, moved) + volume)
        each = products @ between[:, a, b].T + information @ moved.T + constant[:, None]
        top = each.max(axis=0)
        weights = np.exp(each - top)
        total = weights.sum(axis=0)
        return rest + top + np.log(total), total**2 / (weights**2).sum(axis=0)

    return likelihood
