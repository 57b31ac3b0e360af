"""The same posterior by Hamiltonian Monte Carlo (numpyro's NUTS), which needs gradients and nothing
of ours.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from experiments.closed_formulas import KubelkaMunk
from irisjax.infer.fit import fit
from irisjax.infer.posterior import sample

pytestmark = [pytest.mark.peer, pytest.mark.filterwarnings("ignore")]  # numpyro's own


@pytest.mark.parametrize("model", ["closed formula", pytest.param("ilit", marks=pytest.mark.slow)])
def test_ensemble_and_nuts_agree(model):
    """Means, spreads and the correlation of load and fraction, within Monte Carlo error."""
    from numpyro.diagnostics import effective_sample_size
    from numpyro.infer import MCMC, NUTS

    grid = ij.wavelengths(400, 700, 10)
    blank = ij.spectrum(grid, np.ones(grid.size))
    problem = ij.problem(blank, solver=KubelkaMunk() if model == "closed formula" else None)
    truth = problem.standard(ij.infer.of_iris(ij.Iris.of_level("low")))
    problem = problem.with_observations(
        ij.spectrum(grid, np.asarray(problem.simulate(truth, jax.random.key(1))[0]))
    )
    best = fit(problem, key=jax.random.key(3))
    chains = sample(problem, best, key=jax.random.key(4))
    assert chains.converged
    nuts = MCMC(
        NUTS(potential_fn=lambda z: -problem.log_posterior(z)),
        num_warmup=300,
        num_samples=2000,
        progress_bar=False,
    )
    nuts.run(jax.random.key(2), init_params=jnp.asarray(best.z))
    other = np.asarray(nuts.get_samples())
    ours = chains.z.reshape(-1, other.shape[1])
    size = np.minimum(effective_sample_size(other[None]), chains.ess_bulk)
    error = np.hypot(ours.std(0), other.std(0)) / np.sqrt(size)
    assert (np.abs(ours.mean(0) - other.mean(0)) < 4.5 * error).all()
    # A standard deviation is known to 1/√(2 n); tails heavier than the normal's widen that.
    np.testing.assert_allclose(ours.std(0) / other.std(0), 1, atol=6 / np.sqrt(2 * size.min()))
    for q in (5, 25, 75, 95):
        np.testing.assert_array_less(
            np.abs(np.percentile(ours, q, 0) - np.percentile(other, q, 0)), 9 * error
        )
    correlation = [np.corrcoef(z[:, 0], z[:, 1])[0, 1] for z in (ours, other)]
    assert correlation[0] == pytest.approx(correlation[1], abs=0.05)
