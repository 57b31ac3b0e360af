"""Least squares: the best parameters, their covariance, and whether to believe them
(optimistix).
"""

from typing import Any

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Int

from irisjax._types import PRNGKey
from irisjax.infer.pieces import elements
from irisjax.infer.problem import Problem
from irisjax.numerics import linear as elimination
from irisjax.numerics.portions import in_pieces


class Normal(lx.AbstractLinearSolver):
    """Linear least squares by the normal equations, in plain JAX for batches (see `elimination`).

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
        x = scale * elimination.solve(scale[:, None] * gram * scale, scale * (matrix.T @ flat))
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


class Fit(eqx.Module):
    """A least-squares fit.

    - `z`, `covariance`: the optimum in the priors' normal coordinates and (JᵀJ)⁻¹ there.
    - `values`, `sd`: the free parameters and their standard deviations by name.
    - `chi_square`: Σ of squared residuals of the data alone, over `degrees` of freedom.
    - `cost`: ½ Σ of squares, the priors' included where they count.
    - `agreeing`: how many of the starts ended within 1e-6 of that cost; `starts` their number.
    - `result`: optimistix's status.
    """

    z: Float[Array, "*batch free"]
    covariance: Float[Array, "*batch free free"]
    values: dict[str, Any]
    sd: dict[str, Any]
    predicted: tuple[Float[Array, "*batch _"], ...]  # each observation has its own length
    chi_square: Float[Array, "*batch"]
    degrees: int = eqx.field(static=True)
    cost: Float[Array, "*batch"]
    agreeing: Int[Array, "*batch"]
    starts: int = eqx.field(static=True)
    steps: Int[Array, "*batch"]
    result: optx.RESULTS

    @property
    def ok(self):
        """Whether the search converged to finite values."""
        return (self.result == optx.RESULTS.successful) & jnp.isfinite(self.cost)


METHODS = {"levenberg-marquardt": optx.LevenbergMarquardt, "gauss-newton": optx.GaussNewton}


def fit(
    problem: Problem,
    *,
    method: str = "levenberg-marquardt",
    use_priors: bool = True,
    starts: int = 4,
    key: PRNGKey | None = None,
    rtol: float = 1e-8,
    atol: float = 1e-8,
    max_steps: int = 200,
    start: Float[Array, " free"] | None = None,
) -> Fit:
    """Fit by least squares.

    With priors this is the most probable vector z (noise held at what is stated: `noise` is not
    fitted and keeps its prior's median); without them, maximum likelihood. Of `starts` searches
    (the first from the priors' medians or from `start`, the others from draws of the priors with
    `key`) the best counts.

    Traceable: `jax.vmap` it over problems with `eqx.filter_vmap`. **Raises:** `ValueError` for an
    unknown method.
    """
    if method not in METHODS:
        raise ValueError(f"unknown method {method!r}; known: {', '.join(METHODS)}")
    key = jax.random.key(0, impl="threefry2x32") if key is None else key
    return _fit(problem, start, key, method, use_priors, starts, rtol, atol, max_steps)


@eqx.filter_jit
def _fit(problem, start, key, method, use_priors, starts, rtol, atol, max_steps) -> Fit:
    moving = np.array([not n.startswith("noise") for n in problem.free])
    dtype = jnp.result_type(float)

    def residuals(x, _):
        z = _placed(x, moving)
        data, predicted = problem.residuals_and_models(z)
        r = jnp.concatenate([data, x]) if use_priors else data
        return r, (data, predicted, 0.5 * (r * r).sum())

    solver = METHODS[method](rtol, atol, linear_solver=Normal())
    first = jnp.zeros(moving.sum(), dtype) if start is None else jnp.asarray(start, dtype)[moving]
    draws = jax.random.normal(key, (starts - 1, first.size), dtype)

    def search(x):
        found = optx.least_squares(
            residuals, solver, x, has_aux=True, max_steps=max_steps, throw=False
        )
        return found.value, found.stats["num_steps"], found.result, found.aux

    begins = jnp.concatenate([first[None], draws])
    # Searches side by side all last as long as the longest: of large problems one after another is
    # quicker.
    ends, steps, results, (data, predicted, costs) = in_pieces(
        search, begins, elements(problem) * first.size
    )
    costs = jnp.where(jnp.isfinite(costs), costs, jnp.inf)
    # Among equal costs one that converged.
    failed = results != optx.RESULTS.successful
    best = jnp.argmin(costs + jnp.where(failed, 1e-9 * jnp.abs(costs) + 1e-12, 0.0))
    x = ends[best]
    z = _placed(x, moving)
    jacobian = jax.jacfwd(lambda x: residuals(x, None)[0])(x)
    gram = jacobian.T @ jacobian
    n = moving.size
    inverse = elimination.solve(gram, jnp.eye(x.size, dtype=dtype))
    where = np.flatnonzero(moving)
    covariance = jnp.zeros((n, n), dtype).at[np.ix_(where, where)].set(inverse)
    slope = jax.grad(lambda z: problem.natural(z).sum())(
        z
    )  # each depends on its own coordinate only
    natural = problem.natural(z)
    sd = jnp.abs(slope) * jnp.sqrt(jnp.diag(covariance))
    return Fit(
        z=z,
        covariance=covariance,
        values=dict(zip(problem.free, natural, strict=True)),
        sd=dict(zip(problem.free, sd, strict=True)),
        predicted=tuple(m[best] for m in predicted),
        chi_square=(data[best] ** 2).sum(),
        degrees=data.shape[1] - int(moving.sum()),
        cost=costs[best],
        agreeing=(costs <= costs[best] * (1 + 1e-6) + 1e-9).sum(),
        starts=starts,
        steps=steps[best],
        result=jax.tree.map(lambda code: code[best], results),
    )


def _placed(x, moving):
    """All of z from its moving part; the rest at the priors' medians."""
    return jnp.zeros(moving.size, x.dtype).at[np.flatnonzero(moving)].set(x)
