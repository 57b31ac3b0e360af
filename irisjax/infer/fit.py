"""Least squares: the best parameters, their covariance, and whether to believe them."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.scipy.special import gammaincc
from jaxtyping import Array, Bool, Float, Int
from scipy.special import chdtri

from irisjax._types import PRNGKey
from irisjax.infer.pieces import elements
from irisjax.infer.problem import Problem
from irisjax.infer.search import Found, levenberg_marquardt, lowest
from irisjax.infer.status import FitStatus
from irisjax.infer.status import throw as throw_if
from irisjax.numerics import linear
from irisjax.numerics.checks import check_whole
from irisjax.numerics.programs import program
from irisjax.transport.solution import RESULTS

MISFIT = 1e-6
"""Below this probability of a chi-square as large a fit is called a misfit."""


class Fit(eqx.Module):
    """A least-squares fit.

    - `z`, `covariance`: the optimum in the priors' normal coordinates and (JᵀJ)⁻¹ there.
    - `values`, `sd`: the free parameters and their standard deviations by name.
    - `predicted`: what each instrument would read there, without noise.
    - `chi_square`: Σ of squared residuals of the data alone, over `degrees` of freedom: the number
        of data, less the free parameters where no priors hold them.
    - `cost`: ½ Σ of squares, the priors' included where they count.
    - `starts`: how many searches ran; `agreeing`: how many of them converged within 1e-6 of that
        cost; `steps`: those of the best.
    - `status`: a `FitStatus` item; `result`: optimistix's status of the best search.
    """

    z: Float[Array, "*batch free"]
    covariance: Float[Array, "*batch free free"]
    values: dict[str, Any]
    sd: dict[str, Any]
    predicted: tuple[Float[Array, "*batch _"], ...]  # each observation has its own length
    chi_square: Float[Array, "*batch"]
    degrees: int = eqx.field(static=True)
    cost: Float[Array, "*batch"]
    starts: Int[Array, "*batch"]
    agreeing: Int[Array, "*batch"]
    steps: Int[Array, "*batch"]
    status: FitStatus
    result: optx.RESULTS

    @property
    def ok(self) -> Bool[Array, "*batch"]:
        """Whether the search found what may be believed: the status is success."""
        return self.status == FitStatus.successful

    @property
    def converged(self) -> Bool[Array, "*batch"]:
        """Whether the search ended as it should, be the model right or wrong for the data."""
        return self.ok | (self.status == FitStatus.misfit)

    @property
    def p_value(self) -> Float[Array, "*batch"]:
        """Probability of a chi-square as large from normal noise as large as stated; NaN without
        degrees of freedom.
        """
        half = jnp.asarray(0.5 * self.degrees if self.degrees > 0 else jnp.nan, self.cost.dtype)
        return gammaincc(half, 0.5 * self.chi_square)


def fit(
    problem: Problem,
    *,
    solver: optx.AbstractLeastSquaresSolver | None = None,
    use_priors: bool = True,
    start: Float[Array, " free"] | None = None,
    starts: int = 4,
    rounds: int = 3,
    max_steps: int = 200,
    throw: bool = False,
    key: PRNGKey | None = None,
) -> Fit:
    """Fit by least squares.

    With priors this is the most probable vector z (noise held at what is stated: `noise` is not
    fitted and keeps its prior's median); without them, maximum likelihood, searched from where the
    priors end. The best of several searches counts. Traceable: `eqx.filter_vmap` it over problems.

    Args:
        problem: What was measured and what is free.
        solver: optimistix's; default `levenberg_marquardt()`.
        use_priors: Whether the priors count.
        start: Where the first search starts, in z; default the priors' medians.
        starts: Searches in a round; all but the first start from draws of the priors.
        rounds: Most rounds: another follows while fewer than two searches agree on the best.
        max_steps: Most steps of a search.
        throw: Whether to raise where the status is not success.
        key: For the draws; needed unless `starts=1`.

    Raises:
        ValueError: Without a key for several starts, for what is no solver or number of starts,
            and with `throw` for any status but success.
    """
    if solver is None:
        solver = levenberg_marquardt()
    elif not isinstance(solver, optx.AbstractLeastSquaresSolver):
        raise ValueError(f"solver={solver!r} is no least-squares solver of optimistix")
    for name, number in (("starts", starts), ("rounds", rounds), ("max_steps", max_steps)):
        check_whole(name, number, 1)
    if starts == 1:
        key, rounds = None, 1
    elif key is None:
        raise ValueError(
            f"starts={starts} draws all but the first at random: give key=jax.random.key(...), or "
            f"starts=1"
        )
    found = _fit(problem.unnamed(), solver, start, key, use_priors, starts, rounds, max_steps)
    if throw:
        throw_if(found.status)
    return found


@program
def _fit(problem, solver, start, key, use_priors, starts, rounds, max_steps) -> Fit:
    moving, dtype = _moving(problem), jnp.result_type(float)
    free = len(problem.free)
    first = jnp.zeros(moving.size, dtype)
    if start is not None:
        first = jnp.asarray(start, dtype)[moving]
    last = jnp.asarray(1.0 if use_priors else 0.0, dtype)
    weights = last[None] if use_priors else jnp.stack([0.1 * _signal_to_noise(problem), last])
    best = lowest(
        lambda x, weight, problem: _residuals(x, weight, problem)[0], problem, first, weights,
        solver=solver, starts=starts, rounds=rounds, max_steps=max_steps,
        elements=elements(problem), key=key,
    )  # fmt: skip
    jacobian, (data, predicted) = jax.jacfwd(lambda x: _residuals(x, last, problem), has_aux=True)(
        best.x
    )
    inverse = linear.solve(jacobian.T @ jacobian, jnp.eye(moving.size, dtype=dtype))
    inverse = 0.5 * (inverse + inverse.T)  # rounding does not keep it symmetric
    covariance = jnp.zeros((free, free), dtype).at[np.ix_(moving, moving)].set(inverse)
    z = _placed(best.x, problem)
    # Each value depends on its own coordinate only.
    natural, slope = jax.jvp(lambda z: problem.natural(z), (z,), (jnp.ones_like(z),))
    sd = jnp.abs(slope) * jnp.sqrt(jnp.diag(covariance))
    chi_square = (data**2).sum()
    solved = problem.status(z) == RESULTS.successful
    degrees = data.size - (0 if use_priors else moving.size)
    return Fit(
        z=z,
        covariance=covariance,
        values=dict(zip(problem.free, natural, strict=True)),
        sd=dict(zip(problem.free, sd, strict=True)),
        predicted=predicted,
        chi_square=chi_square,
        degrees=degrees,
        cost=best.cost,
        starts=best.searches,
        agreeing=best.agreeing,
        steps=best.steps,
        status=_status(best, chi_square, _most(problem, degrees), solved),
        result=best.result,
    )


def _moving(problem: Problem) -> np.ndarray:
    """Places of the parameters that are fitted."""
    return np.flatnonzero([not n.startswith("noise") for n in problem.free])


def _placed(x, problem: Problem):
    """All of z from its moving part; the rest at the priors' medians."""
    return jnp.zeros(len(problem.free), x.dtype).at[_moving(problem)].set(x)


def _residuals(x, weight, problem: Problem):
    data, predicted = problem.residuals_and_models(_placed(x, problem))
    return jnp.concatenate([data, weight * x]), (data, predicted)


def _signal_to_noise(problem: Problem):
    """Root mean square over all data."""
    whitened = [problem.noise.whiten(o, jnp.zeros_like(o.values)) for o in problem.observations]
    return jnp.sqrt(jnp.mean(jnp.concatenate(whitened) ** 2))


def _status(best: Found, chi_square, limit: float, solved) -> FitStatus:
    """What is worst: the data's `limit` of chi-square last, before it how the search ended, and
    first of all whether there is an answer.
    """
    status = FitStatus.where(chi_square > limit, FitStatus.misfit, FitStatus.successful)
    lone = (best.agreeing < 2) & (best.elsewhere > 0)
    status = FitStatus.where(lone, FitStatus.disagreement, status)
    exhausted = best.result == optx.RESULTS.nonlinear_max_steps_reached
    status = FitStatus.where(exhausted, FitStatus.not_converged, status)
    ended = exhausted | (best.result == optx.RESULTS.successful)
    answered = ended & jnp.isfinite(best.cost) & solved
    return FitStatus.where(answered, status, FitStatus.solver_failed)


def _most(problem: Problem, degrees: int) -> float:
    """The largest chi-square that is no misfit."""
    # Student's t has outliers that chi-square knows nothing of.
    if degrees < 1 or problem.noise.degrees_of_freedom is not None:
        return np.inf
    return float(chdtri(degrees, MISFIT))
