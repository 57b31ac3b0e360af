"""A posterior of the pigments of a photographed iris.

Importance sampling about the least-squares fit is enough as a rule, and takes seconds. Where its
weights stay uneven, or where it is asked for, emcee's walkers start from its draws, whose
differences teach their jumps; the chain goes on until it is long enough.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import emcee
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from irisjax.infer.importance import ImportanceSample, importance_sample
from irisjax.infer.moves import mixture
from irisjax.infer.posterior import Chains, diagnose
from irisjax.numerics.programs import program
from irisjax.photo.pigments import NAMES, Fit, log_probability, values_of
from irisjax.photo.windows import Windows
from irisjax.tissue.iris import Iris

SAMPLERS = ("importance", "emcee")
WALKERS = 48
_BLOCK = 150  # steps between looks at the chain
_ROWS = WALKERS // 2  # log probabilities computed at a time: what a step of emcee asks for


class Estimate(NamedTuple):
    """What is known of one parameter.

    - `median`, `sd`, `low`, `high`: of its samples, the last two 2.5 and 97.5 per cent.
    - `contraction`: one minus the variance over the prior's, in the coordinate in which that is a
        standard normal: 0 where the photograph told nothing.
    """

    median: float
    sd: float
    low: float
    high: float
    contraction: float


class PigmentPosterior(NamedTuple):
    """Samples of all parameters by name, and what they say of each.

    - `z`: the samples as standard normal numbers of their priors, (samples, free).
    - `effective`: how many independent ones they are worth, of the parameter where they are fewest.
    - `chains`: of emcee; `None` where importance sampling was enough.
    - `reason`: why they may not stand for the posterior, or nothing.
    """

    samples: dict[str, Float[np.ndarray, " samples"]]
    estimates: dict[str, Estimate]
    z: Float[np.ndarray, "samples free"]
    effective: float
    chains: Chains | None
    reason: str

    @property
    def sampler(self) -> str:
        """By which they were drawn."""
        return SAMPLERS[0] if self.chains is None else SAMPLERS[1]

    @property
    def converged(self) -> bool:
        """Whether they may stand for the posterior."""
        return not self.reason


def sample(
    windows: Windows,
    base: Iris,
    best: Fit,
    *,
    sampler: str = SAMPLERS[0],
    max_steps: int = 8000,
    progress: Callable[[int], Any] = lambda steps: None,
    seed: int,
) -> PigmentPosterior:
    """Sample the posterior of concentrations, light and camera.

    Args:
        windows: Of one photograph.
        base: Fixes everything but melanins and scattering.
        best: The least-squares fit, from which it starts.
        sampler: `"importance"` goes on to emcee only where it must.
        max_steps: At which emcee's chain ends, long enough or not; `reason` says which.
        progress: Gets the number of steps done.
        seed: Of all random numbers.
    """
    held = _density.bound((windows, base))

    def density(z):
        z = np.asarray(z, np.float64)
        padded = np.pad(z, ((0, -len(z) % _ROWS), (0, 0)), mode="edge")
        rows = padded.reshape(-1, _ROWS, z.shape[1])
        return np.concatenate([np.asarray(held(jnp.asarray(r))) for r in rows])[: len(z)]

    random = np.random.RandomState(seed)
    covariance = best.covariance + 1e-9 * np.eye(len(best.z))
    first = importance_sample(density, best.z, covariance, random)
    if sampler == SAMPLERS[0] and first.enough:
        return _posterior(first.samples, first.effective, None, "")
    chains = _chains(density, first, random, max_steps, progress)
    flat = chains.z.reshape(-1, len(NAMES))
    effective = float(min(chains.ess_bulk.min(), chains.ess_tail.min()))
    return _posterior(flat, effective, chains, chains.reason)


def _chains(density, first: ImportanceSample, random, max_steps: int, progress) -> Chains:
    places = first.samples[random.choice(len(first.samples), WALKERS, False)]
    start = places + 1e-3 * first.samples.std(0) * random.standard_normal(places.shape)
    # What teaches jumps may be uneven where the sample is small: walkers then go by differences.
    moves = mixture(first.samples if first.effective > 100 else None)
    sampler = emcee.EnsembleSampler(
        WALKERS, len(NAMES), density, vectorize=True, moves=moves, backend=emcee.backends.Backend()
    )
    sampler.random_state = random.get_state()
    here: Any = start
    chains = None
    while chains is None or not (chains.converged or chains.steps >= max_steps):
        for _ in sampler.sample(here, iterations=_BLOCK, skip_initial_state_check=True):
            progress(sampler.iteration)
        here = sampler.get_last_sample()
        chains = diagnose(sampler.backend, sampler.iteration)
    return chains


def _posterior(z, effective: float, chains: Chains | None, reason: str) -> PigmentPosterior:
    drawn_values = jax.vmap(values_of)(jnp.asarray(z))
    values = {name: np.asarray(drawn_values[name]) for name in NAMES}
    estimates = {}
    for i, (name, drawn) in enumerate(values.items()):
        low, median, high = (float(v) for v in np.quantile(drawn, [0.025, 0.5, 0.975]))
        told = float(1 - z[:, i].var())
        estimates[name] = Estimate(median, float(drawn.std()), low, high, told)
    return PigmentPosterior(values, estimates, z, float(effective), chains, reason)


@program
def _density(held, z):
    windows, base = held
    return jax.vmap(lambda row: log_probability(row, windows, base))(z)
