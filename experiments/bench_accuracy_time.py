"""Run time against error: every solver at several sizes, in float64 and float32, beside two peers.

The job is 81 wavelengths, 400–720 nm, normal incidence, first surface left out, an error over the
three levels. Times are medians of warm calls after `block_until_ready`; compile time stands apart.
`single` is one spectrum through the public function, `jitted` the same inside the caller's jit,
`batch` the time a spectrum takes in a batch. Samplers say their standard error; as `max_rel_error`
and `rms_rel_error` it is relative to the reference, the root mean square over wavelengths and
levels. Ratios within one run are what counts: machines differ.
"""

import json
import os
import platform
import statistics
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import irisjax as ij
from experiments import bench_peers
from experiments.bench_job import GRID, LEVELS, errors, matched, median_us, reading, values
from experiments.common import RESULTS, start, write
from irisjax.transport.defaults import table_for

COLUMNS = (
    "job",
    "solver",
    "size",
    "precision",
    "single_us",
    "jitted_us",
    "batch_us",
    "max_rel_error",
    "rms_rel_error",
    "rms_standard_error",
    "compile_s",
)


def main(key, quick=False, out=RESULTS):
    """Write `bench_accuracy_time.csv` and `bench_scaling.csv`."""
    device = f"{jax.devices()[0].device_kind}, {os.cpu_count()} cores, {platform.machine()}"
    rows = _solvers(key, quick)
    print(f"{len(rows)} solver rows", flush=True)
    if not quick:
        rows += _other_precision()
    rows += _depth_resolved(key, quick) + bench_peers.rows(quick)
    header = (
        f"simulated irides; {len(GRID)} wavelengths; {device}; jax {jax.__version__}; irisjax "
        f"{ij.__version__}",
        "times in microseconds a spectrum, warm medians; errors against Exact with 288 nodes a "
        "layer "
        "(72 for lb06; 96 and 5 panels of 12 polynomials, depth-resolved)",
    )
    write(out / "bench_accuracy_time.csv", header, COLUMNS, rows)
    write(
        out / "bench_scaling.csv",
        (header[0], "cost against number of wavelengths, irides and photons, and import time"),
        ("quantity", "number", "seconds", "seconds_per_unit"),
        _scaling(key, quick) + _imports(quick),
    )


def _solvers(key, quick):
    precision = "float64" if jax.config.jax_enable_x64 else "float32"
    rows = []
    for job, process in (("ilit-2006", ij.ILIT_2006), ("ilit-corrected", ij.ILIT_CORRECTED)):
        reference = _reference(process, 288 if job == "ilit-corrected" else 72)
        for n in (8, 16) if quick else (8, 12, 16, 20, 24, 28, 40):
            rows.append(
                (
                    job,
                    "exact",
                    n,
                    precision,
                    *_deterministic(ij.IlitExact(n, process=process), reference, quick),
                )
            )
        for n in (64,) if quick else (64, 128, 256):
            solver = ij.IlitTabulated.build(process=process, n_intervals=n, tolerance=1.0)
            rows.append((job, "tabulated", n, precision, *_deterministic(solver, reference, quick)))
        if precision == "float32" or job == "ilit-corrected":
            continue
        for n in (1_000,) if quick else (1_000, 10_000, 100_000):
            found = _sampled(ij.MonteCarlo(n), key, reference)
            rows.append((job, "analog", n, "float32", *found))
    return rows


def _reference(process, n_angles):
    with jax.enable_x64(True):
        return np.stack(
            [values(ij.Iris.of_level(v), ij.IlitExact(n_angles, process=process)) for v in LEVELS]
        )


def _deterministic(solver, reference, quick):
    irides = [ij.Iris.of_level(v) for v in LEVELS]
    size = 64 if quick else 1024
    loads = jnp.geomspace(0.01, 2.0, size)
    return _integrated(solver, irides, reference, loads, together=64, calls=(40, 40, 5))


def _integrated(solver, irides, reference, loads, together, calls):
    """Times, errors and compile time of a solver without chance, as they stand in a row."""
    found = np.stack([values(i, solver) for i in irides])
    iris = irides[LEVELS.index("moderate")]

    def spectrum(x):
        return ij.reflectance(x, GRID, solver=solver, first_surface=False, throw=False).values

    batch = jax.vmap(lambda c: iris.replace(eumelanin=c))(loads)
    jitted = jax.jit(spectrum)
    begin = time.perf_counter()
    jax.block_until_ready(jitted(iris))
    compile_s = time.perf_counter() - begin
    many = jax.jit(lambda x: jax.lax.map(spectrum, x, batch_size=together))
    return (
        median_us(lambda: spectrum(iris), calls[0]),
        median_us(partial(jitted, iris), calls[1]),
        median_us(partial(many, batch), calls[2]) / loads.size,
        *errors(found, reference),
        float("nan"),
        compile_s,
    )


