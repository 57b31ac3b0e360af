"""Summary of a posterior: medians and intervals, checks of the model, and both in one call."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import emcee
import jax
import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from irisjax._types import PRNGKey
from irisjax.infer import model_comparison
from irisjax.infer.fit import Fit, fit
from irisjax.infer.identifiability import Information, information
from irisjax.infer.model_comparison import DRAWS, Interval, ProcessComparison, compare_processes
from irisjax.infer.parameters import unit_of
from irisjax.infer.posterior import Chains, check_run, mixing, sample
from irisjax.infer.problem import Problem, predicted, reported
from irisjax.numerics.streams import one_key

UNMOVED = 0.3
"""Contraction below which a posterior is mostly the prior."""


class Row(NamedTuple):
    """One parameter's posterior: quantiles, R-hat, effective samples of bulk and tails, and the
    contraction, 1 − posterior variance / prior variance where the prior is normal.
    """

    parameter: str
    unit: str
    median: float
    sd: float
    q2_5: float
    q16: float
    q84: float
    q97_5: float
    rhat: float
    ess_bulk: float
    ess_tail: float
    contraction: float


class PredictiveCheck(NamedTuple):
    """Share of simulated data that lie further from the model than the measured ones, by Σ of
    squared residuals and by their pattern, and the median factor on the stated noise (1 if fixed).
    """

    p_chi_square: float
    p_pattern: float
    noise: float

    @property
    def large(self) -> bool:
        """Whether residuals are larger than the noise."""
        return self.p_chi_square < 0.01

    @property
    def smooth(self) -> bool:
        """Whether neighbouring residuals are alike."""
        return self.p_pattern < 0.01

    @property
    def noisy(self) -> bool:
        """Whether the fit takes much more noise than was stated."""
        return self.noise > 2.5

    @property
    def passed(self) -> bool:
        """Whether the model may have produced the data."""
        return not (self.large or self.smooth or self.noisy)


class Analysis(NamedTuple):
    """All that is said of one eye: least-squares fit, posterior, a row for every parameter, whether
    the model may have produced the data, what they determine, and the other process's fit.
    """

    problem: Problem
    fit: Fit
    chains: Chains
    rows: list[Row]
    check: PredictiveCheck
    information: Information
    other: ProcessComparison

    @property
    def unmoved(self) -> tuple[str, ...]:
        """Free parameters of which the posterior is mostly the prior."""
        names = (row.parameter for row in self.rows if row.contraction < UNMOVED)
        return tuple(name for name in names if name in self.problem.free)


def analyse(
    problem: Problem,
    *,
    store: str | Path | None = None,
    resume: bool = False,
    walkers: int = 64,
    max_steps: int = 20_000,
    progress: Callable[[int, str], object] | None = None,
    key: PRNGKey,
) -> Analysis:
    """Fit a problem, sample its posterior, and judge both; `ValueError` as by `sample`, whose
    arguments these are, before any work.
    """
    check_run(problem, store, walkers=walkers, resume=resume, key=key)
    best = fit(problem, key=jax.random.fold_in(one_key(key), 1))
    other = problem.by(model_comparison.other_of(problem.process))
    best_by_other = fit(other, key=jax.random.fold_in(key, 5))
    chains = sample(
        problem, best, store=store, resume=resume, walkers=walkers, max_steps=max_steps,
        progress=progress, key=key,
    )  # fmt: skip
    rows = summarise(problem, chains)
    check = predictive_check(problem, chains, key=jax.random.fold_in(key, 2))
    intervals = {r.parameter: Interval(r.median, r.q2_5, r.q97_5) for r in rows}
    compared = compare_processes(problem, best, other, best_by_other, intervals=intervals)
    return Analysis(problem, best, chains, rows, check, information(problem, best), compared)


def summarise(problem: Problem, chains: Chains) -> list[Row]:
    """Return a row for every free and derived parameter."""
    # The prior of derived parameters: an integral over even points, nothing random.
    even = qmc.Sobol(len(problem.free), scramble=False).random_base2(14)
    prior, rows = reported(problem, ndtri(even + 2.0**-15)), []
    # A chain that is too short to be judged has no R-hat.
    has_rhat = np.isfinite(chains.rhat).all()
    for name, values in reported(problem, chains.z).items():
        if name in problem.free:
            i = problem.free.index(name)
            rhat, bulk, tail = chains.rhat[i], chains.ess_bulk[i], chains.ess_tail[i]
            variance = chains.z[..., i].var()
        else:
            rhat, bulk, tail = mixing(values.T) if has_rhat else (np.nan,) * 3
            # Walkers are not independent chains, as for the parameters.
            time = emcee.autocorr.integrated_time(values[..., None], tol=0, quiet=True)[0]
            bulk, tail = (min(ess, values.size / time) for ess in (bulk, tail))
            # The logarithm of a derived parameter has a nearly normal prior.
            variance = np.log(values).var() / np.log(prior[name]).var()
        q2_5, q16, median, q84, q97_5 = np.percentile(values, (2.5, 16, 50, 84, 97.5))
        numbers = median, values.std(), q2_5, q16, q84, q97_5, rhat, bulk, tail, float(1 - variance)
        rows.append(Row(name, unit_of(name), *numbers))
    return rows


def predictive(problem: Problem, chains: Chains, *, key: PRNGKey) -> Any:
    """Return `predicted` for `DRAWS` samples of the chains."""
    z = chains.flat
    index = np.linspace(0, len(z) - 1, min(DRAWS, len(z))).astype(int)
    return predicted(problem, z[index], key)


def predictive_check(problem: Problem, chains: Chains, *, key: PRNGKey) -> PredictiveCheck:
    """Check residuals by their size and by their pattern."""
    simulated, models, sds, *_ = predictive(problem, chains, key=key)
    statistics = []
    for values in (tuple(np.asarray(o.values) for o in problem.observations), simulated):
        residuals = [(y - m) / sd for y, m, sd in zip(values, models, sds, strict=True)]
        size = [(r**2).sum(axis=1) for r in residuals]
        products = [(r[:, 1:] * r[:, :-1]).sum(axis=1) for r in residuals]
        statistics.append((sum(size), sum(a / s for a, s in zip(products, size, strict=True))))
    larger, smoother = (float((b >= a).mean()) for a, b in zip(*statistics, strict=True))
    noise = reported(problem, chains.z).get("noise")
    return PredictiveCheck(larger, smoother, 1.0 if noise is None else float(np.median(noise)))
