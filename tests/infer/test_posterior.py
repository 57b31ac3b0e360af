"""Posterior sampling: right distributions, chains that survive being killed,
diagnostics that tell.
"""

import shutil
import subprocess
import sys
import tracemalloc

import h5py
import jax
import numpy as np
import pytest

import irisjax as ij
from common import heavily, slowly
from irisjax.infer import importance, posterior
from irisjax.infer.analytic import BeerLambert, FirstOrder
from irisjax.infer.fit import fit
from irisjax.infer.posterior import sample
from irisjax.infer.resume import check_run
from irisjax.infer.summary import check, summarise

GRID = ij.wavelengths(400, 700, 30)
KEY, OTHER = jax.random.key(3), jax.random.key(4)
TRUTH = {"melanin_load": 0.1, "hemoglobin": 0.08, "pheomelanin_share": 0.4, "abl_fraction": 0.6}


def stated(seed=0, free=("melanin_load", "hemoglobin", "noise"), **options):
    """A problem that compiles in a moment: the closed formula in place of transport."""
    problem = ij.problem(
        ij.spectrum(GRID, np.zeros(GRID.size)), free=free, solver=BeerLambert(), **options
    )
    z = problem.standard({**TRUTH, "noise": 1.0})
    values = problem.simulate(z, jax.random.key(seed))[0]
    return problem.with_observations(ij.spectrum(GRID, np.asarray(values)))


