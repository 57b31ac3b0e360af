"""A measurement from the command line, with a progress bar while photons are followed."""

import sys
from typing import Any

from tqdm import tqdm

import irisjax as ij
from irisjax.cli.model import SolverOptions, key_of, solver_of
from irisjax.measure.instrument import AbstractInstrument
from irisjax.transport.process import AbstractProcess


def measured(
    iris: ij.Iris,
    instrument: AbstractInstrument,
    process: AbstractProcess,
    options: SolverOptions,
) -> Any:
    """What the instrument reads; photons are followed in blocks, so that Ctrl-C gets through."""
    solver = solver_of(options, process)
    if options.solver == "exact":
        return ij.observe(iris, instrument, process, solver)
    # `delay`: runs of less than a second need no bar.
    with tqdm(
        total=options.photons,
        unit="photon",
        unit_scale=True,
        delay=1,
        disable=not sys.stderr.isatty(),
    ) as bar:
        key = key_of(options.seed)
        return ij.observe(iris, instrument, process, solver, key=key, progress=bar.update)
