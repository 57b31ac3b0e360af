"""The same data read by the other process: how far the pigments move, which one the data prefer.

ILIT and radiative transfer of the same layers differ by factors in the pigments that they find. So
no fit speaks alone: the other process is fitted beside it, by least squares.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

from irisjax._types import PRNGKey
from irisjax.infer.fit import Fit
from irisjax.infer.parameters import kind
from irisjax.infer.problem import Problem
from irisjax.transport.process import DEPTH_RESOLVED, ILIT_2006, AbstractProcess, Ilit

PIGMENTS = ("melanin_load", "abl_fraction", "pheomelanin_share", "hemoglobin", "saturation")
"""Parameters of which it is said how far they move."""
_TOLD = ("melanin_load", "abl_fraction")
PREFERRED = math.log(20.0)
"""Log odds from which on the data are said to prefer the other process. Data of the process itself,
of irides as its prior has them and with the noise that was stated, reach them once in twenty times
at most [Royall 2000, J. Am. Stat. Assoc. 95, 760]."""


class Optimum(NamedTuple):
    """What of a least-squares fit is compared; a `Fit` has the same fields.

    `z`, `covariance` in the priors' coordinates; `chi_square` of the data over `degrees`; `cost`:
    half the sum of squares, the priors' included.
    """

    z: np.ndarray
    covariance: np.ndarray
    chi_square: float
    degrees: int
    cost: float


class Interval(NamedTuple):
    """A value and its 95 % interval."""

    value: float
    low: float
    high: float


class Moved(NamedTuple):
    """A parameter by the process of a fit and by the other one."""

    own: Interval
    other: Interval

    @property
    def differs(self) -> bool:
        """Whether each value lies outside the other's interval."""
        (a, low, high), (b, lowest, highest) = self
        return not (low <= b <= high) and not (lowest <= a <= highest)


class Comparison(NamedTuple):
    """What another process makes of the same data.

    - `moved`: of each of `PIGMENTS` that is free.
    - `log_odds`: logarithm of how much more probable the other makes the data [Laplace's
        approximation of both evidences; noise as stated, or as the better fit leaves it].
    """

    process: AbstractProcess
    moved: dict[str, Moved]
    log_odds: float

    @property
    def preferred(self) -> bool:
        """Whether the data prefer the other process."""
        return self.log_odds > PREFERRED


def compare(
    problem: Problem,
    own: Fit | Optimum,
    *,
    key: PRNGKey,
    intervals: Mapping[str, Interval] | None = None,
    starts: int = 4,
) -> Comparison:
    """Fit the other process by least squares, and set it beside the fit `own` of the problem.

    `intervals`: of a posterior of the problem, in place of those of `own`.
    """
    other_problem = problem.by(other_of(problem.process))
    return compared(problem, own, other_problem, optimum(other_problem, key, starts), intervals)


def compared(
    problem: Problem,
    own: Fit | Optimum,
    other_problem: Problem,
    other: Fit | Optimum,
    intervals: Mapping[str, Interval] | None = None,
) -> Comparison:
    """As `compare`, of fits that are there."""
    spread = noise_left(own, other)
    mine = intervals_of(problem, own, spread) | dict(intervals or {})
    theirs = intervals_of(other_problem, other, spread)
    names = [n for n in problem.free if n.partition("@")[0] in PIGMENTS]
    log_odds = _log_evidence(other_problem, other, spread) - _log_evidence(problem, own, spread)
    moved = {n: Moved(mine[n], theirs[n]) for n in names}
    return Comparison(other_problem.process, moved, log_odds)


def optimum(problem: Problem, key: PRNGKey, starts: int = 4) -> Optimum:
    """The most probable parameters, as `fit` finds them: the best of several searches from draws of
    the priors, the first from their medians.

    A loop on the host [scipy.optimize.least_squares], whose one program compiles in a fraction of
    the time that a compiled search takes.
    """
    moving, unnamed = np.array(_fitted(problem)), problem.unnamed()
    z = np.zeros(len(problem.free))
    ones = np.eye(moving.size)
    known: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def both(x):
        if (place := x.tobytes()) not in known:
            known.clear()
            z[moving] = x
            residuals, slopes = map(np.asarray, _linearised(unnamed, jnp.asarray(z)))
            known[place] = np.append(residuals, x), np.vstack([slopes[:, moving], ones])
        return known[place]

    draws = np.array(jax.random.normal(key, (starts, moving.size)))
    draws[0] = 0.0
    search: Any = least_squares  # whose stub takes names of rules for Jacobians only
    searches = (search(lambda x: both(x)[0], x, lambda x: both(x)[1], method="lm") for x in draws)
    found = min(searches, key=lambda f: f.cost)
    residuals, slopes = both(found.x)
    z[moving] = found.x
    covariance = np.eye(z.size)
    covariance[np.ix_(moving, moving)] = np.linalg.inv(slopes.T @ slopes)
    data = residuals[: -moving.size]
    return Optimum(z, covariance, float(data @ data), data.size, float(found.cost))


