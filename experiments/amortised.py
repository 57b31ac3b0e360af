"""Posteriors by a trained flow, weighted by the exact likelihood: whether they are as wide as they
should be, how many draws are effective, which spectra are called unlike the model's, and times.

Eyes drawn from the priors (noise 2 %, gain and noise free) are inverted as in `calibration.py`.
Pixels are those of a simulated cube (noise 1 %, strength of scattering free), mapped by the command
in a process of its own; a larger cube's time is extrapolated. Spectra unlike the model's are those
of the other process, and the model's own with one band 10 or 20 standard deviations off.
"""

import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import h5netcdf
import jax
import numpy as np

import irisjax as ij
from experiments import cubes
from experiments.calibration import DRAWS, GRID, LEVELS
from experiments.common import RESULTS, start, uniform_ranks, write
from irisjax.infer.amortised import flow_name, save_flow, train_flow, weighted_draws, with_chains
from irisjax.infer.pixels import fit_pixels, prior_starts
from irisjax.infer.problem import predicted
from irisjax.io.cubes import read_map

EYES, PER_EYE = 500, 1024
OTHER = dict(zip(cubes.PROCESSES, cubes.PROCESSES[::-1], strict=True))
RULES = dict(zip(cubes.PROCESSES, (ij.ILIT_2006, ij.DEPTH_RESOLVED), strict=True))
COLUMNS = ("process", "spectra", "what", "value", "unit")


def main(key, quick=False, out=RESULTS):
    """Write ranks, coverage, efficiency, flags and times for either process (quick: 16 eyes, a flow
    hardly trained, a cube of 16 by 16 pixels).
    """
    for process in cubes.PROCESSES[:1] if quick else cubes.PROCESSES:
        of_eyes(process, key, quick, out)
        of_pixels(process, key, quick, out)


def of_eyes(process, key, quick=False, out=RESULTS):
    """Write `amortised_ranks_*`, `amortised_summary_*` and `amortised_eyes_*` of a process."""
    problem, other = (
        ij.problem(ij.spectrum(GRID, np.zeros(GRID.size)), process=RULES[p])
        for p in (process, OTHER[process])
    )
    flow, rows = trained(problem, key, quick)
    starts, count = prior_starts(problem), 16 if quick else EYES
    z = np.random.default_rng([*np.ravel(jax.random.key_data(key)), 2]).standard_normal(
        (count, len(problem.free))
    )
    (values,), *_ = predicted(problem, z, jax.random.fold_in(key, 3))
    found = posteriors(flow, problem, values, starts, key)
    rows += efficiency(found)
    own = jax.random.fold_in(key, 4)
    draws, good = with_chains(found, problem, values, *fitted(problem, values, starts), key=own)
    rows.append(("eyes whose draws are a chain's", float((found.efficiency < 0.05).sum()), "1"))
    rows.append(("eyes with no posterior to be trusted", float((~good).sum()), "1"))
    (strange,), *_ = predicted(other, z, jax.random.fold_in(key, 5))
    rows += flags(flow, problem, values, strange, starts, key)
    samples = np.stack([draws.equal(i, DRAWS, key=own) for i in range(count)])
    ranks = (samples < z[:, None]).sum(axis=1)
    below = ((draws.z < z[:, None]) * draws.weights[..., None]).sum(axis=1)
    covered = [(np.abs(2 * below - 1) < level).mean(axis=0) for level in LEVELS]
    summary = [
        (n, count, *uniform_ranks(ranks[:, i], DRAWS), *(float(c[i]) for c in covered))
        for i, n in enumerate(problem.free)
    ]
    head = about(process, f"{count} simulated eyes from the default priors, noise 2 % + 2e-4", key)
    errors = ", ".join(f"{np.sqrt(p * (1 - p) / count):.3f}" for p in LEVELS)
    head = (*head, f"binomial standard errors of the coverage: {errors}")
    columns = ("p_chi_square", "p_kolmogorov", *(f"covered_{100 * p:g}" for p in LEVELS))
    columns = ("parameter", "eyes", *columns)
    write(out / f"amortised_summary_{process}.csv", head, columns, summary)
    each = [
        (eye, n, float(z[eye, i]), int(ranks[eye, i]), DRAWS, float(found.efficiency[eye]))
        for eye in range(count)
        for i, n in enumerate(problem.free)
    ]
    columns = ("eye", "parameter", "truth_z", "rank", "draws", "efficiency")
    write(out / f"amortised_ranks_{process}.csv", head, columns, each)
    rows = [(process, "eyes", *row) for row in rows]
    write(out / f"amortised_eyes_{process}.csv", head, COLUMNS, rows)


