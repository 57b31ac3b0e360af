"""The job of the benchmarks of transport: one spectrum of each level, its time and its error."""

import statistics
import time

import jax
import numpy as np

import irisjax as ij

GRID = ij.wavelengths(400, 720, 4)
LEVELS = ("low", "moderate", "high")


def median_us(call, repeats=40):
    """Median time of a warm call, microseconds."""
    for _ in range(2):
        jax.block_until_ready(call())
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        jax.block_until_ready(call())
        times.append(time.perf_counter() - begin)
    return statistics.median(times) * 1e6


def reading(iris, solver, **options):
    """Measured reflectance of an iris on `GRID`, the first surface left out."""
    return ij.reflectance(iris, GRID, solver=solver, first_surface=False, throw=False, **options)


def values(iris, solver):
    """The values alone of `reading`, by a solver without chance."""
    return np.asarray(reading(iris, solver).values)


def errors(found, reference):
    """Largest relative error, and the root mean square of all."""
    error = np.abs(found / reference - 1)
    return float(error.max()), float(np.sqrt((error**2).mean()))


def matched(iris):
    """The iris with the chamber's index everywhere: no interface mirrors."""
    return iris.replace(abl_index=1.336, stroma_index=1.336, ipe_index=1.336)
