"""The chain over pigments and camera: seeded, and honest where it is too short."""

import jax.numpy as jnp
import numpy as np
import pytest
from window_scenes import BASE, made_windows

from irisjax.photo.pigments import NAMES, least_squares, predicted, values_of
from irisjax.photo.posterior import sample

pytestmark = pytest.mark.heavy  # compiles search and density

TRUE = np.array([0.4 * (-1) ** i for i in range(len(NAMES))])


@pytest.fixture(scope="module")
def sampled():
    windows = made_windows(lambda w: predicted(values_of(jnp.asarray(TRUE)), w, BASE))
    best = least_squares(windows, BASE)
    return [sample(windows, BASE, best, max_steps=150, seed=seed) for seed in (3, 3, 4)]


def test_equal_seeds_give_equal_samples(sampled):
    one, again, other = (s.chains.z for s in sampled)
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one, other)


def test_a_chain_that_is_too_short_says_so(sampled):
    chains = sampled[0].chains
    assert chains.steps == 150 and not chains.converged
    assert "autocorrelation" in chains.reason or "effective" in chains.reason


def test_estimates_are_those_of_the_samples_and_hold_the_truth(sampled):
    true = values_of(jnp.asarray(TRUE))
    for name, estimate in sampled[0].estimates.items():
        low, median, high = np.quantile(sampled[0].samples[name], [0.025, 0.5, 0.975])
        assert (estimate.low, estimate.median, estimate.high) == pytest.approx((low, median, high))
        # Windows without noise: what the camera has free still hides the pigments.
        if not name.endswith("noise"):
            assert low < float(true[name]) < high, name
