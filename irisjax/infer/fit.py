"""Least squares: the best parameters, their covariance, and whether to believe them."""

from collections.abc import Sequence
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
from irisjax.infer.least_squares import Minimum, least_squares, levenberg_marquardt
from irisjax.infer.problem import Problem
from irisjax.numerics.checks import check_whole
from irisjax.numerics.streams import one_key
from irisjax.transport.solution import RESULTS, raise_failure

MISFIT = 1e-6
"""Probability of a chi-square as large below which a fit is called a misfit."""
OFF_PRIOR = 4.0
"""Standard deviations of its prior beyond which a parameter is doubted."""


class FitStatus(eqx.Enumeration):
    """Outcome of a least-squares fit; the first of these that holds, from the bottom up."""

    successful = ""
    misfit = (
        "the search converged, but the model does not produce these data: chi-square is far above "
        "its degrees of freedom at the stated noise"
    )
    disagreement = (
        "one start alone reached the lowest cost while others converged elsewhere; there may be a "
        "lower one: give more starts"
    )
    not_converged = "the search did not converge within its steps"
    solver_failed = (
        "least squares or the transport solver failed at the best point found; see `steps` and "
        "`Problem.evaluated`"
    )


class Fit(eqx.Module):
    """A least-squares fit.

    Attributes:
        z: The optimum in the priors' normal coordinates.
        jacobian: Derivatives of the data's residuals by the values of the free parameters; zero for
            the noise, which is not fitted.
        covariance: (JᵀJ)⁻¹, with the priors' part where they count; zero for the noise.
        values: The free parameters by name, in the order of the alphabet, where arrays have that of
            `Problem.free`; their standard deviations are `sd`.
        predicted: What each instrument would read at the optimum, without noise.
        chi_square: Σ of squared residuals of the data alone.
        degrees: Its degrees of freedom: the data, less the free parameters without priors.
        cost: ½ Σ of squares, the priors' included where they count.
        agreeing: Number of searches that converged within 1e-6 of that cost.
        steps: Number of steps of the best search.
    """

    z: Float[Array, "*batch free"]
    jacobian: Float[Array, "*batch all_data free"]
    covariance: Float[Array, "*batch free free"]
    values: dict[str, Any]
    sd: dict[str, Any]
    predicted: tuple[Float[Array, "*batch _"], ...]
    chi_square: Float[Array, "*batch"]
    degrees: int = eqx.field(static=True)
    cost: Float[Array, "*batch"]
    agreeing: Int[Array, "*batch"]
    steps: Int[Array, "*batch"]
    status: FitStatus

    @property
    def ok(self) -> Bool[Array, "*batch"]:
        """Whether the status is success."""
        return self.status == FitStatus.successful

    @property
    def converged(self) -> Bool[Array, "*batch"]:
        """Whether the search converged, even if the model does not fit the data."""
        return self.ok | (self.status == FitStatus.misfit)

    @property
    def p_value(self) -> Float[Array, "*batch"]:
        """Probability of a chi-square as large for normal noise; NaN without degrees of freedom."""
        half = jnp.asarray(0.5 * self.degrees if self.degrees > 0 else jnp.nan, self.cost.dtype)
        return gammaincc(half, 0.5 * self.chi_square)


def fit(
    problem: Problem,
    *,
    solver: optx.AbstractGaussNewton[Array, Array, Any] | None = None,
    use_priors: bool = True,
    start: Float[Array, " free"] | None = None,
    starts: int = 4,
    rounds: int = 3,
    max_steps: int = 200,
    throw: bool = False,
    key: PRNGKey | None = None,
) -> Fit:
    """Fit a problem by least squares.

    With priors this is the most probable vector z, the noise being as stated (`noise` is not fitted
    and keeps its prior's median). Without them it is the maximum likelihood, searched from the
    optimum with priors of little weight. The best of several searches counts. It can be traced:
    `eqx.filter_vmap` it over problems.

    Args:
        problem: What was measured and what is free.
        solver: One of optimistix's Gauss–Newton solvers; default `levenberg_marquardt()`.
        use_priors: Whether the priors count.
        start: Where the first search starts, in z; default the priors' medians.
        starts: Number of searches in a round; all but the first start from draws of the priors.
        rounds: Largest number of rounds: another follows while fewer than two searches agree.
        max_steps: Largest number of steps of a search.
        throw: Whether to raise where the status is not success.
        key: Source of the draws; needed unless `starts=1`.

    Raises:
        ValueError: For a missing key, a wrong number, and, with `throw`, any status but success.
    """
    if solver is None:
        solver = levenberg_marquardt()
    elif not isinstance(solver, optx.AbstractGaussNewton):
        raise ValueError(
            f"solver={solver!r}: give one of optimistix's Gauss–Newton solvers, such as "
            "LevenbergMarquardt or Dogleg"
        )
    for name, number in (("starts", starts), ("rounds", rounds), ("max_steps", max_steps)):
        check_whole(name, number, 1)
    if starts == 1:
        key, rounds = None, 1
    elif key is None:
        to_do = "give key=jax.random.key(...), or starts=1"
        raise ValueError(f"starts={starts} draws all but the first at random: {to_do}")
    else:
        one_key(key)
    solution = _fit(problem.unnamed(), solver, start, key, use_priors, starts, rounds, max_steps)
    return raise_failure(solution, solution.status) if throw else solution


