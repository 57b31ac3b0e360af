"""Pigments from windows whose colours a known iris made."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from window_scenes import BASE, made_windows

from irisjax.photo.pigments import (
    CONCENTRATIONS,
    LEAST_CHANNEL,
    LEAST_COMMON,
    NAMES,
    concentrations_of,
    iris_of,
    least_squares,
    log_probability,
    predicted,
    simplex,
    values_of,
)
from irisjax.tissue.iris import Iris

# Standard normal numbers; what is not named, noise and room, is at the prior's median.
_NAMED = dict(zip(CONCENTRATIONS, (0.6, -0.5, 0.8, 0.4), strict=True)) | {
    "scattering_scale": 0.3,
    "exposure": 0.5,
    "red_gain": 0.4,
    "blue_gain": -0.6,
    "contrast": 0.2,
}
TRUE = np.array([_NAMED.get(name, 0.0) for name in NAMES])


def test_concentrations_there_and_back():
    values = dict(zip(CONCENTRATIONS, (4.3, 1.8, 0.57, 0.24), strict=True))
    found = concentrations_of(iris_of(values, Iris()))
    assert found == pytest.approx(values)
    none = concentrations_of(iris_of(dict.fromkeys(CONCENTRATIONS, 0.0), Iris()))
    assert none == pytest.approx(dict.fromkeys(CONCENTRATIONS, 0.0))


@pytest.fixture(scope="module")
def windows():
    return made_windows(lambda w: predicted(values_of(jnp.asarray(TRUE)), w, BASE))


def _cost(z, windows):
    return -float(log_probability(jnp.asarray(z), windows, BASE))


@pytest.mark.heavy  # compiles the search
def test_least_squares_fits_what_the_model_made(windows):
    found = least_squares(windows, BASE)
    assert found.converged
    assert found.rms.max() < 0.01
    assert tuple(found.values) == NAMES
    assert _cost(found.z, windows) <= _cost(TRUE, windows) + 1e-6
    # The prior pulls by less than what is not known.
    off = (found.z - TRUE) / np.sqrt(np.diag(found.covariance))
    assert abs(off).max() < 3


@pytest.mark.heavy
def test_the_simplex_goes_down_stage_by_stage(windows):
    found, log = simplex(windows, BASE)
    assert [set(row) for row in log] == [{*CONCENTRATIONS, "steps", "rms"}] * 2
    start = windows_rms(np.zeros(len(NAMES)), windows)
    assert start > log[0]["rms"] >= log[1]["rms"]
    assert found.rms.mean() == pytest.approx(log[1]["rms"])
    assert found.values["exposure"] == pytest.approx(1)


def windows_rms(z, windows):
    shown = np.asarray(predicted(values_of(jnp.asarray(z)), windows, BASE))[windows.present]
    off = np.log(shown / windows.colour[windows.present])
    return float(np.sqrt((off**2).mean(0)).mean())


@pytest.mark.heavy
def test_the_posterior_is_a_normal_one_with_a_common_factor(windows):
    def direct(z):
        values = {n: float(v) for n, v in values_of(jnp.asarray(z)).items()}
        shown = np.asarray(predicted(values_of(jnp.asarray(z)), windows, BASE))
        there = windows.present
        colour = windows.colour[there]
        floor = 0.01 * colour.mean()
        off = np.log((colour + floor) / (shown[there] + floor))
        pixels = windows.error[there] / (colour + floor)
        common = values["common_noise"] ** 2 + LEAST_COMMON**2
        total = scipy.stats.norm.logpdf(z).sum()
        for o, p in zip(off, pixels, strict=True):
            own = values["channel_noise"] ** 2 + LEAST_CHANNEL**2 + p**2
            covariance = np.diag(own) + common
            total += scipy.stats.multivariate_normal.logpdf(o, np.zeros(3), covariance)
        return total

    places = TRUE + 0.3 * np.random.default_rng(4).standard_normal((4, len(NAMES)))
    own = np.array([float(log_probability(jnp.asarray(z), windows, BASE)) for z in places])
    other = np.array([direct(z) for z in places])
    np.testing.assert_allclose(own - own[0], other - other[0], atol=1e-6)


@pytest.mark.heavy
def test_the_posterior_has_a_slope_everywhere(windows):
    slope = jax.grad(lambda z: log_probability(z, windows, BASE))(jnp.asarray(TRUE))
    assert np.isfinite(np.asarray(slope)).all()
