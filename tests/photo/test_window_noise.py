"""Errors of windows, integrated out: the same by scipy's densities and by drawing covariances."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import linalg, special, stats

from irisjax.photo.pigments import (
    ALONG_RAYS,
    ALONG_RINGS,
    PRIOR_COVARIANCE,
    PRIOR_WINDOWS,
    RING,
    SPREAD_FACTORS,
    WHOLE,
    covariances,
    log_likelihood,
    whitened_errors,
)
from irisjax.photo.windows import ANGLES, COUNT, RINGS

likelihood, covariances_of, whitened = map(jax.jit, (log_likelihood, covariances, whitened_errors))
_RANDOM = np.random.default_rng(3)
RESPONSE = np.repeat(_RANDOM.uniform(0.1, 0.7, (RINGS, 1, 3)), ANGLES, 1).reshape(COUNT, 3)
# A full ring, a part of one, one window, and none.
PRESENT = np.arange(COUNT) < 2 * ANGLES + 1
PRESENT[ANGLES + 5 : 2 * ANGLES] = False


def _errors(seed):
    random = np.random.default_rng(seed)
    off = 0.05 * random.standard_normal((COUNT, 1)) + 0.01 * random.standard_normal((COUNT, 3))
    return np.where(PRESENT[:, None], off, 0.0)


def _rings(off):
    by_ring = zip(off.reshape(RINGS, ANGLES, 3), PRESENT.reshape(RINGS, ANGLES), strict=True)
    return [ring[there] for ring, there in by_ring if there.any()]


def _apart(off):
    """For each ring with windows, differences from its mean, decorrelated along rays, by the root
    of the covariance of the windows of each angle, which reach from the pupil without a gap, and
    then, about their new mean, round the iris, by that of a chain.
    """
    present, by_ring = PRESENT.reshape(RINGS, ANGLES), off.reshape(RINGS, ANGLES, 3)
    away = _about_the_mean(by_ring)
    for angle, count in enumerate(present.sum(0)):
        root = np.linalg.cholesky(linalg.toeplitz(ALONG_RAYS ** np.arange(count)))
        away[:count, angle] = np.linalg.solve(root, away[:count, angle])
    away = _about_the_mean(away)
    for ring, there in enumerate(present):
        count = there.sum()
        if there.all():  # a chain without an end: its filter is circulant
            first = np.zeros(ANGLES)
            first[:2] = 1, -ALONG_RINGS
            away[ring] = linalg.circulant(first) @ away[ring] / np.sqrt(1 - ALONG_RINGS**2)
        elif count:
            root = np.linalg.cholesky(linalg.toeplitz(ALONG_RINGS ** np.arange(count)))
            away[ring, there] = np.linalg.solve(root, away[ring, there])
    return [ring[there] for ring, there in zip(away, present, strict=True) if there.any()]


def _about_the_mean(by_ring):
    present, away = PRESENT.reshape(RINGS, ANGLES), np.zeros_like(by_ring)
    for ring in np.flatnonzero(present.any(1)):
        there = present[ring]
        away[ring, there] = by_ring[ring, there] - by_ring[ring, there].mean(0)
    return away


def _correlations():
    """Return the correlations of the errors of the windows of a ring."""
    apart = np.abs(np.subtract.outer(np.arange(ANGLES), np.arange(ANGLES)))
    return ALONG_RINGS ** np.minimum(apart, ANGLES - apart)


def _between(off, within, wider):
    """Covariance of the means of rings with windows, block by block."""
    windows = [np.flatnonzero(there) for there in PRESENT.reshape(RINGS, ANGLES) if there.any()]
    rings, along = _rings(off), RESPONSE.reshape(RINGS, ANGLES, 3)[:, 0]
    seen = along[: len(rings)]
    blocks = [[WHOLE.thickness**2 * np.outer(a, b) + WHOLE.light**2 for b in seen] for a in seen]
    for k in range(len(rings)):
        own = RING.thickness**2 * np.outer(seen[k], seen[k]) + RING.light**2
        own += RING.channel**2 * np.eye(3)
        of_mean = _correlations()[np.ix_(windows[k], windows[k])].mean()
        blocks[k][k] += wider**2 * own + of_mean * within[k]
    return np.block(blocks)


def _means(off, within):
    """Logarithms of the densities of the rings' means, each as likely as `SPREAD_FACTORS` has it."""
    means = np.concatenate([ring.mean(0) for ring in _rings(off)])
    normal = [stats.multivariate_normal(cov=_between(off, within, w)) for w in SPREAD_FACTORS]
    return np.array(
        [n.logpdf(means) - np.log(w) for n, w in zip(normal, SPREAD_FACTORS, strict=True)]
    )


