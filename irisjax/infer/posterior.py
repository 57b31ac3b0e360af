"""Posterior by ensemble sampling (emcee), streamed to disk, resumable, long enough or said not to
be.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import emcee
import jax
import numpy as np

from irisjax._interrupt import unfinished
from irisjax._types import PRNGKey
from irisjax.infer.diagnostics import diagnostics
from irisjax.infer.fit import Fit, fit
from irisjax.infer.importance import DRAWS, importance_sample
from irisjax.infer.laplace import laplace
from irisjax.infer.moves import mixture
from irisjax.infer.pieces import density
from irisjax.infer.problem import Problem
from irisjax.infer.resume import check_run, fingerprint, words_of
from irisjax.infer.status import ChainStatus
from irisjax.infer.status import throw as throw_if
from irisjax.infer.stream import Stream, checkpoint

_SPREAD, _BURN, _BLOCK, _MOST_KEPT = 200, 300, 125, 1000
_LESSONS, _TAUGHT_BY = 3, 8192  # most times that a chain teaches a new one, most samples that teach
TAUS, ESS, RHAT = 50, 1000, 1.03
"""A chain is long enough with 50 autocorrelation times, 1,000 effective samples of every parameter,
and a split R-hat below 1.03 (walkers as chains: at 50 autocorrelation times each half-walker's mean
scatters by 1/√25)."""


class Chains(NamedTuple):
    """What a sampler left: the file, and how far it can be trusted.

    - `z`: kept samples (draws, walkers, free) in the priors' coordinates, every `thin`-th step
        after burn-in.
    - `tau` (steps), `ess_bulk`, `ess_tail`, `rhat`: one a parameter.
    - `status`: a `ChainStatus` item; `reason`: the figures behind it, empty for success.
    """

    z: np.ndarray
    log_probability: np.ndarray
    thin: int
    steps: int
    acceptance: float
    tau: np.ndarray
    ess_bulk: np.ndarray
    ess_tail: np.ndarray
    rhat: np.ndarray
    status: ChainStatus
    reason: str

    @property
    def converged(self) -> bool:
        """Whether the chain is long enough."""
        return bool(self.status == ChainStatus.successful)

    def steps_needed(self) -> float:
        """Steps for this autocorrelation time, which still grows; NaN where a walker is stuck."""
        return 1.05 * TAUS * self.tau.max()

    def next_look(self, least: int) -> int:
        """Steps at which to look again whether it is long enough, `least` on or later."""
        # A stuck walker may yet move: then as late as for a long autocorrelation time.
        needed = np.nan_to_num(self.steps_needed(), nan=np.inf)
        return int(np.clip(needed, self.steps + least, 1.5 * self.steps))


def sample(
    problem: Problem,
    path: str | Path,
    *,
    walkers: int = 64,
    start: Fit | None = None,
    resume: bool = False,
    max_steps: int = 20_000,
    progress: Callable[[int, str], Any] | None = None,
    throw: bool = False,
    key: PRNGKey,
) -> Chains:
    """Sample the posterior into an HDF5 file until it is long enough.

    That is for every parameter 50 autocorrelation times (`TAUS`), 1,000 effective samples (`ESS`;
    500 of the tails) and an R-hat of at most 1.03 (`RHAT`).

    `importance_sample`, from the least-squares optimum and the priors on, gives the walkers their
    first places and teaches the proposal of their independent jumps. Where its weights stay uneven
    a burn-in does, first with differences of walkers alone; it is kept apart and not used
    otherwise. A chain that is not long enough after 500 steps, or will not be, teaches a new one
    and is forgotten: a tail that the first lesson missed holds walkers for long. Such a second one
    has 1,000 steps, a third 2,000, a fourth as many as it takes. Step i draws from the key and i: a
    run that was killed and resumed gives the chain of one that was not.

    Args:
        problem: What was measured and what is free.
        path: The file.
        walkers: How many, more than twice the free parameters.
        start: Where the walkers begin; default the fit with this key.
        resume: Whether to go on where the file ends.
        max_steps: Most steps after burn-in.
        progress: Gets the number of steps and a word on what is done after each step; 0 after each
            round of importance sampling.
        throw: Whether to raise where the chain is not long enough.
        key: For all draws.

    Raises:
        ValueError: If `path` exists and `resume` is false, or belongs to another problem; if there
            are too few walkers; with `throw` for a chain that is not long enough.
    """
    path = Path(path)
    check_run(problem, path, walkers=walkers, resume=resume, key=key)
    words = words_of(key)

    def report(word, offset=0):
        def tell(n):
            if progress is not None:
                progress(offset + n, word)

        return tell

    if not path.exists():
        best = fit(problem, key=jax.random.fold_in(key, 0)) if start is None else start
        _begin(path, problem, walkers, words, best, lambda _: report("importance sampling")(0))
    log_probability = density(problem)

    burn = _Run(path, "burn", log_probability, mixture(None), words)
    taught = burn.backend.taught()
    if taught is None:
        # Differences of walkers, then jumps that these have taught.
        burn.advance(_SPREAD, report("burn-in"))
        taught = burn.between(_SPREAD // 2, _SPREAD)
        burn = _Run(path, "burn", log_probability, mixture(taught), words)
        burn.advance(_BURN, report("burn-in"))
        taught = burn.between((_SPREAD + _BURN) // 2, _BURN)
    begun = Stream(str(path), name="chain").initialized
    run = _Run(
        path, "chain", log_probability, mixture(taught), words, None if begun else burn.standing()
    )
    before, wanted = burn.backend.iteration, run.backend.next_look() or 2 * _BLOCK
    while True:
        run.advance(min(wanted, max_steps), report("sampling", before))
        steps = run.backend.iteration
        checkpoint(path)
        chains = diagnose(run.backend, steps)
        if chains.converged or steps >= max_steps:
            break
        wanted = chains.next_look(_BLOCK)
        run.backend.plan(wanted)
        lesson = run.backend.lesson() + 1
        patience = 2 * _BLOCK * 2**lesson
        if lesson <= _LESSONS and (steps >= patience or chains.steps_needed() > patience):
            thin = -(-steps * walkers // _TAUGHT_BY)
            taught = run.backend.get_chain(thin=thin, flat=True)
            mark, places = fingerprint(problem, walkers, words), run.standing()
            _new_file(path, places, mark, taught, lesson)
            run = _Run(path, "chain", log_probability, mixture(taught), words, places)
            before, wanted = before + steps, 2 * _BLOCK
    if throw:
        throw_if(chains.status, chains.reason)
    return chains


def diagnose(backend, steps: int) -> Chains:
    """Autocorrelation, effective samples and R-hat of a chain on disk, read with a stride that
    bounds memory.
    """
    stride = -(-steps // _MOST_KEPT)
    z = backend.get_chain(thin=stride)
    with np.errstate(invalid="ignore"):  # of a walker that never moved: NaN, which is reported
        tau = stride * emcee.autocorr.integrated_time(z, tol=0, quiet=True)
    rhat = bulk = tail = np.full(tau.shape, np.nan)
    if tau.max() * TAUS <= steps:  # a second's work, for nothing if it has to go on
        by_walker = np.moveaxis(
            z[:: max(1, int(tau.min() / stride / 3))], 0, 1
        )  # neighbours are alike
        rhat, bulk, tail = np.array([diagnostics(by_walker[..., k]) for k in range(z.shape[2])]).T
    # Walkers are not independent chains: count no more than their autocorrelation leaves.
    bulk = np.minimum(bulk, steps * z.shape[1] / tau)
    tail = np.minimum(tail, steps * z.shape[1] / tau)
    status, reason = ChainStatus.successful, ""
    if not np.isfinite(tau).all():
        status, reason = ChainStatus.stuck, "a walker never moved"
    elif not tau.max() * TAUS <= steps:
        status = ChainStatus.few_autocorrelation_times
        reason = f"{steps} steps are {steps / np.max(tau):.0f} autocorrelation times, not {TAUS}"
    elif not bulk.min() >= ESS or not tail.min() >= ESS / 2:
        status = ChainStatus.few_effective_samples
        reason = (
            f"effective samples {bulk.min():.0f} ({tail.min():.0f} of the tails), not {ESS} "
            f"({ESS // 2})"
        )
    elif not rhat.max() <= RHAT:
        status, reason = ChainStatus.not_mixed, f"R-hat {rhat.max():.3f}, not {RHAT}"
    thin = max(1, int(tau.min() / 2 / stride)) if np.isfinite(tau).all() else 1
    return Chains(
        z=z[thin - 1 :: thin],
        log_probability=backend.get_log_prob(thin=stride)[thin - 1 :: thin],
        thin=thin * stride,
        steps=steps,
        acceptance=float(np.mean(backend.accepted) / max(steps, 1)),
        tau=tau,
        ess_bulk=bulk,
        ess_tail=tail,
        rhat=rhat,
        status=status,
        reason=reason,
    )


class _Run:
    """An ensemble and the group of the file that it streams to."""

    def __init__(self, path, name, log_probability, moves, words, first=None):
        self.backend = Stream(str(path), name=name)
        if first is not None:
            self.backend.reset(*first.shape)
            self.backend.begin(first)
        self._forget_half_written(path, log_probability)
        self.sampler = emcee.EnsembleSampler(
            *self.backend.shape, log_probability, vectorize=True, moves=moves, backend=self.backend
        )
        lesson = self.backend.lesson()
        self.seed = [*words, len(name), *([lesson] if lesson else [])]
        self.random = np.random.RandomState(0)

    def advance(self, steps: int, progress) -> None:
        """Go on to so many steps."""
        done = self.backend.iteration
        if done >= steps:
            return
        here = self.standing()
        self._reseed(done)
        with self.backend.held():
            for _ in self.sampler.sample(
                here, iterations=steps - done, skip_initial_state_check=True
            ):
                done += 1
                self._reseed(done)
                progress(done)

    def standing(self) -> np.ndarray:
        """Where the walkers are."""
        if self.backend.iteration:
            return self.backend.get_last_sample().coords
        return self.backend.first()

    def between(self, first: int, last: int) -> np.ndarray:
        """All walkers' places in steps first to last, (n, free)."""
        z = self.backend.rows(first, last)
        return z.reshape(-1, z.shape[-1])

    def _reseed(self, step: int):
        self.random.seed([*self.seed, step])
        self.sampler.random_state = self.random.get_state()

    def _forget_half_written(self, path, log_probability):
        """Drop a last step whose log probability is not that of its place: the process died while
        writing it.
        """
        for _ in range(3):
            if not self.backend.iteration:
                return
            last = self.backend.get_last_sample()
            again = log_probability(last.coords)
            if np.allclose(again, np.asarray(last.log_prob), rtol=1e-9, atol=1e-9, equal_nan=True):
                return
            self.backend.drop_last()
        raise ValueError(
            f"{path}: its steps do not belong to this problem; remove it and start again"
        )


def _begin(
    path: Path, problem: Problem, walkers: int, words: list[int], best: Fit, progress
) -> None:
    """A new file with the walkers' first places, and with what teaches their jumps."""
    random = np.random.RandomState([*words, 1 << 31])
    found = importance_sample(density(problem), *laplace(problem, best), random, progress)
    free = found.samples.shape[1]
    # Walkers on one spot would know no differences.
    places = found.samples[random.choice(len(found.samples), walkers, walkers > DRAWS)]
    cloud = places + 1e-3 * found.samples.std(axis=0) * random.standard_normal((walkers, free))
    mark = fingerprint(problem, walkers, words)
    _new_file(path, cloud, mark, found.samples if found.enough else None)


def _new_file(path: Path, places, mark: str, taught, lesson: int = 0) -> None:
    """A file without a step, in place of one that may be there."""
    with unfinished(path.with_name(f".{path.name}.{os.getpid()}.tmp")) as temporary:
        backend = Stream(str(temporary), name="burn")
        try:
            backend.reset(*places.shape)
            backend.begin(places, mark, taught, lesson)
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
