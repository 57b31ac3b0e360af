"""The distribution of parameters in a group of eyes, from the fit of each.

Every eye has its own parameters z_i, normal about the group's mean μ with the spreads τ, in the
coordinates in which the fits' priors are standard normal [Gelman et al. 2013, Section 5.5]. A fit
gives a normal posterior; divided by its prior it is the eye's likelihood, of precision L_i = C_i⁻¹
− 1 and information h_i = C_i⁻¹ z_i. z_i and μ are integrated exactly, τ by importance sampling.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import log_ndtr, ndtri_exp

from irisjax._types import PRNGKey
from irisjax.infer.importance import Start, importance_sample
from irisjax.infer.posterior import words_of

PRIOR = "each mean as an eye in the fits; each spread half-normal, as wide as the fits' prior"
"""The prior of a group, in words."""
_MOST_NUMBERS = 1 << 22  # of matrices at a time


class Population(NamedTuple):
    """Draws of the distribution of a group, and what it does to its eyes.

    Attributes:
        mean: Means of the parameters' normal coordinates.
        spread: Their standard deviations between eyes.
        shrinkage: Share by which an eye's own value is drawn towards the mean, on average.
        effective: Number of effective draws.
    """

    mean: Float[np.ndarray, "draws parameters"]
    spread: Float[np.ndarray, "draws parameters"]
    shrinkage: Float[np.ndarray, " parameters"]
    effective: float


def population(
    z: Float[np.ndarray, "eyes parameters"],
    covariance: Float[np.ndarray, "eyes parameters parameters"],
    *,
    key: PRNGKey,
) -> Population:
    """Infer the distribution of a group of eyes from their fits.

    Args:
        z: Most probable values, in the coordinates in which priors are standard normal.
        covariance: Of the fits, the prior's part included.
        key: Source of the draws.
    """
    free = z.shape[1]
    inverse = np.linalg.inv(covariance)
    values, vectors = np.linalg.eigh(inverse - np.eye(free))
    # Rounding must not leave less than no information.
    precision = (vectors * np.maximum(values, 0)[:, None]) @ np.swapaxes(vectors, 1, 2)
    information = (inverse @ z[..., None])[..., 0]
    random = np.random.RandomState(words_of(key))

    def log_density(x):
        _, vector, matrix, rest = _of_spreads(_spread(x), precision, information)
        fitted = np.einsum("ri,ri->r", vector, np.linalg.solve(matrix, vector[..., None])[..., 0])
        return rest + 0.5 * (fitted - np.linalg.slogdet(matrix)[1] - (x**2).sum(axis=1))

    found = importance_sample(log_density, Start(np.zeros(free), np.eye(free)), random)
    spread = _spread(found.samples)
    _, vector, matrix, _ = _of_spreads(spread, precision, information)
    noise = np.swapaxes(np.linalg.inv(np.linalg.cholesky(matrix)), 1, 2) @ random.standard_normal(
        (*spread.shape, 1)
    )
    mean = np.linalg.solve(matrix, vector[..., None]) + noise
    typical = np.median(spread, axis=0, keepdims=True)
    between, *_ = _of_spreads(typical, precision, information)
    own = np.einsum("nij,nji->ni", between[0], precision).mean(axis=0)
    return Population(mean[..., 0], spread, 1 - own, found.effective)


def _spread(x: np.ndarray) -> np.ndarray:
    """Spreads whose half-normal prior is standard normal in x."""
    return -ndtri_exp(np.log(0.5) + log_ndtr(-x))


def _of_spreads(spread, precision, information):
    """(T⁻¹ + L_i)⁻¹ of the last spreads, and of all: vector and matrix of the means' posterior, and
    the logarithm of what does not depend on them.
    """
    each = max(1, _MOST_NUMBERS // precision.size)
    between, vectors, matrices, rest = precision, [], [], []
    for t in np.split(spread, range(each, len(spread), each)):
        t = t[:, None, :]
        root = np.eye(t.shape[-1]) + t[..., None] * precision * t[..., None, :]
        between = t[..., None] * np.linalg.inv(root) * t[..., None, :]
        moved = (between @ information[..., None])[..., 0]
        matrices.append((precision - precision @ between @ precision).sum(axis=1))
        vectors.append((information - (precision @ moved[..., None])[..., 0]).sum(axis=1))
        explained = (information * moved).sum(axis=-1)
        rest.append(0.5 * (explained - np.linalg.slogdet(root)[1]).sum(axis=1))
    matrix = np.concatenate(matrices) + np.eye(spread.shape[1])
    return between, np.concatenate(vectors), matrix, np.concatenate(rest)
