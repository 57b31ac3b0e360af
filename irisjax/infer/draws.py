"""A posterior in ArviZ's groups, which its plots, scores and re-weightings take as they are."""

from typing import Any, NamedTuple, TypeAlias

import jax
import numpy as np
from jaxtyping import Float

from irisjax._types import PRNGKey
from irisjax.infer.posterior import Chains, ChainStatus
from irisjax.infer.problem import Problem, predicted, reported
from irisjax.numerics.streams import words_of

Labelled: TypeAlias = dict[str, tuple[tuple[str, ...], np.ndarray]]
"""Arrays by name, each with the names of its axes."""

_MOST_NUMBERS = 1 << 23  # of log likelihoods, and as many of predictions: 64 MB each
_SAMPLED = ("chain", "draw")


class ArvizGroups(NamedTuple):
    """Draws of a posterior in the groups of ArviZ.

    Attributes:
        arrays: Of the groups `posterior`, `prior`, `log_prior` (of the parameters' values),
            `log_likelihood`, `posterior_predictive`, `observed_data` and `sample_stats`. Data are
            called by their quantity, `reflectance`; of several observations `reflectance_1`, ....
        coordinates: Values along axes: `wavelength_nm` (or `wavelength_nm_1`, ...) of the data.
        every: Steps of the chain between two draws.
    """

    arrays: dict[str, Labelled]
    coordinates: dict[str, np.ndarray]
    every: int


def of_draws(problem: Problem, z: Float[np.ndarray, "draws free"]) -> Chains:
    """Return independent draws of a posterior in the form of a chain of one walker."""
    count, ones = len(z), np.ones(z.shape[1])
    return Chains(
        z=z[:, None],
        log_probability=problem.log_density(z)[:, None],
        thin=1,
        steps=count,
        acceptance=1.0,
        tau=ones,
        ess_bulk=count * ones,
        ess_tail=count * ones,
        rhat=ones,
        status=ChainStatus.successful,
        reason="",
    )


def arviz_groups(problem: Problem, chains: Chains, *, key: PRNGKey) -> ArvizGroups:
    """Return a posterior in ArviZ's groups, with fewer draws where the data are many."""
    data, walkers = problem.observations, chains.z.shape[1]
    limit = _MOST_NUMBERS // (walkers * sum(o.values.shape[-1] for o in data))
    thin = -(-len(chains.z) // max(1, limit))
    z = np.moveaxis(chains.z[::thin], 0, 1)
    flat = z.reshape(-1, z.shape[-1])
    simulated, _, _, likelihoods, priors = predicted(problem, flat, jax.random.fold_in(key, 6))

    def sampled(array: np.ndarray, *axes: str) -> tuple[tuple[str, ...], np.ndarray]:
        return (*_SAMPLED, *axes), array.reshape(*z.shape[:2], *array.shape[1:])

    tags = [f"_{i + 1}" if len(data) > 1 else "" for i in range(len(data))]
    names = [o.quantity + tag for o, tag in zip(data, tags, strict=True)]
    axes = [
        ("channel" if o.is_colour else "wavelength_nm") + tag
        for o, tag in zip(data, tags, strict=True)
    ]
    random = np.random.default_rng([*words_of(key), 4])
    prior_z = random.standard_normal((1, 4000, len(problem.free)))
    indices = range(len(data))
    arrays: dict[str, Labelled] = {
        "posterior": {n: (_SAMPLED, x) for n, x in reported(problem, z).items()},
        "prior": {n: (_SAMPLED, x) for n, x in reported(problem, prior_z).items()},
        "log_prior": {n: sampled(priors[:, i]) for i, n in enumerate(problem.free)},
        "log_likelihood": {names[i]: sampled(likelihoods[i], axes[i]) for i in indices},
        "posterior_predictive": {names[i]: sampled(simulated[i], axes[i]) for i in indices},
        "observed_data": {names[i]: ((axes[i],), np.asarray(data[i].values)) for i in indices},
        "sample_stats": {"lp": (_SAMPLED, chains.log_probability[::thin].T)},
    }
    grids = {a: np.asarray(o.wavelengths) for a, o in zip(axes, data, strict=True)}
    coordinates = {a: np.arange(3) if a.startswith("channel") else x for a, x in grids.items()}
    return ArvizGroups(arrays, coordinates, thin * chains.thin)


def to_arviz(problem: Problem, chains: Chains, *, key: PRNGKey) -> Any:
    """Return a posterior as ArviZ takes it, an `InferenceData` (before ArviZ 1.0) or a `DataTree`;
    the groups are those of the file `posterior.nc`. It needs the package arviz.
    """
    import arviz
    import xarray

    arrays, coordinates, _ = arviz_groups(problem, chains, key=key)
    groups = {}
    for name, group in arrays.items():
        dims = {axis for axes, _ in group.values() for axis in axes} & set(coordinates)
        groups[name] = xarray.Dataset(dict(group), {axis: coordinates[axis] for axis in dims})
    if arviz.__version__.startswith("0."):
        return arviz.InferenceData(**groups)
    return xarray.DataTree.from_dict(groups)
