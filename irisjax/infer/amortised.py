"""Posteriors by a normalising flow that is trained once for an instrument, a model and its priors,
and weighted by the exact likelihood.

The flow [neural posterior estimation, Papamakarios & Murray 2016; `flowjax`] is trained on spectra
simulated from the priors. It describes how a posterior differs from the normal distribution about
its least-squares fit: vectors z = ẑ + L sinh v, with L Lᵀ the covariance of the fit and v from the
flow, given ẑ, L and the misfit. These contain what the spectrum and its noise say; the sinh brings
the ends of curved ridges, hundreds of the fit's standard deviations away, within the flow's reach.

Each draw is weighted by posterior over proposal [importance sampling], so that the flow decides how
many draws are effective, not what they converge to. All spectra share one set of base points, a
scrambled Sobol sequence: equal spectra have equal posteriors, wherever they are computed.
"""

import dataclasses
import functools
import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy import stats
from scipy.stats import qmc

from irisjax._types import PRNGKey
from irisjax.infer.importance import Start, resample
from irisjax.infer.observation import with_values
from irisjax.infer.pixels import Each, fit_pixels, prior_starts
from irisjax.infer.posterior import Chains, sample
from irisjax.infer.problem import Problem, predicted
from irisjax.numerics import linear
from irisjax.numerics.chunks import map_rows
from irisjax.numerics.streams import key_of, words_of

if TYPE_CHECKING:
    from flowjax.distributions import Transformed

EFFICIENT = 0.05
"""Share of effective draws below which a chain should replace them."""
_SIMULATED, _EPOCHS = 2**17, 20
"""Spectra that a flow is trained on, and how often."""
_LEVELS = np.geomspace(0.7, 1.4, 8)  # of the noise, in units of the problem's
_FALSE_ALARMS = 0.01  # share of the model's own spectra that are called unusual, at most
_LAYERS, _WIDTH, _DEPTH, _KNOTS, _REACH = 6, 64, 2, 8, 6.0
_DEGREES = 10.0  # of the base's t distributions: heavier tails than a posterior's bound the weights
_BATCH, _FASTEST = 1024, 3e-3  # spectra of a step of training, and its largest rate
_FARTHEST = 4.0  # standard deviations within which conditions are kept
_LONGEST = 1.0  # step of a centre, in z, that a free noise makes
_ROWS, _DRAWS = 64, 64  # spectra of a call, and their draws at a time


class PosteriorFlow(eqx.Module):
    """A flow trained for one problem by `train_flow`.

    Attributes:
        flow: The distribution of v.
        centre, scale: Mean and standard deviation of the conditions of spectra it was trained on.
        limits: Of `Weighted.oddness`, which one in 400 of these exceeds each.
    """

    flow: "Transformed"
    centre: Float[Array, " conditions"]
    scale: Float[Array, " conditions"]
    limits: Float[Array, "4"]


class Weighted(NamedTuple):
    """Weighted draws of posteriors, one a spectrum.

    Attributes:
        z: Draws in the priors' normal coordinates.
        weights: Their weights, whose sum is one; zeros where no draw is possible.
        oddness: What tells a spectrum from those of the model: χ² over the number of data, the
            largest residual over their root mean square, their correlation between neighbouring
            wavelengths, and the square of the optimum's distance from the priors' medians.
        unusual: Whether one of these exceeds its limit: the model does not produce such spectra.
    """

    z: Float[np.ndarray, "spectra draws free"]
    weights: Float[np.ndarray, "spectra draws"]
    oddness: Float[np.ndarray, "spectra 4"]
    unusual: Bool[np.ndarray, " spectra"]

    @property
    def efficiency(self) -> Float[np.ndarray, " spectra"]:
        """Share of effective draws [Kong 1992]; 0 where no draw is possible."""
        square = (self.weights**2).sum(axis=1)
        return np.where(square > 0, 1 / np.maximum(square, 1e-300), 0) / self.weights.shape[1]

    def equal(self, i: int, count: int, *, key: PRNGKey) -> Float[np.ndarray, "count free"]:
        """Return draws of equal weight of one spectrum, by systematic resampling."""
        random = np.random.default_rng([*words_of(key), i])
        return self.z[i][resample(self.weights[i], count, random)]


