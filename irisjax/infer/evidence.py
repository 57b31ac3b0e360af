"""The evidence of a model, the probability of the data whatever its parameters, by nested sampling,
and by importance sampling where a spectrum takes too long for that.

Likelihoods are compared over the whole of the priors and not at their best: a model that could have
made many other data pays for it. The sampler is BlackJAX's nested slice sampling, all of whose
walks go side by side in one program [Yallup, Kroupa & Handley 2026, arXiv:2601.23252].
"""

import importlib.util
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from irisjax._types import PRNGKey
from irisjax.infer.fit import fit
from irisjax.infer.importance import EFFECTIVE, importance_sample
from irisjax.infer.pieces import density
from irisjax.infer.posterior import words_of
from irisjax.infer.problem import Problem
from irisjax.numerics.checks import check_whole

_LEFT = 0.01  # of the evidence, in the points that still live, where the sampler stops
_TOGETHER = 64  # points that are replaced side by side, no more than an eighth of those that live
_STEPS = 8  # between two looks of the host
_VOLUMES = 200  # of histories of the prior's volume
_LOWEST = -1e30  # in place of the log likelihood where the solver has no answer


class Evidence(NamedTuple):
    """What a sampler found.

    - `log_evidence`: ln of the evidence, the likelihood averaged over the priors.
    - `error`: its standard deviation: by what is not known of the prior's volumes, or by the
        importance weights'.
    - `z`: draws of the posterior (draws, free) in the priors' coordinates, of equal weight.
    - `effective`: effective number of samples that they are drawn from; `steps` of the sampler,
        or rounds.
    - `by`: the sampler's name.
    """

    log_evidence: float
    error: float
    z: Float[np.ndarray, "draws free"]
    effective: float
    steps: int
    by: str = "nested sampling"

    @property
    def text(self) -> str:
        """The value and its error, with as many digits as the error asks for."""
        digits = 1 if self.error >= 0.05 else 2
        return f"{self.log_evidence:.{digits}f} ± {self.error:.{digits}f}"


class _Settings(NamedTuple):
    """What a program is made for; the version stands for the sampler's code."""

    together: int
    walk: int
    version: str


def evidence(
    problem: Problem,
    *,
    live: int = 500,
    draws: int = 2000,
    progress: Callable[[int], Any] | None = None,
    key: PRNGKey,
) -> Evidence:
    """The evidence of a problem's model, and draws of its posterior.

    Nested sampling [Skilling 2006, Bayesian Analysis 1, 833]: points drawn from the priors are
    replaced, the least probable first, by others that make the data more probable, until 1 % of
    the evidence is left in the points that live. The error falls as 1/√`live`, the time grows as
    `live`. Points move along slices of the region that they may be in [Neal 2003, Annals of
    Statistics 31, 705], twice as many as there are parameters for each replacement.

    Args:
        problem: What was measured and what is free.
        live: Points that live at a time.
        draws: Draws of the posterior that are kept.
        progress: Gets the number of steps, now and then.
        key: For all draws.

    Raises:
        ValueError: Without BlackJAX, for fewer than 50 points, and where no point has a likelihood.
    """
    check_sampler()
    check_whole("live", live, 50)
    check_whole("draws", draws, 1)
    import blackjax
    from blackjax.ns import base, utils

    first, moves, volumes, choice = jax.random.split(key, 4)
    settings = _Settings(
        max(1, min(_TOGETHER, live // 8)), max(5, 2 * len(problem.free)), blackjax.__version__
    )
    problem, dtype = problem.unnamed(), jnp.result_type(float)
    state = _begun(problem, jax.random.normal(first, (live, len(problem.free)), dtype), settings)
    if not bool((state.particles.loglikelihood > _LOWEST).any()):
        raise ValueError("no draw of the priors has a likelihood: see Problem.status")
    without_moves: Any = base.NSInfo
    dead = []
    steps, left = 0, math.inf
    while left > math.log(_LEFT):
        state, died = _advanced(problem, state, jax.random.fold_in(moves, steps), settings)
        dead.append(without_moves(died, None))
        steps += _STEPS
        left = float(state.integrator.logZ_live - state.integrator.logZ)
        if progress is not None:
            progress(steps)
    found = utils.finalise(state, dead, update_info=False)
    log_weights = np.asarray(utils.log_weights(volumes, found, shape=_VOLUMES), float)
    totals = np.logaddexp.reduce(log_weights, axis=0)
    weights = np.exp(log_weights - totals).mean(axis=1)
    z = np.asarray(found.particles.position)[_chosen(weights, draws, choice)]
    effective = weights.sum() ** 2 / (weights**2).sum()
    return Evidence(float(totals.mean()), float(totals.std()), z, float(effective), steps)


def evidence_by_importance(
    problem: Problem,
    *,
    draws: int = 2000,
    progress: Callable[[int], Any] | None = None,
    key: PRNGKey,
) -> Evidence:
    """The same by importance sampling from the least-squares fit and the priors on, see
    `importance.importance_sample`: some 10,000 likelihoods in place of a million, and a smaller
    error.

    It can miss a second mode far from the first, which nested sampling would find.

    Args:
        problem: What was measured and what is free.
        draws: Draws of the posterior that are kept.
        progress: Gets the number of rounds, now and then.
        key: For all draws.

    Raises:
        ValueError: Where no proposal resembles the posterior.
    """
    check_whole("draws", draws, 1)
    one, two = jax.random.split(key)
    random = np.random.RandomState(words_of(two))
    found = importance_sample(
        density(problem),
        fit(problem, key=one),
        random,
        *(() if progress is None else (progress,)),
    )
    if not found.enough:
        raise ValueError(
            f"importance weights stay uneven ({found.effective:.0f} effective draws of "
            f"{EFFECTIVE} asked): no evidence"
        )
    z = found.samples[random.choice(len(found.samples), draws, draws > len(found.samples))]
    return Evidence(
        found.log_integral, found.error, z, found.effective, found.rounds, "importance sampling"
    )


def check_sampler() -> None:
    """Raise `ValueError` where the package of the sampler is not installed."""
    if importlib.util.find_spec("blackjax") is None:
        raise ValueError("evidences need BlackJAX: pip install 'irisjax[compare]'")


def _chosen(weights: np.ndarray, count: int, key: PRNGKey) -> np.ndarray:
    """Places of so many draws in proportion to the weights, in no order [systematic resampling:
    Kitagawa 1996, J. Comput. Graph. Stat. 5, 1].
    """
    where, order = jax.random.split(key)
    even = (np.arange(count) + float(jax.random.uniform(where))) / count
    places = np.searchsorted(np.cumsum(weights) / weights.sum(), even)
    return places[np.asarray(jax.random.permutation(order, count))]


def _sampler(problem: Problem, settings: _Settings) -> Any:
    import blackjax

    def log_likelihood(z):
        value = problem.log_likelihood(z)
        return jnp.where(jnp.isfinite(value), value, _LOWEST)

    return blackjax.nss(
        logprior_fn=problem.log_prior,
        loglikelihood_fn=log_likelihood,
        num_delete=settings.together,
        num_inner_steps=settings.walk,
    )


@eqx.filter_jit
def _begun(problem: Problem, z, settings: _Settings):
    return _sampler(problem, settings).init(z)


@eqx.filter_jit
def _advanced(problem: Problem, state, key, settings: _Settings):
    """The state after `_STEPS` steps, and the points that died."""

    def step(state, key):
        state, info = _sampler(problem, settings).step(key, state)
        return state, info.particles

    state, died = jax.lax.scan(step, state, jax.random.split(key, _STEPS))
    return state, jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), died)
