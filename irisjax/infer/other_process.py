"""The same data read by the other process: how far the pigments move, and which process the data
prefer.

ILIT and radiative transfer of the same layers differ by factors in the pigments that they find.
Therefore no fit stands alone: the other process is fitted beside it, by least squares.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from irisjax.infer.fit import Fit
from irisjax.infer.parameters import kind
from irisjax.infer.problem import Problem
from irisjax.transport.process import DEPTH_RESOLVED, ILIT_2006, AbstractProcess, Ilit

COMPARED = ("melanin_load", "abl_fraction", "pheomelanin_share", "hemoglobin", "saturation")
"""Parameters that are compared."""
PREFERRED = math.log(20.0)
"""Log odds from which on the data prefer another process. Data of the process itself, of irides as
its prior has them and with the noise that was stated, reach them once in twenty times at most
[Royall 2000, J. Am. Stat. Assoc. 95, 760]."""


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


class ProcessComparison(NamedTuple):
    """What another process makes of the same data.

    Attributes:
        process: The other process.
        moved: Each of `COMPARED` that is free, by both.
        log_odds: Logarithm of how much more probable the data are by the other process [Laplace's
            approximation of both evidences; noise as stated, or as the better fit leaves it].
    """

    process: AbstractProcess
    moved: dict[str, Moved]
    log_odds: float

    @property
    def preferred(self) -> bool:
        """Whether the data prefer the other process."""
        return self.log_odds > PREFERRED


def compare_processes(
    problem: Problem,
    own: Fit,
    other_problem: Problem,
    other: Fit,
    *,
    intervals: Mapping[str, Interval] | None = None,
) -> ProcessComparison:
    """Compare two least-squares fits of the same data, with priors, by different processes.

    Args:
        problem: The problem.
        own: Its fit.
        other_problem: The same problem by the other process, see `Problem.by` and `other_of`.
        other: Its fit.
        intervals: Of a posterior of the problem, in place of those of `own`.
    """
    spread = noise_left(own, other)
    mine = intervals_of(problem, own, spread) | dict(intervals or {})
    theirs = intervals_of(other_problem, other, spread)
    names = [n for n in problem.free if kind(n) in COMPARED]
    log_odds = _log_evidence(other_problem, other, spread) - _log_evidence(problem, own, spread)
    moved = {n: Moved(mine[n], theirs[n]) for n in names}
    return ProcessComparison(other_problem.process, moved, log_odds)


def other_of(process: AbstractProcess) -> AbstractProcess:
    """Return radiative transfer for ILIT, ILIT as printed for radiative transfer."""
    return DEPTH_RESOLVED if isinstance(process, Ilit) else ILIT_2006


def noise_left(own: Fit, other: Fit) -> float:
    """Return the factor on the stated noise that the better of two fits needs, at least 1."""
    least = min(float(own.chi_square), float(other.chi_square))
    return math.sqrt(max(1.0, least / max(own.degrees, 1)))


def intervals_of(problem: Problem, found: Fit, spread: float) -> dict[str, Interval]:
    """Return the free parameters with 95 % intervals, of a fit whose noise is `spread` times what
    was stated.
    """
    z = np.asarray(found.z)
    half = 1.96 * np.sqrt(np.diagonal(covariance_at(np.asarray(found.covariance), spread)))
    values = (np.asarray(problem.natural(jnp.asarray(x))) for x in (z, z - half, z + half))
    return {
        n: Interval(*(float(v) for v in row)) for n, *row in zip(problem.free, *values, strict=True)
    }


def covariance_at(
    covariance: Float[np.ndarray, "free free"], spread: float
) -> Float[np.ndarray, "free free"]:
    """Return (JᵀJ/s² + 1)⁻¹ of noise s times as large, from (JᵀJ + 1)⁻¹.

    The data count for less and the priors, standard normal in these coordinates, for as much as
    before.
    """
    square = spread**2
    return square * np.linalg.solve(np.eye(len(covariance)) + (square - 1) * covariance, covariance)


def _log_evidence(problem: Problem, found: Fit, spread: float) -> float:
    """Logarithm of the evidence but for a constant that processes share [Laplace]."""
    kept = [i for i, n in enumerate(problem.free) if kind(n) != "noise"]
    covariance = covariance_at(np.asarray(found.covariance)[np.ix_(kept, kept)], spread)
    data = 0.5 * float(found.chi_square)
    prior = float(found.cost) - data
    return float(0.5 * np.linalg.slogdet(covariance)[1] - data / spread**2 - prior)
