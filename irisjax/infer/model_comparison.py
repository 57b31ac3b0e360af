"""One measurement read by several models of light: evidences, scores, and how far pigments move.

Every model has the same priors of what it shares with the others and the same noise. Its posterior
is that of the sampler which finds its evidence.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from irisjax._types import PRNGKey
from irisjax.infer.diagnostics import predictive_score
from irisjax.infer.evidence import Evidence, check_sampler, evidence, evidence_by_importance
from irisjax.infer.models import solvers_of
from irisjax.infer.other_process import (
    PIGMENTS,
    PREFERRED,
    Interval,
    name_of,
    odds_in_words,
    other_of,
)
from irisjax.infer.parameters import OF_POWER_LAW, kind, unit_of
from irisjax.infer.pieces import pointwise, predicted
from irisjax.infer.problem import Problem
from irisjax.infer.summary import DRAWS, reported
from irisjax.tissue.scattering import PowerLaw
from irisjax.transport.radiative.adding import AddingDoubling

GENERAL = "general radiative transfer"
"""Radiative transfer with a power law of scattering, a Rayleigh share and an anisotropy."""
_QUOTED = {"melanin_load": "melanin load", "abl_fraction": "ABL fraction"}


class Candidate(NamedTuple):
    """A model that may have made the data: what a sentence calls it, the data's problem by it, and
    whether its evidence is found by importance sampling, where nested sampling would take hours.
    """

    name: str
    problem: Problem
    by_importance: bool = False


class Assessment(NamedTuple):
    """What one model makes of the data.

    - `evidence`: with the posterior's draws.
    - `score`, `score_error`: PSIS-LOO and its standard error. Neighbouring wavelengths tell of one
        another, so it is no evidence of its own.
    - `values`: median and 95 % interval of each of `PIGMENTS` that is free, of a power law's
        parameters, and of the noise.
    - `ratios`: of these, to the first model's where it has them; draws of either posterior by
        themselves.
    - `models`, `residuals`: of each observation, the median of the model without noise, and the
        data less that in standard deviations, the noise's factor included.
    """

    candidate: Candidate
    evidence: Evidence
    score: float
    score_error: float
    values: dict[str, Interval]
    ratios: dict[str, Interval]
    models: tuple[np.ndarray, ...]
    residuals: tuple[np.ndarray, ...]

    @property
    def name(self) -> str:
        """What a sentence calls the model."""
        return self.candidate.name


def candidates_of(problem: Problem) -> tuple[Candidate, ...]:
    """The models that a measurement is read by: ILIT, radiative transfer, and radiative transfer
    with a power law of scattering ("general"); the problem's own first.
    """
    if problem.base.power_law is not None:
        plain = problem.under(None)
        problems = problem, plain, plain.by(other_of(plain.process))
    else:
        problems = problem, problem.by(other_of(problem.process)), _general(problem)
    return tuple(
        Candidate(name_of(p.process), p)
        if p.base.power_law is None
        else Candidate(GENERAL, p, by_importance=True)
        for p in problems
    )


def _general(problem: Problem) -> Problem:
    """The problem with a power law of scattering, by a solver with a relative error of 2e-3 or less
    for 95 % of the priors' irides: a tenth of the noise of a good spectrum.
    """
    general = problem.under(PowerLaw())
    return dataclasses.replace(
        general,
        solvers=solvers_of(
            general.base, general.observations, general.process, {}, AddingDoubling(12, 10)
        ),
    )


def compare_models(
    problem: Problem,
    candidates: Sequence[Candidate] | None = None,
    *,
    live: int = 500,
    progress: Callable[[str, int], Any] | None = None,
    key: PRNGKey,
) -> tuple[Assessment, ...]:
    """What each of several models makes of a problem's data.

    Args:
        problem: What was measured and what is free.
        candidates: The models, of the same data; default `candidates_of(problem)`.
        live: Points of the nested sampler that live at a time, see `evidence`.
        progress: Gets a model's name and the number of the sampler's steps, now and then.
        key: For all draws.

    Raises:
        ValueError: For fewer than two models or equal names, and without BlackJAX where an
            evidence is to be found by nested sampling.
    """
    candidates = candidates_of(problem) if candidates is None else tuple(candidates)
    if not all(c.by_importance for c in candidates):
        check_sampler()
    if len({c.name for c in candidates}) < max(2, len(candidates)):
        raise ValueError("give two or more models to compare, each with a name of its own")
    out: list[Assessment] = []
    for i, candidate in enumerate(candidates):

        def tell(steps: int, name=candidate.name) -> None:
            if progress is not None:
                progress(name, steps)

        one, two = jax.random.split(jax.random.fold_in(key, i))
        tell(0)
        if candidate.by_importance:
            found = evidence_by_importance(candidate.problem, progress=tell, key=one)
        else:
            found = evidence(candidate.problem, live=live, progress=tell, key=one)
        out.append(_assessed(candidate, found, out[0] if out else None, two))
    return tuple(out)


def comparison_sentence(assessments: Sequence[Assessment]) -> str:
    """One sentence to quote: which model the data prefer by what odds, and how far the melanin
    load moves.
    """
    first, second = sorted(assessments, key=lambda a: -a.evidence.log_evidence)[:2]
    log_odds = first.evidence.log_evidence - second.evidence.log_evidence
    error = math.hypot(first.evidence.error, second.evidence.error)
    if log_odds - 2 * error > PREFERRED:
        said = f"prefer {first.name} to {second.name} by odds of {odds_in_words(log_odds)} to 1"
    else:
        said = f"do not decide between {first.name} and {second.name}"
    evidences = ", ".join(f"{a.evidence.text} by {a.name}" for a in assessments)
    data = ", ".join(o.name for o in assessments[0].candidate.problem.observations)
    quoted = [n for n in assessments[0].values if kind(n) in _QUOTED]
    samplers = " and ".join(dict.fromkeys(a.evidence.by for a in assessments))
    parts = (
        f"The data ({data}) {said} (ln evidence {evidences}; {samplers}, equal priors)",
        *(_placed(name, assessments) for name in quoted),
    )
    return f"{'; '.join(parts)}."


def _placed(name: str, assessments: Sequence[Assessment]) -> str:
    """A pigment by every model, and its ratio to the first one's."""
    each = []
    for a in assessments:
        value, low, high = a.values[name]
        text = f"{value:.3g} ({low:.3g} to {high:.3g}) by {a.name}"
        if a is not assessments[0]:
            ratio, least, most = a.ratios[name]
            text += f", {ratio:.2g} ({least:.2g} to {most:.2g}) times that"
        each.append(text)
    plain, tag = _QUOTED[kind(name)], name.partition("@")[2]
    unit = unit_of(name) and f", {unit_of(name)}"
    return f"{plain}{tag and f' {tag}'}{unit} (95 %): {', '.join(each)}"


