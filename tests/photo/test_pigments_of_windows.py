"""Pigments and their posterior from windows whose colours a known iris made."""

import dataclasses
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from formula import BASE, formula_windows
from scipy import optimize

from irisjax.infer.importance import Start
from irisjax.infer.posterior import sample
from irisjax.photo import pigments
from irisjax.photo.pigments import (
    CONCENTRATIONS,
    FREE_NAMES,
    RING,
    _totals_and_slope,
    _values_of_draws,
    exposures_for,
    fit_pigments,
    iris_of_concentrations,
    log_likelihood,
    log_posterior,
    parameter_values,
    predicted_colours,
    sample_pigments,
    sd_of_abl_melanin,
    simplex,
    strange_white,
)
from irisjax.photo.windows import WhiteSeen
from irisjax.tissue.iris import Iris

# Standard normal numbers; what is not named, the room, is at the prior's median.
_NAMED = dict(zip(CONCENTRATIONS, (0.6, -0.5, 0.8, 0.4), strict=True)) | {
    "scattering_scale": 0.3,
    "exposure": 0.5,
    "red_gain": 0.4,
    "blue_gain": -0.6,
    "contrast": 0.2,
}
TRUE = np.array([_NAMED.get(name, 0.0) for name in FREE_NAMES])


def test_concentrations_there_and_back():
    values = dict(zip(CONCENTRATIONS, (4.3, 1.8, 0.57, 0.24), strict=True))
    found = iris_of_concentrations(values, Iris()).layer_concentrations()
    assert found == pytest.approx(values)
    none = iris_of_concentrations(dict.fromkeys(CONCENTRATIONS, 0.0), Iris()).layer_concentrations()
    assert none == pytest.approx(dict.fromkeys(CONCENTRATIONS, 0.0))


@pytest.fixture(scope="module")
def windows():
    return formula_windows(TRUE)


@pytest.fixture(scope="module")
def fit(windows):
    return fit_pigments(windows, BASE)


_posterior, _colours, _likelihood = map(
    eqx.filter_jit, (log_posterior, predicted_colours, log_likelihood)
)


def _cost(z, windows):
    return -float(_posterior(jnp.asarray(z), windows, BASE))


def test_least_squares_fits_what_the_model_made(windows, fit):
    assert fit.converged
    assert fit.rms.max() < RING.light  # by which a ring may be off
    assert tuple(fit.values) == FREE_NAMES
    assert {*FREE_NAMES, "start", "turn", "steps", "log_density"} == set(fit.log[0])
    ended = [row["log_density"] for row in fit.log if row["turn"] == fit.log[-1]["turn"]]
    cost = _cost(fit.z, windows)
    assert max(ended) == pytest.approx(-cost)
    assert cost <= _cost(TRUE, windows) + 1e-6
    # The prior pulls by less than what is not known.
    assert abs((fit.z - TRUE) / np.sqrt(np.diag(fit.covariance))).max() < 3


def test_of_several_maxima_the_highest_is_found():
    """The search reaches the log density that Powell's method finds from the truth, within 0.5. The
    iris scatters strongly in little light; from starts that scatter little the search ended 1.4
    below.
    """
    true = {"scattering_scale": 2.8, "exposure": -2.3, "red_gain": 1.5, "blue_gain": 1.3}
    true |= {"stroma_eumelanin": 0.4, "stroma_pheomelanin": -0.7, "contrast": 0.8}
    truth = np.array([true.get(name, 0.0) for name in FREE_NAMES])
    windows = formula_windows(truth)
    reference = optimize.minimize(_cost, truth, args=(windows,), method="Powell")
    assert _cost(fit_pigments(windows, BASE).z, windows) < reference.fun + 0.5


def _shown(z, windows, base=BASE):
    values = {name: jnp.asarray(v) for name, v in parameter_values(jnp.asarray(z)).items()}
    return np.asarray(_colours(values, windows, base))


def test_the_simplex_goes_down_stage_by_stage_where_light_and_scattering_are_known(windows):
    """F09's premises: all but the pigments at the values that the windows were made with."""
    true = {n: float(v) for n, v in parameter_values(jnp.asarray(TRUE)).items()}
    known = {n: v for n, v in true.items() if n not in CONCENTRATIONS}
    found = simplex(windows, BASE, known)
    assert [set(row) for row in found.log] == [{*CONCENTRATIONS, "steps", "rms"}] * 2
    start = np.where(np.isin(FREE_NAMES, CONCENTRATIONS), 0.0, TRUE)
    seen = windows.present
    off = np.log(_shown(start, windows)[seen] / windows.colour[seen])
    first, last = (row["rms"] for row in found.log)
    assert np.sqrt((off**2).mean(0)).mean() > first >= last
    assert found.rms.mean() == pytest.approx(last)
    assert {n: found.values[n] for n in known} == pytest.approx(known)
    # The windows have no noise.
    assert found.rms.mean() < 1e-3 < 0.3 * simplex(windows, BASE).rms.mean()


