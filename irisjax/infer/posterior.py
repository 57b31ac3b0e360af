"""Posteriors by ensemble sampling (emcee): importance sampling finds where the walkers start, and
the chain goes on until it is long enough.
"""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import emcee
import equinox as eqx
import numpy as np
from jaxtyping import Float

from irisjax._types import PRNGKey
from irisjax.infer.importance import DRAWS, Approximation, importance_sample
from irisjax.infer.moves import mixture
from irisjax.infer.store import ChainStart, Store
from irisjax.numerics.streams import words_of

TAUS, ESS, RHAT = 50, 1000, 1.03
"""A chain is long enough with 50 autocorrelation times, 1,000 effective samples of every parameter,
and a split R-hat below 1.03 (walkers as chains: at 50 autocorrelation times each half-walker's mean
scatters by 1/√25)."""
_BURN_IN = (200, 100)  # steps of the two stages of burn-in
_FIRST_LOOK, _BETWEEN_LOOKS = 250, 125  # steps
_PATIENCE = 500  # steps after which a first chain that is not long enough is replaced
_REPLACED = 3  # largest number of chains that are replaced
_ADAPTED_TO = 8192  # most samples that proposals are adapted to
_MOST_KEPT = 1000  # steps that a diagnosis reads
_BETWEEN_SAVES = 2.0  # seconds


@runtime_checkable
class Density(Protocol):
    """A density that can be sampled: its unnormalised logarithm for many vectors, (n, free) → (n,),
    −∞ where it is zero, and the names of its coordinates. Their priors should be standard normal:
    importance sampling draws from that too.
    """

    @property
    def names(self) -> Sequence[str]: ...

    @property
    def log_density(self) -> Callable[[np.ndarray], np.ndarray]: ...


class ChainStatus(eqx.Enumeration):
    """Outcome of a sampling run: whether the chain is long enough, or what it lacks first."""

    successful = ""
    stuck = "a walker never moved"
    few_autocorrelation_times = "the chain has too few autocorrelation times"
    few_effective_samples = "the chain has too few effective samples"
    not_mixed = "walkers disagree (R-hat)"


class Chains(NamedTuple):
    """Samples of a posterior, and how far they can be trusted.

    Attributes:
        z: Samples (draws, walkers, free) in the priors' coordinates, every `thin`-th step.
        log_probability: Their log densities, (draws, walkers).
        thin: Steps between two samples.
        steps: Number of steps after burn-in.
        acceptance: Share of accepted proposals in the last 1,000 steps.
        tau: Autocorrelation time of each parameter, in steps.
        ess_bulk: Effective number of samples of each parameter; `ess_tail` that of the tails.
        rhat: Split R-hat of each parameter.
        reason: The figures behind the status, empty for success.
    """

    z: Float[np.ndarray, "draws walkers free"]
    log_probability: Float[np.ndarray, "draws walkers"]
    thin: int
    steps: int
    acceptance: float
    tau: Float[np.ndarray, " free"]
    ess_bulk: Float[np.ndarray, " free"]
    ess_tail: Float[np.ndarray, " free"]
    rhat: Float[np.ndarray, " free"]
    status: ChainStatus
    reason: str

    @property
    def converged(self) -> bool:
        """Whether the chain is long enough."""
        return bool(self.status == ChainStatus.successful)

    @property
    def flat(self) -> Float[np.ndarray, "samples free"]:
        """Samples of all walkers, one after another."""
        return self.z.reshape(-1, self.z.shape[-1])


