"""The whole analysis of an eye: summaries and checks of a posterior, and the other process."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import quick_jit
from experiments.closed_formulas import BeerLambert
from irisjax.cli import report, sentences
from irisjax.infer import draws
from irisjax.infer.analysis import PredictiveCheck, analyse, predictive_check
from irisjax.infer.fit import fit
from irisjax.infer.model_comparison import (
    Interval,
    compare_processes,
    covariance_at,
    intervals_of,
    other_of,
    predictive_score,
)
from irisjax.infer.noise import Noise
from irisjax.infer.observation import with_values
from irisjax.infer.posterior import sample

KEY = jax.random.key(3, impl="threefry2x32")
GRID = np.arange(400.0, 701.0, 20.0)
FREE = ("melanin_load", "abl_fraction", "gain", "noise")
TRUTH = {"melanin_load": 0.1, "abl_fraction": 0.4, "gain": 1.0, "noise": 1.0}
PROCESSES = (ij.ILIT_2006, ij.DEPTH_RESOLVED)
SETTINGS = {"walkers": 16, "max_steps": 1000, "key": KEY}


def stated(process):
    """The problem of a spectrum yet without values."""
    blank = ij.spectrum(GRID, np.full(GRID.size, 0.05), sd=np.full(GRID.size, 0.01))
    return ij.problem(blank, free=FREE, process=process)


@pytest.fixture(scope="module")
def eyes():
    """Noiseless spectra of one iris by either process."""
    problems = [stated(process) for process in PROCESSES]

    @quick_jit
    def spectra():
        values = [p.predict(p.standard(TRUTH))[0] for p in problems]
        return [(y, 0.02 * y + 2e-4) for y in values]

    pairs = zip(problems, spectra(), strict=True)
    return [with_values(p.observations[0], *seen) for p, seen in pairs]


@pytest.fixture(scope="module")
def fits(eyes):
    """The problem of each spectrum by each process, and its fit; processes first."""
    problems = [[stated(p).with_observations(eye) for eye in eyes] for p in PROCESSES]
    return [[(problem, fit(problem, key=KEY)) for problem in each] for each in problems]


@pytest.fixture(scope="module")
def analysed(fits):
    """The analysis of the spectrum of ILIT with noise."""
    problem, _ = fits[0][0]
    (seen,) = problem.observations
    noisy = seen.values + seen.sd * np.random.default_rng(1).normal(size=GRID.size)
    return analyse(problem.with_observations(with_values(seen, noisy)), **SETTINGS)


def test_noise_widens_what_the_data_say_and_not_the_prior(fits):
    """As a fit whose noise is stated that much larger."""
    one, narrow = fits[0][0]
    (seen,) = one.observations
    larger = one.with_observations(with_values(seen, seen.values, 3 * seen.sd))
    wide = fit(larger, key=KEY)
    found = covariance_at(np.asarray(narrow.covariance), 3.0)
    fitted = np.ix_([0, 1, 2], [0, 1, 2])
    np.testing.assert_allclose(found[fitted], wide.covariance[fitted], atol=0.02)
    np.testing.assert_allclose(covariance_at(np.eye(3), 7.0), np.eye(3))
    intervals = intervals_of(one, narrow, 3.0)
    for name, expected in intervals_of(larger, wide, 1.0).items():
        if name != "noise":
            np.testing.assert_allclose(intervals[name], expected, rtol=0.05)


@pytest.mark.parametrize("maker", [0, 1], ids=["ILIT", "radiative transfer"])
def test_the_data_prefer_the_process_that_made_them(fits, maker):
    for reader in (0, 1):
        (problem, own), (other_problem, other) = fits[reader][maker], fits[1 - reader][maker]
        found = compare_processes(problem, own, other_problem, other)
        assert found.process == other_of(problem.process) == PROCESSES[1 - reader]
        assert found.preferred == (reader != maker)
        load = found.moved["melanin_load"]
        right = load.own if reader == maker else load.other
        assert right.low < 0.1 < right.high
        # ILIT takes the darkness of radiative transfer for several times as much melanin.
        ratio = load.other.value / load.own.value
        assert ratio < 0.6 if reader == 0 else ratio > 1.7
        lines = sentences.process_lines(found)
        assert lines[0].startswith("WARNING: the pigments depend on the model")
        assert ("the data prefer" in lines[-1]) == found.preferred
        given = {"melanin_load": Interval(0.2, 0.1, 0.3)}
        moved = compare_processes(problem, own, other_problem, other, intervals=given).moved
        assert moved["melanin_load"].own == given["melanin_load"]
        assert moved["abl_fraction"] == found.moved["abl_fraction"]


def test_an_analysis_of_data_of_the_model_and_of_others(analysed):
    """A step that no pigment makes: smooth residuals, and noise beyond what was stated."""
    assert analysed.chains.converged
    assert bool(analysed.fit.ok)
    table = {row.parameter: row for row in analysed.rows}
    assert tuple(table)[:4] == FREE
    load = table["melanin_load"]
    assert load.q2_5 < load.q16 < load.median < load.q84 < load.q97_5
    assert load.q2_5 < TRUTH["melanin_load"] < load.q97_5
    assert 0.9 < load.contraction < 1
    assert table["eumelanin"].unit == "mg/ml"
    assert (analysed.problem.undetermined, analysed.check.passed) == (0, True)
    assert analysed.other.process == ij.DEPTH_RESOLVED
    assert analysed.other.moved["melanin_load"].own == (load.median, load.q2_5, load.q97_5)
    (seen,) = analysed.problem.observations
    stepped = with_values(seen, seen.values * np.where(GRID < 550, 1.0, 1.6))
    problem = analysed.problem.with_observations(stepped)
    check = predictive_check(problem, analysed.chains, key=KEY)
    assert check.smooth and not check.passed
    line = sentences.result_warnings(analysed._replace(check=check))[-1]
    assert line.startswith("WARNING: the model does not produce these data: ")


def test_checks_are_said():
    assert PredictiveCheck(0.02, 0.02, 2.0).passed
    assert PredictiveCheck(0.0, 0.5, 1.0).large and PredictiveCheck(0.5, 0.5, 3.0).noisy
    assert not PredictiveCheck(0.5, 0.5, 3.0).passed


@pytest.mark.usefixtures("float32")
def test_single_precision_samples_without_a_warning():
    """Rounding leaves the fit's covariance symmetric; as sharp a measurement as any."""
    free = ["melanin_load", "abl_fraction", "pheomelanin_share", "hemoglobin", "noise"]
    blank = ij.spectrum(GRID, np.zeros(GRID.size))
    problem = ij.problem(blank, free=free, noise=Noise(1e-3, 1e-5), solver=BeerLambert())
    z = np.asarray([-0.3, 0.2, 1.2, -0.1, 0.0], np.float32)
    (y,) = quick_jit(lambda z: problem.predict(z))(z)
    noisy = np.asarray(y) * (1 + 1e-3 * np.random.default_rng(0).normal(size=GRID.size))
    seen = with_values(problem.observations[0], jnp.asarray(noisy, jnp.float32))
    problem = problem.with_observations(seen)
    best = fit(problem, starts=1)
    assert best.covariance.dtype == np.float32
    np.testing.assert_array_equal(best.covariance, best.covariance.T)
    assert sample(problem, best, **SETTINGS).converged


