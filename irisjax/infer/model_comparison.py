"""One measurement read by several models of light: evidences, scores, and how far pigments move."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from irisjax._types import PRNGKey
from irisjax.infer.analysis import DRAWS, predictive_score, reported
from irisjax.infer.fit import fit
from irisjax.infer.importance import EFFECTIVE, ImportanceSample, importance_sample
from irisjax.infer.models import solvers_of
from irisjax.infer.other_process import COMPARED, Interval, other_of
from irisjax.infer.parameters import OF_POWER_LAW, kind
from irisjax.infer.posterior import words_of
from irisjax.infer.problem import Problem, pointwise, predicted
from irisjax.tissue.scattering import PowerLaw
from irisjax.transport.process import Ilit
from irisjax.transport.radiative.adding import AddingDoubling


class Candidate(NamedTuple):
    """A model that may have made the data: its name, and the problem of the data by it."""

    name: str
    problem: Problem


class Assessment(NamedTuple):
    """What one model makes of the data.

    Attributes:
        candidate: The model.
        evidence: Samples of its posterior, and its evidence: the probability of the data averaged
            over the priors. A model that could have made many other data has less of it.
        score: Predictive score (PSIS-LOO). Neighbouring wavelengths are not independent, so it is
            no evidence of its own.
        score_error: Its standard error.
        values: Median and 95 % interval of each of `COMPARED` that is free, of a power law's
            parameters, and of the noise.
        ratios: Ratios of these to the first model's where it has them, the draws of the two
            posteriors being independent.
        models: Of each observation, the median of the model without noise.
        residuals: The data less that, in standard deviations, the noise's factor included.
    """

    candidate: Candidate
    evidence: ImportanceSample
    score: float
    score_error: float
    values: dict[str, Interval]
    ratios: dict[str, Interval]
    models: tuple[np.ndarray, ...]
    residuals: tuple[np.ndarray, ...]

    @property
    def name(self) -> str:
        """Name of the model."""
        return self.candidate.name


def candidates_of(problem: Problem) -> tuple[Candidate, ...]:
    """Return the models that a measurement is read by, the problem's own first: ILIT, radiative
    transfer, and radiative transfer with a power law of scattering ("general").
    """
    if problem.base.power_law is not None:
        plain = problem.under(None)
        problems = problem, plain, plain.by(other_of(plain.process))
    else:
        problems = problem, problem.by(other_of(problem.process)), _general(problem)
    return tuple(Candidate(_name_of(p), p) for p in problems)


def _name_of(problem: Problem) -> str:
    """Return the name of a problem's model of light."""
    if problem.base.power_law is not None:
        return "general radiative transfer"
    return "ILIT" if isinstance(problem.process, Ilit) else "radiative transfer"


def compare_models(
    problem: Problem,
    candidates: Sequence[Candidate] | None = None,
    *,
    progress: Callable[[str, int], Any] | None = None,
    key: PRNGKey,
) -> tuple[Assessment, ...]:
    """Assess several models of a problem's data by importance sampling.

    All have the same noise, and the same priors of what they share. An evidence can miss a second
    mode far from the least-squares fit.

    Args:
        problem: What was measured and what is free.
        candidates: The models, of the same data; default `candidates_of(problem)`.
        progress: Called with a model's name and the number of rounds of sampling done.
        key: Source of all draws.

    Raises:
        ValueError: For fewer than two models or equal names, and where no proposal resembles a
            model's posterior.
    """
    candidates = candidates_of(problem) if candidates is None else tuple(candidates)
    if len({c.name for c in candidates}) < max(2, len(candidates)):
        raise ValueError("give two or more models to compare, each with a name of its own")
    out: list[Assessment] = []
    for i, candidate in enumerate(candidates):

        def tell(rounds: int, name: str = candidate.name) -> None:
            if progress is not None:
                progress(name, rounds)

        one, two, three = jax.random.split(jax.random.fold_in(key, i), 3)
        tell(0)
        best = fit(candidate.problem, key=one)
        random = np.random.RandomState(words_of(two))
        found = importance_sample(candidate.problem.log_density, best, random, tell)
        if not found.enough:
            raise ValueError(
                f"{candidate.name}: importance weights stay uneven ({found.effective:.0f} "
                f"effective draws of {EFFECTIVE} asked): no evidence"
            )
        # Resampling leaves them in the order of the rounds.
        found = found._replace(samples=random.permutation(found.samples))
        out.append(_assessed(candidate, found, out[0] if out else None, three))
    return tuple(out)


def _general(problem: Problem) -> Problem:
    """The problem with a power law of scattering, by a solver with a relative error of 2e-3 or less
    for 95 % of the priors' irides: a tenth of the noise of a good spectrum.
    """
    general = problem.under(PowerLaw())
    return dataclasses.replace(
        general,
        solvers=solvers_of(general.base, general.observations, AddingDoubling(12, 10)),
    )


def _assessed(
    candidate: Candidate, found: ImportanceSample, first: Assessment | None, key: PRNGKey
) -> Assessment:
    problem, z = candidate.problem, found.samples
    draws = reported(problem, z)
    names = [n for n in problem.free if kind(n) in (*COMPARED, *OF_POWER_LAW, "noise")]
    beside = draws if first is None else reported(first.candidate.problem, first.evidence.samples)
    score, error = predictive_score(pointwise(problem, z)[None], found.effective / len(z))
    _, models, sds = predicted(problem.unnamed(), jnp.asarray(z[:DRAWS]), key)
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
