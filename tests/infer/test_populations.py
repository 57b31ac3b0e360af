"""Groups of eyes: calibration on normal likelihoods, limits that are known, published examples."""

import jax
import numpy as np
import pytest
from scipy.stats import truncnorm

from irisjax.infer.importance import Start
from irisjax.infer.populations import KERNELS, WIDTH, likelihood_draws, population
from irisjax.infer.repeatability import agreement, intraclass_correlation

KEY = jax.random.key(1, impl="threefry2x32")


def fits_of(random, true, precision):
    """Estimates and covariance of eyes whose data have this precision, priors standard normal."""
    root = np.linalg.cholesky(precision)
    covariance = np.linalg.inv(precision + np.eye(len(precision)))
    data = true @ precision + random.standard_normal(true.shape) @ root.T
    return data @ covariance, np.broadcast_to(covariance, (len(true), *covariance.shape))


def test_intervals_hold_the_truth_along_a_ridge():
    """14 pairs of groups whose two parameters trade with each other: of 84 right intervals of 95 %
    more than 11 miss with a probability of 0.001.
    """
    random = np.random.default_rng(4)
    along, across = np.array([1.0, -1]) / np.sqrt(2), np.array([1.0, 1]) / np.sqrt(2)
    precision = 0.3 * np.outer(along, along) + 400 * np.outer(across, across)
    held = np.zeros((3, 2))
    for i in range(14):
        mean, spread = random.standard_normal((2, 2)), np.abs(random.standard_normal((2, 2)))
        found = []
        for g in (0, 1):
            true = mean[g] + spread[g] * random.standard_normal((12, 2))
            fits = fits_of(random, true, precision)
            found.append(population(*fits, key=jax.random.fold_in(KEY, 2 * i + g)))
        drawn = (found[0].mean, found[0].spread, found[1].mean - found[0].mean)
        truth = (mean[0], spread[0], mean[1] - mean[0])
        low, high = np.percentile(np.array(drawn), (2.5, 97.5), axis=1)
        held += (low <= truth) & (truth <= high)
    assert 73 <= held.sum() < 84


def test_sharp_fits_are_plain_statistics_and_blunt_ones_are_the_prior():
    random = np.random.default_rng(2)
    true = 0.5 + 0.3 * random.standard_normal((400, 1))
    sharp = population(*fits_of(random, true, np.array([[1e6]])), key=KEY)
    assert sharp.mean.mean() == pytest.approx(true.mean(), abs=0.003)
    assert sharp.mean.std() == pytest.approx(true.std() / 20, rel=0.1)
    assert sharp.spread.mean() == pytest.approx(true.std(), rel=0.01)
    assert sharp.shrinkage == pytest.approx(0, abs=1e-3)
    blunt = population(np.zeros((3, 1)), np.ones((3, 1, 1)), key=KEY)
    assert blunt.mean.std() == pytest.approx(1, rel=0.1)
    assert np.sqrt((blunt.spread**2).mean()) == pytest.approx(1, rel=0.1)
    assert blunt.shrinkage == pytest.approx(1)


def test_draws_of_normal_posteriors_say_what_the_fits_say_and_others_more():
    random = np.random.default_rng(3)
    true = [0.5, -0.2] + 0.3 * random.standard_normal((15, 2))
    z, covariance = fits_of(random, true, np.array([[40.0, -18], [-18, 12]]))
    root = np.linalg.cholesky(covariance)
    off = random.standard_normal((15, KERNELS, 2)) @ np.swapaxes(root, 1, 2)
    fits, drawn = (population(z, covariance, d, key=KEY) for d in (None, z[:, None] + off))
    assert fits.fewest == 1 and 30 < drawn.fewest < KERNELS
    for n in ("mean", "spread"):
        a, b = getattr(fits, n), getattr(drawn, n)
        np.testing.assert_allclose(b.mean(axis=0), a.mean(axis=0), atol=0.4 * a.std(axis=0).min())
        np.testing.assert_allclose(b.std(axis=0), a.std(axis=0), rtol=0.3)
    # The data say z < −1 alone: no fit's mean and sd say so, draws do.
    below = truncnorm.ppf((np.arange(KERNELS) + 0.5) / KERNELS, -np.inf, -1)
    draws = np.broadcast_to(random.permutation(below)[:, None], (20, KERNELS, 1))
    z, covariance = np.full((20, 1), below.mean()), np.full((20, 1, 1), below.var())
    fits, drawn = (population(z, covariance, d, key=KEY) for d in (None, draws))
    assert drawn.mean.std() > 1.5 * fits.mean.std()