def _drawn(off, inverse):
    """Logarithm of the density of the windows about the means of their rings under covariances that
    were drawn, given as their inverses.
    """
    total, log_determinant = 0.0, np.linalg.slogdet(inverse)[1]
    for apart in _apart(off):
        squares = np.einsum("ij,nij->n", apart.T @ apart, inverse)
        # The mean takes one window's worth of freedom.
        log_density = 0.5 * ((len(apart) - 1) * log_determinant - squares)
        total += float(np.logaddexp.reduce(log_density) - np.log(len(inverse)))
    return total


def test_the_likelihood_is_the_one_with_covariances_drawn():
    prior = stats.invwishart(PRIOR_WINDOWS, PRIOR_WINDOWS * PRIOR_COVARIANCE)
    inverse = np.linalg.inv(prior.rvs(100_000, random_state=7))
    own, other = [], []
    for off in map(_errors, range(3)):
        known = jnp.asarray(off), jnp.asarray(RESPONSE), jnp.asarray(PRESENT)
        own.append(float(likelihood(*known)))
        means = np.logaddexp.reduce(_means(off, np.asarray(covariances_of(*known)[0])))
        other.append(_drawn(off, inverse) + means)
    assert np.ptp(own) > 5
    np.testing.assert_allclose(np.diff(own), np.diff(other), atol=0.15)  # as sure as 100,000 are


def test_whitened_errors_have_the_density_of_their_covariances():
    off = _errors(1)
    held = covariances_of(jnp.asarray(off), jnp.asarray(RESPONSE), jnp.asarray(PRESENT))
    within, direct = np.asarray(held[0]), 0.0
    for covariance, apart in zip(within, _apart(off), strict=False):
        direct += np.einsum("ni,ij,nj->", apart, np.linalg.inv(covariance), apart)
    means = np.concatenate([ring.mean(0) for ring in _rings(off)])
    shares = special.softmax(_means(off, within))
    for share, wider in zip(shares, SPREAD_FACTORS, strict=True):
        direct += share * means @ np.linalg.solve(_between(off, within, wider), means)
    found = whitened(jnp.asarray(off), jnp.asarray(PRESENT), held)
    assert float((found**2).sum()) == pytest.approx(direct)


def test_correlated_errors_become_as_many_independent_ones_as_there_are_windows():
    """Less one for the mean of each ring: by the covariance of all, without a draw."""
    one = jnp.broadcast_to(jnp.eye(3), (RINGS, 3, 3)), jnp.eye(3 * RINGS)
    filtered = jax.jit(jax.jacobian(lambda off: whitened_errors(off, jnp.asarray(PRESENT), one)))
    slope = np.asarray(filtered(jnp.zeros((COUNT, 3)))).reshape(-1, COUNT, 3)
    rays = linalg.toeplitz(ALONG_RAYS ** np.arange(RINGS))
    covariance = np.kron(rays, _correlations())
    squares = np.einsum("ewc,wv,evc->e", slope, covariance, slope)[: 3 * COUNT]
    counts = PRESENT.reshape(RINGS, ANGLES).sum(1)
    found = squares.reshape(RINGS, -1).sum(1)
    np.testing.assert_allclose(found, 3 * np.maximum(counts - 1, 0), atol=0.1)


def _of_all(off):
    """The likelihood of errors of all windows."""
    return float(likelihood(jnp.asarray(off), jnp.asarray(RESPONSE), jnp.ones(COUNT, bool)))


def test_errors_alike_in_a_ring_are_forgiven_more_than_uneven_ones():
    """A ring that is thicker is no sign of other pigments; a colour that no thickness gives is."""
    rings = np.repeat([0.1, -0.1, 0.1, -0.1], ANGLES)[:, None]
    scatter = np.repeat(_RANDOM.standard_normal((1, ANGLES, 3)), RINGS, 0).reshape(COUNT, 3)
    noise = 0.005 * (scatter - scatter.mean(0))
    other = np.array([0.5, -0.5, 0.5]) * rings * np.linalg.norm(RESPONSE, axis=1, keepdims=True)
    assert _of_all(rings * RESPONSE + noise) > _of_all(other + noise) + 5


def test_rings_far_off_one_another_are_paid_for_once():
    """Light that falls off as that of no lamp: twice as far off costs by the logarithm."""
    scatter = 0.02 * _RANDOM.standard_normal((COUNT, 3))
    rings = np.repeat([-0.5, 0.5, -0.5, 0.5], ANGLES)[:, None]
    near, far, farther = (_of_all(factor * rings + scatter) for factor in (0.05, 0.5, 1.0))
    assert near - far < 20
    assert far - farther < 20
