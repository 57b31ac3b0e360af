"""Least squares: several searches from different starts, and more of them while they disagree."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Float, Int

from irisjax._types import PRNGKey, Scalar
from irisjax.numerics import linear
from irisjax.numerics.portions import in_pieces


class Found(NamedTuple):
    """The best of several searches.

    Attributes:
        x: Where it ended.
        cost: ½ Σ residuals² there.
        steps: Number of its steps.
        result: optimistix's status of it.
        searches: Number of searches.
        agreeing: How many of them converged to this cost.
        elsewhere: How many converged to a higher one.
    """

    x: Float[Array, " moving"]
    cost: Scalar
    steps: Int[Array, ""]
    result: optx.RESULTS
    searches: Int[Array, ""]
    agreeing: Int[Array, ""]
    elsewhere: Int[Array, ""]


def least_squares(
    residuals: Callable[[Any, Any, Any], Any],
    args: Any,
    start: Float[Array, " moving"],
    *,
    weights: Float[Array, " stages"] | None = None,
    solver: optx.AbstractLeastSquaresSolver | None = None,
    starts: int = 1,
    rounds: int = 1,
    max_steps: int = 200,
    elements: int = 1,
    key: PRNGKey | None = None,
) -> Found:
    """Find the lowest ½ Σ residuals² of `starts` searches, and of as many again, up to `rounds`
    times, while fewer than two agree. Call it inside a jitted function.

    Args:
        residuals: Pure function `residuals(x, weight, args)`, where `weight` is that of the priors.
        args: Whatever else the residuals depend on.
        start: Where the first search starts; the others start from standard normal draws.
        weights: Weights of the priors, one search after another; the last one counts. By default
            there is one, 1. A search that shall end with priors of little weight should begin with
            more: far outside nothing depends on some parameters any more.
        solver: Rule of the steps; default `levenberg_marquardt()`.
        starts: Number of searches in a round.
        rounds: Largest number of rounds.
        max_steps: Largest number of steps of a search at each weight.
        elements: Numbers in the largest array that one evaluation makes.
        key: Source of the draws; not needed for a single start.
    """
    solver = levenberg_marquardt() if solver is None else solver
    weights = jnp.ones(1, start.dtype) if weights is None else weights
    dense = _with_dense_jacobian(residuals)

    def residuals_and_cost(x, weight):
        r = dense(x, weight, args)
        return r, 0.5 * (r * r).sum()

    def at_weight(x, weight):
        ended = optx.least_squares(
            residuals_and_cost, solver, x, weight, has_aux=True, max_steps=max_steps, throw=False
        )
        return ended.value, (ended.stats["num_steps"], ended.result, ended.aux)

    def search(x):
        x, (steps, results, costs) = jax.lax.scan(at_weight, x, weights)
        result = jax.tree.map(lambda code: code[-1], results)
        return _End(x, jnp.where(jnp.isfinite(costs[-1]), costs[-1], jnp.inf), steps.sum(), result)

    def one_round(i, ends):
        begins = start[None]
        if key is not None:
            begins = jax.random.normal(
                jax.random.fold_in(key, i), (starts, start.size), start.dtype
            )
            begins = begins.at[0].set(jnp.where(i == 0, start, begins[0]))
        # Searches side by side all last as long as the longest: large problems are quicker one
        # after another.
        new = in_pieces(search, begins, elements * start.size)
        return jax.tree.map(
            lambda old, x: jax.lax.dynamic_update_slice_in_dim(old, x, i * starts, 0), ends, new
        )

    many = rounds * starts
    ends = _End(
        jnp.zeros((many, start.size), start.dtype),
        jnp.full(many, jnp.inf, start.dtype),
        jnp.zeros(many, int),
        _repeated(optx.RESULTS.nonlinear_max_steps_reached, many),
    )
    if rounds == 1:
        done, ends = jnp.ones((), int), one_round(0, ends)
    else:
        # Under vmap all problems do as many rounds as the one that takes most.
        done, ends = jax.lax.while_loop(
            lambda state: (state[0] == 0) | ((state[0] < rounds) & (_best(state[1])[1] < 2)),
            lambda state: (state[0] + 1, one_round(state[0], state[1])),
            (jnp.zeros((), int), ends),
        )
    best, agreeing, elsewhere = _best(ends)
    x, cost, steps, result = jax.tree.map(lambda all_ends: all_ends[best], ends)
    return Found(x, cost, steps, result, done * starts, agreeing, elsewhere)


def levenberg_marquardt(rtol: float = 1e-8, atol: float = 1e-8) -> optx.LevenbergMarquardt:
    """Return optimistix's Levenberg–Marquardt with the linear solver `Normal`."""
    return optx.LevenbergMarquardt(rtol, atol, linear_solver=Normal())


