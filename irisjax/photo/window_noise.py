"""Errors of the model of windows, integrated out of the likelihood of their colours.

An iris is not as thick as the average one and its relief shades otherwise. Both differ from iris to
iris, from ring to ring of one, and from window to window of a ring: normal errors of three levels,
as in an analysis of variance with random effects. In the logarithms of the channels, an error of
the thickness of the whole or of a ring is proportional to the model's own response to it, and one
of light is equal in all channels. The scatter of the windows of a ring and the spread of the rings
are estimated from the photograph itself: irides contain more than pigments and thickness, may have
another colour around the pupil, and light may fall off as that of no lamp of the model does.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from irisjax._types import Scalar
from irisjax.photo.windows import ANGLES, RINGS

WindowColours = Float[Array, "windows 3"]
_Present = Bool[ArrayLike, " windows"]


class Spreads(NamedTuple):
    """Standard deviations of the logarithms of thickness, light, and each channel by itself."""

    thickness: float
    light: float
    channel: float


WHOLE = Spreads(0.15, 0.1, 0.0)
"""Errors of a whole iris: assumed. Errors of single channels are the camera's white balance."""
RING = Spreads(0.12, 0.08, 0.02)
"""Errors of the rings of one iris, by its collarette, folds and colours: assumed; the light of
those of `procedural` differs by 0.01.
"""
SPREAD_FACTORS = 2.0 ** np.arange(4)
"""Factors on `RING`, with a 1/x prior, so that the photograph determines the spread."""
PRIOR_COVARIANCE = (
    0.04**2 * np.ones((3, 3))
    + 0.06**2 * np.outer([0.55, 0.33, 0.15], [0.55, 0.33, 0.15])
    + 0.007**2 * np.eye(3)
)
"""Prior covariance of a window's channels about its ring: light, thickness with the response of a
green iris, and each channel by itself.
"""
PRIOR_WINDOWS = 5.0
"""Number of windows that the prior counts for."""


class Covariances(NamedTuple):
    """Covariances of the channels of a window about its ring's mean, and of the rings' means."""

    within: Float[Array, "rings 3 3"]
    between: Float[Array, "means means"]


def log_likelihood(off: WindowColours, response: WindowColours, present: _Present) -> Scalar:
    """Return the logarithm of the density of errors, without constants.

    That of the rings' means is a mixture of normal densities over `SPREAD_FACTORS`. That of windows
    about them is a matrix t: the normal density with the inverse Wishart prior of its covariance
    integrated out [Gelman et al. 2013, Section 3.6].

    Args:
        off: Logarithms of photograph over model, ring after ring.
        response: Derivatives of the model's by that of thickness; their means in rings count.
        present: Windows that count.
    """
    within, between = _every(off, response, present)
    number, means, _ = _in_rings(off, present)
    scatter = (_free(number) * jnp.linalg.slogdet(within)[1]).sum()
    return jax.nn.logsumexp(_log_weights(between, means)) - 0.5 * scatter


def whitened_errors(
    off: WindowColours, present: _Present, held: Covariances
) -> Float[Array, " values"]:
    """Return errors as numbers of unit variance, under fixed covariances."""
    _, means, apart = _in_rings(off, present)
    within, between = (jnp.linalg.cholesky(c) for c in held)
    rows = jax.scipy.linalg.solve_triangular(within, apart.mT, lower=True)
    row = jax.scipy.linalg.solve_triangular(between, means.ravel(), lower=True)
    return jnp.concatenate([rows.ravel(), row])


def covariances(off: WindowColours, response: WindowColours, present: _Present) -> Covariances:
    """Return the most likely covariance within rings, and that of their means weighted by the
    probability of each factor.

    With it a step of least squares is one of expectation and maximisation over `SPREAD_FACTORS`.
    """
    within, between = _every(off, response, present)
    share = jax.nn.softmax(_log_weights(between, _in_rings(off, present)[1]))
    inverse = (share[:, None, None] * jnp.linalg.inv(between)).sum(0)
    return Covariances(within, jnp.linalg.inv(0.5 * (inverse + inverse.T)))


def _log_weights(between, means):
    """Logarithms of the densities of rings' means under each of the covariances."""
    factor = jnp.linalg.cholesky(between)
    row = jax.scipy.linalg.solve_triangular(
        factor, jnp.broadcast_to(means.ravel(), factor.shape[:-1])[..., None], lower=True
    )
    density = -0.5 * (row**2).sum((1, 2)) - jnp.log(jnp.diagonal(factor, 0, 1, 2)).sum(-1)
    return density - jnp.log(jnp.asarray(SPREAD_FACTORS))


def _every(off: WindowColours, response: WindowColours, present: _Present) -> Covariances:
    """The most likely covariance within rings, and those of their means for each factor; rings
    without windows are independent with a variance of 1.
    """
    number, _, apart = _in_rings(off, present)
    along = _in_rings(response, present)[1]
    scatter = PRIOR_WINDOWS * jnp.asarray(PRIOR_COVARIANCE)
    scatter = scatter + jnp.einsum("rni,rnj->rij", apart, apart)
    within = scatter / _free(number)[:, None, None]

    def of(level: Spreads):
        squares = level.thickness**2 * along[:, None, :, None] * along[None, :, None, :]
        return squares + level.light**2 + level.channel**2 * jnp.eye(3)

    every = jnp.arange(RINGS)
    alone = within / jnp.maximum(number, 1)[:, None, None]
    alone = jnp.asarray(SPREAD_FACTORS**2)[:, None, None, None] * of(RING)[every, every] + alone
    seen = (number > 0)[:, None, None]
    between = of(WHOLE) * (seen[:, None] & seen[None])
    between = jnp.broadcast_to(between, (len(SPREAD_FACTORS), *between.shape))
    between = between.at[:, every, every].add(jnp.where(seen, alone, jnp.eye(3)))
    flat = len(SPREAD_FACTORS), 3 * RINGS, 3 * RINGS
    return Covariances(within, between.transpose(0, 1, 3, 2, 4).reshape(flat))


def _free(number):
    """Windows of rings, and of the prior, that count for the scatter about their mean."""
    return PRIOR_WINDOWS + jnp.maximum(number - 1, 0)


def _in_rings(values, present):
    """Number of windows of each ring, their mean values, and the differences from it."""
    count = jnp.asarray(present).reshape(RINGS, ANGLES, 1)
    by_ring = values.reshape(RINGS, ANGLES, 3)
    number = count.sum(1)[:, 0]
    means = jnp.where(count, by_ring, 0).sum(1) / jnp.maximum(number, 1)[:, None]
    return number, means, jnp.where(count, by_ring - means[:, None], 0)
