"""Least squares: several searches from different starts, and more of them while they disagree."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from equinox.internal import nondifferentiable
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from irisjax._types import PRNGKey, Scalar
from irisjax.numerics import linear

_Count = Int[Array, ""]


class Minimum(NamedTuple):
    """The best of several searches.

    Attributes:
        x: Where it ended, with this `cost`, ½ Σ residuals², and these derivatives of the residuals.
        aux: What the function returned there beside its residuals.
        searches: Number of searches, of which `agreeing` converged to this cost and `elsewhere` to
            a higher one.
    """

    x: Float[Array, " moving"]
    cost: Scalar
    jacobian: Float[Array, "residuals moving"]
    aux: Any
    steps: _Count
    result: optx.RESULTS
    searches: _Count
    agreeing: _Count
    elsewhere: _Count

    @property
    def covariance(self) -> Float[Array, "moving moving"]:
        """(JᵀJ)⁻¹."""
        jacobian = self.jacobian
        inverse = linear.solve(jacobian.T @ jacobian, jnp.eye(self.x.size, dtype=self.x.dtype))
        return 0.5 * (inverse + inverse.T)  # rounding does not keep it symmetric


def least_squares(
    residuals: Callable[[Any, Any, Any], Any],
    args: Any,
    start: Float[Array, " moving"],
    *,
    weights: Float[Array, " stages"] | None = None,
    solver: optx.AbstractGaussNewton[Array, Array, Any] | None = None,
    starts: int = 1,
    rounds: int = 1,
    max_steps: int = 200,
    key: PRNGKey | None = None,
) -> Minimum:
    """Find the lowest ½ Σ residuals² of `starts` searches, one after another, and of as many again,
    up to `rounds` times, while fewer than two agree. Call it inside a jitted function.

    Args:
        residuals: Pure function `residuals(x, weight, args)` that returns residuals and whatever
            else is of use; `weight` is that of the priors.
        args: Whatever else the residuals depend on; not differentiable.
        start: Where the first search starts; the others start from standard normal draws.
        weights: Weights of the priors, by default 1, one search after another; the last one counts.
            A search that shall end with priors of little weight should begin with more: far outside
            nothing depends on some parameters any more.
        solver: Rule of the steps; default `levenberg_marquardt()`.
        starts: Number of searches in a round.
        rounds: Largest number of rounds.
        max_steps: Largest number of steps of a search at each weight.
        key: Source of the draws; not needed for a single start.

    Raises:
        ValueError: If there are several starts and no key.
    """
    if key is None and starts * rounds > 1:
        raise ValueError(
            f"starts={starts}, rounds={rounds} draw all but the first at random: give a key"
        )
    solver = levenberg_marquardt() if solver is None else solver
    weights = jnp.ones(1, start.dtype) if weights is None else weights
    args = nondifferentiable(args, name="the data of least squares")

    search = partial(_search, _with_jacobian(residuals), args, solver, weights, max_steps)
    points = start[None]
    if key is not None:
        keys = jax.vmap(partial(jax.random.fold_in, key))(jnp.arange(rounds))
        draws = jax.vmap(lambda k: jax.random.normal(k, (starts, start.size), start.dtype))(keys)
        points = draws.reshape(-1, start.size).at[0].set(start)

    def search_next(state):
        count, searches = state
        result = search(points[count])
        return count + 1, jax.tree.map(lambda rows, x: rows.at[count].set(x), searches, result)

    def incomplete(state):
        count, searches = state
        agree = _best(searches, count)[1] >= 2
        return (count == 0) | (count % starts > 0) | ((count < rounds * starts) & ~agree)

    # A loop that is mapped runs as many rounds for every problem as the slowest one needs.
    shapes = eqx.filter_eval_shape(search, start)
    empty = jax.tree.map(lambda s: jnp.zeros((rounds * starts, *s.shape), s.dtype), shapes)
    count, searches = jax.lax.while_loop(incomplete, search_next, (jnp.zeros((), int), empty))
    best, agreeing, elsewhere = _best(searches, count)
    x, cost, jacobian, aux, steps, result = jax.tree.map(lambda rows: rows[best], searches)
    return Minimum(x, cost, jacobian, aux, steps, result, count, agreeing, elsewhere)


def least_squares_of_rows(
    residuals: Callable[[Any, Any, Any], Any],
    rows: Any,
    starts: Float[Array, "rows moving"],
    *,
    solver: optx.AbstractGaussNewton[Array, Array, Any],
    lanes: int,
    max_steps: int = 200,
    count: Any,
) -> Minimum:
    """Search from one start for each of many rows, as `least_squares` does for one problem. The
    searches run in lanes that do not wait for each other: a lane whose search has ended takes the
    next row. Call it inside a jitted function.

    Args:
        residuals: As for `least_squares`; its `args` are one row, its `weight` is 1.
        rows: Arrays whose first axis is that of the rows; not differentiable.
        starts: Where the search of each row starts.
        solver: Rule of the steps.
        lanes: Number of searches that run at a time, at least 1.
        max_steps: Largest number of steps of a search, at least 1.
        count: Number of rows that are searched, the first ones.

    Returns:
        The minima, rows first, zeros where no search was; map over them before you ask for a
        covariance.
    """
    rows = nondifferentiable(rows, name="the data of least squares")
    function, weight = _with_jacobian(residuals), jnp.ones((), starts.dtype)
    size, tags = len(starts), frozenset[object]()

    def pick(places):
        places = jnp.minimum(places, size - 1)
        return starts[places], jax.tree.map(lambda array: array[places], rows)

    def begin(x, row):
        residual, aux = eqx.filter_eval_shape(function, x, (weight, row))
        return solver.init(function, x, (weight, row), {}, residual, aux, tags)

    places = jnp.arange(lanes)
    x, row = pick(places)
    dynamic, static = eqx.partition(eqx.filter_vmap(begin)(x, row), eqx.is_array)

    def step(x, dynamic, steps, row):
        args, state, steps = (weight, row), eqx.combine(static, dynamic), steps + 1
        # The solver returns the aux of the point before; its state has that of x.
        x, state, _ = solver.step(function, x, args, {}, state, tags)
        done, result = solver.terminate(function, x, args, {}, state, tags)
        _, cost, *_ = state.aux
        finite = jnp.isfinite(x).all() & jnp.isfinite(cost)
        result = optx.RESULTS.where(finite, result, optx.RESULTS.nonfinite)
        failed = result != optx.RESULTS.successful
        exhausted = (steps >= max_steps) & ~done & ~failed
        result = optx.RESULTS.where(exhausted, optx.RESULTS.nonlinear_max_steps_reached, result)
        end = state.aux, steps, result
        return x, eqx.filter(state, eqx.is_array), steps, done | failed | exhausted, end

    def advance(state):
        places, x, dynamic, steps, ends = state
        x, dynamic, steps, ended, end = eqx.filter_vmap(step)(x, dynamic, steps, pick(places)[1])
        # A lane without a row has a place behind all rows: what it finds is dropped.
        stored = jnp.where(ended & (places < count), places, size)
        ends = jax.tree.map(lambda rows, new: rows.at[stored].set(new, mode="drop"), ends, end)
        # Places are dealt in order, and the lane with the last one still has it: go on from there.
        places = jnp.where(ended, places.max() + jnp.cumsum(ended), places)
        first, row = pick(places)
        begun = first, eqx.filter(eqx.filter_vmap(begin)(first, row), eqx.is_array), 0 * steps

        def renew(new, old):
            return jnp.where(ended.reshape(-1, *(1,) * (old.ndim - 1)), new, old)

        return places, *jax.tree.map(renew, begun, (x, dynamic, steps)), ends

    state = x, dynamic, jnp.zeros_like(places)
    *_, shapes = eqx.filter_eval_shape(eqx.filter_vmap(step), *state, row)
    ends = jax.tree.map(lambda s: jnp.zeros((size, *s.shape[1:]), s.dtype), shapes)
    state = places, *state, ends
    *_, ends = jax.lax.while_loop(lambda state: (state[0] < count).any(), advance, state)
    (x, cost, jacobian, aux), steps, result = ends
    cost, one = jnp.where(jnp.isfinite(cost), cost, jnp.inf), jnp.ones_like(steps)
    converged = (result == optx.RESULTS.successful).astype(one.dtype)
    return Minimum(x, cost, jacobian, aux, steps, result, one, converged, 0 * one)


def levenberg_marquardt(
    rtol: float = 1e-8, atol: float = 1e-8
) -> optx.LevenbergMarquardt[Array, Array, Any]:
    """Return optimistix's Levenberg–Marquardt with the linear solver `NORMAL_EQUATIONS`."""
    return optx.LevenbergMarquardt(rtol, atol, linear_solver=NORMAL_EQUATIONS)