def abl_melanin(
    names: Sequence[str],
    values: Float[np.ndarray, "*s fitted"],
    covariance: Float[np.ndarray, "*s fitted fitted"],
) -> tuple[Any, Any] | None:
    """Return load times ABL fraction, µg/mm², and its standard deviation, to first order, of one
    fit or of many; `None` unless both are among the names.
    """
    if not {"melanin_load", "abl_fraction"} <= set(names):
        return None
    places = [names.index(n) for n in ("melanin_load", "abl_fraction")]
    load, fraction = np.moveaxis(values[..., places], -1, 0)
    slopes, block = np.stack([fraction, load], -1), covariance[..., places, :][..., places]
    return load * fraction, np.sqrt(np.einsum("...i,...ij,...j", slopes, block, slopes))


def words_for(status: FitStatus) -> str:
    """Return the words of one concrete status, empty for success."""
    # Equinox has no words for a NumPy scalar, which is what an item of a batch is.
    return FitStatus[jax.tree.map(np.asarray, status)]


@eqx.filter_jit
def _fit(problem, solver, start, key, use_priors, starts, rounds, max_steps) -> Fit:
    dtype, moving = jnp.result_type(float), np.asarray(problem.moving, int)
    weights = jnp.asarray([1.0 if use_priors else 0.0], dtype)
    if not use_priors:
        signal = [problem.noise.whiten(o, jnp.zeros_like(o.values)) for o in problem.observations]
        weights = jnp.append(0.1 * jnp.sqrt(jnp.mean(jnp.concatenate(signal) ** 2)), weights)
    free = len(problem.free)
    initial = jnp.zeros(free, dtype) if start is None else jnp.asarray(start, dtype)
    best = least_squares(
        residuals, problem, initial[moving], weights=weights, solver=solver,
        starts=starts, rounds=rounds, max_steps=max_steps, key=key,
    )  # fmt: skip
    return fit_at(problem, best, use_priors)


def residuals(x: Float[Array, " moving"], weight: Any, problem: Problem) -> Any:
    """Return the residuals of the data and of the priors, as `least_squares` takes them, and beside
    them those of the data alone, the predicted readings and the solver's status.
    """
    data, predicted, status = problem.evaluated(_expanded(problem, x))
    return jnp.concatenate([data, weight * x]), (data, predicted, status)


def fit_at(problem: Problem, best: Minimum, use_priors: bool = True) -> Fit:
    """Return the fit of a problem whose `residuals` have this minimum."""
    dtype, free, moving = jnp.result_type(float), len(problem.free), np.asarray(problem.moving, int)
    data, predicted, solved = best.aux
    covariance = jnp.zeros((free, free), dtype).at[np.ix_(moving, moving)].set(best.covariance)
    jacobian = jnp.zeros((data.size, free), dtype).at[:, moving].set(best.jacobian[: data.size])
    z = _expanded(problem, best.x)
    slope = problem.slopes(z)
    sd = jnp.abs(slope) * jnp.sqrt(jnp.diag(covariance))
    chi_square = (data**2).sum()
    degrees = data.size - (0 if use_priors else moving.size)
    # Chi-square means nothing for Student's t, which has outliers.
    testable = degrees > 0 and problem.noise.degrees_of_freedom is None
    limit = float(chdtri(degrees, MISFIT)) if testable else np.inf
    values, sds = (dict(zip(problem.free, v, strict=True)) for v in (problem.natural(z), sd))
    status = _status(best, chi_square, limit, solved == RESULTS.successful)
    return Fit(
        z, jacobian / slope, covariance, values, sds, predicted, chi_square, degrees, best.cost,
        best.agreeing, best.steps, status,
    )  # fmt: skip


def _expanded(problem: Problem, x: Float[Array, " moving"]) -> Float[Array, " free"]:
    """Return z from its fitted part, with the rest at the priors' medians."""
    return jnp.zeros(len(problem.free), x.dtype).at[np.asarray(problem.moving, int)].set(x)


def _status(best: Minimum, chi_square, limit: float, solved) -> FitStatus:
    """The worst that holds."""
    status = FitStatus.where(chi_square > limit, FitStatus.misfit, FitStatus.successful)
    isolated = (best.agreeing < 2) & (best.elsewhere > 0)
    status = FitStatus.where(isolated, FitStatus.disagreement, status)
    exhausted = best.result == optx.RESULTS.nonlinear_max_steps_reached
    status = FitStatus.where(exhausted, FitStatus.not_converged, status)
    finished = exhausted | (best.result == optx.RESULTS.successful)
    valid = finished & jnp.isfinite(best.cost) & solved
    return FitStatus.where(valid, status, FitStatus.solver_failed)
