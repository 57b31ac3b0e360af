"""A measurement from the command line; photons are followed in blocks, with a progress bar."""

import operator
import sys
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

import irisjax as ij
from irisjax.measure.colour import illuminant_power
from irisjax.measure.measurement import layers_of, through_cornea
from irisjax.tissue.pigments import extinction
from irisjax.transport.montecarlo import Counts, MonteCarlo
from irisjax.transport.solver import AbstractSolver

_BLOCK = 1 << 22
"""Photons of all wavelengths together between two looks at the progress bar and at Ctrl-C."""


def measured(name: str, iris: ij.Iris, grid: np.ndarray, options: Mapping[str, Any]) -> Any:
    """What the instrument of this name in `irisjax` reads, called with `options`."""
    instrument, solver = getattr(ij, name), options["solver"]
    if not isinstance(solver, MonteCarlo) or solver.estimator != "analog":
        return instrument(iris, grid, **options)

    def read(counts: Counts):
        return instrument(iris, grid, **{**options, "solver": _Counted(solver, counts)})

    exits = np.shape(options["cos_exit"]) if "cos_exit" in options else None
    read(_no_counts(grid.size, exits))  # wrong input is refused before photons are sent
    # `delay`: runs of less than a second need no bar.
    with tqdm(
        total=solver.n_photons,
        unit="photon",
        unit_scale=True,
        delay=1,
        disable=not sys.stderr.isatty(),
    ) as bar:
        count = _counting(solver, name, iris, grid, options)
        counts = in_blocks(count, solver.n_photons, max(1, _BLOCK // grid.size), bar.update)
    return read(counts)


def in_blocks(
    count: Callable[..., Counts],
    n_photons: int,
    block: int,
    progress: Callable[[int], Any],
) -> Counts:
    """Counts of all photons, followed `block` at a time.

    **Arguments:** `count(first=, last=)` follows photons `first` to `last`, as `MonteCarlo.count`;
    `progress` is told after each block how many it had. The loop is Python's, so that Ctrl-C gets
    through. Counts add: the result does not depend on `block`.
    """
    total: Counts | None = None
    for first in range(0, n_photons, block):
        last = min(first + block, n_photons)
        counts = count(first=first, last=last)
        total = counts if total is None else jax.tree.map(operator.add, total, counts)
        jax.block_until_ready(total)
        progress(last - first)
    assert total is not None  # there is at least one photon
    return total


class _Counted(AbstractSolver):
    """A Monte Carlo solver whose photons have been counted."""

    solver: MonteCarlo
    counts: Counts

    def prepare(self, layers, process) -> "_Counted":
        return _Counted(self.solver.prepare(layers, process), self.counts)

    def solve(
        self, layers, process, cos_incidence, *, cos_exit=None, azimuth=None, key=None, rays=None
    ):
        return self.solver.summarise(self.counts, layers, process, cos_exit)


def _no_counts(wavelengths: int, exits: tuple[int, ...] | None) -> Counts:
    return Counts(
        fates=jnp.zeros((wavelengths, 5), jnp.int32),
        exits=None if exits is None else jnp.zeros((wavelengths, *exits), jnp.int32),
        photons=jnp.ones(wavelengths, jnp.int32),
    )


def _counting(
    solver: MonteCarlo, name: str, iris: ij.Iris, grid: np.ndarray, options: Mapping[str, Any]
) -> Callable[..., Counts]:
    """`MonteCarlo.count` for the light that the instrument of this name sends to the iris."""
    process, table, cosine = options["process"], extinction(grid), options["cos_incidence"]
    cornea = {"brdf": "none", "radiance": process.cornea or "inward"}.get(name, process.cornea)
    if cosine != ij.DIFFUSE:
        cosine = jnp.asarray(cosine, table.wavelengths.dtype)
        cosine = jax.jit(through_cornea, static_argnums=2)(iris, cosine, cornea or "none")[1]
    power = illuminant_power(options["illuminant"], grid) if name == "radiance" else None
    exits = options.get("cos_exit")
    return partial(
        solver.count,
        layers_of(iris, table, process),
        process,
        cosine,
        cos_exit=None if exits is None else jnp.asarray(exits, table.wavelengths.dtype),
        key=options["key"],
        rays=power,
    )
