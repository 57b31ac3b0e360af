"""The distribution of parameters in a group of eyes, from the fit of each.

Every eye has its own parameters z_i, normal about the group's mean μ with the spreads τ, in the
coordinates in which the fits' priors are standard normal [Gelman et al. 2013, Section 5.5]. The
posterior of an eye, divided by its prior, is the eye's likelihood. A least-squares fit gives a
normal posterior, draws a mixture of normal distributions. In either case z_i is integrated exactly;
μ and τ are sampled by importance.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.special import log_ndtr, ndtri_exp, softmax
from scipy.stats import norm

from irisjax._types import PRNGKey
from irisjax.infer.importance import DRAWS, Start, complete, importance_sample
from irisjax.infer.least_squares import least_squares, levenberg_marquardt
from irisjax.infer.mixtures import Mixture
from irisjax.infer.posterior import Density
from irisjax.infer.problem import Problem
from irisjax.numerics.streams import words_of

PRIOR = "each mean as an eye in the fits; each spread half-normal, as wide as the fits' prior"
"""The prior of a group, in words."""
KERNELS = 1024
"""Number of draws of an eye's posterior that are used."""
WIDTH = 3.0
"""Standard deviation of the priors of `likelihood_draws`: those of the fits, 1, leave hardly a draw
where the eyes of a group far out in the prior lie."""
_COMPONENTS = 8  # of the mixture that is fitted to draws
_ROUNDS = 12  # of importance sampling by a mixture, at most
_TAIL = 1.5 * WIDTH  # where a parameter is held for the likelihood's tails
_HOLD = 0.1  # standard deviation with which it is
_FAINT = 25.0  # logarithm of densities that do not count
_LEAST = 1e-4  # precision that a flat likelihood is given


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
    free, random = z.shape[1], np.random.RandomState(words_of(key))
    if draws is None:
        mixtures = [
            Mixture(np.ones(1), m[None], c[None]) for m, c in zip(z, covariance, strict=True)
        ]
    else:
        z = draws.mean(axis=1)
        deviation = draws - z[:, None]
        covariance = np.einsum("nki,nkj->nij", deviation, deviation) / (draws.shape[1] - 1)
        mixtures = [Mixture.of_draws(posterior, _COMPONENTS, random) for posterior in draws]
    eyes = [_likelihood(mixture, width) for mixture in mixtures]

    def log_density(x):
        terms = (eye(x[:, :free], _spread(x[:, free:])) for eye in eyes)
        return sum(terms) - 0.5 * (x**2).sum(axis=1)

    sample = importance_sample(log_density, _moments(z, covariance), random)
    mean, spread = sample.samples[:, :free], _spread(sample.samples[:, free:])
    middle, typical = np.median(mean, axis=0), np.median(spread, axis=0)
    precision = [_precision(c, width) for c in covariance]
    own_shares = np.mean([np.diag(_own_share(typical, p)) for p in precision], axis=0)
    smallest = 1.0
    if draws is not None:
        # A mixture resolves no group narrower than half of the eye's own standard deviation.
        scales = np.sqrt(typical**2 + 0.25 * draws.var(axis=1, keepdims=True))
        log = norm.logpdf(draws, middle, scales) - norm.logpdf(draws, 0, width)
        weights = softmax(log.sum(axis=2), axis=1)
        smallest = float(1 / (weights**2).sum(axis=1).max())
    return Population(mean, spread, 1 - own_shares, sample.effective, smallest)


def likelihood_draws(
    target: Density, starts: Sequence[Start], names: Sequence[str], *, key: PRNGKey
) -> Float[np.ndarray, "kernels parameters"]:
    """Draw some parameters of an eye from its likelihood times normal priors of `WIDTH`.

    Args:
        target: The eye's posterior under its own priors, such as a `Problem`.
        starts: Normal approximations of places where the density may be large; see `tails`.
        names: Of the parameters; the others keep their own priors and are left out.
        key: Source of the draws.
    """
    index, wide = _selection(target, names)

    def log_density(z):
        return np.asarray(target.log_density(z)) + 0.5 * (1 - WIDTH**-2) * (z[:, index] ** 2).sum(1)

    places = [complete(log_density, start) for start in starts]
    means = np.stack([*(m for m, _ in places), np.zeros(wide.size)])
    # Half as wide again, so that little is missed; the last one is the prior.
    covariances = np.stack([*(1.5 * c for _, c in places), np.diag(2 / wide)])
    log = log_density(means)
    likely = log > log[:-1].max() - _FAINT
    likely[-1] = True
    initial = Mixture(np.full(likely.sum(), 1 / likely.sum()), means[likely], covariances[likely])
    random = np.random.RandomState(words_of(key))
    found = importance_sample(log_density, initial, random, rounds=_ROUNDS)
    if not found.enough:
        found = importance_sample(log_density, starts[0], random)
    return found.samples[np.linspace(0, DRAWS - 1, KERNELS).astype(int)][:, index]


