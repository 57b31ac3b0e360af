"""How long `irisjax map` takes, what it finds of a simulated cube's truth, and what it costs beside
SciPy's least squares.

A cube of a grown iris (64 % of its pixels) is mapped by the process that simulated it, in a process
of its own; the peak of its memory is the system's count. (With posteriors: `cube_posteriors.py`.) A
cube of sixteen times as many pixels, of which as many are fitted as of the smaller one's ring,
shows that the memory does not grow. SciPy fits 50 of the pixels with the same forward model, the
same priors and differences as derivatives.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5netcdf
import jax
import numpy as np
from scipy.optimize import least_squares

import irisjax as ij
from experiments.common import RESULTS, start, write
from irisjax import io

PROCESSES = ("ilit-2006", "depth-resolved")
VARIED = ("melanin_load", "abl_fraction", "pheomelanin_share", "hemoglobin", "saturation")
FREE = (*VARIED, "scattering_scale")
NOISE, LEVEL = 0.01, "moderate"


def main(key, quick=False, out=RESULTS):
    """Write times, memory and coverage (quick: a cube of 16 by 16 pixels, two pixels by SciPy)."""
    size, count = (16, 2) if quick else (512, 50)
    rows, covered = [], []
    with tempfile.TemporaryDirectory() as temporary:
        for process in PROCESSES:
            cube, maps = Path(temporary, f"cube-{process}"), Path(temporary, f"maps-{process}")
            tiny = Path(temporary, f"tiny-{process}")
            simulate(tiny, 16, process, key)
            _, first, _ = mapped(tiny, maps)
            simulate(cube, size, process, key)
            seconds, cpu, peak = mapped(cube, maps)
            spectra, problem = pixels(cube, process)
            rows += [
                (process, "pixels", float(size * size), "1"),
                (process, "pixels fitted", float(len(spectra)), "1"),
                (process, "seconds", seconds, "s"),
                (process, "CPU seconds", cpu, "s"),
                (process, "CPU seconds of 16 by 16, first run (compiles)", first, "s"),
                (process, "pixels fitted a second", len(spectra) / seconds, "1/s"),
                (process, "peak memory", peak, "MiB"),
            ]
            covered += [(process, *row) for row in coverage(cube, maps)]
            each, off = by_scipy(problem, spectra, maps, count)
            rows += [
                (process, f"SciPy, {count} pixels: seconds a pixel", each, "s"),
                (process, "largest difference to SciPy", off, "sd"),
            ]
        cube, maps = Path(temporary, "large"), Path(temporary, "maps-large")
        large = 64 if quick else 2048
        enlarge(Path(temporary, f"cube-{PROCESSES[0]}"), cube, size, large)
        seconds, cpu, peak = mapped(cube, maps)
        rows += [
            (PROCESSES[0], f"{large} by {large}, as many fitted: seconds", seconds, "s"),
            (PROCESSES[0], f"{large} by {large}, as many fitted: peak memory", peak, "MiB"),
        ]
    head = (about(size),)
    write(out / "cubes.csv", head, ("process", "what", "value", "unit"), rows)
    columns = "process", "parameter", "within_2_sd", "mean_off_sd", "sd_off_sd", "relative_rms"
    write(out / "cubes_coverage.csv", head, columns, covered)


def about(size):
    """Return what a cube and its fits are, for the head of a file."""
    cores = len(os.sched_getaffinity(0))
    return (
        f"{size} by {size} pixels, 31 bands, noise 1 % + 2e-4, {len(FREE)} parameters free, "
        f"float64, {cores} cores"
    )


def simulate(folder, size, process, key):
    """Simulate a cube by the command."""
    seed = int(jax.random.key_data(key)[-1])
    run(
        "simulate-cube", "--size", size, "--level", LEVEL, "--scattering-scale", 6, "--process",
        process, "--relative-noise", NOISE, "--seed", seed, "-o", folder,
    )  # fmt: skip


def mapped(cube, maps, *more):
    """Map a cube by the command: wall and CPU seconds, and peak memory, MiB."""
    header = io.read_cube(cube / "cube.hdr").header
    return run(
        "map", cube / "cube.hdr", "--white", cube / "white.csv", "--dark", cube / "dark.csv",
        "--limbus", header["limbus"], "--pupil", header["pupil"], "--relative-noise", str(NOISE),
        "--free", ",".join(FREE), "-o", maps, "--overwrite", *more,
    )  # fmt: skip


def run(*arguments):
    """Run the command in a process of its own."""
    begin = time.perf_counter()
    command = [sys.executable, "-m", "irisjax", *map(str, arguments)]
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise RuntimeError(f"{' '.join(command)}: exit status {child.returncode}")
    return time.perf_counter() - begin, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def pixels(cube, process):
    """Reflectances of the pixels that are fitted, and the problem that each is."""
    opened = io.read_cube(cube / "cube.hdr")
    read = {n: io.read_reference(cube / f"{n}.csv", opened) for n in ("white", "dark")}
    source = io.Reflectances(opened, **read, ceiling=opened.ceiling)
    values, flags = source.read(0, opened.shape[0])
    inside = np.isfinite(io.read_map(cube / "truth.nc", "melanin_load"))
    blank = ij.spectrum(opened.wavelengths, np.zeros(opened.shape[2]))
    noise = ij.Noise(relative=NOISE, absolute=2e-4)
    rules = ij.ILIT_2006 if process == PROCESSES[0] else ij.DEPTH_RESOLVED
    return values[inside & (flags == 0)], ij.problem(blank, free=FREE, noise=noise, process=rules)


def coverage(cube, maps):
    """For each parameter the share of truths within 2 sd, and how far they are off."""
    rows = []
    with h5netcdf.File(maps / "maps.nc") as found, h5netcdf.File(cube / "truth.nc") as truth:
        good = (found["flag"][...] & 7) == 0
        for name in FREE:
            true, value = truth[name][...][good], found[name][...][good]
            off = (value - true) / found[f"{name}_sd"][...][good]
            rms = float(np.sqrt(np.mean((value / true - 1) ** 2)))
            within = float((np.abs(off) < 2).mean())
            rows.append((name, within, float(off.mean()), float(off.std()), rms))
    return rows


def by_scipy(problem, spectra, maps, count):
    """Fit some of the pixels by SciPy: seconds a pixel, and the largest difference in sd."""
    predict = jax.jit(lambda z: problem.predict(z)[0])
    predict(np.zeros(len(FREE)))
    with h5netcdf.File(maps / "maps.nc") as found:
        good = (found["flag"][...] & 7) == 0
        values, sds = (np.stack([found[n + s][...][good] for n in FREE], 1) for s in ("", "_sd"))
    chosen, largest, seconds = np.linspace(0, len(spectra) - 1, count).astype(int), 0.0, 0.0
    for i in chosen:
        y = spectra[i]
        sd = np.hypot(NOISE * y, 2e-4)

        def residuals(z, y=y, sd=sd):
            return np.concatenate([(y - np.asarray(predict(z))) / sd, z])

        begin = time.perf_counter()
        ended = least_squares(residuals, np.zeros(len(FREE)), x_scale="jac")
        seconds += time.perf_counter() - begin
        natural = np.asarray(problem.natural(jax.numpy.asarray(ended.x)))
        largest = max(largest, float(np.max(np.abs(natural - values[i]) / sds[i])))
    return seconds / count, largest


def enlarge(small, large, size, to):
    """Repeat a cube until it has `to` rows and columns; the outlines remain those of the first."""
    large.mkdir()
    times = to // size
    counts = np.fromfile(small / "cube.img", "<u2").reshape(size, -1, size)
    with (large / "cube.img").open("wb") as file:
        for _ in range(times):
            for row in counts:
                file.write(np.tile(row, times).tobytes())
    header = (small / "cube.hdr").read_text(encoding="utf-8")
    header = header.replace(f"samples = {size}\n", f"samples = {to}\n")
    header = header.replace(f"lines = {size}\n", f"lines = {to}\n")
    (large / "cube.hdr").write_text(header, encoding="utf-8")
    for name in ("white.csv", "dark.csv"):
        (large / name).write_bytes((small / name).read_bytes())


if __name__ == "__main__":
    start(main, __doc__)