def test_the_posterior_is_likelihood_times_prior(windows):
    """With the response to thickness by differences."""

    def off(z, thicker=1.0):
        base = BASE.replace(stroma_thickness=thicker * BASE.stroma_thickness)
        shown = _shown(z, windows, base)
        floor = 0.01 * windows.colour[windows.present].mean()
        found = np.log((windows.colour + floor) / (shown + floor))
        return np.where(windows.present[:, None], found, 0.0)

    def direct(z):
        step = 1e-4
        response = (off(z, np.exp(-step)) - off(z, np.exp(step))) / (2 * step)
        parts = (jnp.asarray(v) for v in (off(z), response, windows.present))
        return float(_likelihood(*parts)) - 0.5 * (z**2).sum()

    places = TRUE + 0.5 * np.random.default_rng(4).standard_normal((4, len(FREE_NAMES)))
    own = [-_cost(z, windows) for z in places]
    assert np.ptp(own) > 10
    np.testing.assert_allclose(own, [direct(z) for z in places], atol=1e-3)


def test_many_densities_at_a_time_wait_for_no_thread_of_each_other(windows):
    """LAPACK's batches wait for the threads that the other program, or they themselves, occupy."""
    many = jax.vmap(lambda z: log_posterior(z, windows, BASE))
    text = jax.jit(many).lower(jnp.zeros((96, len(FREE_NAMES)))).as_text()
    assert "lapack" not in text


@pytest.fixture
def few_draws(monkeypatch):
    """Searches begin at the best of fewer draws: where a maximum is one of few, they find it too."""
    monkeypatch.setattr(pigments, "_DRAWN", 256)


@pytest.mark.usefixtures("few_draws")
def test_mirror_images_tell_the_exposure_or_how_much_it_is_at_least(windows, fit):
    exposure, at = fit.values["exposure"], FREE_NAMES.index("exposure")

    def told(factor, at_least):
        """Exposure, and its variance, over those without mirror images."""
        known = {"exposure": np.asarray(factor * exposure), "at_least": np.asarray(at_least)}
        found = fit_pigments(dataclasses.replace(windows, **known), BASE)
        return found.values["exposure"] / exposure, found.covariance[at, at] / fit.covariance[
            at, at
        ]

    less, more, at_least = told(0.5, False), told(2.0, True), told(0.5, True)
    assert 0.4 < less[0] < 1 and less[1] < 0.5
    assert 1 < more[0] < 2.5 and more[1] < 0.5
    assert at_least == (pytest.approx(1, rel=0.01), pytest.approx(1, rel=0.1))


@pytest.mark.usefixtures("few_draws")
def test_the_white_of_the_eye_tells_exposure_and_balance(windows, fit):
    """It tells them as closely as its usual colour is known; a white far off it is doubted."""
    true = {name: float(value) for name, value in parameter_values(TRUE).items()}
    names = "exposure", "red_gain", "blue_gain"

    def with_white(factor, sd):
        usual, light = np.array([0.6, 0.5, 0.4]), np.full(3, 0.9)
        gains = np.array([true["red_gain"], 1, true["blue_gain"]])
        lit = (usual * (light + true["room"])) ** true["contrast"]
        white = WhiteSeen(true["exposure"] * gains * lit * factor, usual, light, np.eye(3) / sd)
        return dataclasses.replace(windows, white=white)

    told = fit_pigments(with_white(1.0, 0.05), BASE)
    for name in names:
        i = FREE_NAMES.index(name)
        assert abs(told.z[i] - TRUE[i]) < 2.5 * np.sqrt(told.covariance[i, i])
        assert told.covariance[i, i] < 0.8 * fit.covariance[i, i]
    assert strange_white(told, windows) is None
    brighter = fit_pigments(with_white(np.array([1.6, 1.5, 1.5]), 0.05), BASE)
    assert brighter.values["exposure"] > 1.2 * told.values["exposure"]
    assert brighter.values["red_gain"] > 1.02 * told.values["red_gain"]
    found = strange_white(told, with_white(np.array([0.2, 0.2, 0.1]), 0.3))
    np.testing.assert_allclose(found, [0.2, 0.2, 0.1], rtol=0.1)


