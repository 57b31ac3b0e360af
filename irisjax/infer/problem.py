"""An inverse problem: measurements, what is free, and the probability of every choice of it."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax._types import PRNGKey, Scalar
from irisjax.infer import parameters
from irisjax.infer.noise import Noise
from irisjax.infer.observation import Observation
from irisjax.infer.parameters import DEFAULT_FREE, OF_POWER_LAW, PARAMETERS, kind
from irisjax.infer.priors import AbstractPrior, check_prior
from irisjax.measure.instrument import AbstractInstrument
from irisjax.measure.observe import observed, prepared
from irisjax.numerics.checks import check_known, check_range
from irisjax.numerics.chunks import map_rows, vmap_in_pieces
from irisjax.numerics.streams import words_of
from irisjax.tissue.iris import Iris
from irisjax.tissue.scattering import PowerLaw
from irisjax.transport import defaults
from irisjax.transport.pointwise import Pointwise
from irisjax.transport.process import DEPTH_RESOLVED, ILIT_2006, AbstractProcess, Ilit
from irisjax.transport.radiative.exact import RadiativeExact
from irisjax.transport.radiative.tabulated import RadiativeTabulated
from irisjax.transport.solution import RESULTS
from irisjax.transport.solver import AbstractSolver

_Z = Float[Array, " free"]
"""Free parameters in coordinates in which each prior is the standard normal."""
_Readings = tuple[Float[Array, " _"], ...]  # one of each observation
_MOST_CORRELATED = 1000  # hours of sampling as it is
_PREDICTED = 500  # draws that one call predicts
_DEEPENING = "scattering_scale", "stroma_thickness"
_FAR = 3.1  # standard deviations: one iris of the prior in a thousand lies beyond
_ROWS = 64  # the sampler's default walkers: a call costs as much as twenty beside its rows


class Problem(eqx.Module):
    """An inverse problem: data, model, noise and priors; make one with `problem`.

    Vectors `z`, shape (free,), contain the free parameters in coordinates in which each prior is
    the standard normal. A parameter that differs between observations is `name@1`, `name@2`, …

    Attributes:
        base: The iris, for all that is neither free nor fixed.
        fixed: Values of parameters that are known.
        solvers: A solver for each observation.
        free: Names of the free parameters, which have these `priors`.
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
    def moving(self) -> list[int]:
        """Places of the free parameters that least squares fit: all but the noise."""
        return [i for i, name in enumerate(self.free) if kind(name) != "noise"]

    @property
    def fitted(self) -> list[str]:
        """Names of the free parameters that least squares fit."""
        return [self.free[i] for i in self.moving]

    @property
    def log_density(self) -> Callable[[np.ndarray], np.ndarray]:
        """Jitted function of vectors z (n, free), which returns log posterior densities (n,)."""
        problem = self.unnamed()
        return lambda z: map_rows(partial(_densities, problem), np.asarray(z), _ROWS)[0]

    @property
    def undetermined(self) -> int:
        """Number of parameters that keep their priors because there are fewer data than these."""
        return max(0, len(self.moving) - sum(o.values.shape[-1] for o in self.observations))

    @property
    def process(self) -> AbstractProcess:
        """The process of the solvers."""
        return self.solvers[0].process

    def values(self, z: _Z) -> dict[str, Any]:
        """Return all parameters by name, including fixed ones."""
        pairs = enumerate(zip(self.free, self.priors, strict=True))
        return self.fixed | {n: p.value(z[i]) for i, (n, p) in pairs}

    def standard(self, values: Mapping[str, Any]) -> _Z:
        """Return the vector z of some values of the free parameters."""
        pairs = zip(self.free, self.priors, strict=True)
        return jnp.stack([p.standard(jnp.asarray(values[n], float)) for n, p in pairs])

    def natural(self, z: _Z) -> _Z:
        """Return the values of the free parameters as a vector."""
        return jnp.stack([p.value(z[i]) for i, p in enumerate(self.priors)])

    def slopes(self, z: _Z) -> _Z:
        """Return the derivative of each free value by its own coordinate, the only one it has."""
        return jax.jvp(self.natural, (z,), (jnp.ones_like(z),))[1]

    def reported(self, z: _Z) -> dict[str, Any]:
        """Return free and derived parameters by name, for each observation that has its own."""
        values = self.values(z)
        results = {name: values[name] for name in self.free}
        for i in range(len(self.observations)):
            suffix = f"@{i + 1}" if any("@" in n for n in self.free) else ""
            results |= {
                name + suffix: value
                for name, value in parameters.derived(parameters.of_observation(values, i)).items()
            }
        return results

    def predict(self, z: _Z) -> _Readings:
        """Compute the reading of each instrument without noise."""
        return self._solve(self.values(z))[0]

    def pointwise(self, z: _Z) -> Float[Array, " all_data"]:
        """Compute the log likelihood of every value, observations concatenated."""
        models, values = self.predict(z), self.values(z)
        return jnp.concatenate(self._with_noise(self.noise.pointwise, values, models))

    def log_likelihood(self, z: _Z) -> Scalar:
        """Compute the log likelihood."""
        return self.pointwise(z).sum()

    def log_prior(self, z: _Z) -> Scalar:
        """Compute the log prior density of z."""
        return -0.5 * (z * z + np.log(2 * np.pi)).sum()

    def log_posterior(self, z: _Z) -> Scalar:
        """Compute the log posterior density of z up to a constant; −∞ if the solver fails."""
        return self.with_prior(self.log_likelihood(z), z)

    def with_prior(self, log_likelihood: Scalar, z: _Z) -> Scalar:
        """Compute `log_posterior` from a known log likelihood."""
        total = log_likelihood + self.log_prior(z)
        return jnp.where(jnp.isfinite(total), total, -jnp.inf)

    def evaluated(self, z: _Z) -> tuple[Float[Array, " all_data"], _Readings, RESULTS]:
        """Return residuals in units of the stated noise, `predict` and `status` at once."""
        models, status = self._solve(self.values(z))
        pairs = zip(self.observations, models, strict=True)
        return jnp.concatenate([self.noise.whiten(o, m) for o, m in pairs]), models, status

    def simulate(self, z: _Z, key: PRNGKey) -> _Readings:
        """Simulate one noisy measurement for each observation, with z as the truth."""
        draws, nu = [], self.noise.degrees_of_freedom
        for i, o in enumerate(self.observations):
            normal_key, gamma_key = jax.random.split(jax.random.fold_in(key, i))
            shape = o.values.shape[-1:]
            chi_square = None if nu is None else 2 * jax.random.gamma(gamma_key, nu / 2, shape)
            draws.append((jax.random.normal(normal_key, shape), chi_square))
        return self.simulated(z, draws)[0]

    def simulated(self, z: _Z, draws: Sequence[Any]) -> tuple[_Readings, ...]:
        """Return `simulate`, `predict`, the standard deviations stated there, and the log
        likelihoods of the data, at once, from standard normal numbers (and χ² ones for Student's t)
        of each observation.
        """
        models, values = self.predict(z), self.values(z)
        measurement = self._with_noise(self.noise.draw, values, models, draws)
        functions = (self.noise.stated, self.noise.pointwise)
        return measurement, models, *(self._with_noise(f, values, models) for f in functions)

    def log_priors(self, z: _Z) -> _Z:
        """Compute the log prior density of the value of each free parameter."""
        return -0.5 * (z * z + np.log(2 * np.pi)) - jnp.log(jnp.abs(self.slopes(z)))

    def unnamed(self) -> "Problem":
        """Return the problem without names of observations, so that files share one program."""
        observations = tuple(dataclasses.replace(o, name="") for o in self.observations)
        return dataclasses.replace(self, observations=observations)

    def with_observations(self, *observations: Observation) -> "Problem":
        """Return the problem for other values, possibly traced, on the same wavelengths."""
        return eqx.tree_at(lambda p: p.observations, self, tuple(observations))

    def by(self, process: AbstractProcess) -> "Problem":
        """Return the problem for another process, with the table of that process."""
        base = self.base.replace(power_law=None) if isinstance(process, Ilit) else self.base
        return self._restate(base, process)

    def under(self, law: PowerLaw | None) -> "Problem":
        """Return the problem by radiative transfer with a power law of scattering (`None`: none),
        whose four numbers become free with their default priors in place of `scattering_scale`.
        """
        base = self.base.replace(power_law=law, scattering_scale=1.0)
        return self._restate(base, DEPTH_RESOLVED, () if law is None else OF_POWER_LAW)

    def _restate(
        self, base: Iris, process: AbstractProcess, extra: Iterable[str] = ()
    ) -> "Problem":
        """The problem for another iris and process, with `extra` parameters free."""
        excluded = () if base.power_law is not None else OF_POWER_LAW
        excluded = (*excluded, "scattering_scale") if extra else excluded
        pairs = zip(self.free, self.priors, strict=True)
        free = {n: p for n, p in pairs if kind(n) not in excluded}
        free |= {n: PARAMETERS[n].prior for n in extra if n not in set(map(kind, free))}
        fixed = {n: v for n, v in self.fixed.items() if n not in excluded}
        return _stated(self.observations, self.noise, base, process, fixed, free)

    def _with_noise(
        self, function: Callable[..., Any], values: Any, models: _Readings, draws: Any = None
    ) -> tuple[Any, ...]:
        """A function of the noise for each observation."""
        cases = zip(self.observations, models, draws or [()] * len(models), strict=True)
        return tuple(
            function(o, m, parameters.of_observation(values, i)["noise"], *d)
            for i, (o, m, d) in enumerate(cases)
        )

    def _solve(self, values: Mapping[str, Any]) -> tuple[_Readings, RESULTS]:
        """The reading of each instrument, and the first status that is not success."""
        models, status = [], RESULTS.successful
        for i, (o, solver) in enumerate(zip(self.observations, self.solvers, strict=True)):
            local, instrument = parameters.of_observation(values, i), o.instrument
            gain = jnp.asarray(local["gain"], instrument.gain.dtype)
            instrument = eqx.tree_at(lambda x: x.gain, instrument, gain)
            reading = observed(parameters.iris_of(local, self.base), instrument, solver)
            models.append(o.of(reading))
            status = RESULTS.where(status == RESULTS.successful, reading.status, status)
        return tuple(models), status


