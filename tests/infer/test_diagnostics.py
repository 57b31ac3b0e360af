"""Predictive scores, by arviz-stats."""

import numpy as np
import pytest

from irisjax.infer.diagnostics import predictive_score


def test_predictive_score_is_the_mean_log_density():
    """Where the posterior hardly varies, leaving one value out changes nothing: the sum of the log
    likelihoods.
    """
    rng = np.random.default_rng(2)
    fixed = rng.normal(size=200)
    score, error = predictive_score(fixed + 1e-3 * rng.normal(size=(4, 500, 200)))
    assert score == pytest.approx(fixed.sum(), abs=1e-2)
    assert error == pytest.approx(np.sqrt(200) * fixed.std(), rel=1e-2)


def test_predictive_score_is_that_of_a_normal_model():
    """Mean of n normal values of unit variance: the density of one, left out, is known."""
    rng = np.random.default_rng(3)
    y = rng.normal(size=30)
    draws = y.mean() + rng.normal(size=(4, 2000)) / np.sqrt(30)
    each = -0.5 * (y - draws[..., None]) ** 2 - 0.5 * np.log(2 * np.pi)
    left_out = (y.sum() - y) / 29
    variance = 1 + 1 / 29
    exact = -0.5 * (y - left_out) ** 2 / variance - 0.5 * np.log(2 * np.pi * variance)
    assert predictive_score(each)[0] == pytest.approx(exact.sum(), abs=0.05)