def train_flow(
    problem: Problem,
    *,
    simulated: int = _SIMULATED,
    epochs: int = _EPOCHS,
    each: Each = map,
    key: PRNGKey,
) -> PosteriorFlow:
    """Train a flow for spectra of a problem, whose noise may be 0.7 to 1.4 times what it states.

    Args:
        problem: A problem of one observation, whose values and standard deviations are not used.
        simulated: Number of spectra that are simulated from the priors, at least 2,048.
        epochs: How often training goes through them.
        each: How calls are mapped.
        key: Source of the spectra and of the flow's start.
    """
    import flowjax.train
    import optax

    problem = _blank(problem)
    starts = prior_starts(problem, each)
    random = np.random.default_rng([*words_of(key), 1])
    count, batches = -(-simulated // len(_LEVELS)), []
    for i, level in enumerate(_LEVELS):
        variant = eqx.tree_at(lambda p: (p.noise.relative, p.noise.absolute), problem, (
            problem.noise.relative * level, problem.noise.absolute * level,
        ))  # fmt: skip
        z = random.standard_normal((count, len(problem.free)))
        (values,), *_ = predicted(variant, z, jax.random.fold_in(key, i))
        fits = fit_pixels(variant, values, starts, each)
        rows = values, None, fits.z, fits.z_covariance
        frames = map_rows(functools.partial(_frames, variant), rows, _ROWS, each)
        batches.append((frames, z))
    frames, z = jax.tree.map(lambda *x: np.concatenate(x), *batches)
    u = np.linalg.solve(frames.root, (z - frames.centre)[..., None])[..., 0]
    centre, scale = frames.condition.mean(axis=0), frames.condition.std(axis=0)
    scale = np.where(scale > 1e-6, scale, 1)
    condition = np.clip((frames.condition - centre) / scale, -_FARTHEST, _FARTHEST)
    steps = epochs * int(0.95 * len(z) / _BATCH)
    rate = optax.warmup_cosine_decay_schedule(0.0, _FASTEST, min(100, steps // 10), steps)
    flow, _ = flowjax.train.fit_to_data(
        key, _new_flow(z.shape[1], centre.size), (np.arcsinh(u), condition),
        optimizer=optax.chain(optax.clip_by_global_norm(5.0), optax.adam(rate)),
        max_epochs=epochs, max_patience=epochs, batch_size=_BATCH, val_prop=0.05,
        show_progress=False,
    )  # fmt: skip
    limits = np.quantile(frames.oddness, 1 - _FALSE_ALARMS / 4, axis=0)
    return PosteriorFlow(flow, *map(jnp.asarray, (centre, scale, limits)))


def weighted_draws(
    flow: PosteriorFlow,
    problem: Problem,
    values: Float[np.ndarray, "spectra data"],
    z: Float[np.ndarray, "spectra free"],
    covariance: Float[np.ndarray, "spectra free free"],
    sd: Float[np.ndarray, "spectra data"] | None = None,
    *,
    draws: int = 64,
    each: Each = map,
    key: PRNGKey,
) -> Weighted:
    """Draw from the posteriors of many spectra, weighted by the exact likelihood.

    Args:
        flow: What was trained for the problem.
        problem: A problem of one observation, whose values are not used.
        values: The spectra.
        z, covariance: Their least-squares fits, in the priors' normal coordinates.
        sd: Standard deviations of the values, where the noise model does not state them.
        draws: Number of draws, a power of two.
        each: How calls are mapped.
        key: Scrambles the base points.
    """
    # The base's draws, made on the host: a random generator takes long to compile.
    seed = np.random.default_rng(words_of(key))
    points = qmc.Sobol(len(problem.free), rng=seed).random(draws)
    base = jnp.asarray(stats.t(_DEGREES).ppf(points), jnp.result_type(float))
    nameless = problem.unnamed()
    run = functools.partial(_weighted_rows, flow, nameless, base)
    rows = _ROWS if len(values) > 1 else 1  # or one spectrum would be drawn as often as `_ROWS`
    return Weighted(*map_rows(run, (values, sd, z, covariance), rows, each))


def with_chains(
    weighted: Weighted,
    problem: Problem,
    values: Float[np.ndarray, "spectra data"],
    z: Float[np.ndarray, "spectra free"],
    covariance: Float[np.ndarray, "spectra free free"],
    *,
    each: Each = map,
    key: PRNGKey,
) -> tuple[Weighted, Bool[np.ndarray, " spectra"]]:
    """Replace draws of spectra of which too few are effective (`EFFICIENT`) by those of a chain,
    unless the model does not produce such a spectrum. Takes the arguments of `weighted_draws`;
    `each` maps chains.

    Returns:
        The draws, and whether each spectrum's can be trusted.
    """
    draws, weights = weighted.z.copy(), weighted.weights.copy()
    valid = weighted.efficiency >= EFFICIENT
    poor = np.flatnonzero(~valid & ~weighted.unusual).tolist()

    def chains_of(i: int) -> Chains:
        observed = with_values(problem.observations[0], jnp.asarray(values[i]))
        start = Start(z[i], covariance[i])
        return sample(problem.with_observations(observed), start, key=key)

    for i, chains in zip(poor, each(chains_of, poor), strict=True):
        index = np.linspace(0, len(chains.flat) - 1, weights.shape[1]).astype(int)
        draws[i], weights[i], valid[i] = chains.flat[index], 1 / len(index), chains.converged
    return weighted._replace(z=draws, weights=weights), valid


def flow_name(problem: Problem) -> str:
    """Return a name that problems share whose flows are the same: SHA-256 of all but the data."""
    leaves, structure = jax.tree.flatten(_blank(problem))
    contents = [(str(x.dtype), x.shape, x.tobytes()) for x in map(np.asarray, leaves)]
    return hashlib.sha256(repr((str(structure), contents)).encode()).hexdigest()[:16]


def save_flow(path: Path, flow: PosteriorFlow) -> None:
    """Write a trained flow."""
    eqx.tree_serialise_leaves(path, flow)


def read_flow(path: Path, problem: Problem) -> PosteriorFlow:
    """Read a flow that was trained for such a problem; `ValueError` for any other file."""
    free = len(problem.free)
    conditions = 2 * free + free * (free - 1) // 2 + 1
    blank = jnp.zeros(conditions), jnp.ones(conditions), jnp.zeros(4)
    try:
        return eqx.tree_deserialise_leaves(path, PosteriorFlow(_new_flow(free, conditions), *blank))
    except (RuntimeError, ValueError, EOFError) as error:
        raise ValueError(f"{path}: is no flow for these parameters; remove it") from error


class _Frame(NamedTuple):
    """Origin and axes of the flow for one spectrum, its condition, and `Weighted.oddness`."""

    centre: Any
    root: Any
    condition: Any
    oddness: Any


def _blank(problem: Problem) -> Problem:
    """The problem without what was measured."""
    (o,) = problem.observations
    o = dataclasses.replace(o, values=jnp.zeros_like(o.values), sd=None)
    return problem.with_observations(o).unnamed()


@functools.lru_cache(maxsize=8)
def _new_flow(free: int, conditions: int) -> "Transformed":
    """A flow before training; one object for each shape, because JAX compiles for its functions."""
    from flowjax.bijections import RationalQuadraticSpline
    from flowjax.distributions import StudentT
    from flowjax.flows import coupling_flow
    from paramax import non_trainable

    return coupling_flow(
        key_of(0),
        base_dist=non_trainable(StudentT(jnp.full(free, _DEGREES))),
        transformer=RationalQuadraticSpline(knots=_KNOTS, interval=_REACH),
        cond_dim=conditions, flow_layers=_LAYERS, nn_width=_WIDTH, nn_depth=_DEPTH,
        nn_activation=jax.nn.silu, invert=False,
    )  # fmt: skip


@eqx.filter_jit
def _frames(problem: Problem, rows: Any) -> _Frame:
    return jax.lax.map(lambda row: _frame(problem, *row), rows, batch_size=_ROWS)


def _frame(problem: Problem, values: Any, sd: Any, z: Any, covariance: Any) -> _Frame:
    target = problem.with_observations(with_values(problem.observations[0], values, sd))
    residuals, moving, free = target.evaluated(z)[0], np.asarray(problem.moving), len(problem.free)
    chi_square, largest = (residuals**2).sum(), jnp.abs(residuals).max()
    mean = chi_square / residuals.size
    correlation = (residuals[1:] * residuals[:-1]).sum() / chi_square
    oddness = jnp.stack([mean, largest / jnp.sqrt(mean), correlation, (z * z).sum()])
    c, spread, centre = covariance[np.ix_(moving, moving)], jnp.eye(free, dtype=z.dtype), z
    if "noise" in problem.free:
        # The fit took the noise as stated: its factor has this mean and variance given χ², and
        # what the data say of the others counts by the factor's inverse square.
        i = problem.free.index("noise")
        nodes = jnp.linspace(-5, 5, 201, dtype=z.dtype)
        factor = problem.priors[i].value(nodes)
        logs = -residuals.size * jnp.log(factor) - chi_square / (2 * factor**2) - nodes**2 / 2
        weights = jax.nn.softmax(logs)
        mu = weights @ nodes
        share, identity = problem.priors[i].value(mu) ** -2, jnp.eye(moving.size, dtype=z.dtype)
        c = linear.solve((linear.solve(c, identity) - identity) * share + identity, identity)
        step = -(c @ z[moving]) * (1 - share)
        step = step * jnp.minimum(1, _LONGEST / jnp.maximum(jnp.abs(step).max(), 1e-30))
        centre = z.at[moving].add(step).at[i].set(mu)
        spread = spread.at[i, i].set(weights @ (nodes - mu) ** 2 + (nodes[1] - nodes[0]) ** 2)
    root = linear.cholesky(spread.at[np.ix_(moving, moving)].set((c + c.T) / 2))
    lower_rows = np.tril_indices(free, -1)
    directions = (root / jnp.sqrt((root**2).sum(axis=1, keepdims=True)))[lower_rows]
    lengths = jnp.log(jnp.diag(root))
    condition = jnp.concatenate([centre, lengths, directions, jnp.log(mean + 1e-12)[None]])
    return _Frame(centre, root, condition, oddness)


@eqx.filter_jit
def _weighted_rows(flow: PosteriorFlow, problem: Problem, base: Any, rows: Any) -> Any:
    from paramax import unwrap

    distribution = unwrap(flow.flow)

    def draws_of(row):
        values, sd, *_ = row
        frame = _frame(problem, *row)
        condition = (frame.condition - flow.centre) / flow.scale
        condition = jnp.clip(condition, -_FARTHEST, _FARTHEST)
        target = problem.with_observations(with_values(problem.observations[0], values, sd))

        def draw(x):
            v, slope = distribution.bijection.transform_and_log_det(x, condition)
            z = frame.centre + frame.root @ jnp.sinh(v)
            proposed = distribution.base_dist.log_prob(x) - slope - jnp.log(jnp.cosh(v)).sum()
            return z, target.log_posterior(z) - proposed

        z, logs = jax.lax.map(draw, base, batch_size=_DRAWS)
        logs = jnp.where(jnp.isfinite(logs), logs, -jnp.inf)
        # Without a draw of some density the softmax is NaN: all weights, and the efficiency, are 0.
        weights = jnp.where(jnp.isfinite(logs).any(), jax.nn.softmax(logs), 0.0)
        return z, weights, frame.oddness, (frame.oddness > flow.limits).any()

    return jax.lax.map(draws_of, rows)
