"""The other process beside a fit: what is said, and what the data prefer."""

import inspect
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from irisjax.cli.sentences import process_lines
from irisjax.infer.fit import fit
from irisjax.infer.observation import with_values
from irisjax.infer.other_process import (
    Interval,
    Moved,
    ProcessComparison,
    compare_processes,
    covariance_at,
    intervals_of,
    noise_left,
    other_of,
)

GRID = np.arange(400.0, 701.0, 20.0)
FREE = ("melanin_load", "abl_fraction", "gain", "noise")
PROCESSES = (ij.ILIT_2006, ij.DEPTH_RESOLVED)


@pytest.fixture(scope="module")
def read():
    """Noiseless spectra of one iris by either process, and the fits of both by both."""
    blank = ij.spectrum(GRID, np.full(GRID.size, 0.05), sd=np.full(GRID.size, 0.01))
    by = [ij.problem(blank, free=FREE, process=p) for p in PROCESSES]
    truth = {"melanin_load": 0.1, "abl_fraction": 0.4, "gain": 1.0, "noise": 1.0}
    eyes = []
    for problem in by:
        (values,) = problem.predict(problem.standard(truth))
        eyes.append(with_values(blank, values, 0.02 * values + 2e-4))
    return [
        [(mine := problem.with_observations(eye), fit(mine, key=jax.random.key(1))) for eye in eyes]
        for problem in by
    ]


@pytest.mark.parametrize("maker", [0, 1], ids=["ILIT", "radiative transfer"])
def test_the_data_prefer_the_process_that_made_them(read, maker):
    for reader in (0, 1):
        (problem, own), (other_problem, other) = read[reader][maker], read[1 - reader][maker]
        found = compare_processes(problem, own, other_problem, other)
        assert found.process == other_of(problem.process) == PROCESSES[1 - reader]
        assert found.preferred == (reader != maker)
        load = found.moved["melanin_load"]
        right = load.own if reader == maker else load.other
        assert right.low < 0.1 < right.high
        # ILIT takes the darkness of radiative transfer for several times as much melanin.
        ratio = load.other.value / load.own.value
        assert ratio < 0.6 if reader == 0 else ratio > 1.7
        lines = process_lines(found)
        assert lines[0].startswith("WARNING: the pigments depend on the model")
        assert ("the data prefer" in lines[-1]) == found.preferred
        given = {"melanin_load": Interval(0.2, 0.1, 0.3)}
        moved = compare_processes(problem, own, other_problem, other, intervals=given).moved
        assert moved["melanin_load"].own == given["melanin_load"]
        assert moved["abl_fraction"] == found.moved["abl_fraction"]


@pytest.mark.parametrize(
    ("other", "differs", "said"),
    [
        ((0.2, 0.15, 0.25), True, "2 times less"),
        ((0.8, 0.7, 0.9), True, "2 times more"),
        ((0.41, 0.3, 0.5), False, "about the same"),
        ((0.2, 0.15, 0.45), False, "2 times less"),
    ],
)
def test_what_is_said(other, differs, said):
    moved = {"melanin_load": Moved(Interval(0.4, 0.35, 0.45), Interval(*other))}
    assert moved["melanin_load"].differs == differs
    (line,) = process_lines(ProcessComparison(ij.DEPTH_RESOLVED, moved, -5.0))
    assert line.startswith("WARNING") == differs
    assert line.endswith(said)


def test_noise_widens_what_the_data_say_and_not_the_prior(read):
    """As a fit whose noise is stated that much larger."""
    one, narrow = read[0][0]
    (seen,) = one.observations
    larger = one.with_observations(with_values(seen, seen.values, 3 * seen.sd))
    wide = fit(larger, key=jax.random.key(1))
    found = covariance_at(np.asarray(narrow.covariance), 3.0)
    fitted = np.ix_([0, 1, 2], [0, 1, 2])
    np.testing.assert_allclose(found[fitted], wide.covariance[fitted], atol=0.02)
    np.testing.assert_allclose(covariance_at(np.eye(3), 7.0), np.eye(3))
    intervals = intervals_of(one, narrow, 3.0)
    for name, expected in intervals_of(larger, wide, 1.0).items():
        if name != "noise":
            np.testing.assert_allclose(intervals[name], expected, rtol=0.05)


def test_noise_is_no_less_than_stated():
    def left(*chi_squares):
        fits = (SimpleNamespace(chi_square=c, degrees=10) for c in chi_squares)
        # Unchecked: these are no fits.
        return inspect.unwrap(noise_left)(*fits)

    assert left(5.0, 90.0) == 1
    assert left(90.0, 40.0) == pytest.approx(2)
    assert jnp.isfinite(left(0.0, 0.0))
