"""Evidences by nested sampling: where they are known, on grids, and beside Laplace's."""

import importlib.util
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_normal

import irisjax as ij
from common import DOUBLE_FIRST
from irisjax.infer import other_process
from irisjax.infer.analytic import KubelkaMunk
from irisjax.infer.evidence import evidence, evidence_by_importance
from irisjax.infer.observation import with_values
from irisjax.infer.pieces import density
from irisjax.infer.priors import Normal

GRID = np.arange(400.0, 701.0, 30.0)


def stated(free, *, share=0.02, key=0, **given):
    """A problem whose data it made itself, at the priors' medians."""
    blank = ij.spectrum(GRID, np.full(GRID.size, 0.05), sd=np.full(GRID.size, 0.01))
    problem = ij.problem(blank, free=free, **given)
    (model,) = problem.predict(jnp.zeros(len(problem.free)))
    sd = share * model + 1e-5
    seen = model + sd * jax.random.normal(jax.random.key(key), model.shape, model.dtype)
    return problem.with_observations(with_values(blank, seen, sd))


def conjugate(mean, sd):
    """A gain with a normal prior and normal noise: the data are normal too. The problem, the data's
    distribution, the spectrum at gain 1 and the covariance of the noise.
    """
    problem = stated(("gain",), solver=KubelkaMunk(), priors={"gain": Normal(mean, sd)})
    (shape,) = (np.asarray(m, float) for m in problem.predict(jnp.zeros(1)))
    noise = np.diag(np.asarray(problem.observations[0].sd, float) ** 2)
    return (
        problem,
        multivariate_normal(mean * shape, noise + sd**2 * np.outer(shape, shape)),
        shape,
        noise,
    )


def test_the_sampler_is_an_extra(monkeypatch):
    """Nothing of it is loaded before it is used; without it one line says what to install."""
    code = "import sys, irisjax.infer.model_comparison; sys.exit('blackjax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
    problem = stated(("gain",), solver=KubelkaMunk())
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"pip install 'irisjax\[compare\]'"):
        evidence(problem, key=jax.random.key(0))


@pytest.mark.peer
@DOUBLE_FIRST
def test_of_a_conjugate_problem(bits):
    problem, known, shape, noise = conjugate(mean := 1.0, sd := 0.1)
    (seen,) = problem.observations
    found = [evidence(problem, key=jax.random.key(i)) for i in range(4)]
    each = np.array([f.log_evidence for f in found])
    error = found[0].error
    expected = known.logpdf(np.asarray(seen.values, float))
    assert abs(each.mean() - expected) < 3 * error / 2 + (1e-3 if bits == 32 else 0)
    assert each.std(ddof=1) < 2.5 * error  # the error is no less than what it is
    # The posterior, in closed form.
    weight = shape / np.diag(noise)
    variance = 1 / (1 / sd**2 + weight @ shape)
    middle = variance * (mean / sd**2 + weight @ np.asarray(seen.values, float))
    gains = np.concatenate([mean + sd * f.z[:, 0] for f in found])
    few = sum(f.effective for f in found)
    assert abs(gains.mean() - middle) < 4 * np.sqrt(variance / few)
    assert gains.std() == pytest.approx(np.sqrt(variance), rel=4 / np.sqrt(2 * few))


@pytest.mark.peer
@pytest.mark.parametrize("way", [evidence, evidence_by_importance])
def test_of_load_and_fraction_on_a_grid(way):
    problem = stated(("melanin_load", "abl_fraction"), share=0.1)
    side = np.linspace(-6, 6, 241)
    z = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    logs = density(problem)(z)
    area = (side[1] - side[0]) ** 2
    expected = np.logaddexp.reduce(logs) + np.log(area)
    options = {"live": 1000} if way is evidence else {}
    found = way(problem, **options, key=jax.random.key(1))
    assert abs(found.log_evidence - expected) < 3.5 * found.error
    weights = np.exp(logs - logs.max())
    mean = weights @ z / weights.sum()
    spread = np.sqrt(weights @ (z - mean) ** 2 / weights.sum())
    assert (np.abs(found.z.mean(0) - mean) < 4.5 * spread / np.sqrt(found.effective)).all()
    np.testing.assert_allclose(found.z.std(0), spread, rtol=0.1)


@pytest.mark.peer
def test_laplace_agrees_where_posteriors_are_normal():
    free = ("melanin_load", "abl_fraction", "gain")
    problem = stated(free, share=0.002)
    best = other_process.optimum(problem, jax.random.key(0))
    (seen,) = problem.observations
    constant = np.log(2 * np.pi) * GRID.size / 2 + float(np.log(np.asarray(seen.sd)).sum())
    laplace = 0.5 * np.linalg.slogdet(best.covariance)[1] - best.cost - constant
    found = evidence(problem, key=jax.random.key(1))
    assert abs(found.log_evidence - laplace) < 3 * found.error
    np.testing.assert_allclose(found.z.std(0), np.sqrt(np.diagonal(best.covariance)), rtol=0.1)


def test_importance_of_a_conjugate_problem():
    """As by nested sampling, with an error of hundredths."""
    problem, known, *_ = conjugate(1.0, 0.1)
    (seen,) = problem.observations
    one, same, other = (evidence_by_importance(problem, key=jax.random.key(k)) for k in (0, 0, 1))
    for found in (one, other):
        assert found.error < 0.05
        assert abs(found.log_evidence - known.logpdf(np.asarray(seen.values))) < 4 * found.error
    assert (one.z.tobytes(), one[:2]) == (same.z.tobytes(), same[:2])
    assert one[:2] != other[:2]


@pytest.mark.peer
def test_equal_keys_give_equal_draws():
    problem = stated(("melanin_load", "gain"), solver=KubelkaMunk())
    one, two, other = (
        evidence(problem, live=100, draws=50, key=jax.random.key(k)) for k in (3, 3, 4)
    )
    assert one.z.shape == (50, 2)
    assert one.z.tobytes() == two.z.tobytes()
    assert one[:2] == two[:2] != other[:2]


@pytest.mark.parametrize("given", [{"live": 49}, {"draws": 0}])
def test_too_few_points(given):
    pytest.importorskip("blackjax")
    with pytest.raises(ValueError, match=f"{next(iter(given))}"):
        evidence(stated(("gain",), solver=KubelkaMunk()), **given, key=jax.random.key(0))
