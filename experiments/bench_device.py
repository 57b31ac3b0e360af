"""Measure what an accelerator gains: spectra, photons, log probabilities, fits and frames a second,
beside the same on the processor of the same machine.

Four minutes at most, one file. Each device and precision has a process of its own, because they
are settings of a whole program; a process that has used its share of the time is ended, and what
it did not reach is missing from its rows. An accelerator's process keeps a quarter of the cores,
the processor's the others. Without an accelerator the file has the processor's rows only. Times
are medians of warm calls; the first call, which compiles, stands beside them.
"""

import json
import os
import platform
import statistics
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial

# The first process to use an accelerator would otherwise take three quarters of its memory.
os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding, PartitionSpec

import irisjax as ij
from experiments.common import RESULTS, start
from irisjax.infer.fit import fit
from irisjax.infer.least_squares import levenberg_marquardt
from irisjax.infer.observation import with_values
from irisjax.infer.pixels import fit_pixels, prior_starts
from irisjax.numerics.chunks import cores
from irisjax.transport.defaults import exact_solver, table_for

GRID = ij.wavelengths(400, 720, 4)
PROCESSES = {"ilit-2006": ij.ILIT_2006, "depth-resolved": ij.DEPTH_RESOLVED}
SHARES = {"frames": 90, "float64": 90, "float32": 55}
"""Seconds that a process of each kind has: pictures in single precision, and numbers in either."""
ACCELERATED, PROCESSOR = "accelerator", "processor"


def main(key, quick=False, out=RESULTS):
    """Write `bench_device.json` (quick: a row of each kind, small, on the processor)."""
    seed = int(jax.random.key_data(key)[-1])
    accelerator = jax.devices()[0] if jax.default_backend() != "cpu" and not quick else None
    devices = {PROCESSOR: platform.machine()} | (
        {} if accelerator is None else {ACCELERATED: accelerator.device_kind}
    )
    rows, ended = [], []

    def work(device):
        for kind, seconds in SHARES.items():
            found, whole = _rows_of(device, kind, seconds, seed, quick, len(devices) > 1)
            rows.extend({"device": device, "kind": kind} | row for row in found)
            if not whole:
                ended.append(f"{device}, {kind}: ended after {len(found)} rows")

    threads = [threading.Thread(target=work, args=(device,)) for device in devices]
    for each in (threading.Thread.start, threading.Thread.join):
        for thread in threads:
            each(thread)
    order = {name: i for i, name in enumerate((PROCESSOR, ACCELERATED))}
    rows.sort(key=lambda row: order[row["device"]])
    result = {
        "about": "simulated irides; warm medians; first_s includes compiling",
        "devices": devices,
        "cores": os.cpu_count(),
        "jax": jax.__version__,
        "irisjax": ij.__version__,
        "ended_early": ended,
        "rows": rows,
    }
    path = out / "bench_device.json"
    path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(f"wrote {path}")
    print(table(result))


def table(result: dict) -> str:
    """Print what was found: both devices beside each other, and their ratio."""
    found = {}
    for row in result["rows"]:
        what = (row["what"], row["kind"])
        found.setdefault(what, {})[row["device"]] = row["per_second"]
    lines = [f"{'a second':74s} {'processor':>11s} {'accelerator':>11s} {'ratio':>7s}"]
    for (what, kind), by in found.items():
        here, there = by.get(PROCESSOR, np.nan), by.get(ACCELERATED, np.nan)
        lines.append(f"{kind + ', ' + what:74s} {here:11.4g} {there:11.4g} {there / here:7.3g}")
    return "\n".join([*lines, *result["ended_early"]])