def _names_in(names: Iterable[str]) -> tuple[str, ...]:
    return (names,) if isinstance(names, str) else tuple(names)


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
        process: Default `ILIT_2006`. Its quickest solver is used: `IlitTabulated`,
            `RadiativeTabulated`, or `AddingDoubling` for a power law of scattering.
        solver: A solver in place of `process`; it has a process.

    Raises:
        ValueError: For wrong names or values, and more than 1,000 of these with a discrepancy.
    """
    data = (observations,) if isinstance(observations, Observation) else tuple(observations)
    fixed, priors, separate = dict(fixed or {}), dict(priors or {}), _names_in(separate)
    free = None if free is None else _names_in(free)
    if not data:
        raise ValueError("no observations")
    for name in (*(free or ()), *fixed, *priors, *separate):
        check_known("parameter", name, PARAMETERS)
    for name, value in fixed.items():
        check_range(name, value, PARAMETERS[name].allowed)
        if free is not None and name in free:
            raise ValueError(f"{name} is both free and fixed")
    requested = DEFAULT_FREE if free is None else free
    names = [n for n in PARAMETERS if n in requested and n not in fixed]
    if not names:
        raise ValueError(f"nothing is free; choose from {', '.join(PARAMETERS)}")
    for name in (*priors, *separate):
        if name not in names:
            raise ValueError(f"{name} has a prior or is separate, but is not free")
    for name, prior in priors.items():
        check_prior(f"{name} ~ {prior}", prior, *PARAMETERS[name].support)
    expanded: list[str] = []
    for n in names:
        expanded += [f"{n}@{i + 1}" for i in range(len(data))] if n in separate else [n]
    largest = max(o.values.shape[-1] for o in data)
    noise = Noise() if noise is None else noise
    correlated = any(o.correlation_root is not None and not o.is_colour for o in data)
    if correlated and noise.degrees_of_freedom is not None:
        raise ValueError("correlated errors and Student's t do not go together; choose one")
    if (correlated or noise.discrepancy is not None) and largest > _MOST_CORRELATED:
        to_do = f"average neighbouring wavelengths, to {_MOST_CORRELATED} values at most"
        cause = "correlation" if correlated else "discrepancy"
        raise ValueError(f"a {cause} takes a matrix of {largest} by {largest} a walker; {to_do}")
    base = Iris() if base is None else base
    if process is not None and solver is not None:
        raise ValueError("a solver has a process: give process or solver, not both")
    process = solver.process if solver else process or ILIT_2006
    base = _with_law(base, process, (*names, *fixed))
    by_name = {n: priors.get(kind(n), PARAMETERS[kind(n)].prior) for n in expanded}
    return _stated(data, noise, base, solver or process, fixed, by_name)


def elements(problem: Problem) -> int:
    """Return the size of the largest array that one evaluation makes."""
    sizes = [max(o.instrument.wavelengths.size, o.values.shape[-1]) for o in problem.observations]
    per_wavelength = max(solver.numbers_per_wavelength for solver in problem.solvers)
    # A correlated error takes a matrix.
    correlated = any(o.correlation_root is not None for o in problem.observations)
    noise = max(sizes) ** 2 if correlated or problem.noise.discrepancy is not None else 0
    return max(noise, sum(sizes) * per_wavelength)


def pointwise(
    problem: Problem, z: Float[Array | np.ndarray, "n free"]
) -> Float[np.ndarray, "n all_data"]:
    """Return the log likelihoods of every value."""
    return map_rows(partial(_densities, problem.unnamed()), np.asarray(z), _ROWS)[1]


def reported(
    problem: Problem, z: Float[np.ndarray, "*samples free"], each: Callable[..., Any] = map
) -> dict[str, Float[np.ndarray, "*samples"]]:
    """Return free and derived parameters of samples by name, in the order of `problem.free`;
    `each` is how calls are mapped.
    """
    flat = np.asarray(z).reshape(-1, z.shape[-1])
    values = map_rows(partial(_reported, problem.unnamed()), flat, 4096, each)
    names = [*problem.free, *(n for n in values if n not in problem.free)]
    return {n: np.asarray(values[n]).reshape(z.shape[:-1]) for n in names}


def predicted(problem: Problem, z: Float[np.ndarray, "n free"], key: PRNGKey) -> Any:
    """Return noisy measurements (n, data), models without noise, stated standard deviations, and
    log likelihoods of the data, of each observation; and log prior densities (n, free).
    """
    # Drawn on the host: a random generator takes longer to compile than the model.
    random, nu = np.random.default_rng(words_of(key)), None
    if problem.noise.degrees_of_freedom is not None:
        nu = float(problem.noise.degrees_of_freedom)
    shapes = [(len(z), o.values.shape[-1]) for o in problem.observations]
    draws = [
        (random.standard_normal(n), None if nu is None else random.chisquare(nu, n)) for n in shapes
    ]
    nameless, rows = problem.unnamed(), min(len(z), _PREDICTED)
    return map_rows(lambda chunk: _predicted(nameless, *chunk), (z, draws), rows)


@eqx.filter_jit
def _predicted(problem: Problem, z: Float[Array, "n free"], draws: Any) -> Any:
    def one(row):
        return *problem.simulated(*row), problem.log_priors(row[0])

    return vmap_in_pieces(one, (z, draws), elements(problem))


@eqx.filter_jit
def _reported(problem: Problem, z: Float[Array, "n free"]) -> Any:
    return jax.vmap(lambda x: problem.reported(x))(z)  # JAX cannot hash bound methods of modules


@eqx.filter_jit
def _densities(problem: Problem, z: Float[Array, "n free"]) -> Any:
    """Log posterior densities (n,), and log likelihoods of every value (n, all data)."""

    def one(x):
        terms = problem.pointwise(x)
        return problem.with_prior(terms.sum(), x), terms

    return vmap_in_pieces(one, z, elements(problem))


def _stated(
    data: tuple[Observation, ...],
    noise: Noise,
    base: Iris,
    by: AbstractProcess | AbstractSolver,
    fixed: Mapping[str, Any],
    free: Mapping[str, AbstractPrior],
) -> Problem:
    """The problem in which parameters are free, fixed or, if neither, those of `base`."""
    names = set(map(kind, free))
    values = {n: v for n, v in parameters.of_iris(base).items() if n not in names}
    known = {n: jnp.asarray(fixed.get(n, v), jnp.result_type(float)) for n, v in values.items()}
    solvers = solvers_of(base, data, by, free)
    return Problem(data, noise, base, known, solvers, tuple(free), tuple(free.values()))


def _with_law(base: Iris, process: AbstractProcess, names: Iterable[str]) -> Iris:
    """`base`, with a power law where one of its numbers is a parameter."""
    law = [n for n in names if n in OF_POWER_LAW]
    if isinstance(process, Ilit) and (law or base.power_law is not None):
        reason = "is of radiative transfer (depth-resolved); ILIT has its own formula of scattering"
        raise ValueError(f"{law[0] if law else 'power_law'} {reason}")
    if "reduced_scattering" in law and "scattering_scale" in names:
        raise ValueError("reduced_scattering and scattering_scale are one factor: state one")
    return base.replace(power_law=PowerLaw()) if law and base.power_law is None else base


def solvers_of(
    base: Iris,
    observations: Sequence[Observation],
    by: AbstractProcess | AbstractSolver,
    free: Mapping[str, AbstractPrior],
) -> tuple[Pointwise, ...]:
    """For each observation the solver given, or a process's quickest one for irides like `base`,
    with parameters of these priors free.
    """
    # The most that scatters: outside its range a table extrapolates, and a chain would not know.
    z, priors = jnp.asarray(_FAR), {kind(n): p for n, p in free.items() if kind(n) in _DEEPENING}
    deepest = {name: float(prior.value(z)) for name, prior in priors.items()}
    iris, solvers = base.replace(melanin_load=0.0, **deepest) if priors else base, []
    for instrument in (o.instrument for o in observations):
        if isinstance(by, AbstractSolver):
            solver = by
        else:
            solver = defaults.quickest(base, instrument.media.aqueous, by)
            if isinstance(solver, RadiativeTabulated) and priors:
                covered = _covers(solver, iris, instrument)
                solver = solver if covered else RadiativeExact(16, 8)
        solvers.append(Pointwise(prepared(iris, instrument, solver)))
    return tuple(solvers)


@eqx.filter_jit
def _covers(table: RadiativeTabulated, iris: Iris, instrument: AbstractInstrument) -> Array:
    return table.holds(iris.layers(instrument.pigments, instrument.media.aqueous))
