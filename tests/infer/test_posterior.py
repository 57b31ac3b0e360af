"""Posterior sampling: right distributions, the same chain in memory, in a file and after a kill, and
chains that are too short are called so.
"""

import functools
import subprocess
import sys
from typing import NamedTuple

import h5py
import jax
import numpy as np
import pytest

import irisjax as ij
from experiments.closed_formulas import BeerLambert
from irisjax.infer import posterior
from irisjax.infer.importance import Start, importance_sample
from irisjax.infer.posterior import check_run, diagnose, mixing, sample
from irisjax.infer.store import ChainStart, Store

KEY, OTHER = jax.random.key(3), jax.random.key(4)
START = Start(np.zeros(2), np.diag([0.5, 0.0]))
SETTINGS = {"walkers": 16, "max_steps": 600, "key": KEY}


class Ridge(NamedTuple):
    """A curved ridge; as any target, it needs no transport and no JAX."""

    middle: float = 0.5

    @property
    def names(self):
        return ("along", "across")

    def log_density(self, z):
        across = z[:, 1] - 0.3 * z[:, 0] ** 2
        return -0.5 * ((z[:, 0] - self.middle) / 0.8) ** 2 - 0.5 * ((across - 1) / 0.2) ** 2


RIDGE = Ridge()


def rows(path):
    with h5py.File(path) as file:
        return np.asarray(file["chain"]), np.asarray(file["log_density"])


def assert_same(one, other):
    for a, b in zip(rows(one), rows(other), strict=True):
        np.testing.assert_array_equal(a, b)


def interrupted(path, *steps, **settings):
    """A run that stops at each of these steps and is resumed."""
    for when in steps:

        def stop(n, _, when=when):
            if n == when:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            sample(RIDGE, START, store=path, resume=True, progress=stop, **settings)
    return sample(RIDGE, START, store=path, resume=True, **settings)