class _NormalEquations(lx.AbstractLinearSolver[Any]):
    """Linear least squares by the normal equations, for batches (see `numerics.linear`).

    With priors among the residuals the equations are well conditioned; without them rounding may
    change a step of an iteration, but not where it ends.
    """

    def init(self, operator: Any, options: Any) -> Any:
        return operator.as_matrix(), operator.in_structure()

    def compute(
        self, state: Any, vector: Any, options: Any
    ) -> tuple[Any, lx.RESULTS, dict[str, Any]]:
        matrix, structure = state
        gram = matrix.T @ matrix
        # A coordinate on which no residual depends stays as it is.
        gram = gram + jnp.diag(jnp.where(jnp.diag(gram) <= 0, 1.0, 0.0))
        scale = 1 / jnp.sqrt(jnp.diag(gram))
        right = scale * (matrix.T @ ravel_pytree(vector)[0])
        x = scale * linear.solve(scale[:, None] * gram * scale[None], right)
        _, unravel = ravel_pytree(jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), structure))
        return unravel(x), lx.RESULTS.successful, {}

    def transpose(self, state: Any, options: Any) -> Any:
        # lineax asks for this method only where a solution is differentiated.
        raise NotImplementedError("a solution by the normal equations has no derivatives")

    def conj(self, state: Any, options: Any) -> Any:
        return state, options

    def assume_full_rank(self) -> bool:
        return True  # the damping term makes the matrix regular


