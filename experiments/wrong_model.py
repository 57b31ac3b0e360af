"""What happens when spectra made by one process are read by the other, and whether it is noticed.

Irides from the priors, 31 wavelengths, noise of 2 % + 2e-4, as stated to the fit. For every pair of
maker and reader: how far melanin load and ABL fraction move, how often their 95 % intervals hold
the truth, and how often the fit warns: by its chi-square, or because the other process explains
the data better (`irisjax.infer.model_comparison`). All of it without and with a smooth error of 2 %
that the fit allows the model, correlated over 80 nm, as `irisjax fit --discrepancy 0.02:80` does;
the data are the same. Intervals are least squares', with the noise that the fit leaves, as those of
a posterior with free noise are. Everything is simulated. Writes wrong_model.csv, an eye a row, and
wrong_model_summary.csv.
"""

import itertools
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import chi2

import irisjax as ij
from experiments import common
from irisjax.infer.fit import MISFIT, fit
from irisjax.infer.least_squares import levenberg_marquardt
from irisjax.infer.model_comparison import compare_processes, intervals_of, noise_left
from irisjax.infer.observation import with_values

PROCESSES = {"ILIT": ij.ILIT_2006, "radiative transfer": ij.DEPTH_RESOLVED}
ALLOWED = {"none": ij.Noise(), "0.02:80": ij.Noise(discrepancy=0.02, length=80.0)}
WAVELENGTHS = np.arange(400.0, 701.0, 10.0)
COLUMNS = (
    "maker", "reader", "discrepancy", "load", "fraction", "read_load", "load_low", "load_high",
    "read_fraction", "fraction_low", "fraction_high", "chi_square", "degrees", "log_odds_other",
    "outside", "misfit", "prefers_other",
)  # fmt: skip


def main(key, quick: bool = False, out: Path = common.RESULTS) -> None:
    """Read `n` irides of each maker by each reader."""
    n = 4 if quick else 200
    blank = ij.spectrum(WAVELENGTHS, np.full(31, 0.05), sd=np.full(31, 0.01), name="eye")
    problems = {
        allowed: {name: ij.problem(blank, process=p, noise=noise) for name, p in PROCESSES.items()}
        for allowed, noise in ALLOWED.items()
    }
    rows = []
    for m, (maker, made_by) in enumerate(problems["none"].items()):
        keys = jax.vmap(lambda i, m=m: jax.random.split(_of(key, m, i), 4))(jnp.arange(n))
        truths, seen, sd = _measured(made_by, keys)
        for allowed, readers in problems.items():
            fits = {name: _fits(p, seen, sd, keys[:, 2]) for name, p in readers.items()}
            for i in range(n):
                eye = with_values(blank, seen[i], sd[i])
                rows += [
                    _row(maker, reader, allowed, truths[i], *_read(readers, fits, reader, eye, i))
                    for reader in readers
                ]
    header = (f"simulated; {n} irides of the priors each, {WAVELENGTHS.size} wavelengths",)
    common.write(out / "wrong_model.csv", header, COLUMNS, rows)
    _summarise(rows, out)


def _of(key, maker, iris):
    return jax.random.fold_in(jax.random.fold_in(key, maker), iris)


@eqx.filter_jit
def _drawn(problem, key):
    z = jax.random.normal(key[0], (len(problem.free),))
    z = z.at[problem.free.index("noise")].set(0.0)
    model = problem.predict(z)[0]
    sd = 0.02 * model + 2e-4
    return problem.values(z), model + sd * jax.random.normal(key[1], model.shape), sd


def _measured(problem, keys):
    """True values, an iris each; spectra and their standard deviations."""
    values, seen, sd = eqx.filter_vmap(lambda k: _drawn(problem, k))(keys)
    truths = [
        {name: float(values[name][i]) for name in ("melanin_load", "abl_fraction")}
        for i in range(len(keys))
    ]
    return truths, seen, sd


@eqx.filter_jit
def _fits(problem, seen, sd, keys):
    def one(values, sd, key):
        eye = with_values(problem.observations[0], values, sd)
        mine = problem.with_observations(eye)
        # As a batch of the command: steps of all eyes are those of the slowest.
        return fit(mine, solver=levenberg_marquardt(1e-5, 1e-5), starts=2, rounds=1, key=key)

    return eqx.filter_vmap(one)(seen, sd, keys)


def _of_eye(found, i: int):
    return jax.tree.map(lambda x: np.asarray(x)[i], found)


def _read(problems, fits, reader: str, eye, i: int):
    """What the reader makes of an eye beside the other process, and its fit."""
    (other,) = (name for name in problems if name != reader)
    mine, beside = (_of_eye(fits[name], i) for name in (reader, other))
    problem, second = (problems[name].with_observations(eye) for name in (reader, other))
    intervals = intervals_of(problem, mine, noise_left(mine, mine))
    return compare_processes(problem, mine, second, beside, intervals=intervals), mine


def _row(maker, reader, allowed, truth, found, fit):
    load, fraction = (found.moved[k].own for k in ("melanin_load", "abl_fraction"))
    outside = not (
        load.low <= truth["melanin_load"] <= load.high
        and fraction.low <= truth["abl_fraction"] <= fraction.high
    )
    misfit = chi2.sf(fit.chi_square, fit.degrees) < MISFIT
    return [
        maker, reader, allowed, truth["melanin_load"], truth["abl_fraction"], *(load), *(fraction),
        fit.chi_square, fit.degrees, found.log_odds, int(outside), int(misfit),
        int(found.preferred),
    ]  # fmt: skip


def _summarise(rows, out: Path) -> None:
    lines = []
    for maker, reader, allowed in itertools.product(PROCESSES, PROCESSES, ALLOWED):
        mine = [
            dict(zip(COLUMNS, r, strict=True)) for r in rows if r[:3] == [maker, reader, allowed]
        ]
        of = {name: np.array([r[name] for r in mine]) for name in COLUMNS[3:]}
        outside, misfit, prefers = (of[k] > 0 for k in ("outside", "misfit", "prefers_other"))
        noticed = misfit | prefers
        held = [
            np.mean((of[f"{k}_low"] <= of[k]) & (of[k] <= of[f"{k}_high"]))
            for k in ("load", "fraction")
        ]
        lines.append([
            maker, reader, allowed, len(mine),
            *np.quantile(of["read_load"] / of["load"], [0.16, 0.5, 0.84]),
            *np.quantile(of["read_fraction"] / of["fraction"], [0.16, 0.5, 0.84]), *held,
            outside.mean(), misfit.mean(), prefers.mean(), noticed.mean(),
            noticed[outside].mean() if outside.any() else np.nan,
        ])  # fmt: skip
    columns = (
        "maker", "reader", "discrepancy", "irides", "load_ratio_q16", "load_ratio_median",
        "load_ratio_q84", "fraction_ratio_q16", "fraction_ratio_median", "fraction_ratio_q84",
        "load_held_95", "fraction_held_95", "outside_95", "misfit", "prefers_other", "noticed",
        "noticed_of_outside",
    )  # fmt: skip
    header = ("simulated; shares of irides; ratio: read over true; held: by the 95 % interval",)
    common.write(out / "wrong_model_summary.csv", header, columns, lines)


if __name__ == "__main__":
    common.start(main, __doc__)
