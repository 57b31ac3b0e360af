"""One measurement read by several models of light: how far pigments move, and what the data prefer.

ILIT and radiative transfer of the same layers differ by factors in the pigments that they find: the
other process is fitted beside every fit, and models are compared by their evidences on request.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from irisjax._types import PRNGKey
from irisjax.infer.fit import Fit, fit
from irisjax.infer.importance import EFFECTIVE, ImportanceSample, importance_sample
from irisjax.infer.parameters import OF_POWER_LAW, kind
from irisjax.infer.problem import Problem, pointwise, predicted, reported, solvers_of
from irisjax.numerics.streams import one_key, words_of
from irisjax.tissue.scattering import PowerLaw
from irisjax.transport.process import DEPTH_RESOLVED, ILIT_2006, AbstractProcess, Ilit
from irisjax.transport.radiative.adding import AddingDoubling

DRAWS = 500
"""Draws of a posterior that stand for all of it where models are computed."""
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

    @classmethod
    def of(cls, draws: np.ndarray) -> "Interval":
        """Return the median and the 95 % interval of draws."""
        return cls(*map(float, np.percentile(draws, (50.0, 2.5, 97.5))))

    def holds(self, value: float) -> bool:
        """Whether a value lies within."""
        return bool(self.low <= value <= self.high)


class Moved(NamedTuple):
    """A parameter by the process of a fit and by the other one."""

    own: Interval
    other: Interval

    @property
    def differs(self) -> bool:
        """Whether each value lies outside the other's interval."""
        return not (self.own.holds(self.other.value) or self.other.holds(self.own.value))


class ProcessComparison(NamedTuple):
    """The fit of the same data by another process.

    Attributes:
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
    """Compare two least-squares fits of the same data, with priors, by a problem's process and by
    the other one (`Problem.by`, `other_of`); `intervals` of the problem's posterior take the place
    of those of its fit.
    """
    spread = noise_left(own, other)
    own_intervals = intervals_of(problem, own, spread) | dict(intervals or {})
    other_intervals = intervals_of(other_problem, other, spread)
    names = [n for n in problem.free if kind(n) in COMPARED]
    log_odds = _log_evidence(other_problem, other, spread) - _log_evidence(problem, own, spread)
    moved = {n: Moved(own_intervals[n], other_intervals[n]) for n in names}
    return ProcessComparison(other_problem.process, moved, log_odds)


def other_of(process: AbstractProcess) -> AbstractProcess:
    """Return radiative transfer for ILIT, ILIT as printed for radiative transfer."""
    return DEPTH_RESOLVED if isinstance(process, Ilit) else ILIT_2006


class Assessment(NamedTuple):
    """What one model makes of the data.

    Attributes:
        evidence: Samples of its posterior, and its evidence: the probability of the data averaged
            over the priors. A model that could have made many other data has less of it.
        score: Predictive score (PSIS-LOO), with its standard error. Neighbouring wavelengths are
            not independent, so it is no evidence of its own.
        values: Median and 95 % interval of each of `COMPARED` that is free, of a power law's
            parameters, and of the noise.
        ratios: Ratios of these to the first model's where it has them, of independent draws.
        models: Of each observation, the median of the model without noise.
        residuals: The data less that, in standard deviations, the noise's factor included.
    """

    name: str
    problem: Problem
    evidence: ImportanceSample
    score: float
    score_error: float
    values: dict[str, Interval]
    ratios: dict[str, Interval]
    models: tuple[np.ndarray, ...]
    residuals: tuple[np.ndarray, ...]


def candidates_of(problem: Problem) -> dict[str, Problem]:
    """Return a problem by ILIT, radiative transfer and one with a power law, its own first."""
    has_law = problem.base.power_law is not None
    without_law = problem.under(None) if has_law else problem
    problems = without_law, without_law.by(other_of(without_law.process))
    by_process = {p.process.name: p for p in problems}
    by_law = "general radiative transfer"
    if has_law:
        return {by_law: problem, **by_process}
    general = problem.under(PowerLaw())
    # A relative error of 2e-3 for 95 % of the priors' irides: a tenth of a good spectrum's noise.
    solvers = solvers_of(general.base, general.observations, AddingDoubling(12, 10), {})
    return {**by_process, by_law: dataclasses.replace(general, solvers=solvers)}


def compare_models(
    problem: Problem,
    candidates: Mapping[str, Problem] | None = None,
    *,
    progress: Callable[[str, int], object] | None = None,
    key: PRNGKey,
) -> tuple[Assessment, ...]:
    """Assess several models of a problem's data by importance sampling.

    All have the same noise, and the same priors of what they share. An evidence can miss a second
    mode far from the least-squares fit.

    Args:
        problem: What was measured and what is free.
        candidates: The same data by each model; default `candidates_of(problem)`.
        progress: Called with a model's name and the number of rounds of sampling done.
        key: Source of all draws.

    Raises:
        ValueError: For fewer than two models, and where no proposal resembles a model's posterior.
    """
    candidates = candidates_of(problem) if candidates is None else candidates
    if len(candidates) < 2:
        raise ValueError("give two or more models to compare")
    results: list[Assessment] = []
    for i, (name, model) in enumerate(candidates.items()):
        report = functools.partial(progress or (lambda name, rounds: None), name)
        fit_key, sample_key, score_key = jax.random.split(jax.random.fold_in(one_key(key), i), 3)
        report(0)
        random = np.random.RandomState(words_of(sample_key))
        evidence = importance_sample(model.log_density, fit(model, key=fit_key), random, report)
        if not evidence.enough:
            draws = f"{evidence.effective:.0f} effective draws of {EFFECTIVE} asked"
            raise ValueError(f"{name}: importance weights stay uneven ({draws}): no evidence")
        # Resampling leaves them in the order of the rounds.
        evidence = evidence._replace(samples=random.permutation(evidence.samples))
        results.append(_assess(name, model, evidence, results[0] if results else None, score_key))
    return tuple(results)


def predictive_score(
    log_likelihood: Float[np.ndarray, "chains draws data"], effective: float = 1.0
) -> tuple[float, float]:
    """Return the expected log predictive density of left-out values by PSIS-LOO [Vehtari et al.
    2017], to be compared between processes fitted to the same data, and its standard error;
    `effective` is the number of effective samples a draw, at most 1.
    """
    from arviz_stats.base.array import array_stats

    stats: Any = array_stats  # it returns scalars where its annotations have tuples too
    by_value, r_eff = np.moveaxis(log_likelihood, -1, 0), min(effective, 1.0)
    scores, _, _ = stats.loo(by_value, chain_axis=-2, draw_axis=-1, r_eff=r_eff)
    return float(np.sum(scores)), float(np.sqrt(np.size(scores)) * np.std(scores))


def noise_left(own: Fit, other: Fit) -> float:
    """Return the factor on the stated noise that the better of two fits needs, at least 1."""
    chi_square = min(float(own.chi_square), float(other.chi_square))
    return math.sqrt(max(1.0, chi_square / max(own.degrees, 1)))


def intervals_of(problem: Problem, solution: Fit, spread: float) -> dict[str, Interval]:
    """Return 95 % intervals of a fit's parameters for noise `spread` times what was stated."""
    margins = 1.96 * np.sqrt(np.diagonal(covariance_at(np.asarray(solution.covariance), spread)))
    points = (jnp.asarray(solution.z + sign * margins) for sign in (0, -1, 1))
    values = [np.asarray(problem.natural(z)) for z in points]
    rows = zip(problem.free, np.stack(values, axis=1).tolist(), strict=True)
    return {n: Interval(*row) for n, row in rows}


