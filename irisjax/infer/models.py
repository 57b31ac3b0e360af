"""Which iris, process and solver an inverse problem is for, and the same problem for others."""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import jax.numpy as jnp

from irisjax.infer.observation import Observation
from irisjax.infer.parameters import OF_POWER_LAW, PARAMETERS, kind, of_iris
from irisjax.measure.instrument import AbstractInstrument
from irisjax.measure.observe import prepared
from irisjax.tissue.iris import Iris
from irisjax.tissue.scattering import PowerLaw
from irisjax.transport import defaults
from irisjax.transport.pointwise import Pointwise
from irisjax.transport.process import AbstractProcess, Ilit
from irisjax.transport.solver import AbstractSolver


def restated(problem: Any, base: Iris, process: AbstractProcess, more: tuple[str, ...] = ()):
    """A `Problem` for another iris and process, with `more` of a power law's parameters free.

    Parameters that the iris has not are gone; what is new and not free stands as in `base`.
    """
    gone = () if base.power_law is not None else OF_POWER_LAW
    gone = (*gone, "scattering_scale") if more else gone
    old = zip(problem.free, problem.priors, strict=True)
    free = {n: p for n, p in old if kind(n) not in gone}
    free |= {n: PARAMETERS[n].prior for n in more if n not in set(map(kind, free))}
    stated = {n: v for n, v in of_iris(base).items() if n not in set(map(kind, free))}
    known = {n: v for n, v in problem.fixed.items() if n in stated and n not in gone}
    fixed = as_arrays(stated) | known
    return dataclasses.replace(
        problem,
        base=base,
        fixed=fixed,
        free=tuple(free),
        priors=tuple(free.values()),
        solvers=solvers_of(base, problem.observations, process),
    )


def with_law(base: Iris, process: AbstractProcess, names: Iterable[str]) -> Iris:
    """`base`, with a power law where one of its numbers is a parameter.

    **Raises:** `ValueError` for a power law by ILIT, and for two parameters that are one factor.
    """
    law = [n for n in names if n in OF_POWER_LAW]
    if isinstance(process, Ilit) and (law or base.power_law is not None):
        raise ValueError(
            f"{law[0] if law else 'power_law'} is of radiative transfer (depth-resolved); ILIT has "
            "its own formula of scattering"
        )
    if "reduced_scattering" in law and "scattering_scale" in names:
        raise ValueError("reduced_scattering and scattering_scale are one factor: state one")
    return base.replace(power_law=PowerLaw()) if law and base.power_law is None else base


def solvers_of(
    base: Iris, observations: Sequence[Observation], by: AbstractProcess | AbstractSolver
) -> tuple[Pointwise, ...]:
    """For each observation a solver that is prepared for an inversion: the one given, or for a
    process the quickest one for many spectra of irides such as `base`.
    """

    def one(instrument: AbstractInstrument):
        if isinstance(by, AbstractSolver):
            return Pointwise(prepared(base, instrument, by))
        quickest = defaults.quickest(base, instrument.media.aqueous, by)
        return Pointwise(prepared(base, instrument, quickest))

    return tuple(one(o.instrument) for o in observations)


def as_arrays(values: Mapping[str, Any]) -> dict[str, Any]:
    """Numbers by name as arrays of the precision in use."""
    return {n: jnp.asarray(v, jnp.result_type(float)) for n, v in values.items()}