class Normal(lx.AbstractLinearSolver):
    """Linear least squares by the normal equations, for batches (see `numerics.linear`).

    With priors among the residuals the equations are well conditioned; without them rounding may
    change a step of an iteration, but not where it ends.
    """

    def init(self, operator, options):
        """Return the matrix."""
        return operator.as_matrix(), operator.in_structure()

    def compute(self, state, vector, options):
        """Return the least-squares solution."""
        matrix, structure = state
        flat, _ = jax.flatten_util.ravel_pytree(vector)
        gram = matrix.T @ matrix
        # A coordinate on which no residual depends stays as it is.
        unseen = jnp.diag(gram) <= 0
        gram = gram + jnp.diag(jnp.where(unseen, 1.0, 0.0))
        scale = 1 / jnp.sqrt(jnp.diag(gram))
        x = scale * linear.solve(scale[:, None] * gram * scale[None], scale * (matrix.T @ flat))
        _, unravel = jax.flatten_util.ravel_pytree(
            jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), structure)
        )
        return unravel(x), lx.RESULTS.successful, {}

    def transpose(self, state, options):
        """Refuse: nothing differentiates through this solver."""
        raise NotImplementedError

    def conj(self, state, options):
        """Return the state: real matrices are their own conjugates."""
        return state, options

    def assume_full_rank(self):
        """Return that it may: the damping term makes the matrix regular."""
        return True


class _End(NamedTuple):
    x: Any
    cost: Any
    steps: Any
    result: Any


def _best(ends: _End) -> tuple[Int[Array, ""], Int[Array, ""], Int[Array, ""]]:
    """Place of the lowest cost, how many searches converged there, and how many elsewhere."""
    converged = ends.result == optx.RESULTS.successful
    # Among equal costs one that converged.
    best = jnp.argmin(ends.cost + jnp.where(converged, 0.0, 1e-9 * ends.cost + 1e-12))
    level = ends.cost <= ends.cost[best] * (1 + 1e-6) + 1e-9
    return best, (converged & level).sum(), (converged & ~level).sum()


def _with_dense_jacobian(residuals):
    """Return the same function with a derivative that is a product with its Jacobian.

    A solver keeps the derivative from step to step and evaluates it in several ways. As a matrix of
    a few columns it compiles in half the time that the model's own derivative takes.
    """

    @eqx.filter_custom_jvp
    def dense(x, weight, args):
        return residuals(x, weight, args)

    @dense.def_jvp
    def _(primals, tangents):
        x, weight, args = primals
        moved, *held = tangents
        if any(t is not None for t in jax.tree.leaves(held)):
            raise NotImplementedError("least squares cannot be differentiated by their data")

        def twice(x):
            r = residuals(x, weight, args)
            return r, r

        jacobian, r = jax.jacfwd(twice, has_aux=True)(x)
        return r, jacobian @ moved

    return dense


def _repeated(item, many: int):
    return jax.tree.map(lambda code: jnp.full(many, code), item)
