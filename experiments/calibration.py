"""Simulation-based calibration: are the posteriors as wide as they should be?

Eyes drawn from the prior, measured with the stated noise, and inverted. The rank of each truth
among 63 independent posterior draws must be uniform over 0 to 63 [Talts et al. 2018]; central
intervals must hold their share of truths.
"""

import tempfile
from pathlib import Path

import jax
import numpy as np
from tqdm import tqdm

import irisjax as ij
from experiments.common import RESULTS, start, uniform_ranks, write
from irisjax.infer.fit import fit
from irisjax.infer.observation import with_values
from irisjax.infer.parameters import DEFAULT_FREE
from irisjax.infer.posterior import sample
from irisjax.infer.store import Store

DRAWS, LEVELS = 63, (0.5, 0.8, 0.95)


EYES = {
    "": ("ilit-2006", ij.ILIT_2006, 320),
    "_radiative": ("depth-resolved", ij.DEPTH_RESOLVED, 160),
}
"""Processes and numbers of eyes, by the end of their files' names."""

GRID = ij.wavelengths(400, 700, 10)
CENTRES = np.array([420.0, 450, 480, 520, 550, 580, 620, 670])  # nm
FWHM = np.array([20.0, 20, 20, 30, 20, 20, 30, 40])
INSTRUMENTS = {
    "_bands": ("eight bands of 20 to 40 nm", CENTRES, {"bands": FWHM}),
    "_slit": ("a slit of 20 nm", GRID, {"bands": 20.0}),
    "_correlated": ("noise correlated over 30 nm", GRID, {"correlated": 30.0}),
    "_without_surface": ("the first surface's reflection excluded", GRID, {"first_surface": False}),
}
"""Instruments by the end of their files' names, with 160 eyes each by ILIT."""
OF_STRENGTH = {
    "_strength": ("ilit-2006", ij.ILIT_2006),
    "_strength_radiative": ("depth-resolved", ij.DEPTH_RESOLVED),
}
"""Processes by the end of their files' names, with 80 eyes each whose strength of scattering is
free.
"""


def main(key, quick=False, out=RESULTS, eyes=None, walkers=64):
    """Write ranks of every eye and, by parameter, p-values and coverage, for either process and for
    other instruments and a free strength of scattering (quick: 3 eyes, a closed formula).
    """
    from experiments.closed_formulas import KubelkaMunk

    blank = ij.spectrum(GRID, np.ones(GRID.size))
    if quick:
        of_formula = ij.problem(blank, solver=KubelkaMunk())
        calibrate(of_formula, "transport: Kubelka-Munk (quick)", "", key, eyes or 3, out, walkers)
        return
    for end, (name, process, count) in EYES.items():
        of_process = ij.problem(blank, process=process)
        calibrate(of_process, f"process {name}", end, key, eyes or count, out, walkers)
    for end in INSTRUMENTS:
        of_instrument(end, key, eyes or 160, out, walkers)
    for end in OF_STRENGTH:
        of_strength(end, key, eyes or 80, out, walkers)


def of_instrument(end, key, count, out=RESULTS, walkers=64):
    """Write the two tables of one of `INSTRUMENTS`."""
    name, grid, settings = INSTRUMENTS[end]
    if "bands" in settings:
        settings = {"bands": ij.Passbands.slit(grid, settings["bands"])}
    problem = ij.problem(ij.spectrum(grid, np.ones(grid.size), **settings), process=ij.ILIT_2006)
    calibrate(problem, f"process ilit-2006, {name}", end, key, count, out, walkers)


def of_strength(end, key, count, out=RESULTS, walkers=64):
    """Write the two tables of one of `OF_STRENGTH`."""
    name, process = OF_STRENGTH[end]
    free = [*DEFAULT_FREE, "scattering_scale"]
    problem = ij.problem(ij.spectrum(GRID, np.ones(GRID.size)), process=process, free=free)
    about = f"process {name}, strength of scattering free, 0.3 to 40 times"
    calibrate(problem, about, end, key, count, out, walkers)


def calibrate(problem, about, end, key, count, out=RESULTS, walkers=64):
    """Write the two tables of a problem."""
    simulate = jax.jit(lambda z, k: problem.simulate(z, k)[0])
    rows, ranks, inside = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        for eye in tqdm(range(count), unit="eye", disable=count < 10):
            own = jax.random.fold_in(key, eye)
            z = jax.random.normal(jax.random.fold_in(own, 0), (len(problem.free),))
            values = simulate(z, jax.random.fold_in(own, 1))
            mine = problem.with_observations(with_values(problem.observations[0], values))
            path = Path(folder) / f"{eye}.h5"
            best = fit(mine, key=jax.random.fold_in(own, 2))
            chains = sample(mine, best, store=path, walkers=walkers, max_steps=400, key=own)
            draws = _independent(path, jax.random.fold_in(own, 3))
            rank = (draws < np.asarray(z)).sum(axis=0)
            ranks.append(rank)
            flat = chains.z.reshape(-1, z.size)
            tail = (flat < np.asarray(z)).mean(axis=0)
            inside.append([np.abs(2 * tail - 1) < level for level in LEVELS])
            tau = float(chains.tau.max())
            rows += [
                (eye, n, float(problem.natural(z)[i]), int(rank[i]), DRAWS, tau, chains.steps)
                for i, n in enumerate(problem.free)
            ]
            for p in Path(folder).iterdir():
                p.unlink()
    ranks, covered = np.array(ranks), np.array(inside).mean(axis=0)
    summary = []
    for i, name in enumerate(problem.free):
        tests = uniform_ranks(ranks[:, i], DRAWS)
        summary.append((name, count, *tests, *(float(c) for c in covered[:, i])))
    header = (
        f"{count} simulated eyes from the default priors, "
        f"{problem.observations[0].values.size} wavelengths, noise 2 % + 2e-4, "
        f"seed {jax.random.key_data(key)[-1]}",
        about,
        f"binomial standard errors of the coverage: "
        f"{', '.join(f'{np.sqrt(p * (1 - p) / count):.3f}' for p in LEVELS)}",
    )
    write(
        out / f"calibration_ranks{end}.csv",
        header,
        ("eye", "parameter", "truth", "rank", "draws", "tau", "steps"),
        rows,
    )
    columns = (
        "parameter",
        "eyes",
        "p_chi_square",
        "p_kolmogorov",
        *(f"covered_{100 * p:g}" for p in LEVELS),
    )
    write(out / f"calibration_summary{end}.csv", header, columns, summary)


def _independent(path, key):
    """Draws far apart: one of each walker, at random steps."""
    store = Store(path)
    z, _ = store.rows(0, store.steps)
    steps = np.asarray(jax.random.randint(key, (z.shape[1],), z.shape[0] // 4, z.shape[0]))
    every = z[steps, np.arange(z.shape[1])]
    return every[np.linspace(0, len(every) - 1, DRAWS).astype(int)]


if __name__ == "__main__":
    start(main, __doc__)