def test_draws_reach_beyond_the_prior_of_the_fits():
    """Normal likelihoods, known to 0.5, about 2.5: under a prior of sd 2 their posterior has the
    precision 4 + 1/4, and the group's mean is found as from the fits.
    """
    random = np.random.default_rng(5)
    data = 2.5 + np.hypot(0.5, 0.3) * random.standard_normal(12)
    covariance, drawn = np.full((12, 1, 1), 1 / 5), []

    class Eye:
        names = ("other", "load")

        def __init__(self, value):
            self.value = value

        def log_density(self, z):
            return -2 * (z[:, 1] - self.value) ** 2 - 0.5 * (z**2).sum(axis=1)

    for i, value in enumerate(data):
        start = Start(np.array([0, 0.8 * value]), np.diag([1.0, 0.2]))
        key = jax.random.fold_in(KEY, i)
        drawn.append(likelihood_draws(Eye(value), start, ["load"], key=key))
    drawn = np.array(drawn)
    assert drawn.shape == (12, KERNELS, 1)
    np.testing.assert_allclose(drawn.mean(1)[:, 0], data * 4 / 4.25, atol=0.15)
    assert drawn.std(1).mean() == pytest.approx(4.25**-0.5, rel=0.05)
    z = 0.8 * data[:, None]
    fits, found = (population(z, covariance, *d, key=KEY) for d in ((), (drawn, WIDTH)))
    assert found.mean.mean() == pytest.approx(fits.mean.mean(), abs=0.05)
    assert found.mean.std() == pytest.approx(fits.mean.std(), rel=0.25)


def test_intraclass_correlations_are_those_of_shrout_and_fleiss():
    """Six subjects and four judges of their Table 2; Table 4 has .29 and .71."""
    x = [[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]]
    found = intraclass_correlation(np.array(x, float))
    assert found.agreement.value == pytest.approx(0.29, abs=0.005)
    assert found.consistency.value == pytest.approx(0.71, abs=0.005)
    # The intervals that R's psych prints for these data.
    np.testing.assert_allclose(found.agreement[1:], [0.019, 0.76], atol=0.005)
    np.testing.assert_allclose(found.consistency[1:], [0.34, 0.95], atol=0.005)


def test_limits_of_agreement_are_those_of_bland_and_altman():
    """Peak flow (l/min) of 17 people by two meters, Table 1 and pages 308-309."""
    wright = [494, 395, 516, 434, 476, 557, 413, 442, 650, 433, 417, 656, 267, 478, 178, 423, 427]
    mini = [512, 430, 520, 428, 500, 600, 364, 380, 658, 445, 432, 626, 260, 477, 259, 350, 451]
    found = agreement(np.array(mini, float), np.array(wright, float))
    np.testing.assert_allclose(found.bias, [-2.1, -22.0, 17.8], atol=0.15)
    rounded = 0.04 * 38.8  # l/min: the paper takes 2 standard deviations, not 1.96
    np.testing.assert_allclose(np.array(found.lower) - rounded, [-79.7, -114.3, -45.1], atol=0.2)
    np.testing.assert_allclose(np.array(found.upper) + rounded, [75.5, 40.9, 110.1], atol=0.2)
