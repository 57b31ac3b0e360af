"""Diagnostics of chains, by arviz-stats."""

from types import SimpleNamespace

import numpy as np
import pytest

from irisjax.infer.diagnostics import diagnostics, predictive_score
from irisjax.infer.posterior import diagnose


def test_independent_draws_count_as_many_as_they_are():
    found = diagnostics(np.random.default_rng(0).normal(size=(8, 500)))
    assert found.rhat == pytest.approx(1, abs=0.01)
    assert found.ess_bulk == pytest.approx(4000, rel=0.2)
    assert found.ess_tail == pytest.approx(4000, rel=0.3)


def test_chains_that_stand_apart_are_told():
    apart = np.random.default_rng(0).normal(size=(4, 200)) + np.arange(4)[:, None]
    assert diagnostics(apart).rhat > 1.2


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


def test_a_walker_that_never_moves_is_told_and_no_warning():
    chain = np.random.default_rng(0).standard_normal((200, 6, 2))
    chain[:, 2] = chain[0, 2]
    backend = SimpleNamespace(
        get_chain=lambda thin: chain[thin - 1 :: thin],
        get_log_prob=lambda thin: chain[thin - 1 :: thin, :, 0],
        accepted=np.array([100, 100, 0, 100, 100, 100]),
    )
    found = diagnose(backend, 200)
    assert not found.converged
    assert found.reason == "a walker never moved"
