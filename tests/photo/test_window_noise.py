"""Errors of windows, integrated out: the same by scipy's densities and by drawing covariances."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from irisjax.photo.pigments import (
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


def _between(off, within, wider):
    """Covariance of the means of rings with windows, element by element."""
    seen = _rings(off)
    along = [r[0] for r in RESPONSE.reshape(RINGS, ANGLES, 3)]
    found = np.zeros((3 * len(seen), 3 * len(seen)))
    for k, ring in enumerate(seen):
        for m in range(len(seen)):
            for c in range(3):
                for d in range(3):
                    e = WHOLE.thickness**2 * along[k][c] * along[m][d] + WHOLE.light**2
                    if k == m:
                        own = RING.thickness**2 * along[k][c] * along[k][d] + RING.light**2
                        e += wider**2 * (own + RING.channel**2 * (c == d))
                        e += within[k][c, d] / len(ring)
                    found[3 * k + c, 3 * m + d] = e
    return found


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
    total = 0.0
    for ring in _rings(off):
        apart = ring - ring.mean(0)
        rows = np.linalg.svd(apart.T @ apart)
        # As many independent rows as there are windows less one, of the same squares.
        independent = np.sqrt(rows[1])[:, None] * rows[2]
        squares = np.einsum("ij,nij->n", independent.T @ independent, inverse)
        log_density = 0.5 * (len(ring) - 1) * np.linalg.slogdet(inverse)[1] - 0.5 * squares
        total += float(np.logaddexp.reduce(log_density) - np.log(len(inverse)))
    return total


def test_the_likelihood_is_the_one_with_covariances_drawn():
    prior = stats.invwishart(PRIOR_WINDOWS, PRIOR_WINDOWS * PRIOR_COVARIANCE)
    inverse = np.linalg.inv(prior.rvs(100_000, random_state=7))
    own, other = [], []
    for seed in range(3):
        off = _errors(seed)
        found = likelihood(jnp.asarray(off), jnp.asarray(RESPONSE), jnp.asarray(PRESENT))
        held = covariances_of(jnp.asarray(off), jnp.asarray(RESPONSE), jnp.asarray(PRESENT))
        means = np.logaddexp.reduce(_means(off, np.asarray(held[0])))
        own.append(float(found))
        other.append(_drawn(off, inverse) + means)
    assert np.ptp(own) > 5
    np.testing.assert_allclose(np.diff(own), np.diff(other), atol=0.15)  # as sure as 100,000 are


def test_whitened_errors_have_the_density_of_their_covariances():
    off, response, present = (jnp.asarray(v) for v in (_errors(1), RESPONSE, PRESENT))
    held = covariances_of(off, response, present)
    direct = 0.0
    within = np.asarray(held[0])
    for k, ring in enumerate(_rings(np.asarray(off))):
        apart = ring - ring.mean(0)
        direct += np.einsum("ni,ij,nj->", apart, np.linalg.inv(within[k]), apart)
    means = np.concatenate([ring.mean(0) for ring in _rings(np.asarray(off))])
    likely = _means(np.asarray(off), within)
    for share, wider in zip(
        np.exp(likely - np.logaddexp.reduce(likely)), SPREAD_FACTORS, strict=True
    ):
        direct += share * means @ np.linalg.solve(_between(np.asarray(off), within, wider), means)
    assert float((whitened(off, present, held) ** 2).sum()) == pytest.approx(direct)


def test_errors_alike_in_a_ring_are_forgiven_more_than_uneven_ones():
    """A ring that is thicker is no sign of other pigments; a colour that no thickness gives is."""
    response, present = jnp.asarray(RESPONSE), jnp.ones(COUNT, bool)
    rings = np.repeat([0.1, -0.1, 0.1, -0.1], ANGLES)[:, None]
    scatter = np.repeat(_RANDOM.standard_normal((1, ANGLES, 3)), RINGS, 0).reshape(COUNT, 3)
    noise = 0.005 * (scatter - scatter.mean(0))
    thicker = likelihood(jnp.asarray(rings * RESPONSE + noise), response, present)
    other = np.array([0.5, -0.5, 0.5]) * rings * np.linalg.norm(RESPONSE, axis=1, keepdims=True)
    coloured = likelihood(jnp.asarray(other + noise), response, present)
    assert thicker > coloured + 5


def test_rings_far_off_one_another_are_paid_for_once():
    """Light that falls off as that of no lamp: twice as far off costs by the logarithm."""
    response, present = jnp.asarray(RESPONSE), jnp.ones(COUNT, bool)
    scatter = 0.02 * _RANDOM.standard_normal((COUNT, 3))
    rings = np.repeat([-0.5, 0.5, -0.5, 0.5], ANGLES)[:, None]

    def found(factor):
        return float(likelihood(jnp.asarray(factor * rings + scatter), response, present))

    assert found(0.05) - found(0.5) < 20
    assert found(0.5) - found(1.0) < 20