def _assessed(
    candidate: Candidate, found: Evidence, first: Assessment | None, key: PRNGKey
) -> Assessment:
    problem = candidate.problem
    draws = reported(problem, found.z)
    names = [n for n in problem.free if kind(n) in (*PIGMENTS, *OF_POWER_LAW, "noise")]
    beside = draws if first is None else reported(first.candidate.problem, first.evidence.z)
    score, error = predictive_score(
        pointwise(problem, found.z)[None], min(1.0, found.effective / len(found.z))
    )
    _, models, sds = predicted(problem.unnamed(), jnp.asarray(found.z[:DRAWS]), key)
    medians = tuple(np.median(np.asarray(m), axis=0) for m in models)
    spread = (np.median(np.asarray(sd), axis=0) for sd in sds)
    data = (np.asarray(o.values) for o in problem.observations)
    return Assessment(
        candidate,
        found,
        score,
        error,
        {n: _interval(draws[n]) for n in names},
        {n: _interval(draws[n] / beside[n]) for n in names if n in beside},
        medians,
        tuple((y - m) / sd for y, m, sd in zip(data, medians, spread, strict=True)),
    )


def _interval(values: np.ndarray) -> Interval:
    median, low, high = np.percentile(values, (50.0, 2.5, 97.5))
    return Interval(float(median), float(low), float(high))
