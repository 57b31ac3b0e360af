"""Pixels of a cube: the results of single fits, starts, flags, maps for the renderers."""

from concurrent.futures import ThreadPoolExecutor

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

import irisjax as ij
from experiments.closed_formulas import KubelkaMunk
from irisjax.infer.observation import with_values
from irisjax.infer.pixels import (
    PixelFlag,
    Starts,
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


@pytest.fixture(scope="module")
def found(problem, starts, spectra):
    return fit_pixels(problem, spectra, starts)


@eqx.filter_jit
def stated(problem, values, z):
    """Residuals of the data at z and of the priors, the values there, and their derivatives."""
    mine = problem.with_observations(with_values(problem.observations[0], values))
    residuals = jnp.concatenate([mine.evaluated(z)[0], z[:-1]])
    return residuals, problem.natural(z), problem.slopes(z)


@pytest.fixture(scope="module")
def singles(problem, spectra):
    """SciPy's fits of the first spectra, each alone: z, values, their deviations, chi-squares."""

    def at(values, x):
        return jax.tree.map(np.asarray, stated(problem, values, np.append(x, 0.0)))

    def fitted(values):
        best = least_squares(lambda x: at(values, x)[0], np.zeros(3), xtol=1e-10)
        (residuals, natural, slopes), end = at(values, best.x), np.append(best.x, 0.0)
        sd = np.abs(slopes[:-1]) * np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac)))
        return end, natural[:-1], sd, (residuals[: GRID.size] ** 2).sum()

    return [fitted(values) for values in spectra[:16]]


@pytest.fixture(scope="module")
def starts_like(problem, starts):
    """Starts at vectors z, in a table as long as that of the priors: one program serves both."""

    def of(z):
        at = starts_at(problem, z)
        return Starts(*(np.resize(x, (len(starts.z), *x.shape[1:])) for x in at))

    return of


def test_pixels_are_single_fits(found, singles):
    assert found.names == FREE[:3]
    for i, (_, values, sd, chi_square) in enumerate(singles[:10]):
        assert (np.abs(found.values[i] - values) < 0.1 * sd).all()
        np.testing.assert_allclose(found.sd[i], sd, rtol=0.05)
        # The sum with the priors is at its minimum, its parts are not.
        assert found.chi_square[i] == pytest.approx(chi_square / GRID.size, abs=0.01)
    assert not found.flags.any()


def test_a_search_that_starts_at_its_optimum_converges(problem, spectra, singles, starts_like):
    ends = np.stack([z for z, *_ in singles])
    found = fit_pixels(problem, spectra[:16], starts_like(ends))
    assert not (found.flags & PixelFlag.NOT_CONVERGED).any()


def test_a_pixel_depends_on_its_own_spectrum_and_the_table(
    problem, starts, spectra, found, starts_like
):
    with ThreadPoolExecutor(2) as pool:
        some = fit_pixels(problem, spectra[3:68], starts, pool.map)
    np.testing.assert_array_equal(some.values, found.values[3:68])
    np.testing.assert_array_equal(some.covariance, found.covariance[3:68])
    again = fit_pixels(problem, spectra[:8], starts_like(found.z[:16]))
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


def test_abl_melanin(found):
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
        for name in ("abl_absorption", "stroma_absorption", "stroma_scattering"):
            np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-6)
