"""Pixels of a cube: the results of single fits, starts, flags, maps for the renderers."""

from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from experiments.closed_formulas import KubelkaMunk
from irisjax.infer.fit import fit
from irisjax.infer.observation import with_values
from irisjax.infer.pixels import (
    PixelFlag,
    fit_pixels,
    iris_of_pixels,
    maps_of_pixels,
    predict_pixels,
    prior_starts,
    starts_at,
)
from irisjax.tissue.maps import Scales, texel_layers

GRID = np.arange(420.0, 700.0, 40.0)
FREE = ("melanin_load", "abl_fraction", "hemoglobin", "noise")


@pytest.fixture(scope="module")
def problem():
    return ij.problem(ij.spectrum(GRID, np.zeros(GRID.size)), free=FREE, solver=KubelkaMunk())


@pytest.fixture(scope="module")
def starts(problem):
    return prior_starts(problem)


@pytest.fixture(scope="module")
def spectra(problem):
    random = np.random.default_rng(1)
    z = random.standard_normal((70, 4))
    values = np.asarray(jax.jit(jax.vmap(problem.natural))(z)).T
    clean = predict_pixels(problem, dict(zip(problem.free, values, strict=True)))
    return clean + np.hypot(0.02 * clean, 2e-4) * random.standard_normal(clean.shape)


def test_values_outside_of_priors_are_refused(problem):
    inside = {"melanin_load": 0.3, "abl_fraction": 0.5, "hemoglobin": 0.1, "noise": 1.0}
    values = {name: np.full(3, value) for name, value in inside.items()}
    values["abl_fraction"][1] = 0.0
    with pytest.raises(ValueError, match="abl_fraction = 0 is outside of its prior uniform"):
        predict_pixels(problem, values)


def test_pixels_are_single_fits(problem, starts, spectra):
    found, o = fit_pixels(problem, spectra, starts), problem.observations[0]
    for i in range(10):
        mine = problem.with_observations(with_values(o, jnp.asarray(spectra[i])))
        one = fit(mine, key=jax.random.key(0))
        names = FREE[:3]
        values, sd = (np.array([float(each[n]) for n in names]) for each in (one.values, one.sd))
        assert found.names == names
        assert (np.abs(found.values[i] - values) < 0.1 * sd).all()
        np.testing.assert_allclose(found.sd[i], sd, rtol=0.05)
        # The sum with the priors is at its minimum, its parts are not.
        expected = float(one.chi_square) / GRID.size
        assert found.chi_square[i] == pytest.approx(expected, abs=0.01)
    assert not found.flags.any()


def test_a_search_that_starts_at_its_optimum_converges(problem, spectra):
    o, ends = problem.observations[0], []
    for spectrum in spectra[:16]:
        mine = problem.with_observations(with_values(o, jnp.asarray(spectrum)))
        ends.append(np.asarray(fit(mine, key=jax.random.key(0)).z))
    found = fit_pixels(problem, spectra[:16], starts_at(problem, np.stack(ends)))
    assert not (found.flags & PixelFlag.NOT_CONVERGED).any()


def test_a_pixel_depends_on_its_own_spectrum_and_the_table(problem, starts, spectra):
    found = fit_pixels(problem, spectra, starts)
    with ThreadPoolExecutor(2) as pool:
        some = fit_pixels(problem, spectra[3:68], starts, pool.map)
    np.testing.assert_array_equal(some.values, found.values[3:68])
    np.testing.assert_array_equal(some.covariance, found.covariance[3:68])
    again = fit_pixels(problem, spectra[:8], starts_at(problem, found.z[:16]))
    assert (np.abs(again.values - found.values[:8]) < 0.15 * found.sd[:8]).all()


def test_flags(problem, starts, spectra):
    odd = spectra[:3].copy()
    odd[0, ::2] *= 1.5  # of no iris
    odd[1] = 0.9  # as no iris of the prior
    found = fit_pixels(problem, odd, starts)
    assert found.flags[0] & PixelFlag.MISFIT
    assert found.flags[1] & PixelFlag.MISFIT
    assert found.flags[1] & PixelFlag.OFF_PRIOR
    assert found.flags[2] == 0


def test_abl_melanin(problem, starts, spectra):
    found = fit_pixels(problem, spectra[:8], starts)
    product, sd = found.abl_melanin()
    np.testing.assert_allclose(product, found.values[:, 0] * found.values[:, 1])
    c, (load, fraction) = found.covariance, found.values[:, :2].T
    slopes = np.stack([fraction, load], -1)
    np.testing.assert_allclose(sd**2, np.einsum("pi,pij,pj->p", slopes, c[:, :2, :2], slopes))


def test_maps_have_the_pixels_layers():
    """The renderers' texels have the optical depths of the pixels' own irides."""
    random, base = np.random.default_rng(0), ij.Iris()
    shape = (2, 3)
    values = {n: np.asarray(v) for n, v in ij.infer.of_iris(base).items()}
    values |= {"melanin_load": random.uniform(0.05, 0.4, shape)}
    values |= {n: random.uniform(0.2, 0.7, shape) for n in ("abl_fraction", "pheomelanin_share")}
    values |= {"stroma_thickness": random.uniform(0.2, 0.4, shape)}
    iris = iris_of_pixels(values, base)
    values = {n: np.broadcast_to(v, shape) for n, v in values.items()}
    maps, table = maps_of_pixels(values, iris), ij.extinction([450.0, 600.0])
    scales = Scales.of(maps, iris)
    for at in np.ndindex(shape):
        own = {n: float(v[at]) for n, v in values.items()}
        expected = ij.infer.parameters.iris_of(own, base).layers(table)
        found = texel_layers(iris, 1.336, table, Scales(*(float(s[at]) for s in scales)))
        for name in ("abl_absorption", "stroma_scattering"):
            np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-6)
        np.testing.assert_allclose(found.stroma_absorption, expected.stroma_absorption, rtol=1e-6)
