"""Moves of walkers: they leave a distribution as it is, and straighten a curved ridge."""

import emcee
import numpy as np
from scipy import stats

from irisjax.infer.moves import Straightening, independent_move, mixture


def test_moves_leave_a_distribution_as_it_is():
    """Samples of a skewed density stay samples of it, with moves adapted to other samples."""
    rng = np.random.default_rng(0)
    taught = rng.normal([0.5, 0.0], [1.4, 0.7], (400, 2))
    taught[:, 1] += 0.2 * taught[:, 0] ** 2

    def log_p(z):
        gumbel = -z[:, 0] - np.exp(-z[:, 0])
        return gumbel - 0.5 * ((z[:, 1] - z[:, 0] / 2) / 0.7) ** 2

    sampler = emcee.EnsembleSampler(32, 2, log_p, vectorize=True, moves=mixture(taught))
    sampler.random_state = np.random.RandomState(1).get_state()
    first = rng.gumbel(size=32)
    sampler.run_mcmc(np.stack([first, rng.normal(first / 2, 0.7)], 1), 1000)
    z = sampler.get_chain(discard=200, thin=20, flat=True)
    assert stats.kstest(z[:, 0], stats.gumbel_r.cdf).pvalue > 1e-3
    assert stats.kstest((z[:, 1] - z[:, 0] / 2) / 0.7, stats.norm.cdf).pvalue > 1e-3


def test_a_curved_ridge_is_straightened():
    """A thin, curved ridge in three dimensions: walkers move along it as along a straight one."""
    rng = np.random.default_rng(0)

    def bent(n):
        z = rng.normal(size=(n, 3)) * [1.0, 0.03, 0.5]
        z[:, 1] += 0.1 * z[:, 0] ** 2 - 0.4 * z[:, 0]
        return z

    straight = Straightening.of_samples(bent(4000))
    z = bent(4000)
    y = straight.forward(z)
    np.testing.assert_allclose(straight.inverse(y), z, rtol=0, atol=1e-12)

    def log_p(z):
        thin = (z[:, 1] - 0.1 * z[:, 0] ** 2 + 0.4 * z[:, 0]) / 0.03
        return -0.5 * (z[:, 0] ** 2 + thin**2 + (z[:, 2] / 0.5) ** 2)

    move = independent_move(straight, z)
    sampler = emcee.EnsembleSampler(32, 3, log_p, vectorize=True, moves=move)
    sampler.random_state = np.random.RandomState(1).get_state()
    sampler.run_mcmc(z[:32], 500)
    assert sampler.acceptance_fraction.mean() > 0.5
    # Densities carry over only if volumes do: the same Jacobian on the ridge, beside it and far
    # out.
    volumes = []
    for place in np.concatenate([z[:5], 3 * z[5:10], [[9.0, -7.0, 8.0]]]):
        there, back = (straight.forward(place + step * np.eye(3)) for step in (1e-6, -1e-6))
        volumes.append(np.linalg.det((there - back) / 2e-6))
    np.testing.assert_allclose(volumes, volumes[0], rtol=1e-5)
