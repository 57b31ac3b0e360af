"""Large problems are evaluated in pieces: the same numbers, in bounded memory."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from irisjax.infer.analytic import BeerLambert
from irisjax.infer.fit import fit
from irisjax.infer.problem import density, pointwise
from irisjax.numerics import portions

GRID = ij.wavelengths(400, 700, 10)


@pytest.fixture
def problem():
    """Its name, a static field, keeps programs compiled for other tests away."""
    seen = ij.spectrum(
        GRID, ij.reflectance(ij.Iris(), GRID, solver=BeerLambert()).values, name="in pieces"
    )
    return ij.problem(seen, free=["melanin_load", "hemoglobin"], solver=BeerLambert())


@pytest.mark.slow  # 10 s of compiling
def test_densities_and_fits_do_not_depend_on_the_pieces(problem, monkeypatch):
    monkeypatch.setattr(portions, "_ELEMENTS", 2 * GRID.size)  # of seven walkers one remains
    z = jnp.asarray(np.random.default_rng(0).normal(size=(7, 2)))
    np.testing.assert_allclose(
        density(problem)(z), [problem.log_posterior(x) for x in z], rtol=1e-12
    )
    np.testing.assert_allclose(pointwise(problem, z), [problem.pointwise(x) for x in z], rtol=1e-12)
    found = fit(problem, use_priors=False, key=jax.random.key(0))
    truth = ij.infer.of_iris(ij.Iris())
    assert int(found.agreeing) == 4
    for name in problem.free:
        assert float(found.values[name]) == pytest.approx(float(truth[name]), rel=1e-5)
