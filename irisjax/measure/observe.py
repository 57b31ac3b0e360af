"""What an instrument reads of an iris: the one way from pigments to data.

The public calls, the inversion and the command all go through `observed`.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax

from irisjax._types import PRNGKey
from irisjax.measure.instrument import AbstractInstrument
from irisjax.tissue.iris import Iris
from irisjax.tissue.layers import Layers
from irisjax.transport.defaults import exact_solver
from irisjax.transport.montecarlo import Counts, MonteCarlo
from irisjax.transport.process import ILIT_2006, AbstractProcess
from irisjax.transport.solution import raise_failure
from irisjax.transport.solver import AbstractSolver, is_polarised

_BLOCK = 1 << 22  # photons of all wavelengths together between two reports of progress


def observe(
    iris: Iris,
    instrument: AbstractInstrument,
    process: AbstractProcess = ILIT_2006,
    solver: AbstractSolver | None = None,
    *,
    key: PRNGKey | None = None,
    throw: bool = True,
    progress: Callable[[int], Any] | None = None,
):
    """What an instrument reads of an iris.

    **Arguments:**

    - `iris`: its fields may be traced; batch with `jax.vmap`.
    - `process`: `ILIT_2006`, `ILIT_CORRECTED`, `DEPTH_RESOLVED`, `POLARISED` or one of your own.
    - `solver`: default the process's exact one (`IlitExact`, `RadiativeExact`; `AddingDoubling`
        for an iris with a power law of scattering).
    - `key`: for solvers that sample.
    - `progress`: called with the number of photons followed since the last call, of `MonteCarlo`
        outside any trace: photons are then followed in blocks. The result does not depend on it.

    **Returns:** what the instrument's `reading` gives: a `Reading`, `Brdf` or `Colour`.
    **Raises:** `ValueError` for concrete input out of range, for an instrument that sees more than
    the process has or, unless `throw=False`, for a solve
    that failed; while tracing, look at `.status`.
    """
    solver = prepared(iris, instrument, process, solver)
    if progress is not None and isinstance(solver, MonteCarlo):
        reading = _in_blocks(iris, instrument, process, solver, key, progress)
    else:
        reading = _observe(iris, instrument, process, solver, key)
    if throw:
        raise_failure(reading.status)
    return reading


def observed(
    iris: Iris,
    instrument: AbstractInstrument,
    process: AbstractProcess,
    solver: AbstractSolver,
    key: PRNGKey | None = None,
):
    """`observe` as a traced function: no checks, no preparation, the status tells."""
    factor, cosine = instrument.incident()
    cos_exit, azimuth = instrument.exits
    light = solver.solve(
        iris.layers(instrument.pigments, instrument.media.aqueous),
        process,
        cosine,
        cos_exit=cos_exit,
        azimuth=azimuth,
        key=key,
        rays=instrument.rays,
    )
    return instrument.reading(light, factor)


def prepared(
    iris: Iris,
    instrument: AbstractInstrument,
    process: AbstractProcess,
    solver: AbstractSolver | None = None,
) -> AbstractSolver:
    """The solver (default: the process's exact one) after a look at the still concrete problem."""
    if instrument.polarised and not is_polarised(process):
        raise ValueError(
            f"{type(instrument).__name__} sees polarisation; "
            "give process=RadiativeTransfer(polarised=True)"
        )
    if solver is None:
        solver = exact_solver(process, iris, exits=instrument.exits[0] is not None)
    layers = partial(_layers, iris, instrument)
    # Through the class: binding a method of an Equinox module costs more than the call.
    solver = type(solver).along(solver, layers, instrument.incident()[1], instrument.exits[0])
    return type(solver).prepare(solver, layers, process)


@jax.jit
def _layers(iris: Iris, instrument: AbstractInstrument) -> Layers:
    return iris.layers(instrument.pigments, instrument.media.aqueous)


_observe = jax.jit(observed)


@jax.jit
def _read(iris, instrument, solver: MonteCarlo, counts: Counts):
    layers = iris.layers(instrument.pigments, instrument.media.aqueous)
    light = solver.summarise(counts, layers, instrument.exits[0])
    return instrument.reading(light, instrument.incident()[0])


@jax.jit
def _count(iris, instrument, process, solver: MonteCarlo, key, first, last) -> Counts:
    return solver.count(
        iris.layers(instrument.pigments, instrument.media.aqueous),
        process,
        instrument.incident()[1],
        cos_exit=instrument.exits[0],
        key=key,
        rays=instrument.rays,
        first=first,
        last=last,
    )


def _in_blocks(iris, instrument, process, solver: MonteCarlo, key, progress):
    """Counts of blocks of photons add, so that the result does not depend on the blocks' size."""
    total, block = None, max(1, _BLOCK // instrument.wavelengths.size)
    for first in range(0, solver.n_photons, block):
        last = min(first + block, solver.n_photons)
        counts = _count(iris, instrument, process, solver, key, first, last)
        total = counts if total is None else jax.tree.map(lambda a, b: a + b, total, counts)
        jax.block_until_ready(total)
        progress(last - first)
    return _read(iris, instrument, solver, total)