def rows(path):
    with h5py.File(path) as file:
        return np.asarray(file["chain"]["chain"]), np.asarray(file["chain"]["log_prob"])


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A chain no one interrupted."""
    path = tmp_path_factory.mktemp("whole") / "chain.h5"
    problem = stated()
    return problem, path, sample(problem, path, walkers=16, key=KEY, max_steps=600)


@pytest.mark.parametrize("when", [1, slowly(100), heavily(240)])
def test_interrupted_and_resumed_is_the_same_chain(whole, tmp_path, when):
    problem, path, _ = whole
    mine = tmp_path / "chain.h5"

    def stop(n, _):
        if n == when:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sample(problem, mine, walkers=16, key=KEY, max_steps=600, progress=stop)
    sample(problem, mine, walkers=16, key=KEY, max_steps=600, resume=True)
    for a, b in zip(rows(path), rows(mine), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.heavy
@pytest.mark.parametrize("when", [100, slowly(250), slowly(400)])
def test_burn_in_interrupted_and_resumed(tmp_path, monkeypatch, when):
    """Where importance weights stay uneven walkers burn in; that too can be interrupted."""
    monkeypatch.setattr(importance, "EFFECTIVE", 1e9)
    problem, paths = stated(), [tmp_path / "whole.h5", tmp_path / "mine.h5"]
    options = {"walkers": 16, "key": KEY, "max_steps": 400}

    def stop(n, _):
        if n == when:
            raise KeyboardInterrupt

    chains = sample(problem, paths[0], **options)
    with pytest.raises(KeyboardInterrupt):
        sample(problem, paths[1], progress=stop, **options)
    sample(problem, paths[1], resume=True, **options)
    for a, b in zip(*(rows(path) for path in paths), strict=True):
        np.testing.assert_array_equal(a, b)
    # Importance sampling begins where burn-in ends.
    assert chains.converged
    monkeypatch.undo()
    direct = sample(problem, tmp_path / "direct.h5", **options)
    assert direct.steps <= chains.steps
    error = chains.z.std(axis=(0, 1)) * np.sqrt(1 / chains.ess_bulk + 1 / direct.ess_bulk)
    assert (np.abs(direct.z.mean(axis=(0, 1)) - chains.z.mean(axis=(0, 1))) < 4 * error).all()


def test_torn_step_and_damaged_file_are_mended(whole, tmp_path):
    problem, path, _ = whole
    for fault in ("torn", "damaged"):
        mine = tmp_path / f"{fault}.h5"
        shutil.copy(path, mine)
        shutil.copy(path.with_name("chain.h5.bak"), mine.with_name(f"{fault}.h5.bak"))
        if fault == "torn":
            with h5py.File(mine, "a") as file:
                file["chain"]["chain"][-1] = 0.25
        else:
            data = mine.read_bytes()
            mine.write_bytes(data[: len(data) // 2])
        sample(problem, mine, walkers=16, key=KEY, max_steps=600, resume=True)
        for a, b in zip(rows(path), rows(mine), strict=True):
            np.testing.assert_array_equal(a, b)


def test_seeds_and_settings_count(whole, tmp_path):
    problem, path, _ = whole
    other = tmp_path / "other.h5"
    sample(problem, other, walkers=16, key=OTHER, max_steps=400)
    assert not np.array_equal(rows(path)[0][:400], rows(other)[0][:400])
    with pytest.raises(ValueError, match="exists"):
        sample(problem, other, walkers=16, key=OTHER)
    with pytest.raises(ValueError, match="other data or settings"):
        sample(stated(seed=9), other, walkers=16, key=OTHER, resume=True)
    with pytest.raises(ValueError, match="too few"):
        sample(problem, tmp_path / "few.h5", walkers=6, key=KEY)


def test_other_settings_cannot_be_resumed(whole, tmp_path):
    """Quantity, incidence, first surface and solver belong to a chain too."""
    path = tmp_path / "chain.h5"
    shutil.copy(whole[1], path)
    seen = whole[0].observations[0]
    for changed in (
        {"quantity": "radiance"},
        {"cos_incidence": 0.5},
        {"cos_incidence": ij.DIFFUSE},
        {"first_surface": False},
        {"solver": FirstOrder()},
    ):
        solver = changed.pop("solver", BeerLambert())
        again = ij.problem(
            ij.spectrum(GRID, np.asarray(seen.values), **changed),
            free=["melanin_load", "hemoglobin", "noise"],
            solver=solver,
        )
        with pytest.raises(ValueError, match="other data or settings"):
            check_run(again, path, walkers=16, resume=True, key=KEY)
    check_run(whole[0], path, walkers=16, resume=True, key=KEY)


def test_short_chains_are_called_short(whole, tmp_path):
    problem, _, chains = whole
    assert chains.converged
    assert chains.steps >= 50 * chains.tau.max()
    assert chains.ess_bulk.min() >= 1000
    short = sample(problem, tmp_path / "short.h5", walkers=16, key=KEY, max_steps=20)
    assert not short.converged
    assert "20 steps are" in short.reason
    # More steps are the same chain, longer.
    longer = sample(problem, tmp_path / "short.h5", walkers=16, key=KEY, max_steps=600, resume=True)
    assert longer.converged
    np.testing.assert_array_equal(rows(tmp_path / "short.h5")[0][:60], rows(whole[1])[0][:60])


@pytest.mark.slow  # long chains
def test_memory_does_not_grow_with_the_chain(whole, tmp_path, monkeypatch):
    """Ten times the steps, resumed or not: less is held at any moment than their log probabilities
    would take.
    """
    problem, best = whole[0], fit(whole[0], starts=1)
    monkeypatch.setattr(
        posterior, "density", lambda _: lambda z: -0.5 * np.square(np.asarray(z)).sum(axis=1)
    )
    # As with the real numbers: a short burn-in, never long enough, and fewer steps kept than either
    # run has.
    for name, value in (
        ("TAUS", np.inf),
        ("_SPREAD", 10),
        ("_BURN", 20),
        ("_MOST_KEPT", 20),
        ("_LESSONS", 0),
    ):
        monkeypatch.setattr(posterior, name, value)
    walkers, peaks = 256, {}
    for resume in (False, True):
        for steps in (20, 30, 300):  # the first warms up
            tracemalloc.start()
            sample(
                problem,
                tmp_path / f"{steps}.h5",
                walkers=walkers,
                start=best,
                max_steps=steps,
                resume=resume,
                key=KEY,
            )
            peaks[steps] = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
        assert peaks[300] - peaks[30] < 270 * walkers * 8


@pytest.mark.heavy
def test_posterior_agrees_with_a_grid(tmp_path):
    """Two parameters: mean, spread and correlation against brute force."""
    problem = stated()
    problem = ij.problem(
        problem.observations[0],
        free=["melanin_load", "hemoglobin"],
        fixed={"noise": 1.0},
        solver=BeerLambert(),
    )
    chains = sample(problem, tmp_path / "chain.h5", walkers=32, key=KEY)
    assert chains.converged
    z = chains.z.reshape(-1, 2)
    best = fit(problem, starts=1)
    width = 6 * np.sqrt(np.diag(best.covariance))
    axes = [np.linspace(c - w, c + w, 201) for c, w in zip(np.asarray(best.z), width, strict=True)]
    nodes = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], 1)
    log_p = np.asarray(jax.jit(jax.vmap(lambda x: problem.log_posterior(x)))(nodes))
    p = np.exp(log_p - log_p.max())
    p /= p.sum()
    mean = p @ nodes
    covariance = (nodes - mean).T @ ((nodes - mean) * p[:, None])
    error = np.sqrt(np.diag(covariance) / chains.ess_bulk)
    assert (np.abs(z.mean(0) - mean) < 4.5 * error).all()
    np.testing.assert_allclose(z.std(0), np.sqrt(np.diag(covariance)), rtol=0.08)
    assert np.corrcoef(z.T)[0, 1] == pytest.approx(
        covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1]), abs=0.06
    )


def test_summary_and_predictive_check(whole):
    problem, _, chains = whole
    table = {row.parameter: row for row in summarise(problem, chains)}
    assert list(table)[:3] == ["melanin_load", "hemoglobin", "noise"]
    load = table["melanin_load"]
    assert load.q2_5 < load.q16 < load.median < load.q84 < load.q97_5
    assert 0.9 < load.contraction < 1
    assert table["eumelanin"].unit == "mg/ml"
    assert check(problem, chains, key=KEY).warning is None


@pytest.mark.slow  # 15 s of sampling
def test_wrong_model_is_noticed(tmp_path):
    """A step that no pigment makes: smooth residuals, and noise beyond what was stated."""
    problem = stated()
    y = np.asarray(problem.observations[0].values) * np.where(GRID < 550, 1.0, 1.6)
    problem = problem.with_observations(ij.spectrum(GRID, y))
    chains = sample(problem, tmp_path / "chain.h5", walkers=16, key=KEY, max_steps=600)
    assert "does not produce these data" in (check(problem, chains, key=KEY).warning or "")


@pytest.mark.slow
def test_killed_process_resumes(whole, tmp_path):
    """kill -9, at several moments; the chain in the end is that of a run no one killed."""
    path = tmp_path / "chain.h5"
    code = (
        "import sys, jax; jax.config.update('jax_enable_x64', True); sys.path[:0] = ['tests', 'tests/infer'];"
        "import test_posterior as t; t.sample(t.stated(), sys.argv[1], walkers=16, key=t.KEY, max_steps=600,"
        "resume=True, progress=lambda n, w: print(n, flush=True))"
    )
    for stop in (30, 150, 220, None):
        with subprocess.Popen(
            [sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE, text=True
        ) as run:
            assert run.stdout is not None
            for line in run.stdout:
                if stop is not None and int(line) >= stop:
                    run.kill()
                    break
        assert (run.returncode == 0) == (stop is None)
    for a, b in zip(rows(whole[1]), rows(path), strict=True):
        np.testing.assert_array_equal(a, b)
