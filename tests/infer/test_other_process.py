"""The other process beside a fit: its optimum, what is said, and what the data prefer."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from irisjax.infer import other_process
from irisjax.infer.fit import fit
from irisjax.infer.observation import with_values
from irisjax.infer.other_process import Comparison, Interval, Moved

GRID = np.arange(400.0, 701.0, 20.0)
FREE = ("melanin_load", "abl_fraction", "gain", "noise")


@pytest.fixture(scope="module")
def read():
    """Spectra without noise of one iris by either process, and the problems that read them."""
    with jax.enable_x64(True):
        blank = ij.spectrum(GRID, np.full(GRID.size, 0.05), sd=np.full(GRID.size, 0.01))
        by = {
            p.transport: ij.problem(blank, free=FREE, process=p)
            for p in (ij.ILIT_2006, ij.DEPTH_RESOLVED)
        }
        eyes = {}
        for name, problem in by.items():
            z = problem.standard(
                {"melanin_load": 0.1, "abl_fraction": 0.4, "gain": 1.0, "noise": 1.0}
            )
            (values,) = problem.predict(z)
            eyes[name] = with_values(blank, values, 0.02 * values + 2e-4)
    return by, eyes


@pytest.mark.slow  # compiles a search
def test_its_search_finds_what_fit_finds(read):
    by, eyes = read
    problem = by["depth-resolved"].with_observations(eyes["whole-layer"])
    key = jax.random.key(0)
    found, expected = other_process.optimum(problem, key), fit(problem, key=key)
    moving = [n != "noise" for n in problem.free]
    np.testing.assert_allclose(found.z[moving], expected.z[np.array(moving)], atol=1e-4)
    np.testing.assert_allclose(found.chi_square, expected.chi_square, rtol=1e-4)
    np.testing.assert_allclose(found.cost, expected.cost, rtol=1e-6)
    assert found.degrees == expected.degrees
    kept = np.ix_(moving, moving)
    np.testing.assert_allclose(found.covariance[kept], expected.covariance[kept], rtol=1e-3)


@pytest.mark.heavy
@pytest.mark.parametrize("maker", ["whole-layer", "depth-resolved"])
def test_the_data_prefer_the_process_that_made_them(read, maker):
    by, eyes = read
    for reader, problem in by.items():
        mine = problem.with_observations(eyes[maker])
        own = other_process.optimum(mine, jax.random.key(1))
        found = other_process.compare(mine, own, key=jax.random.key(2))
        assert found.process == other_process.other_of(mine.process) != mine.process
        assert found.preferred == (reader != maker)
        load = found.moved["melanin_load"]
        right = load.own if reader == maker else load.other
        assert right.low < 0.1 < right.high
        # ILIT takes the darkness of radiative transfer for several times as much melanin.
        ratio = load.other.value / load.own.value
        assert ratio < 0.6 if reader == "whole-layer" else ratio > 1.7
        lines = other_process.comparison_in_words(found)
        assert lines[0].startswith("WARNING: the pigments depend on the model")
        assert ("the data prefer" in lines[-1]) == found.preferred


@pytest.mark.heavy
def test_intervals_of_a_posterior_take_the_place_of_the_fits(read):
    by, eyes = read
    mine = by["whole-layer"].with_observations(eyes["whole-layer"])
    own = other_process.optimum(mine, jax.random.key(1))
    given = {"melanin_load": Interval(0.2, 0.1, 0.3)}
    moved = other_process.compare(mine, own, key=jax.random.key(2), intervals=given).moved
    assert moved["melanin_load"].own == given["melanin_load"]
    assert moved["abl_fraction"].own != given["melanin_load"]


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
    (line,) = other_process.comparison_in_words(Comparison(ij.DEPTH_RESOLVED, moved, -5.0))
    assert line.startswith("WARNING") == differs
    assert line.endswith(said)


def test_noise_widens_what_the_data_say_and_not_the_prior(read):
    """As a fit whose noise is stated that much larger."""
    by, eyes = read
    one = by["whole-layer"].with_observations(eyes["whole-layer"])
    (seen,) = one.observations
    larger = one.with_observations(with_values(seen, seen.values, 3 * seen.sd))
    narrow, wide = (other_process.optimum(p, jax.random.key(1)) for p in (one, larger))
    found = other_process.covariance_at(narrow.covariance, 3.0)
    np.testing.assert_allclose(found, wide.covariance, atol=0.02)
    np.testing.assert_allclose(other_process.covariance_at(np.eye(3), 7.0), np.eye(3))
    intervals = other_process.intervals_of(one, narrow, 3.0)
    for name, expected in other_process.intervals_of(larger, wide, 1.0).items():
        np.testing.assert_allclose(intervals[name], expected, rtol=0.05)


def test_noise_is_no_less_than_stated():
    def left(chi_square):
        z = np.zeros(1)
        fits = (other_process.Optimum(z, np.eye(1), c, 10, c / 2) for c in chi_square)
        return other_process.noise_left(*fits)

    assert left((5.0, 90.0)) == 1
    assert left((90.0, 40.0)) == pytest.approx(2)
    assert jnp.isfinite(left((0.0, 0.0)))
