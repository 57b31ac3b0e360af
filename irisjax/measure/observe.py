"""Reading an iris with an instrument; calls, inversions and commands all use `observed`."""

from collections.abc import Callable
from typing import Any

import jax

from irisjax._types import PRNGKey
from irisjax.measure.instrument import AbstractInstrument
from irisjax.numerics.precision import full_precision
from irisjax.numerics.sharding import call_with_layout
from irisjax.tissue.iris import Iris
from irisjax.tissue.layers import Layers
from irisjax.transport.ilit.exact import IlitExact
from irisjax.transport.montecarlo import Counts, MonteCarlo
from irisjax.transport.solution import raise_failure
from irisjax.transport.solver import AbstractSolver

_BLOCK = 1 << 22  # photons of all wavelengths together between two reports of progress


def observe(
    iris: Iris,
    instrument: AbstractInstrument,
    solver: AbstractSolver | None = None,
    *,
    key: PRNGKey | None = None,
    throw: bool = True,
    progress: Callable[[int], object] | None = None,
) -> Any:
    """Read an iris with an instrument.

    Args:
        iris: The iris; its fields may be traced; batch with `jax.vmap`.
        instrument: The instrument.
        solver: Which process the light follows, and how it is solved; `IlitExact()` by default.
            `RadiativeExact()` is radiative transfer, `AddingDoubling()` that of an iris with a
            power law of scattering.
        key: For solvers that sample.
        throw: Whether a failed solve raises. Under `jit`, `vmap` and `grad` it raises when the
            program runs; programs that are exported, mapped over shards or kept on disk cannot call
            back: they need `throw=False` and a look at `.status`.
        progress: Called with the number of photons followed since the last call, of `MonteCarlo`
            outside any trace. The result does not depend on it.

    Returns:
        What the instrument's `reading` gives: a `Reading`, `Brdf` or `Colour`.

    Raises:
        ValueError: For concrete input out of range, for an instrument that sees more than the
            process has, and for a solve that failed.
    """
    solver = prepared(iris, instrument, IlitExact() if solver is None else solver)
    if progress is not None and isinstance(solver, MonteCarlo):
        reading = _in_blocks(iris, instrument, solver, key, progress)
    else:
        reading = _observe(iris, instrument, solver, key)
    return raise_failure(reading, reading.status) if throw else reading


def observed(
    iris: Iris, instrument: AbstractInstrument, solver: AbstractSolver, key: PRNGKey | None = None
) -> Any:
    """Read an iris in a traced function: without checks, preparation and exceptions."""
    return call_with_layout(_trace, instrument.wavelengths, iris, instrument, solver, key)


@full_precision
def _trace(iris, instrument, solver, key):
    factor, light = instrument.incident()
    layers = iris.layers(instrument.pigments, instrument.media.aqueous)
    return instrument.reading(solver.solve(layers, light, key=key), factor)


def prepared(iris: Iris, instrument: AbstractInstrument, solver: AbstractSolver) -> AbstractSolver:
    """Return the solver prepared for the problem, while its values are known."""
    if instrument.polarised and not solver.process.polarised:
        to_do = "give solver=RadiativeExact(process=POLARISED)"
        raise ValueError(f"{type(instrument).__name__} sees polarisation; {to_do}")
    if instrument.aperture is not None and isinstance(solver, MonteCarlo):
        to_do = "whose photons are counted in wide cells of the cosine: give an exact solver"
        raise ValueError(f"an aperture is not for MonteCarlo, {to_do}")
    if type(solver).prepare is AbstractSolver.prepare:
        return solver  # Layers take as long as a tenth of a spectrum.
    return solver.prepare(_layers(iris, instrument), instrument.incident()[1])


@jax.jit
def _layers(iris: Iris, instrument: AbstractInstrument) -> Layers:
    pigments, aqueous = instrument.pigments, instrument.media.aqueous
    return call_with_layout(Iris.layers, instrument.wavelengths, iris, pigments, aqueous)


_observe = jax.jit(observed)


@jax.jit
def _read(iris, instrument, solver: MonteCarlo, counts: Counts):
    factor, light = instrument.incident()
    solution = solver.summarise(counts, _layers(iris, instrument), light.exits)
    return instrument.reading(solution, factor)


@jax.jit
def _count(iris, instrument, solver: MonteCarlo, key, first, last) -> Counts:
    layers, light = _layers(iris, instrument), instrument.incident()[1]
    return solver.count(layers, light, key=key, first=first, last=last)


def _in_blocks(iris, instrument, solver: MonteCarlo, key, progress):
    """Counts of blocks of photons add, so that the result does not depend on the blocks' size."""
    total, block = None, max(1, _BLOCK // instrument.wavelengths.size)
    for first in range(0, solver.n_photons, block):
        last = min(first + block, solver.n_photons)
        counts = _count(iris, instrument, solver, key, first, last)
        total = counts if total is None else jax.tree.map(lambda a, b: a + b, total, counts)
        jax.block_until_ready(total)
        progress(last - first)
    return _read(iris, instrument, solver, total)