def tails(problem: Problem, z: Float[np.ndarray, " free"], names: Sequence[str]) -> list[Start]:
    """Approximate the likelihood times normal priors of `WIDTH` about a fit and in its tails.

    Where a parameter's likelihood does not end, such as that of an ABL fraction near zero, another
    group's distribution can give most of the weight to a tail that no draw about the fit reaches.
    Each parameter is therefore held far out on either side, the others are fitted there, and the
    curvature without the hold gives the covariance.
    """
    index, wide = _selection(problem, names)
    indices = np.array([index[0], *np.repeat(index, 2)])
    targets = np.array([0.0, *np.tile([_TAIL, -_TAIL], len(index))])
    stiffness = np.full(indices.size, 1 / _HOLD)
    stiffness[0] = 0  # the fit itself, under wide priors
    solution = _constrained_fit(
        problem.unnamed(), *map(jnp.asarray, (z, wide, indices, targets, stiffness))
    )
    places, precision = map(np.asarray, solution)
    valid = np.isfinite(places).all(axis=1) & np.isfinite(precision).all(axis=(1, 2))
    covariance = np.linalg.inv(precision[valid])
    covariance = 0.5 * (covariance + np.swapaxes(covariance, 1, 2))
    unfitted = [i for i in range(len(z)) if i not in problem.moving]
    covariance[:, unfitted] = 0
    covariance[:, :, unfitted] = 0
    return [Start(m, c) for m, c in zip(places[valid], covariance, strict=True)]


def _selection(target: Density, names: Sequence[str]) -> tuple[list[int], np.ndarray]:
    """Places of the parameters, and the precision of all priors."""
    index = [list(target.names).index(name) for name in names]
    wide = np.ones(len(target.names))
    wide[index] = WIDTH**-2
    return index, wide


@eqx.filter_jit
def _constrained_fit(
    problem: Problem,
    z: Float[Array, " free"],
    prior_precision: Float[Array, " free"],
    indices: Int[Array, " places"],
    targets: Float[Array, " places"],
    stiffness: Float[Array, " places"],
) -> tuple[Float[Array, "places free"], Float[Array, "places free free"]]:
    """Fit with one coordinate held, and the precision without the hold."""
    free = z.size

    def residuals(x, weight, args):
        problem, stiff, value = args
        data, _, _ = problem.evaluated(x)
        return jnp.concatenate([data, jnp.sqrt(prior_precision) * x, stiff * (x - value)]), None

    def one(index, value, stiffness):
        stiff = jnp.where(jnp.arange(free) == index, stiffness, 0.0)
        start = jnp.where(stiff > 0, value, z)
        search = levenberg_marquardt(1e-3, 1e-3)
        best = least_squares(residuals, (problem, stiff, value), start, solver=search, max_steps=30)
        jacobian = best.jacobian[:-free]
        return best.x, jacobian.T @ jacobian

    return eqx.filter_vmap(one)(indices, targets, stiffness)


def _spread(x: np.ndarray) -> np.ndarray:
    """Spreads whose half-normal prior is standard normal in x."""
    return -ndtri_exp(np.log(0.5) + log_ndtr(-x))


def _moments(z, covariance) -> Start:
    """A first guess of means and spreads."""
    between = np.cov(z.T).reshape(covariance.shape[1:])
    spread = np.sqrt(np.diag(between)).clip(0.02, 2.5)
    guess = np.concatenate([z.mean(axis=0), norm.isf(2 * norm.sf(spread))])
    free, covariances = len(spread), 0.09 * np.eye(len(guess))
    covariances[:free, :free] = (between + covariance.mean(axis=0)) / len(z)
    return Start(guess, covariances)


def _precision(covariance: np.ndarray, width: float) -> np.ndarray:
    """L = C⁻¹ − 1/w² of a likelihood; rounding must not leave less than no information."""
    prior = np.eye(len(covariance)) / width**2
    values, vectors = np.linalg.eigh(np.linalg.inv(covariance) - prior)
    return (vectors * np.maximum(values, 0)) @ vectors.T


def _own_share(spread: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Shares (T⁻¹ + L)⁻¹ L of an eye's own values that are left."""
    scaled = spread[:, None] * precision
    inner = np.eye(len(spread)) + scaled * spread
    return spread[:, None] * np.linalg.solve(inner, scaled)


def _likelihood(mixture: Mixture, width: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """An eye's log likelihood of means and spreads, but for a constant.

    A component N(m, C), divided by its prior, is that of a measurement L⁻¹ C⁻¹ m with the precision
    L = C⁻¹ − 1/w². Integrated over z ~ N(μ, T), T = diag τ², this is N(L⁻¹ C⁻¹ m; μ, T + L⁻¹).
    """
    inverse = np.linalg.inv(mixture.covariances)
    information = np.einsum("kij,kj->ki", inverse, mixture.means)
    precision = np.stack([_precision(c, width) for c in mixture.covariances])
    free = precision.shape[1]
    error = np.linalg.inv(precision + _LEAST * np.eye(free))
    means = np.einsum("kij,kj->ki", error, information)
    constant = np.log(mixture.shares) - 0.5 * (information * mixture.means).sum(axis=1)
    constant += 0.5 * (information * means).sum(axis=1)
    constant += 0.5 * (np.linalg.slogdet(inverse)[1] + np.linalg.slogdet(error)[1])

    def likelihood(mean, spread):
        # `factor` is the Cholesky factor of T + L⁻¹; each entry has the shape (components, draws).
        log = np.repeat(constant[:, None], len(mean), axis=1)
        factor, white = {}, []
        for j in range(free):
            variance = error[:, j, j, None] + spread[:, j] ** 2
            root = np.sqrt(variance - sum(factor[j, k] ** 2 for k in range(j)))
            deviation = means[:, j, None] - mean[:, j]
            white.append((deviation - sum(factor[j, k] * white[k] for k in range(j))) / root)
            log -= np.log(root) + 0.5 * white[j] ** 2
            for i in range(j + 1, free):
                inner = sum(factor[i, k] * factor[j, k] for k in range(j))
                factor[i, j] = (error[:, i, j, None] - inner) / root
        top = log.max(axis=0)
        return top + np.log(np.exp(log - top).sum(axis=0))

    return likelihood
