"""An inverse problem: measurements, what is free, and the probability of every choice of it."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax._types import PRNGKey, Scalar
from irisjax.infer.models import as_arrays, restated, solvers_of, with_law
from irisjax.infer.noise import Noise
from irisjax.infer.observation import Observation
from irisjax.infer.parameters import (
    DEFAULT_FREE,
    OF_POWER_LAW,
    PARAMETERS,
    derived,
    iris_of,
    kind,
    of_iris,
    seen_by,
)
from irisjax.infer.priors import AbstractPrior, check_prior
from irisjax.measure.observe import observed
from irisjax.numerics.checks import check_range
from irisjax.numerics.portions import in_pieces
from irisjax.tissue.iris import Iris
from irisjax.tissue.scattering import PowerLaw
from irisjax.transport.process import DEPTH_RESOLVED, ILIT_2006, AbstractProcess, Ilit
from irisjax.transport.solution import RESULTS
from irisjax.transport.solver import AbstractSolver

_MOST_CORRELATED = 1000  # hours of sampling as it is
_ROWS = 64
"""The sampler's default walkers: a call costs as much as twenty of them beside its rows."""


class Problem(eqx.Module):
    """An inverse problem: data, model, noise and priors; make one with `problem`.

    Vectors `z`, shape (free,), contain the free parameters in coordinates in which each prior is
    the standard normal. A parameter that differs between observations is `name@1`, `name@2`, …

    Attributes:
        observations: The data and their instruments.
        noise: The noise model.
        base: The iris, for all that is neither free nor fixed.
        fixed: Values of parameters that are known.
        solvers: A solver for each observation.
        free: Names of the free parameters.
        priors: Their priors.
    """

    observations: tuple[Observation, ...]
    noise: Noise
    base: Iris
    fixed: dict[str, Any]
    solvers: tuple[AbstractSolver, ...]
    free: tuple[str, ...] = eqx.field(static=True)
    priors: tuple[AbstractPrior, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return self.free

    @property
    def log_density(self) -> Callable[[np.ndarray], np.ndarray]:
        """Function that maps vectors z, (n, free), to their log posterior densities, (n,)."""
        return density(self)

    @property
    def process(self) -> AbstractProcess:
        """The process of the solvers."""
        return self.solvers[0].process

    def values(self, z: Float[Array, " free"]) -> dict[str, Any]:
        """Return all parameters by name, including fixed ones."""
        return {
            **self.fixed,
            **{
                n: p.value(z[i])
                for i, (n, p) in enumerate(zip(self.free, self.priors, strict=True))
            },
        }

    def standard(self, values: Mapping[str, Any]) -> Float[Array, " free"]:
        """Return the vector z of some values of the free parameters."""
        return jnp.stack(
            [
                p.standard(jnp.asarray(values[n], float))
                for n, p in zip(self.free, self.priors, strict=True)
            ]
        )

    def natural(self, z: Float[Array, " free"]) -> Float[Array, " free"]:
        """Return the values of the free parameters as a vector."""
        return jnp.stack([p.value(z[i]) for i, p in enumerate(self.priors)])

    def reported(self, z: Float[Array, " free"]) -> dict[str, Any]:
        """Return free and derived parameters by name, for each observation that has its own."""
        values = self.values(z)
        out = {name: values[name] for name in self.free}
        for i in range(len(self.observations)):
            tag = f"@{i + 1}" if any("@" in n for n in self.free) else ""
            for name, value in derived(seen_by(values, i)).items():
                out[name + tag] = value
        return out

    def predict(self, z: Float[Array, " free"]) -> tuple[Float[Array, " _"], ...]:
        """Compute the reading of each instrument without noise."""
        return self._models(self._readings(self.values(z)))

    def status(self, z: Float[Array, " free"]):
        """Return the solver's status at z: a `RESULTS` item, the first that is not success."""
        return _worst(self._readings(self.values(z)))

    def pointwise(self, z: Float[Array, " free"]) -> Float[Array, " all_data"]:
        """Compute the log likelihood of every value, observations concatenated."""
        values = self.values(z)
        return jnp.concatenate(
            [
                self.noise.pointwise(o, m, seen_by(values, i)["noise"])
                for i, (o, m) in enumerate(
                    zip(self.observations, self._models(self._readings(values)), strict=True)
                )
            ]
        )

    def log_likelihood(self, z: Float[Array, " free"]) -> Float[Array, ""]:
        """Compute the log likelihood."""
        return self.pointwise(z).sum()

    def log_prior(self, z: Float[Array, " free"]) -> Float[Array, ""]:
        """Compute the log prior density of z."""
        return -0.5 * (z * z + np.log(2 * np.pi)).sum()

    def log_posterior(self, z: Float[Array, " free"]) -> Float[Array, ""]:
        """Compute the log posterior density of z up to a constant; −∞ if the solver fails."""
        return self.with_prior(self.log_likelihood(z), z)

    def with_prior(self, log_likelihood, z: Float[Array, " free"]) -> Float[Array, ""]:
        """Compute `log_posterior` from a known log likelihood."""
        total = log_likelihood + self.log_prior(z)
        return jnp.where(jnp.isfinite(total), total, -jnp.inf)

    def residuals(self, z: Float[Array, " free"], factor=1.0) -> Float[Array, " all_data"]:
        """Compute residuals in units of the noise, which is `factor` times the stated one."""
        return self.evaluated(z, factor)[0]

    def evaluated(
        self, z: Float[Array, " free"], factor: float | Scalar = 1.0
    ) -> tuple[Float[Array, " all_data"], tuple[Float[Array, " _"], ...], RESULTS]:
        """Return `residuals`, `predict` and `status` at once."""
        readings = self._readings(self.values(z))
        models = self._models(readings)
        whitened = [
            self.noise.whiten(o, m, factor) for o, m in zip(self.observations, models, strict=True)
        ]
        return jnp.concatenate(whitened), models, _worst(readings)

    def simulate(self, z: Float[Array, " free"], key) -> tuple[Float[Array, " _"], ...]:
        """Simulate one noisy measurement for each observation, with z as the truth."""
        return self.simulated_and_models(z, key)[0]

    def simulated_and_models(self, z: Float[Array, " free"], key):
        """Return `simulate` and `predict` at once."""
        values, out = self.values(z), []
        models, nu = self._models(self._readings(values)), self.noise.degrees_of_freedom
        for i, (o, m) in enumerate(zip(self.observations, models, strict=True)):
            one, two = jax.random.split(jax.random.fold_in(key, i))
            normal = jax.random.normal(one, m.shape)
            square = None if nu is None else 2 * jax.random.gamma(two, nu / 2, m.shape)
            out.append(self.noise.draw(o, m, seen_by(values, i)["noise"], normal, square))
        return tuple(out), models

    def stated_sds(self, z: Float[Array, " free"], models) -> tuple[Float[Array, " _"], ...]:
        """Return the standard deviations of the values of each observation."""
        values, noise, out = self.values(z), self.noise, []
        for i, (o, m) in enumerate(zip(self.observations, models, strict=True)):
            if o.covariance_root is not None:
                out.append(jnp.sqrt((o.covariance_root**2).sum(axis=1)))
                continue
            sd = noise.sd(o, m, seen_by(values, i)["noise"])
            # A marginalised discrepancy is part of what the residuals may be.
            out.append(sd if noise.discrepancy is None else jnp.hypot(sd, noise.discrepancy * m))
        return tuple(out)

    def unnamed(self) -> "Problem":
        """Return the problem without names of observations, so that files share one program."""
        seen = tuple(dataclasses.replace(o, name="") for o in self.observations)
        return dataclasses.replace(self, observations=seen)

    def with_observations(self, *observations: Observation) -> "Problem":
        """Return the problem for other values, possibly traced, on the same wavelengths."""
        return eqx.tree_at(lambda p: p.observations, self, tuple(observations))

    def by(self, process: AbstractProcess) -> "Problem":
        """Return the problem for another process, with the table of that process."""
        base = self.base.replace(power_law=None) if isinstance(process, Ilit) else self.base
        return restated(self, base, process)

    def under(self, law: PowerLaw | None) -> "Problem":
        """Return the problem by radiative transfer with another scattering of the stroma.

        Args:
            law: Power law, whose four numbers become free with their default priors in place of
                `scattering_scale`; `None` for the formula of the iris without these parameters.
        """
        base = self.base.replace(power_law=law, scattering_scale=1.0)
        return restated(self, base, DEPTH_RESOLVED, () if law is None else OF_POWER_LAW)

    def _models(self, readings: list[Any]) -> tuple[jax.Array, ...]:
        return tuple(o.of(r) for o, r in zip(self.observations, readings, strict=True))

    def _readings(self, values: Mapping[str, Any]) -> list[Any]:
        return [self._reading(values, i) for i in range(len(self.observations))]

    def _reading(self, values, i: int):
        """Compute the reading of the i-th instrument."""
        mine, instrument = seen_by(values, i), self.observations[i].instrument
        gain = jnp.asarray(mine["gain"], instrument.gain.dtype)
        instrument = eqx.tree_at(lambda x: x.gain, instrument, gain)
        return observed(iris_of(mine, self.base), instrument, self.solvers[i])


def problem(
    observations: Observation | Sequence[Observation],
    *,
    free: Iterable[str] | None = None,
    fixed: Mapping[str, float] | None = None,
    priors: Mapping[str, AbstractPrior] | None = None,
    separate: Iterable[str] = (),
    noise: Noise | None = None,
    base: Iris | None = None,
    process: AbstractProcess | None = None,
    solver: AbstractSolver | None = None,
) -> Problem:
    """State an inverse problem.

    Naming one of a `PowerLaw`'s numbers, free or fixed, adds a power law to `base`.

    Args:
        observations: One observation, or several of the same eye.
        free: Names from `PARAMETERS`; default `DEFAULT_FREE`.
        fixed: Values of known parameters, which are removed from `free`.
        priors: Priors that replace those of `PARAMETERS`.
        separate: Names of parameters that differ between the observations (two spots share blood,
            not melanin).
        noise: The noise model; default `Noise()`.
        base: The iris, for all that is neither free nor fixed; default LB06's, moderate.
        process: Default `ILIT_2006`. Its quickest solver is used: `IlitTabulated` for ILIT,
            `RadiativeTabulated` for radiative transfer and `AddingDoubling` for a power law of
            scattering.
        solver: A solver in place of `process`; it has a process.

    Raises:
        ValueError: For unknown names, values out of range, nothing free, a process beside a solver,
            or more than 1,000 values with a correlated discrepancy.
    """
    seen = (observations,) if isinstance(observations, Observation) else tuple(observations)
    fixed, priors, separate = dict(fixed or {}), dict(priors or {}), tuple(separate)
    if not seen:
        raise ValueError("no observations")
    for name in (*(free or ()), *fixed, *priors, *separate):
        if name not in PARAMETERS:
            raise ValueError(f"unknown parameter {name!r}; known: {', '.join(PARAMETERS)}")
    for name, value in fixed.items():
        check_range(name, value, PARAMETERS[name].allowed)
        if free is not None and name in free:
            raise ValueError(f"{name} is both free and fixed")
    names = [
        n
        for n in PARAMETERS
        if n in (DEFAULT_FREE if free is None else tuple(free)) and n not in fixed
    ]
    if not names:
        raise ValueError(f"nothing is free; choose from {', '.join(PARAMETERS)}")
    for name in (*priors, *separate):
        if name not in names:
            raise ValueError(f"{name} has a prior or is separate, but is not free")
    for name, prior in priors.items():
        check_prior(f"{name} ~ {prior}", prior, *PARAMETERS[name].support)
    expanded = [
        f"{n}@{i + 1}" if n in separate else n
        for n in names
        for i in range(len(seen) if n in separate else 1)
    ]
    most = max(o.values.shape[-1] for o in seen)
    if noise is not None and noise.discrepancy is not None and most > _MOST_CORRELATED:
        raise ValueError(
            f"a discrepancy takes a matrix of {most} by {most} for every walker; average "
            f"neighbouring wavelengths, "
            f"to {_MOST_CORRELATED} values at most"
        )
    base = Iris() if base is None else base
    if process is not None and solver is not None:
        raise ValueError("a solver has a process: give process or solver, not both")
    by = solver or process or ILIT_2006
    base = with_law(base, by.process if isinstance(by, AbstractSolver) else by, (*names, *fixed))
    start = {**of_iris(base), **fixed}
    known = as_arrays({n: v for n, v in start.items() if n not in names})
    return Problem(
        observations=seen,
        noise=Noise() if noise is None else noise,
        base=base,
        fixed=known,
        solvers=solvers_of(base, seen, by),
        free=tuple(expanded),
        priors=tuple(priors.get(kind(n), PARAMETERS[kind(n)].prior) for n in expanded),
    )


class Form:
    """What of a problem is no array, with its hash: an argument of jitted functions that is cheap
    to compare.
    """

    def __init__(self, problem: Problem):
        """Keep the problem with a mark in place of every array."""
        self._marked = jax.tree.map(lambda x: ... if eqx.is_array(x) else x, problem)
        leaves, structure = jax.tree.flatten(self._marked)
        self._parts = structure, *((type(leaf), leaf) for leaf in leaves)
        self._hash = hash(self._parts)

    def __hash__(self) -> int:
        """Return the hash that was computed once."""
        return self._hash

    def __eq__(self, other: object) -> bool:
        """Compare all that is no array."""
        return self is other or (isinstance(other, Form) and self._parts == other._parts)

    def __reduce__(self) -> Any:
        """Pickle the problem alone: structures of trees have no pickle."""
        return Form, (self._marked,)

    def filled(self, arrays: list[Array]) -> Problem:
        """Return the problem with these arrays."""
        places = iter(arrays)
        return jax.tree.map(lambda x: next(places) if x is ... else x, self._marked)


def elements(problem: Problem) -> int:
    """Return the size of the largest array that one evaluation makes."""
    sizes = [max(o.wavelengths.size, o.values.shape[-1]) for o in problem.observations]
    each = max(solver.numbers_per_wavelength for solver in problem.solvers)
    # A correlated error takes a matrix.
    noise = max(sizes) ** 2 if problem.noise.discrepancy is not None else 0
    return max(noise, sum(sizes) * each)


def density(problem: Problem) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function z (n, free) → log posterior densities (n,), which is compiled once for
    all problems of the same form.
    """
    both = in_rows(_densities, problem)
    return lambda z: both(z)[0]


def pointwise(
    problem: Problem, z: Float[Array | np.ndarray, "n free"]
) -> Float[np.ndarray, "n all_data"]:
    """Return the log likelihoods of every value."""
    return in_rows(_densities, problem)(z)[1]


def in_rows(
    function: Callable[[list[Array], Form, Any], Any], problem: Problem, rows: int = _ROWS
) -> Callable[[Array | np.ndarray], Any]:
    """Return `function` of any number of vectors z, so many at a time.

    To compile a program for each number would take longer than to run all of them.

    Args:
        function: Jitted function of a problem's arrays, its `Form`, and vectors (rows, free).
        problem: The problem, which is taken apart once and not at every call.
        rows: Number of vectors at a time.
    """
    problem = problem.unnamed()
    arrays, form = [x for x in jax.tree.leaves(problem) if eqx.is_array(x)], Form(problem)

    def each(z: Array | np.ndarray) -> Any:
        z = np.asarray(z)
        count = len(z)
        # Copies of the last: whatever is finite there has finite copies.
        z = np.pad(z, [(0, -count % rows), (0, 0)], mode="edge")
        done = [function(arrays, form, z[i : i + rows]) for i in range(0, len(z), rows)]
        return jax.tree.map(lambda *x: np.concatenate([np.asarray(p) for p in x])[:count], *done)

    return each


@eqx.filter_jit
def predicted(problem: Problem, z: Float[Array, "n free"], key: PRNGKey) -> Any:
    """Return noisy measurements, the models without noise and the standard deviations stated there:
    three tuples of arrays (n, data), one an observation.
    """

    def one(each):
        simulated, models = problem.simulated_and_models(*each)
        return simulated, models, problem.stated_sds(each[0], models)

    return in_pieces(one, (z, jax.random.split(key, len(z))), elements(problem))


@eqx.filter_jit
def _densities(arrays: list[Array], form: Form, z: Float[Array, "n free"]) -> Any:
    """Log posterior densities (n,), and log likelihoods of every value (n, all data)."""
    problem = form.filled(arrays)

    def one(x):
        each = problem.pointwise(x)
        return problem.with_prior(each.sum(), x), each

    return in_pieces(one, z, elements(problem))


def _worst(readings: list[Any]) -> RESULTS:
    out = RESULTS.successful
    for reading in readings:
        out = RESULTS.where(out == RESULTS.successful, reading.status, out)
    return out
