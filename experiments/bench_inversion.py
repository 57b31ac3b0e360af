"""How long an inversion takes: log probability, least squares, posteriors; and which moves suit the
ridge.

Warm times on the machine at hand; every number is a median. Compile times stand beside them.
"""

import time

import emcee
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import irisjax as ij
from experiments.bench_job import median_us
from experiments.common import RESULTS, start, write
from irisjax.infer.fit import fit
from irisjax.infer.least_squares import levenberg_marquardt
from irisjax.infer.moves import Straightening, independent_move, mixture
from irisjax.infer.observation import with_values
from irisjax.infer.posterior import sample

LEVELS = ("low", "moderate", "high")


JOBS = {"ilit-2006": ij.ILIT_2006, "depth-resolved": ij.DEPTH_RESOLVED}


def main(key, quick=False, out=RESULTS):
    """Write times and autocorrelation times (quick: one level, short chains)."""
    times, moves = [], []
    for name, process in JOBS.items():
        problems = _problems(process, LEVELS[:1] if quick else LEVELS, key)
        for level, problem in problems.items():
            best, rows = _times(problem, key, quick)
            times += [(name, level, *row) for row in rows]
            if process is ij.ILIT_2006:
                found = _moves(problem, best, 400 if quick else 2500)
                moves += [(level, *row) for row in found]
        level, problem = next(iter(problems.items()))
        times.append((name, level, *_many(problem, key, 64 if quick else 2048)))
    header = ("31 wavelengths, noise 2 % + 2e-4, default free set, tabulated solvers, float64",)
    write(out / "bench_inversion.csv", header, ("process", "level", "what", "value", "unit"), times)
    write(
        out / "bench_moves.csv",
        (*header, "ilit-2006, 64 walkers; seconds that 50 autocorrelation times take"),
        ("level", "moves", "tau_max", "acceptance", "ms_per_step", "seconds_50_tau"),
        moves,
    )


def _problems(process, levels, key):
    """Noisy spectra that a process made of each level, to be read by it."""
    grid, found = ij.wavelengths(400, 700, 10), {}
    for i, level in enumerate(levels):
        blank = ij.spectrum(grid, np.ones(grid.size))
        problem = ij.problem(blank, base=ij.Iris.of_level(level), process=process)
        truth = ij.infer.of_iris(ij.Iris.of_level(level))
        noisy = problem.simulate(problem.standard(truth), jax.random.fold_in(key, i))[0]
        found[level] = problem.with_observations(with_values(problem.observations[0], noisy))
    return found


def _times(problem, key, quick):
    """The best fit, and rows of what was timed."""
    begin = time.perf_counter()
    best = fit(problem, key=key)
    jax.block_until_ready(best.z)
    first = 1e3 * (time.perf_counter() - begin)
    again = median_us(lambda: fit(problem, key=key).z, 10) / 1e3
    at = problem.log_density
    z = np.asarray(best.z) + 0.05 * np.random.default_rng(0).normal(size=(64, 7))
    rows = [
        ("least squares, first (compiles)", first, "ms"),
        ("least squares, 4 starts", again, "ms"),
        ("log probability, 64 walkers", median_us(lambda: at(z), 100) / 1e3, "ms"),
    ]
    for seed in range(1 if quick else 5):
        begin = time.perf_counter()
        chains = sample(
            problem,
            best,
            max_steps=200 if quick else 20_000,
            key=jax.random.fold_in(key, seed),
        )
        seconds = time.perf_counter() - begin
        found = (
            f"{chains.steps} steps, ESS {chains.ess_bulk.min():.0f}, converged {chains.converged}"
        )
        rows.append((f"posterior, seed {seed}: {found}", seconds, "s"))
    return best, rows


def _many(problem, key, size: int):
    """Least squares of many eyes in one program."""
    o = problem.observations[0]
    batch = o.values * (1 + 0.02 * jax.random.normal(key, (size, o.values.size)))

    @eqx.filter_jit
    def many(problem, values):
        def one(v):
            return fit(
                problem.with_observations(with_values(o, v)),
                solver=levenberg_marquardt(1e-5, 1e-5),
                starts=1,
            ).z

        return jax.lax.map(one, values, batch_size=32)

    us = median_us(lambda: many(problem, batch), 3)
    return f"least squares, batch of {size}: spectra a second", size / us * 1e6, "1/s"


def _moves(problem, best, steps):
    """Autocorrelation time of mixtures of moves."""
    z, at = np.asarray(best.z), problem.log_density
    # The noise, which least squares do not fit, is as sharp as the other parameters.
    covariance = np.asarray(best.covariance) + 0.06 * np.diag(np.diag(best.covariance) == 0)

    def run(moves, first, n, seed):
        sampler = emcee.EnsembleSampler(
            64, z.size, lambda x: np.asarray(at(jnp.asarray(x))), vectorize=True, moves=moves
        )
        sampler.random_state = np.random.RandomState(seed).get_state()
        begin = time.perf_counter()
        sampler.run_mcmc(first, n, skip_initial_state_check=True)
        return sampler, (time.perf_counter() - begin) / n

    cloud = (
        z
        + np.random.RandomState(0).standard_normal((64, z.size)) @ np.linalg.cholesky(covariance).T
    )
    spread, _ = run(mixture(None), cloud, 300, 1)
    taught = spread.get_chain(discard=150, flat=True)
    burn, _ = run(mixture(taught), spread.get_chain()[-1], 300, 2)
    taught = burn.get_chain(discard=150, flat=True)
    last = burn.get_chain()[-1]
    straight = Straightening.of_samples(taught)
    rows = []
    for name, moves in {
        "stretch (emcee's default)": [(emcee.moves.StretchMove(), 1.0)],
        "differences + snooker": mixture(None),
        "kernel density of the other half": [(emcee.moves.KDEMove(), 1.0)],
        "independent t": [(independent_move(straight.linear(), taught), 1.0)],
        "independent t, straightened": [(independent_move(straight, taught), 1.0)],
        "independent t 0.8 + differences, straightened (used)": mixture(taught),
    }.items():
        sampler, seconds = run(moves, last, steps, 3)
        tau = float(emcee.autocorr.integrated_time(sampler.get_chain(), tol=0, quiet=True).max())
        rows.append(
            (
                name,
                tau,
                float(sampler.acceptance_fraction.mean()),
                1e3 * seconds,
                50 * tau * seconds,
            )
        )
    return rows


if __name__ == "__main__":
    start(main, __doc__)
