"""The search for the least squares: solvers, many starts, and more of them while they disagree."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from irisjax._types import PRNGKey, Scalar
from irisjax.numerics import linear
from irisjax.numerics.portions import in_pieces


def levenberg_marquardt(rtol: float = 1e-8, atol: float = 1e-8) -> optx.LevenbergMarquardt:
    """optimistix's Levenberg–Marquardt with the linear solver `Normal`: what `fit` uses."""
    return optx.LevenbergMarquardt(rtol, atol, linear_solver=Normal())


class Normal(lx.AbstractLinearSolver):
    """Linear least squares by the normal equations, for batches (see `numerics.linear`).

    With priors among the residuals the equations are well conditioned; without them rounding may
    bend a step of an iteration, but not its end.
    """

    def init(self, operator, options):
        """The matrix."""
        return operator.as_matrix(), operator.in_structure()

    def compute(self, state, vector, options):
        """The least-squares solution."""
        matrix, structure = state
        flat, _ = jax.flatten_util.ravel_pytree(vector)
        gram = matrix.T @ matrix
        # A direction that the data do not see keeps its place.
        unseen = jnp.diag(gram) <= 0
        gram = gram + jnp.diag(jnp.where(unseen, 1.0, 0.0))
        scale = 1 / jnp.sqrt(jnp.diag(gram))
        x = scale * linear.solve(scale[:, None] * gram * scale[None], scale * (matrix.T @ flat))
        _, unravel = jax.flatten_util.ravel_pytree(
            jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), structure)
        )
        return unravel(x), lx.RESULTS.successful, {}

    def transpose(self, state, options):
        """Not needed: least squares are not differentiated through."""
        raise NotImplementedError

    def conj(self, state, options):
        """Real matrices are their own conjugates."""
        return state, options

    def assume_full_rank(self):
        """The damping term sees to it."""
        return True


class Found(NamedTuple):
    """The best of several searches.

    - `x`, `cost` (½ Σ of squares), `steps`, `result` (optimistix's) of the best.
    - `searches`: how many ran; `agreeing`: how many of them ended at that cost; `elsewhere`: how
        many converged at a higher one.
    """

    x: Float[Array, " moving"]
    cost: Scalar
    steps: Int[Array, ""]
    result: optx.RESULTS
    searches: Int[Array, ""]
    agreeing: Int[Array, ""]
    elsewhere: Int[Array, ""]


def lowest(
    residuals: Callable[[Any, Any, Any], Any],
    args: Any,
    first: Float[Array, " moving"],
    weights: Float[Array, " stages"],
    *,
    solver: optx.AbstractLeastSquaresSolver,
    starts: int,
    rounds: int,
    max_steps: int,
    elements: int,
    key: PRNGKey | None,
) -> Found:
    """The lowest ½ Σ residuals², of `starts` searches and of as many again, up to `rounds` times,
    while fewer than two agree.

    Args:
        residuals: `residuals(x, weight, args)`, `weight` that of the priors; a pure function of
            these.
        args: Whatever else they depend on.
        first: Where the first search starts; the others start from standard normal draws.
        weights: The priors' weights one after another, the last one that counts. To begin with the
            priors keeps a search that shall end without them, or with little of them, off the
            plains far outside, where nothing depends on a parameter any more.
        solver: What makes the steps.
        starts: Searches in a round.
        rounds: Most rounds.
        max_steps: Most steps of a search, at each weight.
        elements: Numbers in the largest array that one evaluation makes.
        key: For the draws; not needed for a single start.
    """

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
        begins = first[None]
        if key is not None:
            begins = jax.random.normal(
                jax.random.fold_in(key, i), (starts, first.size), first.dtype
            )
            begins = begins.at[0].set(jnp.where(i == 0, first, begins[0]))
        # Searches side by side all last as long as the longest: of large problems one after
        # another is quicker.
        new = in_pieces(search, begins, elements * first.size)
        return jax.tree.map(
            lambda old, x: jax.lax.dynamic_update_slice_in_dim(old, x, i * starts, 0), ends, new
        )

    many = rounds * starts
    ends = _End(
        jnp.zeros((many, first.size), first.dtype),
        jnp.full(many, jnp.inf, first.dtype),
        jnp.zeros(many, int),
        _repeated(optx.RESULTS.nonlinear_max_steps_reached, many),
    )
    if rounds == 1:
        done, ends = jnp.ones((), int), one_round(0, ends)
    else:
        # Of many problems at once all do as many rounds as the one that takes most.
        done, ends = jax.lax.while_loop(
            lambda state: (state[0] == 0) | ((state[0] < rounds) & (_best(state[1])[1] < 2)),
            lambda state: (state[0] + 1, one_round(state[0], state[1])),
            (jnp.zeros((), int), ends),
        )
    best, agreeing, elsewhere = _best(ends)
    x, cost, steps, result = jax.tree.map(lambda all_ends: all_ends[best], ends)
    return Found(x, cost, steps, result, done * starts, agreeing, elsewhere)


class _End(NamedTuple):
    x: Any
    cost: Any
    steps: Any
    result: Any


def _best(ends: _End) -> tuple[Int[Array, ""], Int[Array, ""], Int[Array, ""]]:
    """The place of the lowest, how many converged there, and how many elsewhere."""
    converged: Bool[Array, " many"] = ends.result == optx.RESULTS.successful
    # Among equal costs one that converged.
    best = jnp.argmin(ends.cost + jnp.where(converged, 0.0, 1e-9 * ends.cost + 1e-12))
    level = ends.cost <= ends.cost[best] * (1 + 1e-6) + 1e-9
    return best, (converged & level).sum(), (converged & ~level).sum()


def _with_dense_jacobian(residuals):
    """The same function, whose derivative is a product with its Jacobian.

    A solver keeps the derivative from step to step and asks it for several things: as a matrix of
    a few columns that takes half as long to compile as the model's own.
    """

    @eqx.filter_custom_jvp
    def dense(x, weight, args):
        return residuals(x, weight, args)

    @dense.def_jvp
    def _(primals, tangents):
        x, weight, args = primals
        moved, *held = tangents
        if any(t is not None for t in jax.tree.leaves(held)):
            raise NotImplementedError("derivatives of a search by its data")

        def twice(x):
            r = residuals(x, weight, args)
            return r, r

        jacobian, r = jax.jacfwd(twice, has_aux=True)(x)
        return r, jacobian @ moved

    return dense


def _repeated(item, many: int):
    return jax.tree.map(lambda code: jnp.full(many, code), item)