def assert_same_distribution(one, other):
    error = one.z.std(axis=(0, 1)) * np.sqrt(1 / one.ess_bulk + 1 / other.ess_bulk)
    assert (np.abs(one.z.mean(axis=(0, 1)) - other.z.mean(axis=(0, 1))) < 4 * error).all()


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A chain that nothing interrupted."""
    path = tmp_path_factory.mktemp("whole") / "chain.h5"
    return path, sample(RIDGE, START, store=path, **SETTINGS)


def test_the_chain_in_memory_is_that_in_a_file(whole):
    path, chains = whole
    assert chains.converged
    again = sample(RIDGE, START, **SETTINGS)
    for one, other in zip(chains, again, strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(rows(path)[0][chains.thin - 1 :: chains.thin], chains.z)


def test_burn_in_interrupted_and_resumed(whole, tmp_path, monkeypatch):
    """Where importance weights stay uneven walkers burn in; that too can be interrupted."""
    uneven = functools.partial(importance_sample, effective=10**9)
    monkeypatch.setattr(posterior, "importance_sample", uneven)
    words = []
    chains = sample(
        RIDGE, START, store=tmp_path / "a.h5", progress=lambda *told: words.append(told), **SETTINGS
    )
    assert words[:1] == [(0, "importance sampling")]
    assert [n for n, word in words if word == "burn-in"] == list(range(1, 301))
    interrupted(tmp_path / "b.h5", 250, **SETTINGS)
    assert_same(tmp_path / "a.h5", tmp_path / "b.h5")
    assert_same_distribution(whole[1], chains)


def test_a_chain_that_is_too_slow_is_replaced(whole, tmp_path, monkeypatch):
    """The next one has the same distribution, and is the same if the work is interrupted, at the
    first step, at the last one before the first chain is replaced and later.
    """
    monkeypatch.setattr(posterior, "TAUS", 150)
    monkeypatch.setattr(posterior, "_PATIENCE", 250)
    settings, reported = SETTINGS | {"max_steps": 20_000}, []
    chains = sample(
        RIDGE, START, store=tmp_path / "a.h5", progress=lambda n, _: reported.append(n), **settings
    )
    assert chains.converged
    assert max(reported) > chains.steps > 250
    assert_same_distribution(whole[1], chains)
    interrupted(tmp_path / "b.h5", 1, 250, 400, **settings)
    assert_same(tmp_path / "a.h5", tmp_path / "b.h5")


def test_a_damaged_file_is_refused(whole, tmp_path):
    mine = tmp_path / "mine.h5"
    mine.write_bytes(whole[0].read_bytes()[:1000])
    with pytest.raises(ValueError, match=r"mine.h5: damaged .*; remove it"):
        sample(RIDGE, START, store=mine, resume=True, **SETTINGS)


def test_other_runs_cannot_be_resumed(whole, tmp_path):
    path, _ = whole
    other = sample(RIDGE, START, **SETTINGS | {"key": OTHER, "max_steps": 20})
    assert not np.array_equal(other.z[0], whole[1].z[0])
    with pytest.raises(ValueError, match="exists; resume it or remove it"):
        sample(RIDGE, START, store=path, **SETTINGS)
    seen = ij.spectrum([500.0, 600.0], [0.1, 0.1])
    renamed = ij.problem(seen, free=["gain", "noise"], solver=BeerLambert())
    for target, changed in (
        (Ridge(0.6), {}),
        (RIDGE, {"key": OTHER}),
        (RIDGE, {"walkers": 18}),
        (renamed, {}),
    ):
        settings = {"walkers": 16, "key": KEY} | changed
        with pytest.raises(ValueError, match="other data or settings"):
            check_run(target, path, resume=True, **settings)
    check_run(RIDGE, path, walkers=16, resume=True, key=KEY)
    with pytest.raises(ValueError, match="5 walkers are too few for 2 free parameters"):
        sample(RIDGE, START, walkers=5, key=KEY)


def test_short_chains_are_called_short(whole, tmp_path):
    path, chains = whole
    assert chains.steps >= 50 * chains.tau.max()
    assert chains.ess_bulk.min() >= 1000
    short = sample(RIDGE, START, store=tmp_path / "short.h5", **SETTINGS | {"max_steps": 20})
    assert not short.converged
    assert "20 steps are" in short.reason
    with pytest.raises(ValueError, match="20 steps are"):
        sample(RIDGE, START, throw=True, **SETTINGS | {"max_steps": 20})
    # More steps are the same chain, longer.
    longer = sample(RIDGE, START, store=tmp_path / "short.h5", resume=True, **SETTINGS)
    assert longer.converged
    np.testing.assert_array_equal(rows(tmp_path / "short.h5")[0][:60], rows(path)[0][:60])


def test_moments_are_those_of_the_density(whole):
    """The ridge's moments are known; its second coordinate has skewness and kurtosis."""
    z, error = whole[1].flat, 4.5 / np.sqrt(whole[1].ess_bulk)
    mean, sd = [0.5, 1 + 0.3 * 0.89], [0.8, np.sqrt(0.04 + 0.09 * (2 * 0.64**2 + 4 * 0.64 * 0.25))]
    assert (np.abs(z.mean(0) - mean) < error * sd).all()
    np.testing.assert_allclose(z.std(0), sd, rtol=2 * error.max())
    covariance = 0.3 * 2 * 0.5 * 0.64  # of x and 0.3 x²
    assert np.cov(z.T)[0, 1] == pytest.approx(covariance, abs=2 * error.max())


def test_a_walker_that_never_moves_is_reported():
    places = np.random.default_rng(0).standard_normal((200, 6, 2))
    places[:, 2] = places[0, 2]
    store = Store()
    store.begin(ChainStart("", 2, 0, places[0], places[0, :, 0], None))
    for step in places:
        store.append(step, step[:, 0])
    found = diagnose(store)
    assert not found.converged
    assert found.reason == "a walker never moved"


def test_mixing_counts_independent_draws_and_notices_chains_apart():
    rng = np.random.default_rng(0)
    rhat, bulk, tail = mixing(rng.normal(size=(8, 500)))
    assert rhat == pytest.approx(1, abs=0.01)
    assert bulk == pytest.approx(4000, rel=0.2)
    assert tail == pytest.approx(4000, rel=0.3)
    assert mixing(rng.normal(size=(4, 200)) + np.arange(4)[:, None])[0] > 1.2


@pytest.mark.slow
def test_killed_process_resumes(whole, tmp_path):
    """kill -9, at several moments; the chain in the end is that of a run that nothing killed."""
    path = tmp_path / "chain.h5"
    code = (
        "import sys, jax; jax.config.update('jax_enable_x64', True); sys.path[:0] = ['tests', 'tests/infer'];"
        "import test_posterior as t; t.sample(t.RIDGE, t.START, store=sys.argv[1], resume=True, **t.SETTINGS,"
        "progress=lambda n, w: print(n, flush=True))"
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
    assert_same(whole[0], path)
