"""A posterior of the pigments of a photographed iris, by emcee.

Importance sampling about the least-squares fit finds the walkers their places and teaches their
jumps, as it does for spectra; the chain goes on until it is long enough.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import emcee
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from irisjax.infer.importance import importance_sample
from irisjax.infer.moves import mixture
from irisjax.infer.posterior import Chains, diagnose
from irisjax.numerics.programs import program
from irisjax.photo.pigments import NAMES, Fit, log_probability, values_of
from irisjax.photo.windows import Windows
from irisjax.tissue.iris import Iris

WALKERS = 48
_BLOCK = 150  # steps between looks at the chain
_ROWS = WALKERS // 2  # log probabilities computed at a time: what a step of emcee asks for


class Estimate(NamedTuple):
    """What is known of one parameter.

    - `median`, `sd`, `low`, `high`: of its samples, the last two 2.5 and 97.5 per cent.
    - `contraction`: one minus the variance over the prior's, in the coordinate in which that is a
        standard normal: 0 where the photograph told nothing.
    - `rhat`, `effective`: of the chains.
    """

    median: float
    sd: float
    low: float
    high: float
    contraction: float
    rhat: float
    effective: float


class PigmentPosterior(NamedTuple):
    """Samples of all parameters by name, what they say of each, and the chains."""

    samples: dict[str, Float[np.ndarray, " samples"]]
    estimates: dict[str, Estimate]
    chains: Chains


def sample(
    windows: Windows,
    base: Iris,
    best: Fit,
    *,
    max_steps: int = 8000,
    progress: Callable[[int], Any] = lambda steps: None,
    seed: int,
) -> PigmentPosterior:
    """Sample the posterior of concentrations, camera and noise.

    Args:
        windows: Of one photograph.
        base: Fixes everything but melanins and scattering.
        best: The least-squares fit, from which it starts.
        max_steps: At which the chain ends, long enough or not; `chains.status` says which.
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
    flat = chains.z.reshape(-1, len(NAMES))
    values = {n: np.asarray(v) for n, v in jax.vmap(values_of)(jnp.asarray(flat)).items()}
    return PigmentPosterior(
        values,
        {n: _estimate(chains, i, values[n]) for i, n in enumerate(NAMES)},
        chains,
    )


def _estimate(chains: Chains, i: int, values) -> Estimate:
    low, median, high = (float(v) for v in np.quantile(values, [0.025, 0.5, 0.975]))
    return Estimate(
        median,
        float(values.std()),
        low,
        high,
        float(1 - chains.z[..., i].var()),
        float(chains.rhat[i]),
        float(min(chains.ess_bulk[i], chains.ess_tail[i])),
    )


@program
def _density(held, z):
    windows, base = held
    return jax.vmap(lambda row: log_probability(row, windows, base))(z)
