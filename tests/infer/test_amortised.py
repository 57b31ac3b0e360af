"""Posteriors by a flow: exact however badly it is trained, flags, files. Needs the extra posteriors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from irisjax.infer.amortised import (
    Weighted,
    flow_name,
    read_flow,
    save_flow,
    train_flow,
    weighted_draws,
    with_chains,
)
from irisjax.infer.importance import Start, importance_sample
from irisjax.infer.observation import with_values
from irisjax.infer.pixels import fit_pixels, prior_starts
from irisjax.infer.problem import predicted

GRID = np.arange(420.0, 700.0, 20.0)
FREE = ("melanin_load", "abl_fraction", "hemoglobin", "noise")
KEY = jax.random.key(3)


def test_weights_say_how_many_draws_are_effective():
    weights = np.array([[0.25] * 4, [1, 0, 0, 0], [0.5, 0.5, 0, 0], [0] * 4], float)
    z = np.tile(np.arange(4.0)[:, None], (4, 1, 1))
    found = Weighted(z, weights, np.zeros((4, 4)), np.zeros(4, bool))
    np.testing.assert_allclose(found.efficiency, [1, 0.25, 0.5, 0])
    same = found.equal(2, 1000, key=KEY)[:, 0]
    assert set(same) == {0.0, 1.0}
    assert abs((same == 0).sum() - 500) <= 1


@pytest.fixture(scope="module")
def problem():
    return ij.problem(ij.spectrum(GRID, np.zeros(GRID.size)), free=FREE, process=ij.ILIT_2006)


@pytest.fixture(scope="module")
def flow(problem):
    """Trained for a hundredth of the time that it takes."""
    return train_flow(problem, simulated=4096, epochs=4, key=KEY)


@pytest.fixture(scope="module")
def spectra(problem):
    z = np.random.default_rng(1).standard_normal((200, len(FREE)))
    (values,), *_ = predicted(problem, z, KEY)
    fits = fit_pixels(problem, values, prior_starts(problem))
    return values, fits.z, fits.z_covariance


@pytest.mark.peer
def test_moments_are_those_of_adaptive_importance_sampling(problem, flow, spectra):
    """The other sampler draws from distributions of its own, and shares the density only."""
    few = [x[:6] for x in spectra]
    found = weighted_draws(flow, problem, *few, draws=4096, key=KEY)
    assert (found.efficiency > 0.05).all()
    for i, (values, z, covariance) in enumerate(zip(*few, strict=True)):
        mine = problem.with_observations(with_values(problem.observations[0], jnp.asarray(values)))
        start, random = Start(z, covariance), np.random.RandomState(i)
        other = importance_sample(mine.log_density, start, random)
        mean = found.weights[i] @ found.z[i]
        sd = np.sqrt(found.weights[i] @ (found.z[i] - mean) ** 2)
        count = min(other.effective, 4096 * found.efficiency[i])
        spread = other.samples.std(axis=0)
        assert (np.abs(mean - other.samples.mean(axis=0)) < 5 * spread / np.sqrt(count)).all()
        np.testing.assert_allclose(sd, spread, rtol=5 * np.sqrt(2 / count))


@pytest.mark.peer
def test_a_spectrum_has_one_posterior_in_whatever_company(problem, flow, spectra):
    whole = weighted_draws(flow, problem, *spectra, key=KEY)
    alone = weighted_draws(flow, problem, *(x[70:71] for x in spectra), key=KEY)
    np.testing.assert_array_equal(whole.weights[70:71], alone.weights)


@pytest.mark.peer
def test_bands_that_are_off_are_flagged_and_others_are_not(problem, flow, spectra):
    values, *_ = spectra
    assert weighted_draws(flow, problem, *spectra, key=KEY).unusual.mean() < 0.05
    off = values.copy()
    off[:, 5] *= 1.6
    fits = fit_pixels(problem, off, prior_starts(problem))
    found = weighted_draws(flow, problem, off, fits.z, fits.z_covariance, key=KEY)
    assert found.unusual.mean() > 0.9


@pytest.mark.peer
def test_a_chain_replaces_draws_of_which_few_are_effective(problem, flow, spectra):
    few = [x[:2] for x in spectra]
    found = weighted_draws(flow, problem, *few, key=KEY)
    one = np.zeros(found.weights.shape[1])
    one[0] = 1
    poor = found._replace(weights=np.stack([one, found.weights[1]]), unusual=np.zeros(2, bool))
    replaced, good = with_chains(poor, problem, *few, key=KEY)
    assert good.all()
    assert replaced.efficiency[0] == pytest.approx(1)
    np.testing.assert_array_equal(replaced.z[1], found.z[1])
    off = replaced.z[0].mean(axis=0) - found.weights[0] @ found.z[0]
    assert (np.abs(off) < 4 * replaced.z[0].std(axis=0) / np.sqrt(20)).all()
    unusual = poor._replace(unusual=np.ones(2, bool))
    np.testing.assert_array_equal(with_chains(unusual, problem, *few, key=KEY)[1], [False, True])


@pytest.mark.peer
def test_a_flow_is_read_as_it_was_written(problem, flow, spectra, tmp_path):
    path = tmp_path / "one.flow"
    save_flow(path, flow)
    few = [x[:3] for x in spectra]
    same = weighted_draws(read_flow(path, problem), problem, *few, key=KEY)
    np.testing.assert_array_equal(
        same.weights, weighted_draws(flow, problem, *few, key=KEY).weights
    )
    fewer = ij.problem(problem.observations[0], free=FREE[:2], process=ij.ILIT_2006)
    with pytest.raises(ValueError, match="is no flow for these parameters"):
        read_flow(path, fewer)
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(ValueError, match="is no flow for these parameters"):
        read_flow(path, problem)


def test_the_name_of_a_flow_depends_on_the_model_and_not_on_the_data(problem):
    o = problem.observations[0]
    measured = problem.with_observations(with_values(o, o.values + 0.1, o.values + 0.01))
    assert flow_name(measured) == flow_name(problem)
    others = [
        ij.problem(o, free=FREE[:2], process=ij.ILIT_2006),
        ij.problem(o, free=FREE, process=ij.ILIT_2006, noise=ij.Noise(relative=0.01)),
        ij.problem(o, free=FREE, process=ij.DEPTH_RESOLVED),
        ij.problem(ij.spectrum(GRID + 1, 0 * GRID), free=FREE, process=ij.ILIT_2006),
        ij.problem(o, free=FREE, priors={"hemoglobin": ij.infer.LogNormal(0.1, 0.3)}),
    ]
    assert len({flow_name(p) for p in (problem, *others)}) == 6
