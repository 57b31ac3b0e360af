"""A posterior of the pigments of a photographed iris, by emcee.

Importance sampling about the least-squares fit finds the walkers their places and teaches their
jumps, as it does for spectra; the chain goes on until it is long enough.
"""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
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
from irisjax.photo.pigments import (
    CONCENTRATIONS,
    NAMES,
    PRIORS,
    Fit,
    log_probability,
    values_of,
)
from irisjax.photo.windows import Windows
from irisjax.tissue.iris import Iris

WALKERS = 48
_BLOCK = 150  # steps between looks at the chain
_ROWS = WALKERS // 4  # log probabilities computed at a time: half of what a step of emcee asks for


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
    - `chains`: of emcee, in coordinates of its own.
    """

    samples: dict[str, Float[np.ndarray, " samples"]]
    estimates: dict[str, Estimate]
    z: Float[np.ndarray, "samples free"]
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
    """Sample the posterior of concentrations, light and camera.

    Args:
        windows: Of one photograph.
        base: Fixes everything but melanins and scattering.
        best: The least-squares fit, from which it starts.
        max_steps: At which the chain ends, long enough or not; `chains.status` says which.
        progress: Gets the number of steps done.
        seed: Of all random numbers.
    """
    held = _density.bound((windows, base))
    random = np.random.RandomState(seed)
    slope = np.asarray(jax.jacfwd(_totals)(jnp.asarray(best.z)))
    covariance = slope @ best.covariance @ slope.T + 1e-9 * np.eye(len(best.z))
    middle = np.asarray(_totals(jnp.asarray(best.z)))
    with ThreadPoolExecutor(2) as pool:  # one program is too small for two cores

        def density(x):
            x = np.asarray(x, np.float64)
            padded = np.pad(x, ((0, -len(x) % _ROWS), (0, 0)), mode="edge")
            rows = padded.reshape(-1, _ROWS, x.shape[1])
            return np.concatenate(list(pool.map(lambda r: np.asarray(held(r)), rows)))[: len(x)]

        first = importance_sample(density, middle, covariance, random)
        chains = _chains(density, first, random, max_steps, progress)
    z = np.asarray(_parts(jnp.asarray(chains.z.reshape(-1, len(NAMES)))))
    drawn_values = jax.vmap(values_of)(jnp.asarray(z))
    values = {name: np.asarray(drawn_values[name]) for name in NAMES}
    estimates = {}
    for i, (name, drawn) in enumerate(values.items()):
        low, median, high = (float(v) for v in np.quantile(drawn, [0.025, 0.5, 0.975]))
        told = float(1 - z[:, i].var())
        estimates[name] = Estimate(median, float(drawn.std()), low, high, told)
    return PigmentPosterior(values, estimates, z, chains)


def _chains(density, first: ImportanceSample, random, max_steps: int, progress) -> Chains:
    places = first.samples[random.choice(len(first.samples), WALKERS, False)]
    start = places + 1e-3 * first.samples.std(0) * random.standard_normal(places.shape)
    # What teaches jumps may be uneven where the sample is small: walkers then go by differences.
    taught = first.samples if first.effective > 100 else None
    burn = _ensemble(density, taught, random)
    for _ in burn.sample(start, iterations=_BLOCK, skip_initial_state_check=True):
        progress(0)
    here: Any = burn.get_last_sample()
    sampler = _ensemble(density, burn.get_chain(discard=_BLOCK // 2, flat=True), random)
    chains = None
    while chains is None or not (chains.converged or chains.steps >= max_steps):
        for _ in sampler.sample(here, iterations=_BLOCK, skip_initial_state_check=True):
            progress(sampler.iteration)
        here = sampler.get_last_sample()
        chains = diagnose(sampler.backend, sampler.iteration)
    return chains


def _ensemble(density, taught, random) -> emcee.EnsembleSampler:
    """Walkers whose jumps are taught by samples."""
    made = emcee.EnsembleSampler(
        *(WALKERS, len(NAMES), density),
        vectorize=True,
        moves=mixture(taught),
        backend=emcee.backends.Backend(),
    )
    made.random_state = random.get_state()
    return made


@program
def _density(held, x):
    windows, base = held
    return jax.vmap(lambda row: log_probability(row, windows, base))(_parts(x))


_PAIRS = tuple(
    tuple(NAMES.index(f"{layer}_{kind}") for kind in ("eumelanin", "pheomelanin"))
    for layer in ("abl", "stroma")
)
_OF_CONCENTRATIONS: list[Any] = [PRIORS[name] for name in CONCENTRATIONS]  # which stand first
_CENTRE = np.log([prior.median for prior in _OF_CONCENTRATIONS])
_SCALE = np.array([prior.spread for prior in _OF_CONCENTRATIONS])


def _totals(z):
    """Coordinates (..., free) in which the chain walks: of each layer the logarithms of its melanin
    and of eumelanin over pheomelanin, scaled about the priors' middles, in place of the two.

    Colours tell the total, which bends what they say of either alone: chains of these forget 10 to
    30 times as slowly. The Jacobian's determinant is constant.
    """
    for e, p in _PAIRS:
        sigma, centre = _SCALE[e], _CENTRE[[e, p]]
        logs = _CENTRE[e] + sigma * z[..., e], _CENTRE[p] + _SCALE[p] * z[..., p]
        total = jnp.logaddexp(*logs) - jnp.logaddexp(*centre)
        share = (logs[0] - logs[1]) - (centre[0] - centre[1])
        z = z.at[..., e].set(total / sigma).at[..., p].set(share / (sigma * math.sqrt(2)))
    return z


def _parts(x):
    """The inverse of `_totals`."""
    for e, p in _PAIRS:
        sigma, centre = _SCALE[e], _CENTRE[[e, p]]
        total = sigma * x[..., e] + jnp.logaddexp(*centre)
        share = sigma * math.sqrt(2) * x[..., p] + (centre[0] - centre[1])
        logs = total + jax.nn.log_sigmoid(share), total + jax.nn.log_sigmoid(-share)
        x = x.at[..., e].set((logs[0] - _CENTRE[e]) / sigma)
        x = x.at[..., p].set((logs[1] - _CENTRE[p]) / _SCALE[p])
    return x