def covariance_at(
    covariance: Float[np.ndarray, "free free"], spread: float
) -> Float[np.ndarray, "free free"]:
    """Return (JᵀJ/s² + 1)⁻¹, for noise s times as large, from (JᵀJ + 1)⁻¹."""
    square = spread**2
    return square * np.linalg.solve(np.eye(len(covariance)) + (square - 1) * covariance, covariance)


def _log_evidence(problem: Problem, solution: Fit, spread: float) -> float:
    """Logarithm of the evidence but for a constant that processes share [Laplace]."""
    moving = problem.moving
    covariance = covariance_at(np.asarray(solution.covariance)[np.ix_(moving, moving)], spread)
    data = 0.5 * float(solution.chi_square)
    prior = float(solution.cost) - data
    return float(0.5 * np.linalg.slogdet(covariance)[1] - data / spread**2 - prior)


def _assess(
    name: str, problem: Problem, evidence: ImportanceSample, first: Assessment | None, key: PRNGKey
) -> Assessment:
    z = evidence.samples
    draws = reported(problem, z)
    names = [n for n in problem.free if kind(n) in (*COMPARED, *OF_POWER_LAW, "noise")]
    reference = draws if first is None else reported(first.problem, first.evidence.samples)
    score, error = predictive_score(pointwise(problem, z)[None], evidence.effective / len(z))
    _, models, sds, *_ = predicted(problem, z[:DRAWS], key)
    medians = tuple(np.median(m, axis=0) for m in models)
    spread = (np.median(sd, axis=0) for sd in sds)
    data = (np.asarray(o.values) for o in problem.observations)
    residuals = tuple((y - m) / sd for y, m, sd in zip(data, medians, spread, strict=True))
    values = {n: Interval.of(draws[n]) for n in names}
    ratios = {n: Interval.of(draws[n] / reference[n]) for n in names if n in reference}
    return Assessment(name, problem, evidence, score, error, values, ratios, medians, residuals)