def _rows_of(device, kind, seconds, seed, quick, shared):
    """The rows that a process of its own printed, and whether it reached its end."""
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else [0]
    if shared:
        quarter = max(1, len(cores) // 4)
        cores = cores[:quarter] if device == ACCELERATED else cores[quarter:]
    flags = os.environ.get("XLA_FLAGS", "")
    if device == PROCESSOR and kind != "frames":  # pictures share themselves among threads
        flags += f" --xla_force_host_platform_device_count={len(cores)}"
    settings = {"XLA_FLAGS": flags} | ({"JAX_PLATFORMS": "cpu"} if device == PROCESSOR else {})
    run = subprocess.Popen(
        [sys.executable, "-c", _WORK.format(cores=cores, kind=kind, seed=seed, quick=quick)],
        env=os.environ | settings, stdout=subprocess.PIPE, stderr=sys.stderr, text=True,
    )  # fmt: skip
    timer = threading.Timer(seconds, run.kill)
    timer.start()
    lines = run.communicate()[0].splitlines()
    timer.cancel()
    return [json.loads(line) for line in lines if line.startswith("{")], run.returncode == 0


_WORK = """
import os
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {cores})
from experiments.bench_device import work
work({kind!r}, {seed}, {quick})
"""


def work(kind: str, seed: int, quick: bool) -> None:
    """Print the rows of one kind as lines of JSON, each as soon as it is known."""
    jax.config.update("jax_enable_x64", kind == "float64")
    key = jax.random.key(seed)
    for row in (_frames if kind == "frames" else _numbers)(key, quick):
        print(json.dumps(row), flush=True)


def _frames(key, quick):
    """Every row of `bench_render`."""
    from experiments.bench_render import frames

    for change, scene, ms, per_second, _ in frames(
        key, (80, 60) if quick else (800, 600), 1 if quick else 5
    ):
        yield {"what": f"{change}: {scene}", "per_second": per_second, "seconds": 1e-3 * ms}
        if quick:
            return


def _numbers(key, quick):
    """Spectra, probabilities, least squares, pixels and photons, in the precision that is set."""
    on_cpu = jax.default_backend() == "cpu"
    scale = 1 if quick else 16 if on_cpu else 1024
    for name, process in PROCESSES.items():
        solver = table_for(ij.Iris().indices(), process)
        yield from _spectra(f"{name}, tabulated", solver, 64 * scale, 64 if on_cpu else 16_384)
        if quick:
            break
    if jax.config.jax_enable_x64:
        for name, process in PROCESSES.items():
            problem = _problem(process, key)
            yield from _log_probabilities(name, problem, 64 * scale)
            yield from _least_squares(name, problem, key, 16 * scale)
            yield from _cube(name, problem, key, 64 * min(scale, 16))
            if quick:
                return
    else:
        size = 1_000 if quick else 250_000 if on_cpu else 10**7
        for name, process in PROCESSES.items():
            yield from _photons(name, process, key, size)
            if quick:
                return
        if not on_cpu:
            yield from _photons("ilit-2006", ij.ILIT_2006, key, size, lanes=1 << 17)
    for name, process in PROCESSES.items():
        size = 16 * scale if process is ij.ILIT_2006 else scale
        yield from _spectra(f"{name}, exact", exact_solver(process), size, 8 if on_cpu else 1024)


def _timed(what, number, call):
    """A row: how many a second a call makes, of `number`."""
    times = []
    while len(times) < 2 or (len(times) < 6 and sum(times[1:]) < 3):
        begin = time.perf_counter()
        jax.block_until_ready(call())
        times.append(time.perf_counter() - begin)
    again = statistics.median(times[1:])
    yield {
        "what": what,
        "number": number,
        "per_second": number / again,
        "seconds": again,
        "first_s": times[0],
    }


def _everywhere(function, batch, together):
    """A compiled function of a batch, shared among all devices, `together` items at a time."""
    mesh = jax.make_mesh((jax.device_count(),), ("items",))
    spec = PartitionSpec("items")
    batch = jax.device_put(batch, NamedSharding(mesh, spec))
    share = jax.shard_map(
        partial(jax.lax.map, function, batch_size=together),
        mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False,
    )  # fmt: skip
    return partial(jax.jit(share), batch)


def _together():
    """Items at a time: what stays in a processor's cache, or what fills an accelerator."""
    return 64 if jax.default_backend() == "cpu" else 4096


def _spectra(name, solver, size, together):
    size = max(size // jax.device_count(), 1) * jax.device_count()
    iris = ij.Iris.of_level("moderate")
    loads = jnp.asarray(np.geomspace(0.01, 2.0, size), jnp.result_type(float))

    def spectrum(load):
        changed = iris.replace(eumelanin=load)
        found = ij.reflectance(changed, GRID, solver=solver, first_surface=False, throw=False)
        return found.values

    call = _everywhere(spectrum, loads, together)
    yield from _timed(f"spectra of 81 wavelengths, {name}", size, call)


def _problem(process, key):
    """A noisy spectrum of a moderate iris, to be read by the process that made it."""
    grid = ij.wavelengths(400, 700, 10)
    blank, base = ij.spectrum(grid, np.ones(grid.size)), ij.Iris.of_level("moderate")
    problem = ij.problem(blank, base=base, process=process)
    noisy = problem.simulate(problem.standard(ij.infer.of_iris(base)), key)[0]
    return problem.with_observations(with_values(problem.observations[0], noisy))


def _log_probabilities(name, problem, size):
    size = max(size // jax.device_count(), 1) * jax.device_count()
    z = jnp.asarray(0.3 * np.random.default_rng(0).normal(size=(size, len(problem.free))))
    call = _everywhere(lambda x: problem.log_posterior(x), z, _together())
    yield from _timed(f"log probabilities of 31 wavelengths, {name}", size, call)


def _least_squares(name, problem, key, size):
    size = max(size // jax.device_count(), 1) * jax.device_count()
    seen = problem.observations[0]
    noise = jax.random.normal(key, (size, seen.values.size))

    def one(values):
        changed = problem.with_observations(with_values(seen, values))
        return fit(changed, solver=levenberg_marquardt(1e-5, 1e-5), starts=1).z

    call = _everywhere(one, seen.values * (1 + 0.02 * noise), _together())
    yield from _timed(f"least squares of 31 wavelengths, {name}", size, call)


def _cube(name, problem, key, size):
    """Pixels of a cube as `irisjax map` fits them, shared among threads of the processor."""
    values = problem.observations[0].values
    pixels = np.asarray(values * (1 + 0.02 * jax.random.normal(key, (size, values.size))))
    with ThreadPoolExecutor(cores()) as pool:
        starts = prior_starts(problem, pool.map)
        call = partial(fit_pixels, problem, pixels, starts, pool.map)
        yield from _timed(f"pixels of a cube of 31 bands, {name}", size, call)


def _photons(name, process, key, size, lanes=1 << 14):
    solver = ij.MonteCarlo(size, lanes, ij.photon_mesh(), process=process)
    iris = ij.Iris.of_level("moderate")

    def call():
        return ij.reflectance(iris, GRID, solver=solver, key=key).values

    yield from _timed(f"photons, {name}, {lanes} lanes", size * GRID.size, call)


if __name__ == "__main__":
    start(main, __doc__)
