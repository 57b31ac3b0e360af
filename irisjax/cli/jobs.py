"""What the command measures: the library's one way from an iris to a reading, with progress."""

import sys
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from tqdm import tqdm

import irisjax as ij
from irisjax.cli import model
from irisjax.measure.colour import Colour
from irisjax.measure.instrument import AbstractInstrument
from irisjax.measure.observe import observe
from irisjax.transport.montecarlo import MonteCarlo
from irisjax.transport.process import DEPTH_RESOLVED, POLARISED
from irisjax.transport.solver import AbstractSolver


def measured(
    iris: ij.Iris,
    instrument: AbstractInstrument,
    solver: AbstractSolver,
    key: jax.Array | None,
) -> Any:
    """What the instrument reads; photons are followed in blocks, with a progress bar."""
    if not isinstance(solver, MonteCarlo):
        return observe(iris, instrument, solver, key=key)
    # `delay`: runs of less than a second need no bar.
    with tqdm(
        total=solver.n_photons,
        unit="photon",
        unit_scale=True,
        delay=1,
        disable=not sys.stderr.isatty(),
    ) as bar:
        return observe(iris, instrument, solver, key=key, progress=bar.update)


def left_out_by_scalar_theory(
    iris: ij.Iris, make: Callable[[np.ndarray], AbstractInstrument], grid: np.ndarray
) -> str:
    """How far scalar theory is off in what the instrument made for some of the wavelengths reads,
    in words.
    """
    if iris.power_law is not None:
        return "how far that is off is not known under a power law of scattering"
    instrument = make(grid)
    if not isinstance(instrument, ij.Colorimeter):  # a colour is of the whole range
        instrument = make(grid[np.unique(np.linspace(0, grid.size - 1, _FEW).round().astype(int))])
    scalar, full = (
        _light(observe(iris, instrument, model.exact_solver(process)))
        for process in (DEPTH_RESOLVED, POLARISED)
    )
    dark = full <= 0
    low = 100 * (1 - np.where(dark, 1, scalar) / np.where(dark, 1, full))
    first, last = float(low.min()), float(low.max())
    name = "luminance" if isinstance(instrument, ij.Colorimeter) else "values"
    if max(abs(first), abs(last)) < 0.05:
        return f"{name} within 0.05 % of polarised transport of the same layers"
    said = [_off(first), _off(last)]
    if said[0] == said[1]:
        said = said[1:]
    elif first >= 0:
        said[0] = f"{first:.1f}"
    return f"{name} {' to '.join(said)} against polarised transport of the same layers"


_FEW = 7  # wavelengths


def few_photons(reading: Any) -> str | None:
    """Says of a reading with standard errors where these rest on too few photons; else `None`."""
    error = getattr(reading, "standard_error", None)
    if error is None:
        return None
    # Of N photons of equal weight the standard error is the Nth part's root of the value.
    rare = np.asarray(error) > np.abs(np.asarray(reading.values)) / np.sqrt(_LEAST)
    if not rare.any():
        return None
    return (
        f"{rare.sum()} of {rare.size} values come from fewer than {_LEAST} photons' worth: their "
        "standard errors may be far too small; give more --photons"
    )


_LEAST = 10  # photons


def _light(reading: Any) -> np.ndarray:
    return np.asarray(reading.xyz[1:2] if isinstance(reading, Colour) else reading.values)


def _off(percent: float) -> str:
    return f"{abs(percent):.1f} % {'low' if percent >= 0 else 'high'}"
