"""What a model of windows gets wrong, integrated out of the likelihood of their colours.

An iris is not as thick as the average one and its relief shades otherwise; both differ from iris to
iris, from ring to ring of one, and from window to window of a ring: normal errors of three levels,
as in an analysis of variance with random effects. In the logarithms of the channels an error of
thickness of the whole or of a ring shows as the model's own response to it, one of light in all
alike. How the windows of a ring scatter is told by the photograph itself, and not by a model of
pigments: irides hold more than pigments and thickness. How much rings are off it tells too: an iris
may have another colour round its pupil, and light may fall off as that of no lamp here does.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.photo.window_pixels import ANGLES, RINGS

WindowColours = Float[Array, "windows 3"]


class Spreads(NamedTuple):
    """Standard deviations of errors of one level: of ln thickness, of ln light, and of ln of each
    channel by itself.
    """

    thickness: float
    light: float
    channel: float


WHOLE = Spreads(0.15, 0.1, 0.0)
"""Of an iris from the average: assumed. What single channels
have in common is the camera's white balance.
"""
RING = Spreads(0.12, 0.08, 0.02)
"""Of rings of one iris, for its collarette, its folds and its colours: assumed; the light of those
of `procedural` differs by 0.01.
"""
WIDER = 2.0 ** np.arange(4)
"""That these may be, twice as wide being half as likely: as much more as the photograph says."""
USUAL = (
    0.04**2 * np.ones((3, 3))
    + 0.06**2 * np.outer([0.55, 0.33, 0.15], [0.55, 0.33, 0.15])
    + 0.007**2 * np.eye(3)
)
"""Covariance of a window's channels about its ring before the photograph is seen: light, thickness
with the response of a green iris, and each channel by itself.
"""
FREEDOM = 5.0
"""Windows that it counts for."""


class Covariances(NamedTuple):
    """Of the channels of a window about the mean of its ring, (rings, 3, 3), and of the means of
    all rings, (3 rings, 3 rings).
    """

    within: Float[Array, "rings 3 3"]
    between: Float[Array, "means means"]


def log_likelihood(off: WindowColours, response: WindowColours, present) -> Scalar:
    """Logarithm of the density of errors, without constants: of the rings' means a mixture of
    normal ones, as `WIDER` has it; of what windows are off them a matrix t, the normal one with an
    inverse Wishart prior of its covariance integrated out [Gelman et al. 2013, Section 3.6].

    Args:
        off: Logarithms of photograph over model, ring after ring.
        response: Derivatives of the model's by that of thickness; its means in rings count.
        present: Windows that count, (windows,).
    """
    within, between = _every(off, response, present)
    number, means, _ = _in_rings(off, present)
    scatter = (_free(number) * jnp.linalg.slogdet(within)[1]).sum()
    return jax.nn.logsumexp(_log_weights(between, means)) - 0.5 * scatter


def whitened(off: WindowColours, present, held: Covariances) -> Float[Array, " values"]:
    """Numbers of unit variance, under covariances that are held."""
    _, means, apart = _in_rings(off, present)
    within, between = (jnp.linalg.cholesky(c) for c in held)
    rows = jax.scipy.linalg.solve_triangular(within, apart.mT, lower=True)
    row = jax.scipy.linalg.solve_triangular(between, means.ravel(), lower=True)
    return jnp.concatenate([rows.ravel(), row])


def covariances(off: WindowColours, response: WindowColours, present) -> Covariances:
    """The likeliest within rings, and that of their means, as wide as these make likely: under it a
    step of least squares is one of expectation and maximisation over `WIDER`.
    """
    within, between = _every(off, response, present)
    share = jax.nn.softmax(_log_weights(between, _in_rings(off, present)[1]))
    inverse = (share[:, None, None] * jnp.linalg.inv(between)).sum(0)
    return Covariances(within, jnp.linalg.inv(0.5 * (inverse + inverse.T)))


def _log_weights(between, means):
    """Logarithms of the densities of rings' means under each of the covariances, (wider,)."""
    factor = jnp.linalg.cholesky(between)
    row = jax.scipy.linalg.solve_triangular(
        factor, jnp.broadcast_to(means.ravel(), factor.shape[:-1])[..., None], lower=True
    )
    density = -0.5 * (row**2).sum((1, 2)) - jnp.log(jnp.diagonal(factor, 0, 1, 2)).sum(-1)
    return density - jnp.log(jnp.asarray(WIDER))


def _every(off: WindowColours, response: WindowColours, present) -> Covariances:
    """The likeliest within rings, and those of their means, (wider, means, means); rings without
    windows stand apart with a variance of 1.
    """
    number, _, apart = _in_rings(off, present)
    along = _in_rings(response, present)[1]
    scatter = FREEDOM * jnp.asarray(USUAL) + jnp.einsum("rni,rnj->rij", apart, apart)
    within = scatter / _free(number)[:, None, None]

    def of(level: Spreads):
        squares = level.thickness**2 * along[:, None, :, None] * along[None, :, None, :]
        return squares + level.light**2 + level.channel**2 * jnp.eye(3)

    every = jnp.arange(RINGS)
    alone = within / jnp.maximum(number, 1)[:, None, None]
    alone = jnp.asarray(WIDER**2)[:, None, None, None] * of(RING)[every, every] + alone
    seen = (number > 0)[:, None, None]
    between = of(WHOLE) * (seen[:, None] & seen[None])
    between = jnp.broadcast_to(between, (len(WIDER), *between.shape))
    between = between.at[:, every, every].add(jnp.where(seen, alone, jnp.eye(3)))
    return Covariances(
        within, between.transpose(0, 1, 3, 2, 4).reshape(len(WIDER), 3 * RINGS, 3 * RINGS)
    )


def _free(number):
    """What windows of rings, and the usual ones, count for where they scatter about their mean."""
    return FREEDOM + jnp.maximum(number - 1, 0)


def _in_rings(values, present):
    """Number of windows of each ring, their mean values (rings, 3), and what they are off it."""
    count = jnp.asarray(present).reshape(RINGS, ANGLES, 1)
    by_ring = values.reshape(RINGS, ANGLES, 3)
    number = count.sum(1)[:, 0]
    means = jnp.where(count, by_ring, 0).sum(1) / jnp.maximum(number, 1)[:, None]
    return number, means, jnp.where(count, by_ring - means[:, None], 0)
