"""Importance sampling before the first step: right moments, found from far off, or said not to be."""

import numpy as np
import pytest
from scipy import stats

from irisjax.infer.importance import DRAWS, Start, importance_sample


def sampled(log_p, mean, variance):
    start = Start(np.array(mean), variance * np.eye(2))
    return importance_sample(log_p, start, np.random.RandomState(0))


def _ridge(z):
    """A thin, curved ridge; its mean and variances are known."""
    first, second = z[:, 0], z[:, 1] - 0.3 * z[:, 0] ** 2
    return stats.norm.logpdf(first, 0.5, 0.8) + stats.norm.logpdf(second, 1.0, 0.1)


def _far(z):
    """Far from where the search says."""
    return stats.norm.logpdf(z, [-1.0, 3.0], [0.5, 0.2]).sum(axis=1)


@pytest.mark.parametrize(
    ("log_p", "mean", "variance"),
    [
        (_ridge, (0.5, 1.0 + 0.3 * 0.89), (0.64, 0.01 + 0.09 * (2 * 0.64**2 + 4 * 0.64 * 0.25))),
        (_far, (-1.0, 3.0), (0.25, 0.04)),
    ],
)
def test_samples_have_the_moments_of_the_posterior(log_p, mean, variance):
    """From a normal approximation that is tilted, too narrow, or elsewhere."""
    found = sampled(log_p, [1.0, 1.3], 0.01)
    assert found.enough
    assert abs(found.log_integral) < 4 * found.error  # the integral of a density is one
    z, count = found.samples, found.effective
    assert z.shape == (DRAWS, 2)
    error = np.sqrt(np.array(variance) / count)
    assert (np.abs(z.mean(axis=0) - mean) < 4 * error).all()
    np.testing.assert_allclose(z.var(axis=0), variance, rtol=5 * np.sqrt(2 / count))


def test_a_covariance_that_rounding_made_indefinite():
    """A fit in single precision, of two coordinates that all but depend on each other."""
    covariance = np.array([[1.0, 1.0 + 3e-6], [1.0 - 2e-6, 1.0]])
    start = Start(np.array([0.4, 0.9]), covariance)
    found = importance_sample(_ridge, start, np.random.RandomState(0))
    assert found.enough
    assert abs(found.log_integral) < 4 * found.error


def test_what_no_proposal_resembles_is_said():
    """A thin ring: the samples may not stand for the posterior."""

    def ring(z):
        return -0.5 * ((np.hypot(*z.T) - 2) / 0.01) ** 2

    found = sampled(ring, [2.0, 0.0], 1e-4)
    assert not found.enough
    assert np.isfinite(found.samples).all()


def test_places_without_probability_are_left_out():
    """Half the plane is impossible; nowhere possible is an error."""

    def half(z):
        return np.where(z[:, 0] > 0, -0.5 * (z**2).sum(axis=1), -np.inf)

    z = sampled(half, [1.0, 1.0], 1.0).samples
    assert (z[:, 0] > 0).all()
    assert z[:, 0].mean() == pytest.approx(np.sqrt(2 / np.pi), abs=0.1)
    with pytest.raises(ValueError, match="no draw"):
        sampled(lambda z: np.full(len(z), -np.inf), [1.0, 1.0], 0.0)


def test_two_maxima_get_the_mass_that_they_have():
    """The start is at the smaller one: alone it would be taken for all."""
    far, sd = 12.0, 0.3

    def both(z):
        first = stats.norm.logpdf(z, 0, sd).sum(axis=1) + np.log(0.2)
        return np.logaddexp(first, stats.norm.logpdf(z, far, sd).sum(axis=1) + np.log(0.8))

    start, other = (Start(np.full(2, place), 0.05 * np.eye(2)) for place in (0.1, far - 0.1))
    found = importance_sample(
        both, start, np.random.RandomState(0), others=(other,), effective=3000, rounds=20
    )
    assert found.enough and len(found.samples) == 3000
    assert abs(found.log_integral) < 4 * found.error
    share = (found.samples[:, 0] > far / 2).mean()
    assert share == pytest.approx(0.8, abs=4 * np.sqrt(0.16 / found.effective))