def sample(
    target: Density,
    start: Approximation,
    *,
    store: str | Path | None = None,
    resume: bool = False,
    walkers: int = 64,
    max_steps: int = 20_000,
    progress: Callable[[int, str], object] | None = None,
    throw: bool = False,
    key: PRNGKey,
) -> Chains:
    """Sample a posterior until the chain is long enough.

    Long enough means, for every parameter, `TAUS` autocorrelation times, `ESS` effective samples
    (half as many of the tails) and an R-hat of at most `RHAT`.

    `importance_sample` draws the walkers' first places, and the proposal of their independent jumps
    is adapted to its samples. Where its weights stay uneven, a burn-in does both, at first with
    differences of walkers alone; it is discarded. If the chain is not long enough after 500 steps,
    or will not be soon after, the proposal is adapted to its samples and a new chain replaces it.
    This rescues runs in which the first proposal missed a tail. The second chain has 1,000 steps,
    the third 2,000, the fourth as many as it takes. Step i draws from the key and i, so that a run
    which was killed and resumed gives the same chain as one that was not.

    Args:
        target: The density, such as a `Problem`.
        start: Normal approximation of it, such as the least-squares fit of a problem.
        store: HDF5 file for the chain, saved every two seconds; by default there is none.
        resume: Whether to continue the chain in the file.
        walkers: Number of walkers, at least 2 more than twice the free parameters.
        max_steps: Largest number of steps after burn-in.
        progress: Called after each step with the number of steps and a word for what is done; with
            0 after each round of importance sampling.
        throw: Whether to raise where the chain is not long enough.
        key: Source of all draws.

    Raises:
        ValueError: For a file of another target, key or number of walkers, or without `resume`; for
            too few walkers; with `throw`, for a chain that is not long enough.
    """
    check_run(target, store, walkers=walkers, resume=resume, key=key)
    storage, log_density = Store(store), target.log_density
    report = progress or (lambda steps, word: None)
    chain = storage.start
    if chain is None:
        chain = storage.begin(_initial_ensemble(target, start, walkers, key, report))
    for steps in _BURN_IN[chain.number :]:
        _advance(storage, chain, steps, log_density, key, report, "burn-in")
        chain = _replace(storage, chain, storage.rows(steps // 2, steps)[0])
    while True:
        steps = min(storage.planned or _FIRST_LOOK, max_steps)
        _advance(storage, chain, steps, log_density, key, report, "sampling")
        chains = diagnose(storage)
        if chains.converged or chains.steps >= max_steps:
            break
        needed = 1.05 * TAUS * chains.tau.max()  # NaN of a walker that never moved, which may yet
        planned = np.nan_to_num(needed, nan=np.inf)
        storage.planned = int(np.clip(planned, chains.steps + _BETWEEN_LOOKS, 1.5 * chains.steps))
        replaced = chain.number - len(_BURN_IN)
        patience = _PATIENCE * 2**replaced
        if replaced < _REPLACED and (chains.steps >= patience or needed > patience):
            stride = -(-chains.steps * walkers // _ADAPTED_TO)
            chain = _replace(storage, chain, storage.rows(stride - 1, chains.steps, stride)[0])
    if throw and not chains.converged:
        raise ValueError(chains.reason)
    return chains


def check_run(
    target: Density,
    store: str | Path | None,
    *,
    walkers: int = 64,
    resume: bool = False,
    key: PRNGKey,
) -> None:
    """Raise, before any work, the `ValueError` that `sample` would raise for its arguments."""
    free = len(target.names)
    if walkers < (minimum := 2 * free + 2):
        message = f"{walkers} walkers are too few for {free} free parameters"
        raise ValueError(f"{message}; give at least {minimum}")
    if store is None or not Path(store).exists():
        return
    if not resume:
        raise ValueError(f"{store}: exists; resume it or remove it")
    start = Store(store).start
    assert start is not None
    same = start.owner == _owner(target, key) and start.places.shape == (walkers, free)
    # A chain belongs to the density that its walkers had where they started.
    limits = {"rtol": 1e-9, "atol": 1e-9, "equal_nan": True}
    if not same or not np.allclose(target.log_density(start.places), start.log_density, **limits):
        message = "made from other data or settings; it cannot be resumed with these"
        raise ValueError(f"{store}: {message}")


def diagnose(store: Store) -> Chains:
    """Judge a chain by its autocorrelation and R-hat; a long one by every n-th of its steps."""
    steps = store.steps
    stride = -(-steps // _MOST_KEPT)
    z, log_density = store.rows(stride - 1, steps, stride)
    with np.errstate(invalid="ignore"):  # of a walker that never moved: NaN, which is reported
        tau = stride * emcee.autocorr.integrated_time(z, tol=0, quiet=True)
    rhat = bulk = tail = np.full(tau.shape, np.nan)
    if tau.max() * TAUS <= steps:  # a second's work, which a chain that goes on does not need
        # Neighbours are alike.
        by_walker = np.moveaxis(z[:: max(1, int(tau.min() / stride / 3))], 0, 1)
        rhat, bulk, tail = np.array([mixing(by_walker[..., k]) for k in range(z.shape[2])]).T
    # Walkers are not independent chains: count no more than their autocorrelation leaves.
    bulk, tail = (np.minimum(ess, steps * z.shape[1] / tau) for ess in (bulk, tail))
    status, reason = ChainStatus.successful, ""
    if not np.isfinite(tau).all():
        status, reason = ChainStatus.stuck, "a walker never moved"
    elif not tau.max() * TAUS <= steps:
        status = ChainStatus.few_autocorrelation_times
        reason = f"{steps} steps are {steps / np.max(tau):.0f} autocorrelation times, not {TAUS}"
    elif not (bulk.min() >= ESS and tail.min() >= ESS / 2):
        status = ChainStatus.few_effective_samples
        counts = f"{bulk.min():.0f} ({tail.min():.0f} of the tails)"
        reason = f"effective samples {counts}, not {ESS} ({ESS // 2})"
    elif not rhat.max() <= RHAT:
        status, reason = ChainStatus.not_mixed, f"R-hat {rhat.max():.3f}, not {RHAT}"
    thin = max(1, int(tau.min() / 2 / stride)) if np.isfinite(tau).all() else 1
    recent, _ = store.rows(max(0, steps - _MOST_KEPT), steps)
    acceptance = float((recent[1:] != recent[:-1]).any(axis=-1).mean()) if steps > 1 else np.nan
    rows = slice(thin - 1, None, thin)
    return Chains(
        z[rows], log_density[rows], thin * stride, steps, acceptance, tau, bulk, tail, rhat,
        status, reason,
    )  # fmt: skip


def mixing(draws: Float[np.ndarray, "chains draws"]) -> tuple[float, float, float]:
    """Compute rank-normalised split R-hat and ESS of bulk and tails  [Vehtari et al. 2021]."""
    from arviz_stats.base.array import array_stats

    stats: Any = array_stats  # it returns scalars where its annotations have tuples too
    bulk, tail = stats.ess(draws, method="bulk"), stats.ess(draws, method="tail", prob=(0.05, 0.95))
    return float(stats.rhat(draws)), float(bulk), float(tail)


def _initial_ensemble(
    target: Density, start: Approximation, walkers: int, key: PRNGKey, report
) -> ChainStart:
    """The walkers' first places, and the samples that their jumps are adapted to."""
    random = np.random.RandomState([*words_of(key), 1 << 31])
    proposal = importance_sample(
        target.log_density, start, random, lambda rounds: report(0, "importance sampling")
    )
    places = proposal.samples[random.choice(len(proposal.samples), walkers, walkers > DRAWS)]
    # Differences of walkers on one spot would be zero.
    jitter = random.standard_normal(places.shape)
    places = places + 1e-3 * proposal.samples.std(axis=0) * jitter
    number, adapted_to = (len(_BURN_IN), proposal.samples) if proposal.enough else (0, None)
    log_density = np.asarray(target.log_density(places), float)
    return ChainStart(_owner(target, key), number, 0, places, log_density, adapted_to)


def _owner(target: Density, key: PRNGKey) -> str:
    return f"{', '.join(target.names)}; key {words_of(key)}"


def _advance(
    store: Store,
    start: ChainStart,
    steps: int,
    log_density: Callable[[np.ndarray], np.ndarray],
    key: PRNGKey,
    report: Callable[[int, str], object],
    word: str,
) -> None:
    """Continue a chain to so many steps."""
    places, values = store.last()
    done, random, saved = store.steps, np.random.RandomState(0), time.monotonic()
    if done >= steps:
        return
    (walkers, free), moves = places.shape, mixture(start.adapted_to)
    sampler = emcee.EnsembleSampler(walkers, free, log_density, vectorize=True, moves=moves)

    def reseed() -> None:
        random.seed([*words_of(key), start.number, done])
        sampler.random_state = random.get_state()

    reseed()
    try:
        for state in sampler.sample(
            emcee.State(places, log_prob=values, copy=True),
            iterations=steps - done,
            store=False,
            skip_initial_state_check=True,
        ):
            store.append(state.coords, np.asarray(state.log_prob))
            done += 1
            reseed()
            if time.monotonic() > saved + _BETWEEN_SAVES:
                store.save()
                saved = time.monotonic()
            report(start.steps_before + done, word)
    finally:
        store.save()


def _replace(store: Store, start: ChainStart, samples: np.ndarray) -> ChainStart:
    """Start a new chain from the walkers' places, with proposals adapted to samples."""
    number, before = start.number + 1, start.steps_before + store.steps
    adapted_to = samples.reshape(-1, samples.shape[-1])
    return store.begin(ChainStart(start.owner, number, before, *store.last(), adapted_to))
