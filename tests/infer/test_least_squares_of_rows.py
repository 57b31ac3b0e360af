"""Least squares of many rows in lanes: the minima of single searches, whatever the lanes."""

import inspect

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

from irisjax.infer.least_squares import least_squares, least_squares_of_rows, levenberg_marquardt

# Rosenbrock's valley, as narrow as the row says: some searches take many times as long as others.
NARROW = np.geomspace(0.1, 300.0, 11)
STARTS = np.stack([np.linspace(-1.5, 1.5, 11), np.full(11, 2.0)], axis=1)


def valley(x, weight, narrow):
    return jnp.stack([narrow * (x[1] - x[0] ** 2), 1 - x[0], 0.1 * weight * x[0]]), narrow


def until(tolerance):
    """Return the solver that ends at a tolerance, which may be traced."""
    solver = levenberg_marquardt()
    return eqx.tree_at(lambda s: (s.rtol, s.atol), solver, (tolerance, tolerance))


@eqx.filter_jit
def compiled(rows, starts, max_steps, tolerance, count):
    settings = {"solver": until(tolerance), "lanes": 4, "count": count}
    # Unchecked: its number of steps is traced, so that one program has several.
    search = inspect.unwrap(least_squares_of_rows)
    return search(valley, rows, starts, max_steps=max_steps, **settings)


def in_lanes(rows=NARROW, starts=STARTS, max_steps=200, tolerance=1e-8, count=11):
    """NumPy's arrays of what JAX found."""
    found = compiled(*map(jnp.asarray, (rows, starts, max_steps, tolerance, count)))
    return jax.tree.map(np.asarray, found)


@pytest.fixture(scope="module")
def four_lanes():
    return in_lanes()


@jax.jit
def singles(tolerance):
    """Single searches, and where optimistix's own end."""
    solver = until(tolerance)

    def single(row):
        narrow, start = row
        found = least_squares(valley, narrow, start, solver=solver)
        other = optx.least_squares(lambda x, n: valley(x, 1.0, n)[0], solver, start, narrow)
        return (found.x, found.cost, found.jacobian, found.aux, found.steps), other.value

    return jax.lax.map(single, (jnp.asarray(NARROW), jnp.asarray(STARTS)))


def half_square(x, narrow):
    return 0.5 * (valley(x, 1.0, narrow)[0] ** 2).sum(0)


def test_rows_have_the_minima_of_single_searches(four_lanes):
    each, _ = singles(1e-8)
    mine = four_lanes.x, four_lanes.cost, four_lanes.jacobian, four_lanes.aux, four_lanes.steps
    for found, expected in zip(mine, each, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
    assert len(set(four_lanes.steps.tolist())) > 3
    assert (four_lanes.agreeing == 1).all()


def test_the_minimum_is_the_last_point_that_was_reached():
    """A search to a loose tolerance ends where optimistix's own does, not a step before, and has
    the cost of that point: optimistix returns what the residuals were before.
    """
    (x, cost, *_), expected = singles(1e-2)
    loose = in_lanes(tolerance=1e-2)
    np.testing.assert_allclose(x, expected, rtol=1e-9)
    np.testing.assert_allclose(cost, half_square(x.T, NARROW), rtol=1e-12)
    np.testing.assert_allclose(loose.x, expected, rtol=1e-6)
    np.testing.assert_allclose(loose.cost, half_square(loose.x.T, NARROW), rtol=1e-9)


def test_a_row_does_not_depend_on_its_lane(four_lanes):
    others = in_lanes(NARROW[::-1], STARTS[::-1])
    np.testing.assert_array_equal(others.x[::-1], four_lanes.x)
    np.testing.assert_array_equal(others.steps[::-1], four_lanes.steps)


def test_a_search_that_does_not_end_says_so(four_lanes):
    most = int(np.median(four_lanes.steps))
    few = in_lanes(max_steps=most)
    exhausted = np.asarray(few.result == optx.RESULTS.nonlinear_max_steps_reached)
    np.testing.assert_array_equal(exhausted, four_lanes.steps > most)
    assert 0 < exhausted.sum() < len(NARROW)
    np.testing.assert_array_equal(few.agreeing, ~exhausted)
    np.testing.assert_array_equal(few.x[~exhausted], four_lanes.x[~exhausted])


def test_a_row_that_is_no_number_fails_alone(four_lanes):
    others = np.arange(len(NARROW)) != 3
    found = in_lanes(np.where(others, NARROW, np.nan))
    np.testing.assert_array_equal(found.x[others], four_lanes.x[others])
    assert found.agreeing[3] == 0
    assert np.isinf(found.cost[3])
    assert found.steps[3] == 1


@pytest.mark.parametrize("count", [3, 6])
def test_the_first_rows_alone_are_searched(four_lanes, count):
    """They may be fewer than the lanes."""
    some = in_lanes(count=count)
    np.testing.assert_array_equal(some.x[:count], four_lanes.x[:count])
    np.testing.assert_array_equal(some.steps[:count], four_lanes.steps[:count])
    assert not some.steps[count:].any()