def test_predictive_score_is_that_of_a_normal_model():
    """Mean of n normal values of unit variance: the density of one, left out, is known."""
    rng = np.random.default_rng(3)
    y = rng.normal(size=30)
    draws = y.mean() + rng.normal(size=(4, 2000)) / np.sqrt(30)
    each = -0.5 * (y - draws[..., None]) ** 2 - 0.5 * np.log(2 * np.pi)
    left_out = (y.sum() - y) / 29
    variance = 1 + 1 / 29
    exact = -0.5 * (y - left_out) ** 2 / variance - 0.5 * np.log(2 * np.pi * variance)
    score, error = predictive_score(each)
    assert score == pytest.approx(exact.sum(), abs=0.05)
    assert error == pytest.approx(np.sqrt(30) * exact.std(), rel=0.02)


def write(analysis, folder):
    report._write(analysis, folder, [], KEY, lambda *given: lambda: b"")


def test_files_of_many_wavelengths_hold_fewer_draws(analysed, tmp_path, monkeypatch):
    """Log likelihoods of all draws of 10,000 wavelengths would be gigabytes; every group keeps the
    same draws.
    """
    import xarray as xr

    walkers, most = 16, 100
    monkeypatch.setattr(draws, "_MOST_NUMBERS", most * walkers * GRID.size)
    z = 0.01 * np.random.default_rng(1).normal(size=(250, walkers, len(FREE)))
    chains = analysed.chains._replace(z=z, log_probability=z[..., 0], thin=5, steps=1250)
    write(analysed._replace(chains=chains), tmp_path)
    loads = {}
    for group in ("posterior", "log_likelihood", "sample_stats"):
        loads[group] = xr.load_dataset(tmp_path / "posterior.nc", group=group, engine="h5netcdf")
        assert loads[group].sizes["chain"] == walkers
        assert most / 2 < loads[group].sizes["draw"] <= most
    kept = loads["sample_stats"].lp.values
    np.testing.assert_array_equal(kept, z[:: int(loads["posterior"].attrs["every"]) // 5, :, 0].T)


@pytest.mark.filterwarnings("ignore")  # ArviZ's own
def test_arviz_plots_scores_and_reweights_a_posterior_as_it_is(analysed, tmp_path):
    import arviz as az
    import matplotlib.pyplot as plt
    from scipy.stats import lognorm, norm

    whole = analysed.chains
    chains = whole._replace(z=whole.z[:40], log_probability=whole.log_probability[:40])
    write(analysed._replace(chains=chains), tmp_path)
    direct = ij.infer.to_arviz(analysed.problem, chains, key=KEY)
    found = az.from_netcdf(tmp_path / "posterior.nc")
    np.testing.assert_array_equal(found.log_likelihood.wavelength_nm, GRID)
    loo, old = az.loo(found, pointwise=True), az.__version__.startswith("0.")
    exact = {} if old else {"round_to": "none"}
    table = az.compare({"one": found, "same": found}, **exact)
    if old:
        each, total, column = loo.loo_i, loo.elpd_loo, "elpd_loo"
        az.plot_ppc(found, num_pp_samples=10)
        az.plot_loo_pit(found, y="reflectance")
    else:
        each, total, column = loo.elpd_i, loo.elpd, "elpd"
        az.plot_ppc_dist(found, num_samples=10)
        az.plot_loo_pit(found)
    assert each.dims == ("wavelength_nm",)
    assert table[column].iloc[0] == pytest.approx(total)
    plt.close("all")
    for component in ("prior", "likelihood"):
        power_scaled = (
            az.psens(found, component=component) if old else az.psense(found, group=component)
        )
        assert np.isfinite(power_scaled["melanin_load"])
    # The prior is in the values' own units, so that another one is a ratio of densities.
    prior = lognorm(1.2, scale=0.15).logpdf(found.posterior.melanin_load)
    np.testing.assert_allclose(found.log_prior.melanin_load, prior, rtol=1e-6)
    np.testing.assert_allclose(found.log_prior.abl_fraction, 0, atol=1e-9)
    for name in direct.groups() if old else direct.children:
        for variable, values in direct[name].items():
            np.testing.assert_allclose(values, found[name][variable])
    y, drawn = found.observed_data.reflectance, found.posterior_predictive.reflectance
    assert 0.5 < norm.cdf(((drawn - y) / (0.02 * y + 2e-4)).std()) < 0.98
