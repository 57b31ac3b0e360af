"""A posterior of the pigments of a photographed iris."""

import math
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from irisjax._types import PRNGKey
from irisjax.infer import posterior
from irisjax.infer.importance import Start
from irisjax.infer.posterior import Chains
from irisjax.photo import pigments
from irisjax.photo.pigments import CONCENTRATIONS, FREE_NAMES, PRIORS, PigmentFit
from irisjax.photo.windows import Windows
from irisjax.tissue.iris import Iris

WALKERS = 48
_ROWS = WALKERS // 4  # densities computed at a time: half of those that a step of emcee needs


class Estimate(NamedTuple):
    """A parameter as estimated from its samples.

    Attributes:
        low: The 2.5 % quantile.
        high: The 97.5 % quantile.
        contraction: One minus the variance over the prior's, in the coordinate in which the prior
            is a standard normal; 0 if the photograph does not constrain the parameter.
    """

    median: float
    sd: float
    low: float
    high: float
    contraction: float


class PigmentPosterior(NamedTuple):
    """Samples of the posterior.

    Attributes:
        samples: Values of each parameter, by name.
        estimates: The same in numbers.
        z: The samples as standard normal numbers of their priors.
        chains: The chains, in coordinates of their own.
    """

    samples: dict[str, Float[np.ndarray, " samples"]]
    estimates: dict[str, Estimate]
    z: Float[np.ndarray, "samples free"]
    chains: Chains


def sample_pigments(
    windows: Windows, base: Iris, best: PigmentFit, *, max_steps: int = 8000, key: PRNGKey
) -> PigmentPosterior:
    """Sample the posterior of concentrations, light and camera by `infer.sample`, from the best fit
    on; the base fixes everything but melanins and scattering.
    """
    held = windows, base
    middle, slope = map(np.asarray, _totals_and_slope(jnp.asarray(best.z)))
    covariance = slope @ best.covariance @ slope.T + 1e-9 * np.eye(len(best.z))
    with ThreadPoolExecutor(2) as pool:  # one program is too small for two cores

        def density(x: np.ndarray) -> np.ndarray:
            rows = _padded(x, _ROWS).reshape(-1, _ROWS, x.shape[1])
            found = pool.map(lambda row: np.asarray(_density(held, row)), rows)
            return np.concatenate(list(found))[: len(x)]

        target: Any = SimpleNamespace(names=FREE_NAMES, log_density=density)
        start = Start(middle, covariance)
        chains = posterior.sample(target, start, walkers=WALKERS, max_steps=max_steps, key=key)
    x = chains.flat
    drawn = {k: np.asarray(v)[: len(x)] for k, v in _drawn(jnp.asarray(_padded(x, 4096))).items()}
    z = drawn.pop("z")
    estimates = {}
    for i, name in enumerate(FREE_NAMES):
        low, median, high = (float(v) for v in np.quantile(drawn[name], [0.025, 0.5, 0.975]))
        sd, contraction = float(drawn[name].std()), float(1 - z[:, i].var())
        estimates[name] = Estimate(median, sd, low, high, contraction)
    return PigmentPosterior({name: drawn[name] for name in FREE_NAMES}, estimates, z, chains)


def _padded(x: np.ndarray, rows: int) -> np.ndarray:
    """The last row repeated up to a multiple of `rows`: every shape compiles a program."""
    return np.pad(np.asarray(x, np.float64), ((0, -len(x) % rows), (0, 0)), mode="edge")


@eqx.filter_jit
def _totals_and_slope(z):
    return _totals(z), jax.jacfwd(_totals)(z)


@eqx.filter_jit
def _drawn(x):
    z = _parts(x)
    return {"z": z, **jax.vmap(pigments.parameter_values)(z)}


@eqx.filter_jit
def _density(held, x):
    windows, base = held
    return jax.vmap(lambda row: pigments.log_posterior(row, windows, base))(_parts(x))


_PAIRS = tuple(
    tuple(FREE_NAMES.index(f"{layer}_{kind}") for kind in ("eumelanin", "pheomelanin"))
    for layer in ("abl", "stroma")
)
_OF_CONCENTRATIONS: list[Any] = [PRIORS[name] for name in CONCENTRATIONS]  # the first ones
_CENTRE = np.log([prior.median for prior in _OF_CONCENTRATIONS])
_SCALE = np.array([prior.spread for prior in _OF_CONCENTRATIONS])


def _totals(z):
    """Coordinates (..., free) of the chain: for each layer the logarithms of its melanin and of
    eumelanin over pheomelanin, scaled about the priors' medians, in place of the two.

    Colours constrain the total, which bends the posterior of either alone: chains of these have 10
    to 30 times the autocorrelation time. The Jacobian's determinant is constant.
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