def of_pixels(process, key, quick=False, out=RESULTS):
    """Write `amortised_pixels_*` of a process."""
    size, count = (16, 64) if quick else (128, 1024)
    with tempfile.TemporaryDirectory() as temporary:
        small, cube, strange, maps, flows = (
            Path(temporary, n) for n in ("small", "cube", "strange", "maps", "flows")
        )
        cubes.simulate(small, 16, process, key)
        cubes.simulate(cube, size, process, key)
        cubes.simulate(strange, size, OTHER[process], key)
        spectra, problem = cubes.pixels(cube, process)
        flow, rows = trained(problem, key, quick)
        flows.mkdir()
        save_flow(flows / f"{flow_name(problem)}.flow", flow)
        how = ("--posterior", "--flows", flows, "--process", process)
        cubes.mapped(small, maps, *how)
        again = cubes.mapped(small, maps, *how)
        seconds, cpu, peak = cubes.mapped(cube, maps, *how)
        more = (cpu - again[1]) / (len(spectra) - 16**2 * len(spectra) / size**2)
        large = 512**2 * len(spectra) / size**2
        rows += [
            (f"{size} by {size}, start to end", seconds, "s"),
            (f"{size} by {size}, of one core", cpu, "s"),
            (f"{size} by {size}, peak memory", peak, "MiB"),
            ("of one core, a pixel that is fitted", more, "s"),
            ("512 by 512, extrapolated, of one core", again[1] + more * large, "s"),
            ("512 by 512, extrapolated, two cores", again[0] + more * large / 2, "s"),
        ]
        flag = read_map(maps / "maps.nc", "flag")
        good = (flag & 7) == 0
        share = read_map(maps / "maps.nc", "efficiency")[good]
        rows += [
            ("64 draws: efficiency of 20 % or more", float((share >= 0.2).mean()), "1"),
            ("64 draws: efficiency below 5 %", float((share < 0.05).mean()), "1"),
            ("no posterior to be trusted", float(((flag[good] & 128) > 0).mean()), "1"),
        ]
        with h5netcdf.File(maps / "maps.nc") as found, h5netcdf.File(cube / "truth.nc") as truth:
            for name in cubes.FREE:
                mean, sd = (found[f"{name}_posterior_{w}"][...][good] for w in ("mean", "sd"))
                off = np.abs(truth[name][...][good] - mean) / sd
                rows.append((f"truth within 2 sd, {name}", float((off < 2).mean()), "1"))
        starts = prior_starts(problem)
        chosen = np.linspace(0, len(spectra) - 1, min(count, len(spectra))).astype(int)
        rows += efficiency(posteriors(flow, problem, spectra[chosen], starts, key))
        others, _ = cubes.pixels(strange, OTHER[process])
        chosen_others = np.linspace(0, len(others) - 1, len(chosen)).astype(int)
        rows += flags(flow, problem, spectra[chosen], others[chosen_others], starts, key)
    what = f"pixels of a simulated cube, {size} by {size}, noise 1 % + 2e-4"
    rows = [(process, "pixels", *row) for row in rows]
    write(out / f"amortised_pixels_{process}.csv", about(process, what, key), COLUMNS, rows)


def trained(problem, key, quick):
    """A flow, and rows of the time that it took."""
    begin, how = (time.perf_counter(), time.process_time()), {}
    if quick:
        how = {"simulated": 2048, "epochs": 2}
    with ThreadPoolExecutor(2) as pool:
        flow = train_flow(problem, key=jax.random.fold_in(key, 0), each=pool.map, **how)
    return flow, [
        ("training, start to end", time.perf_counter() - begin[0], "s"),
        ("training, of one core", time.process_time() - begin[1], "s"),
    ]


def fitted(problem, values, starts):
    """Optima of spectra in the priors' coordinates, and their covariances."""
    fits = fit_pixels(problem, values, starts)
    return fits.z, fits.z_covariance


def posteriors(flow, problem, values, starts, key):
    """Weighted draws of the posteriors of spectra."""
    at = fitted(problem, values, starts)
    return weighted_draws(flow, problem, values, *at, draws=PER_EYE, key=jax.random.fold_in(key, 6))


def efficiency(found):
    """Rows of the shares of effective draws."""
    share, name = found.efficiency, f"{PER_EYE} draws: efficiency"
    return [
        (f"{name}, median", float(np.median(share)), "1"),
        (f"{name} of 20 % or more", float((share >= 0.2).mean()), "1"),
        (f"{name} below 5 %", float((share < 0.05).mean()), "1"),
    ]


def flags(flow, problem, values, strange, starts, key):
    """Rows of the shares of spectra that are called unusual."""
    random = np.random.default_rng([*np.ravel(jax.random.key_data(key)), 7])
    each = np.arange(len(values)), random.integers(0, values.shape[1], len(values))
    sd = float(problem.noise.relative) * values[each] + float(problem.noise.absolute)
    sign = random.choice([-1, 1], len(values))
    kinds = {"the model's own": values, "the other process": strange}
    for times in (10, 20):
        kinds[f"a band {times} standard deviations off"] = values.copy()
        kinds[f"a band {times} standard deviations off"][each] += times * sign * sd
    return [
        (f"unusual, {n}", float(posteriors(flow, problem, v, starts, key).unusual.mean()), "1")
        for n, v in kinds.items()
    ]


def about(process, what, key):
    """The lines above a table."""
    return f"{what}, 31 bands, seed {jax.random.key_data(key)[-1]}", f"process {process}, float64"


if __name__ == "__main__":
    start(main, __doc__)
