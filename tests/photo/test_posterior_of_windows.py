"""The chain over pigments and camera: seeded, and honest where it is too short."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from window_scenes import BASE, made_windows

from irisjax.photo.concentrations import CONCENTRATIONS
from irisjax.photo.pigments import NAMES, least_squares, predicted, values_of
from irisjax.photo.posterior import sample

pytestmark = pytest.mark.heavy  # compiles search and density

TRUE = np.array([0.4 * (-1) ** i for i in range(len(NAMES))])


@pytest.fixture(scope="module")
def problem():
    windows = made_windows(lambda w: predicted(values_of(jnp.asarray(TRUE)), w, BASE))
    return windows, BASE, least_squares(windows, BASE)


@pytest.fixture(scope="module")
def drawn(problem):
    return sample(*problem, seed=3)


def test_equal_seeds_give_equal_samples(problem):
    one, again, other = (sample(*problem, max_steps=150, seed=s) for s in (3, 3, 4))
    np.testing.assert_array_equal(one.z, again.z)
    assert not np.array_equal(one.z, other.z)


def test_a_chain_that_is_too_short_says_so(problem):
    chains = sample(*problem, max_steps=150, seed=3).chains
    assert chains.steps == 150 and not chains.converged
    # On some machines a walker stays where it is for as long.
    words = "autocorrelation", "effective", "never moved"
    assert any(word in chains.reason for word in words)


def test_estimates_are_those_of_the_samples_and_hold_the_truth(drawn):
    assert drawn.chains.converged
    true = values_of(jnp.asarray(TRUE))
    assert tuple(drawn.estimates) == tuple(drawn.samples) == NAMES
    for i, (name, estimate) in enumerate(drawn.estimates.items()):
        low, median, high = np.quantile(drawn.samples[name], [0.025, 0.5, 0.975])
        assert (estimate.low, estimate.median, estimate.high) == pytest.approx((low, median, high))
        # Windows without noise: what the camera has free still hides the pigments.
        assert low < float(true[name]) < high, name
        assert estimate.contraction == pytest.approx(1 - drawn.z[:, i].var())


def test_where_windows_tell_nothing_the_priors_come_back(problem):
    """Windows on which no light of the iris falls: the chain's own coordinates do not show."""
    windows, base, best = problem
    dark = dataclasses.replace(windows, matrix=0 * windows.matrix)
    drawn = sample(dark, base, best, seed=6)
    z = drawn.z[:, [NAMES.index(name) for name in (*CONCENTRATIONS, "scattering_scale")]]
    error = 1 / np.sqrt(drawn.chains.ess_tail.min())
    assert np.abs(z.mean(0)).max() < 4 * error
    assert np.abs(np.cov(z.T) - np.eye(5)).max() < 6 * error