def _sampled(solver, key, reference):
    keys = jax.random.split(key, len(LEVELS))
    readings = [
        reading(ij.Iris.of_level(v), solver, key=k) for v, k in zip(LEVELS, keys, strict=True)
    ]
    found, error = (
        np.stack([np.asarray(getattr(r, name)) for r in readings])
        for name in ("values", "standard_error")
    )
    iris = ij.Iris.of_level("moderate")

    def spectrum():
        return reading(iris, solver, key=key).values

    nan = float("nan")
    relative = float(np.sqrt(np.mean((error / reference) ** 2)))
    return (median_us(spectrum, 5), nan, nan, *errors(found, reference), relative, nan)


def _other_precision():
    """The same in float32, in a process of its own: precision is a setting of the whole program."""
    code = (
        "import json, jax; from experiments.bench_accuracy_time import _solvers; "
        "print(json.dumps(_solvers(jax.random.key(0), False)))"
    )
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    return [tuple(row) for row in json.loads(run.stdout.splitlines()[-1])]


def _depth_resolved(key, quick):
    """Radiative transfer with Fresnel interfaces, and index-matched as the peers treat it."""
    rows = []
    full = [ij.Iris.of_level(v) for v in LEVELS]
    loads = jnp.geomspace(0.01, 1.0, 16 if quick else 1000)
    for job, irides in (
        ("depth-resolved", full),
        ("depth-resolved, index-matched", [matched(iris) for iris in full]),
    ):
        reference = np.stack([values(i, ij.RadiativeExact(96, 12, 5)) for i in irides])
        for n, depths in ((12, 6),) if quick else ((8, 4), (12, 6), (10, 8), (16, 8), (24, 8)):
            solver = ij.RadiativeExact(n, depths, 1)
            found = _integrated(solver, irides, reference, loads, 8, (20, 20, 3))
            rows.append((job, "exact", f"{n}x{depths}", "float64", *found))
        if irides is full:
            table = table_for(ij.Iris().indices(), ij.DEPTH_RESOLVED)
            found = _integrated(table, irides, reference, loads, 32, (40, 40, 5))
            rows.append((job, "tabulated", "shipped", "float64", *found))
            for n in (1_000,) if quick else (1_000, 10_000, 100_000, 1_000_000):
                found = _sampled(ij.MonteCarlo(n, process=ij.DEPTH_RESOLVED), key, reference)
                rows.append((job, "analog", n, "float32", *found))
    return rows


def _scaling(key, quick):
    rows = []
    iris = ij.Iris.of_level("moderate")
    for n in (81, 810) if quick else (81, 810, 8_100, 81_000):
        seconds = (
            median_us(lambda n=n: ij.reflectance(iris, np.linspace(400, 720, n)).values, 10) / 1e6
        )
        rows.append(("wavelengths, exact", n, seconds, seconds / n))
    table = ij.IlitTabulated.build()
    for name, solver in (("exact", ij.IlitExact()), ("tabulated", table)):

        def spectrum(x, solver=solver):
            return ij.reflectance(x, GRID, solver=solver, throw=False).values

        many = jax.jit(lambda x, f=spectrum: jax.lax.map(f, x, batch_size=64))
        for n in (64, 128) if quick else (64, 640, 3_200):
            batch = jax.vmap(lambda c: iris.replace(eumelanin=c))(jnp.geomspace(0.01, 2.0, n))
            seconds = median_us(partial(many, batch), 5) / 1e6
            rows.append((f"irides, {name}", n, seconds, seconds / n))
    for n in (1_000, 10_000) if quick else (1_000, 10_000, 100_000):
        solver = ij.MonteCarlo(n)
        seconds = (
            median_us(lambda s=solver: ij.reflectance(iris, GRID, solver=s, key=key).values, 5)
            / 1e6
        )
        rows.append(("photons, analog", n * GRID.size, seconds, seconds / n / GRID.size))
    return rows


def _imports(quick):
    """Import time of irisjax against that of jax and equinox together,
    each in a fresh interpreter.
    """
    rows = []
    root = Path(ij.__file__).parent.parent
    for name, code in (("jax, equinox", "import jax, equinox"), ("irisjax", "import irisjax")):
        times = []
        for _ in range(1 if quick else 7):
            begin = time.perf_counter()
            subprocess.run([sys.executable, "-c", code], check=True, cwd=root)
            times.append(time.perf_counter() - begin)
        rows.append((f"import {name}", 1, statistics.median(times), statistics.median(times)))
    return rows


if __name__ == "__main__":
    start(main, __doc__)
