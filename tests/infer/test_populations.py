"""Groups of eyes: calibration on normal likelihoods, limits that are known, published examples."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
import pytest
from scipy.stats import kstest, norm, truncnorm

import irisjax as ij
from irisjax.infer.importance import Start
from irisjax.infer.populations import KERNELS, WIDTH, likelihood_draws, population, tails
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


class Eye(NamedTuple):
    """An eye whose data depend on its last parameter; the priors are standard normal."""

    names: tuple[str, ...]
    log_likelihood: Callable

    def log_density(self, z):
        return self.log_likelihood(z[:, -1]) - 0.5 * (z**2).sum(axis=1)


def test_draws_reach_beyond_the_prior_of_the_fits():
    """Normal likelihoods, known to 0.5, about 2.5: under a prior of sd 3 their posterior has the
    precision 4 + 1/9, and the group's mean is found as from the fits.
    """
    random = np.random.default_rng(5)
    data = 2.5 + np.hypot(0.5, 0.3) * random.standard_normal(12)
    covariance, drawn = np.full((12, 1, 1), 1 / 5), []
    for i, value in enumerate(data):
        seen = Eye(("other", "load"), lambda z, value=value: -2 * (z - value) ** 2)
        start = Start(np.array([0, 0.8 * value]), np.diag([1.0, 0.2]))
        key = jax.random.fold_in(KEY, i)
        drawn.append(likelihood_draws(seen, [start], ["load"], key=key))
    drawn = np.array(drawn)
    assert drawn.shape == (12, KERNELS, 1)
    np.testing.assert_allclose(drawn.mean(1)[:, 0], data * 36 / 37, atol=0.1)
    assert drawn.std(1).mean() == pytest.approx((37 / 9) ** -0.5, rel=0.05)
    z = 0.8 * data[:, None]
    fits, found = (population(z, covariance, *d, key=KEY) for d in ((), (drawn, WIDTH)))
    assert found.mean.mean() == pytest.approx(fits.mean.mean(), abs=0.05)
    assert found.mean.std() == pytest.approx(fits.mean.std(), rel=0.25)


def test_likelihoods_without_an_end_have_their_tails():
    """Half of the eyes say z < a alone. The integral of Φ((a − z)/s) over z ~ N(μ, τ²) is
    Φ((a − μ)/√(s² + τ²)), so that the posterior of μ and τ is known on a grid.
    """
    random, s = np.random.default_rng(8), 0.4
    measured = -1.5 + np.hypot(1.5, s) * random.standard_normal(6)
    limits = np.array([-2.5, -2, -1.5, -1, 0, 0.5])
    eyes = [(lambda z, v=v: norm.logpdf(v, z, s), v) for v in measured]
    eyes += [(lambda z, a=a: norm.logcdf((a - z) / s), a - 0.5) for a in limits]
    drawn = []
    for i, (log_likelihood, at) in enumerate(eyes):
        starts = [Start(np.array([x]), np.array([[v]])) for x, v in ((at, 0.2), (-4.5, 9.0))]
        key = jax.random.fold_in(KEY, i)
        drawn.append(likelihood_draws(Eye(("load",), log_likelihood), starts, ["load"], key=key))
    z = np.array([[at] for _, at in eyes])
    found = population(z, np.full((12, 1, 1), 0.2), np.array(drawn), WIDTH, key=KEY)
    mean, spread = np.meshgrid(np.linspace(-5, 3, 161), np.linspace(0.02, 4, 200), indexing="ij")
    whole = np.hypot(spread, s)
    log = sum(norm.logpdf(v, mean, whole) for v in measured)
    log = log + sum(norm.logcdf((a - mean) / whole) for a in limits) - 0.5 * (mean**2 + spread**2)
    weights = np.exp(log - log.max()) / np.exp(log - log.max()).sum()
    for name, grid in (("mean", mean), ("spread", spread)):
        exact = (weights * grid).sum()
        sd = np.sqrt((weights * (grid - exact) ** 2).sum())
        draws = getattr(found, name)
        assert draws.mean() == pytest.approx(exact, abs=0.15 * sd)
        assert draws.std() == pytest.approx(sd, rel=0.1)
    # Draws about the fits alone miss what lies below.
    assert min(np.quantile(d, 0.02) for d in drawn[6:]) < -4


@pytest.mark.peer
def test_tails_of_an_eye_of_the_model():
    """The ABL fraction of an eye with all melanin in the stroma has no lower end in z."""
    x = np.arange(400.0, 701.0, 10.0)
    iris = ij.Iris().replace(melanin_load=0.3, abl_fraction=0.0)
    clean = np.asarray(ij.reflectance(iris, x).values)
    sd = 0.02 * clean + 2e-4
    values = clean + sd * np.random.default_rng(0).standard_normal(x.size)
    problem = ij.problem(ij.spectrum(x, values, sd=sd, name="eye"))
    names = ("melanin_load", "abl_fraction", "hemoglobin")
    z = np.asarray(ij.fit(problem, key=KEY).z)
    starts, place = tails(problem, z, names), problem.free.index("abl_fraction")
    drawn = {}
    for tag, some in (("fit", starts[:1]), ("tails", starts)):
        drawn[tag] = likelihood_draws(problem, some, names, key=KEY)[:, 1]
    assert min(start.z[place] for start in starts) < -4
    # Below z = -3 (a fraction of 0.001) the likelihood is flat: the normal prior is left.
    below = drawn["tails"][drawn["tails"] < -3]
    assert len(below) > 0.2 * KERNELS
    expected = truncnorm(-np.inf, -3 / WIDTH, scale=WIDTH)
    assert kstest(below[::4], expected.cdf).pvalue > 0.001


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
