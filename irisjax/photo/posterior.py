"""A posterior of the pigments of a photographed iris, by emcee.

Importance sampling about the least-squares fit finds the walkers their places and teaches their
jumps, as it does for spectra, or a burn-in does; the chain goes on until it is long enough.
"""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from irisjax.infer import posterior
from irisjax.infer.importance import Start
from irisjax.infer.posterior import Chains
from irisjax.photo.concentrations import CONCENTRATIONS
from irisjax.photo.pigments import NAMES, PRIORS, Fit, log_probability, values_of
from irisjax.photo.windows import Windows
from irisjax.tissue.iris import Iris

WALKERS = 48
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


@dataclass(frozen=True)
class _Target:
    """A `posterior.Target`."""

    names: tuple[str, ...]
    log_density: Callable[[np.ndarray], np.ndarray]


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
    middle, slope = (np.asarray(v) for v in _totals_and_slope(jnp.asarray(best.z)))
    covariance = slope @ best.covariance @ slope.T + 1e-9 * np.eye(len(best.z))
    with ThreadPoolExecutor(2) as pool:  # one program is too small for two cores

        def density(x):
            rows = _padded(x, _ROWS).reshape(-1, _ROWS, x.shape[1])
            return np.concatenate(
                list(pool.map(lambda r: np.asarray(_density((windows, base), r)), rows))
            )[: len(x)]

        chains = posterior.sample(
            _Target(NAMES, density),
            Start(middle, covariance),
            walkers=WALKERS,
            max_steps=max_steps,
            progress=lambda steps, word: progress(steps),
            key=jax.random.key(seed),
        )
    x = chains.z.reshape(-1, len(NAMES))
    drawn = {k: np.asarray(v)[: len(x)] for k, v in _drawn(jnp.asarray(_padded(x, 4096))).items()}
    z, values = drawn.pop("z"), {name: drawn[name] for name in NAMES}
    estimates = {}
    for i, (name, value) in enumerate(values.items()):
        low, median, high = (float(v) for v in np.quantile(value, [0.025, 0.5, 0.975]))
        told = float(1 - z[:, i].var())
        estimates[name] = Estimate(median, float(value.std()), low, high, told)
    return PigmentPosterior(values, estimates, z, chains)


def _padded(x, rows: int) -> np.ndarray:
    """The last repeated up to a multiple of `rows`: programs are compiled for each shape."""
    return np.pad(np.asarray(x, np.float64), ((0, -len(x) % rows), (0, 0)), mode="edge")


@eqx.filter_jit
def _totals_and_slope(z):
    return _totals(z), jax.jacfwd(_totals)(z)


@eqx.filter_jit
def _drawn(x):
    z = _parts(x)
    return {"z": z, **jax.vmap(values_of)(z)}


@eqx.filter_jit
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