NORMAL_EQUATIONS: lx.AbstractLinearSolver[Any] = _NormalEquations()
"""Linear least squares by the normal equations, for batches."""


def _with_jacobian(residuals: Callable[[Any, Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """The residuals with their Jacobian as the derivative that the solver takes: its program then
    holds the model once.
    """

    @eqx.filter_jit  # traced once, however often optimistix evaluates it
    def linearised(x, args):
        def twice(x):
            values, aux = residuals(x, *args)
            return values, (values, aux)

        point = jax.lax.stop_gradient(x)
        jacobian, (values, aux) = jax.jacfwd(twice, has_aux=True)(point)
        return values + jacobian @ (x - point), (point, 0.5 * (values**2).sum(), jacobian, aux)

    return linearised


def _search(function, args, solver, weights, max_steps, x):
    """Run one search, with the priors at one weight after another."""

    def at_weight(x, weight):
        end = optx.least_squares(
            function, solver, x, (weight, args), has_aux=True, max_steps=max_steps, throw=False
        )
        # optimistix returns the aux of the point before; its state holds that of the value.
        return end.value, (end.state.aux, end.stats["num_steps"], end.result)

    _, (ends, steps, results) = jax.lax.scan(at_weight, x, weights)
    (x, cost, jacobian, aux), result = jax.tree.map(lambda stages: stages[-1], (ends, results))
    cost = jnp.where(jnp.isfinite(cost), cost, jnp.inf)
    return x, cost, jacobian, aux, steps.sum(), result


def _best(searches: Any, count: _Count) -> tuple[_Count, _Count, _Count]:
    """Place of the lowest cost, how many searches converged there, and how many elsewhere."""
    _, costs, *_, results = searches
    valid = jnp.arange(costs.size) < count
    costs = jnp.where(valid, costs, jnp.inf)
    converged = valid & (results == optx.RESULTS.successful)
    # Among equal costs one that converged.
    best = jnp.argmin(costs + jnp.where(converged, 0.0, 1e-9 * costs + 1e-12))
    level = costs <= costs[best] * (1 + 1e-6) + 1e-9
    return best, (converged & level).sum(), (converged & ~level).sum()
