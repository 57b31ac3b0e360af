"""Large problems are evaluated in pieces: the same numbers, in bounded memory."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from irisjax.cli import report
from irisjax.infer import pieces
from irisjax.infer.analytic import BeerLambert
from irisjax.infer.fit import fit
from irisjax.infer.posterior import Chains, ChainStatus
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
        pieces.density(problem)(z), [problem.log_posterior(x) for x in z], rtol=1e-12
    )
    np.testing.assert_allclose(
        pieces.pointwise(problem, z), [problem.pointwise(x) for x in z], rtol=1e-12
    )
    found = fit(problem, use_priors=False, key=jax.random.key(0))
    truth = ij.infer.parameters.of_iris(ij.Iris())
    assert int(found.agreeing) == 4
    for name in problem.free:
        assert float(found.values[name]) == pytest.approx(float(truth[name]), rel=1e-5)


def test_files_of_many_wavelengths_hold_fewer_draws(problem, tmp_path, monkeypatch):
    """Log likelihoods of all draws of 10,000 wavelengths would be gigabytes; every group keeps the
    same draws.
    """
    import xarray as xr

    walkers, most = 8, 100
    monkeypatch.setattr(report, "_MOST_NUMBERS", most * walkers * GRID.size)
    z = 0.01 * np.random.default_rng(1).normal(size=(250, walkers, 2))
    one = np.ones(2)
    chains = Chains(z, z[..., 0], 5, 1250, 0.5, one, one, one, one, ChainStatus.successful, "")
    report._write(problem, tmp_path, chains, "", [], jax.random.key(0), [z[:, 0, :1]], {})
    loads = {}
    for group in ("posterior", "log_likelihood", "sample_stats"):
        loads[group] = xr.load_dataset(tmp_path / "posterior.nc", group=group, engine="h5netcdf")
        assert loads[group].sizes["chain"] == walkers
        assert most / 2 < loads[group].sizes["draw"] <= most
    kept = loads["sample_stats"].lp.values
    np.testing.assert_array_equal(kept, z[:: int(loads["posterior"].attrs["every"]) // 5, :, 0].T)
