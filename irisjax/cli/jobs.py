"""What the command measures: the library's one way from an iris to a reading, with progress."""

import sys
from typing import Any

import jax
from tqdm import tqdm

import irisjax as ij
from irisjax.measure.instrument import AbstractInstrument
from irisjax.measure.observe import observe
from irisjax.transport.montecarlo import MonteCarlo
from irisjax.transport.process import AbstractProcess
from irisjax.transport.solver import AbstractSolver


def measured(
    iris: ij.Iris,
    instrument: AbstractInstrument,
    process: AbstractProcess,
    solver: AbstractSolver,
    key: jax.Array | None,
) -> Any:
    """What the instrument reads; photons are followed in blocks, with a progress bar."""
    if not isinstance(solver, MonteCarlo):
        return observe(iris, instrument, process, solver, key=key)
    # `delay`: runs of less than a second need no bar.
    with tqdm(
        total=solver.n_photons,
        unit="photon",
        unit_scale=True,
        delay=1,
        disable=not sys.stderr.isatty(),
    ) as bar:
        return observe(iris, instrument, process, solver, key=key, progress=bar.update)
