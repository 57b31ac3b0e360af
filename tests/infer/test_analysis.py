"""Summaries and checks of a posterior, predictive scores, and all of it at once."""

import jax
import numpy as np
import pytest

import irisjax as ij
from irisjax.cli import report, sentences
from irisjax.infer.analysis import PredictiveCheck, analyse, predictive_check, predictive_score
from irisjax.infer.analytic import BeerLambert
from irisjax.infer.fit import fit
from irisjax.infer.noise import Noise
from irisjax.infer.posterior import sample

KEY = jax.random.key(3)
GRID = ij.wavelengths(400, 700, 30)
TRUTH = {"melanin_load": 0.1, "hemoglobin": 0.08, "pheomelanin_share": 0.4, "abl_fraction": 0.6}


def stated(free=("melanin_load", "hemoglobin", "noise"), **options):
    """A problem that compiles in a moment: the closed formula in place of transport."""
    problem = ij.problem(
        ij.spectrum(GRID, np.zeros(GRID.size)), free=free, solver=BeerLambert(), **options
    )
    z = problem.standard({**TRUTH, "noise": 1.0})
    values = problem.simulate(z, jax.random.key(0))[0]
    return problem.with_observations(ij.spectrum(GRID, np.asarray(values)))


def test_an_analysis_of_data_of_the_model_and_of_others():
    """A step that no pigment makes: smooth residuals, and noise beyond what was stated."""
    problem = stated()
    found = analyse(problem, walkers=16, max_steps=600, key=KEY)
    assert found.chains.converged
    assert bool(found.fit.ok)
    table = {row.parameter: row for row in found.rows}
    assert list(table)[:3] == ["melanin_load", "hemoglobin", "noise"]
    load = table["melanin_load"]
    assert load.q2_5 < load.q16 < load.median < load.q84 < load.q97_5
    assert load.q2_5 < TRUTH["melanin_load"] < load.q97_5
    assert 0.9 < load.contraction < 1
    assert table["eumelanin"].unit == "mg/ml"
    assert (found.undetermined, found.unmoved, found.check.passed) == (0, (), True)
    assert found.other.process == ij.DEPTH_RESOLVED
    assert found.other.moved["melanin_load"].own == (load.median, load.q2_5, load.q97_5)
    y = np.asarray(problem.observations[0].values) * np.where(GRID < 550, 1.0, 1.6)
    problem = problem.with_observations(ij.spectrum(GRID, y))
    chains = sample(problem, found.fit, walkers=16, max_steps=600, key=KEY)
    check = predictive_check(problem, chains, key=KEY)
    assert check.smooth and not check.passed
    (line,) = sentences.cautions(found._replace(check=check))
    assert line.startswith("WARNING: the model does not produce these data: ")


def test_checks_are_said():
    assert PredictiveCheck(0.02, 0.02, 2.0).passed
    assert PredictiveCheck(0.0, 0.5, 1.0).large and PredictiveCheck(0.5, 0.5, 3.0).noisy
    assert not PredictiveCheck(0.5, 0.5, 3.0).passed


@pytest.mark.usefixtures("float32")
def test_single_precision_samples_without_a_warning():
    """Rounding leaves the fit's covariance symmetric; as sharp a measurement as any."""
    free = ["melanin_load", "abl_fraction", "pheomelanin_share", "hemoglobin", "noise"]
    problem = stated(free=free, noise=Noise(1e-3, 1e-5))
    best = fit(problem, key=KEY)
    assert best.covariance.dtype == np.float32
    np.testing.assert_array_equal(best.covariance, best.covariance.T)
    assert sample(problem, best, walkers=16, max_steps=600, key=KEY).converged


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


def test_files_of_many_wavelengths_hold_fewer_draws(tmp_path, monkeypatch):
    """Log likelihoods of all draws of 10,000 wavelengths would be gigabytes; every group keeps the
    same draws.
    """
    import xarray as xr

    walkers, most = 16, 100
    monkeypatch.setattr(report, "_MOST_NUMBERS", most * walkers * GRID.size)
    found = analyse(stated(), walkers=walkers, max_steps=600, key=KEY)
    z = 0.01 * np.random.default_rng(1).normal(size=(250, walkers, 3))
    chains = found.chains._replace(z=z, log_probability=z[..., 0], thin=5, steps=1250)
    report._write(found._replace(chains=chains), tmp_path, [], KEY, lambda *given: lambda: b"")
    loads = {}
    for group in ("posterior", "log_likelihood", "sample_stats"):
        loads[group] = xr.load_dataset(tmp_path / "posterior.nc", group=group, engine="h5netcdf")
        assert loads[group].sizes["chain"] == walkers
        assert most / 2 < loads[group].sizes["draw"] <= most
    kept = loads["sample_stats"].lp.values
    np.testing.assert_array_equal(kept, z[:: int(loads["posterior"].attrs["every"]) // 5, :, 0].T)