def test_exposures_take_up_brightness_that_other_maps_change_and_no_tint(windows, fit):
    """The white of the eye would show the tint as one of the light."""

    def exposures_through(*filter_of):
        darker = dataclasses.replace(windows, colour=windows.colour * np.array(filter_of))
        return exposures_for(fit, darker, BASE)

    first = exposures_through(1.0, 1.0, 1.0)
    np.testing.assert_allclose(exposures_through(0.8, 0.8, 0.8) / first, 0.8, rtol=0.01)
    values = fit.values
    own = values["exposure"] * np.array([values["red_gain"], 1, values["blue_gain"]])
    # The fit's windows are as bright as it says, but for what the prior pulls.
    np.testing.assert_allclose(first, own, rtol=0.05)
    red, green, blue = exposures_through(0.8, 0.9, 0.7) / first
    assert red == pytest.approx(green) == pytest.approx(blue)
    assert 0.7 < green < 0.9
    # A channel that is black is not exposed a hundred times as long.
    np.testing.assert_allclose(exposures_through(1.0, 1.0, 1e-3) / first, 1, rtol=0.5)


def test_estimates_are_those_of_the_samples_and_hold_the_truth(windows, fit, monkeypatch):
    monkeypatch.setattr(pigments, "EFFECTIVE", 1024)
    drawn = sample_pigments(windows, BASE, fit, key=jax.random.key(1))
    assert drawn.converged
    true = parameter_values(jnp.asarray(TRUE))
    assert tuple(drawn.estimates) == tuple(drawn.samples) == FREE_NAMES
    for i, (name, estimate) in enumerate(drawn.estimates.items()):
        low, median, high = np.quantile(drawn.samples[name], [0.025, 0.5, 0.975])
        assert (estimate.low, estimate.median, estimate.high) == pytest.approx((low, median, high))
        # Windows without noise: what the camera has free still hides the pigments.
        assert low < float(true[name]) < high, name
        assert estimate.contraction == pytest.approx(1 - drawn.z[:, i].var())


def test_the_melanin_of_the_abl_is_as_sure_as_draws_of_the_fit(fit):
    sure = fit._replace(covariance=1e-4 * fit.covariance)  # the approximation is a linear one
    draws = np.random.default_rng(2).multivariate_normal(sure.z, sure.covariance, 4000).T
    both = [pigments.PRIORS[n].value(z) for n, z in zip(CONCENTRATIONS[:2], draws, strict=False)]
    assert sd_of_abl_melanin(sure) == pytest.approx(np.log(sum(both)).std(), rel=0.05)


@pytest.mark.peer
def test_emcee_samples_the_same_posterior(windows, fit, monkeypatch):
    """Its quantiles have the same probabilities, to four standard errors of either sample: of many
    draws, since a tail of few heavy ones errs more than their worth in independent draws says.
    """
    monkeypatch.setattr(pigments, "EFFECTIVE", 16_384)
    drawn = sample_pigments(windows, BASE, fit, key=jax.random.key(1))
    density = eqx.filter_jit(lambda z: jax.vmap(lambda row: log_posterior(row, windows, BASE))(z))
    target = SimpleNamespace(names=FREE_NAMES, log_density=lambda z: np.asarray(density(z)))
    chains = sample(
        target, Start(fit.z, fit.covariance), walkers=48, max_steps=8000, key=jax.random.key(5)
    )
    shares = np.array([0.025, 0.5, 0.975])[:, None]
    below = (drawn.z[:, None] < np.quantile(chains.flat, shares[:, 0], axis=0)).mean(0)
    effective = 1 / (1 / drawn.effective + 1 / np.minimum(chains.ess_bulk, chains.ess_tail))
    assert (np.abs(below - shares) < 4 * np.sqrt(shares * (1 - shares) / effective)).all()
    assert chains.converged


def test_the_draws_own_coordinates_leave_the_prior_as_it_is():
    """They lead back, and their volume is the same everywhere: no Jacobian is left out."""
    z = jnp.asarray(np.random.default_rng(6).normal(size=(20, len(FREE_NAMES))))
    x, slope = jax.jit(jax.vmap(_totals_and_slope))(z)
    assert np.abs(x - z).max() > 0.5
    np.testing.assert_allclose(_values_of_draws(x)["z"], z, atol=1e-10)
    volumes = np.linalg.det(slope)
    np.testing.assert_allclose(volumes, volumes[0], rtol=1e-10)
