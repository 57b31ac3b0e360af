"""An eye that scatters twenty times as much as LB06's, by radiative transfer with default priors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import quick_jit
from irisjax.cli.sentences import information_lines
from irisjax.infer.fit import Fit, FitStatus
from irisjax.infer.identifiability import information
from irisjax.infer.importance import Start
from irisjax.infer.posterior import sample

TRUTH = {"melanin_load": 0.2, "abl_fraction": 0.5, "scattering_scale": 20.0}
# By RadiativeExact(40, 8, 5), with a noise of 2 %.
VALUES = np.array([0.06345, 0.12487, 0.16804, 0.13968, 0.12198, 0.14416, 0.13176, 0.11241])
SEEN = ij.spectrum(ij.wavelengths(410, 690, 40), VALUES)


def test_its_posterior_holds_the_truth():
    problem = ij.problem(SEEN, free=list(TRUTH), process=ij.DEPTH_RESOLVED)
    assert isinstance(problem.solvers[0].solver, ij.RadiativeTabulated)
    start = Start(np.asarray(quick_jit(lambda: problem.standard(TRUTH))()), np.eye(3) * 0.01)
    chains = sample(problem, start, walkers=32, max_steps=200, key=jax.random.key(1))
    z = np.quantile(chains.z.reshape(-1, 3), [0.005, 0.5, 0.995], axis=0)
    values = np.asarray(quick_jit(jax.vmap(problem.natural))(z)).T
    for name, (low, middle, high) in zip(problem.free, values, strict=True):
        assert low < TRUTH[name] < high
        assert middle == pytest.approx(TRUTH[name], rel=0.25)


def test_its_ridge_is_named():
    problem = ij.problem(SEEN, free=list(TRUTH), process=ij.ILIT_2006)
    zero, whole = jnp.zeros(()), jnp.asarray(1)
    fit = Fit(
        z=jnp.zeros(3),
        jacobian=jnp.eye(8, 3),
        covariance=0.04 * jnp.asarray([[1, 0, 0.9], [0, 1, 0], [0.9, 0, 1]]),
        values=TRUTH,
        sd={},
        predicted=(),
        chi_square=zero,
        degrees=5,
        cost=zero,
        agreeing=whole,
        steps=whole,
        status=FitStatus.successful,
    )
    said = information_lines(information(problem, fit))[-1]
    assert said == "scattering: 20 % of its prior's width; trades with load (correlation +0.90)"
