"""Other codes on the benchmarks' job: nanodisort (C) and iadpython; rows where they are installed.

Neither has interfaces as the iris has them: nanodisort solves the index-matched irides, iadpython
one slab that scatters alike in all directions.
"""

import importlib.util

import numpy as np

import irisjax as ij
from experiments.bench_job import GRID, LEVELS, errors, matched, median_us, values


def rows(quick):
    """Rows of the table of `bench_accuracy_time`."""
    nan = float("nan")
    found = []
    if importlib.util.find_spec("nanodisort"):
        found += [
            ("depth-resolved, index-matched", name, size, "float64", us, nan, us, *error, nan, nan)
            for name, size, us, error in _disort(quick)
        ]
    if importlib.util.find_spec("iadpython"):
        job = "one slab, isotropic, index-matched"
        found += [
            (job, name, size, "float64", us, nan, us, *error, nan, nan)
            for name, size, us, error in _adding_doubling(quick)
        ]
    return found


def _disort(quick):
    reference = np.stack(
        [values(matched(ij.Iris.of_level(v)), ij.RadiativeExact(96, 12, 5)) for v in LEVELS]
    )
    for streams in (16,) if quick else (8, 16, 32):
        for threads in (1, 2):
            many = [_nanodisort(v, streams, threads) for v in LEVELS]
            found = np.stack([solve() for solve in many])
            # Its pool works on a batch of wavelengths: one iris is already one.
            us = median_us(many[1], 20)
            yield f"nanodisort, {threads} threads", streams, us, errors(found, reference)


def _adding_doubling(quick):
    import iadpython

    for points in (8,) if quick else (8, 16, 32):
        sample = iadpython.Sample(a=0.8, b=0.18, g=0, n=1.0, quad_pts=points)
        # Index-matched, isotropic, normal incidence: a Monte Carlo of 2·10⁹ photons confirms
        # this value.
        error = float(abs(sample.rt()[0] / 0.062305650 - 1))
        us = median_us(lambda s=sample: s.rt(), 5) * len(GRID)
        yield "iadpython", points, us, (error, error)


def _nanodisort(level, streams, threads):
    import nanodisort
    from nanodisort.utils import phase_functions

    layers = matched(ij.Iris.of_level(level)).layers(ij.extinction(GRID))
    n = GRID.size
    solver = nanodisort.BatchSolver(nthreads=threads)
    for name, value in {
        "nstr": streams,
        "nlyr": 2,
        "nmom": streams,
        "ntau": 1,
        "usrtau": True,
        "usrang": False,
        "lamber": True,
        "onlyfl": True,
        "quiet": True,
        "umu0": 1.0,
        "phi0": 0.0,
    }.items():
        setattr(solver, name, value)
    solver.set_utau(np.array([0.0]))
    solver.allocate(n)
    solver.set_dtauc(
        np.stack([np.asarray(layers.abl_absorption), np.asarray(layers.extinction)], 1)
    )
    solver.set_ssalb(np.stack([np.zeros(n), np.asarray(layers.albedo)], 1))
    moments = np.asarray(phase_functions.rayleigh(streams))[:, None, None]
    solver.set_pmom(np.ascontiguousarray(np.broadcast_to(moments, (streams + 1, 2, n))))
    solver.set_fbeam(np.ones(n))
    solver.set_albedo(np.zeros(n))

    def solve():
        solver.solve()
        return np.asarray(solver.flup)[:, 0]

    return solve