@eqx.filter_jit
def _linearised(problem: Problem, z):
    def twice(z):
        residuals = problem.residuals(z)
        return residuals, residuals

    slopes, residuals = jax.jacfwd(twice, has_aux=True)(z)
    return residuals, slopes


def other_of(process: AbstractProcess) -> AbstractProcess:
    """Radiative transfer for ILIT, ILIT as printed for radiative transfer."""
    return DEPTH_RESOLVED if isinstance(process, Ilit) else ILIT_2006


def noise_left(own: Fit | Optimum, other: Fit | Optimum) -> float:
    """Factor on the stated noise that the better of two fits still needs, 1 at least."""
    least = min(float(own.chi_square), float(other.chi_square))
    return math.sqrt(max(1.0, least / max(own.degrees, 1)))


def comparison_in_words(found: Comparison) -> list[str]:
    """How far the pigments move, and a warning where the data prefer the other process."""
    told = [n for n in found.moved if n.partition("@")[0] in _TOLD] or list(found.moved)[:1]
    parts = [_shift(n, found.moved[n]) for n in told]
    by = name_of(found.process)
    lines = []
    if parts:
        differ = [n for n in found.moved if found.moved[n].differs]
        word = "WARNING: the pigments depend on the model by more than their intervals: "
        lines.append(f"{word if differ else ''}by {by} {', '.join(parts)}")
    if found.preferred:
        lines.append(f"WARNING: {preference(found)}")
    return lines


def preference(found: Comparison) -> str:
    """That the data prefer the other process, and by how much."""
    odds = odds_in_words(found.log_odds)
    return (
        f"the data prefer {name_of(found.process)}, by odds of {odds} to 1 (least squares, "
        f"Laplace's approximation)"
    )


def name_of(process: AbstractProcess) -> str:
    """What a process is called in a sentence."""
    return "ILIT" if isinstance(process, Ilit) else "radiative transfer"


def odds_in_words(log_odds: float) -> str:
    """Odds to one, of their logarithm."""
    return _number(math.exp(log_odds)) if log_odds < 12 else f"1e{log_odds / math.log(10):.0f}"


def _shift(name: str, moved: Moved) -> str:
    own, other = moved
    text = f"{name} is {other.value:.3g} ({other.low:.3g} to {other.high:.3g})"
    if name.partition("@")[0] != "melanin_load" or not (own.value > 0 and other.value > 0):
        return f"{text} for {own.value:.3g}"
    ratio = other.value / own.value
    if 0.95 < ratio < 1.05:
        return f"{text}, about the same"
    more = ratio > 1
    return f"{text}, {_number(ratio if more else 1 / ratio)} times {'more' if more else 'less'}"


def _number(x: float) -> str:
    """Two digits, without an exponent."""
    return f"{x:.2g}" if x < 100 else f"{float(f'{x:.2g}'):,.0f}"


def _fitted(problem: Problem) -> list[int]:
    """Places of the parameters that least squares fit."""
    return [i for i, n in enumerate(problem.free) if kind(n) != "noise"]


def intervals_of(problem: Problem, found: Fit | Optimum, spread: float) -> dict[str, Interval]:
    """The free parameters with 95 % intervals, of a fit whose noise is `spread` times what was
    stated.
    """
    z = np.asarray(found.z)
    half = 1.96 * np.sqrt(np.diagonal(covariance_at(np.asarray(found.covariance), spread)))
    values = (np.asarray(problem.natural(jnp.asarray(x))) for x in (z, z - half, z + half))
    return {
        n: Interval(*(float(v) for v in row)) for n, *row in zip(problem.free, *values, strict=True)
    }


def covariance_at(covariance: np.ndarray, spread: float) -> np.ndarray:
    """(JᵀJ/s² + 1)⁻¹ of noise s times as large, from (JᵀJ + 1)⁻¹: the data count for less, the
    priors, standard normal in these coordinates, for as much as before.
    """
    square = spread**2
    return square * np.linalg.solve(np.eye(len(covariance)) + (square - 1) * covariance, covariance)


def _log_evidence(problem: Problem, found: Fit | Optimum, spread: float) -> float:
    """ln of the evidence but for a constant that processes share."""
    kept = _fitted(problem)
    covariance = covariance_at(np.asarray(found.covariance)[np.ix_(kept, kept)], spread)
    data = 0.5 * float(found.chi_square)
    prior = float(found.cost) - data
    return float(0.5 * np.linalg.slogdet(covariance)[1] - data / spread**2 - prior)
