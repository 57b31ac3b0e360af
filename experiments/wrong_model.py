"""What happens when spectra made by one process are read by the other, and whether it is noticed.

Irides from the priors, 31 wavelengths, noise of 2 % + 2e-4, as stated to the fit. For every pair of
maker and reader: how far melanin load and ABL fraction move, how often their 95 % intervals miss
the truth, and how often the fit warns: by its chi-square, or because the other process explains
the data better (`irisjax.infer.other_process`). Intervals are least squares', with the noise that
the fit leaves, as those of a posterior with free noise are. Everything is simulated. Writes
wrong_model.csv, an eye a row, and wrong_model_summary.csv.
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import chi2

import irisjax as ij
from experiments import common
from irisjax.infer.fit import MISFIT
from irisjax.infer.observation import with_values
from irisjax.infer.other_process import compared, intervals_of, noise_left, optimum

PROCESSES = {"ILIT": ij.ILIT_2006, "radiative transfer": ij.DEPTH_RESOLVED}
WAVELENGTHS = np.arange(400.0, 701.0, 10.0)
COLUMNS = (
    "maker", "reader", "load", "fraction", "read_load", "load_low", "load_high",
    "read_fraction", "fraction_low", "fraction_high", "chi_square", "degrees", "log_odds_other",
    "outside", "misfit", "prefers_other",
)  # fmt: skip


def main(key, quick: bool = False, out: Path = common.RESULTS) -> None:
    """Read `n` irides of each maker by each reader."""
    n = 4 if quick else 200
    blank = ij.spectrum(WAVELENGTHS, np.full(31, 0.05), sd=np.full(31, 0.01), name="eye")
    problems = {name: ij.problem(blank, process=p) for name, p in PROCESSES.items()}
    rows = []
    for m, (maker, made_by) in enumerate(problems.items()):
        for i in range(n):
            keys = jax.random.split(jax.random.fold_in(jax.random.fold_in(key, m), i), 4)
            z = jax.random.normal(keys[0], (len(made_by.free),))
            z = z.at[made_by.free.index("noise")].set(0.0)
            truth = {k: float(v) for k, v in made_by.values(z).items() if k in made_by.free}
            model = np.asarray(made_by.predict(z)[0])
            sd = 0.02 * model + 2e-4
            seen = model + sd * np.asarray(jax.random.normal(keys[1], model.shape))
            eye = with_values(blank, jnp.asarray(seen), jnp.asarray(sd))
            fits = {
                name: optimum(p.with_observations(eye), keys[2]) for name, p in problems.items()
            }
            for reader, other in (tuple(problems), tuple(problems)[::-1]):
                mine, spread = fits[reader], noise_left(fits[reader], fits[reader])
                found = compared(
                    problems[reader],
                    mine,
                    problems[other],
                    fits[other],
                    intervals_of(problems[reader], mine, spread),
                )
                rows.append(_row(maker, reader, truth, found, fits[reader]))
    header = (f"simulated; {n} irides of the priors each, {WAVELENGTHS.size} wavelengths",)
    common.write(out / "wrong_model.csv", header, COLUMNS, rows)
    _summarise(rows, out)


def _row(maker, reader, truth, found, fit):
    load, fraction = (found.moved[k].own for k in ("melanin_load", "abl_fraction"))
    outside = not (
        load.low <= truth["melanin_load"] <= load.high
        and fraction.low <= truth["abl_fraction"] <= fraction.high
    )
    misfit = chi2.sf(fit.chi_square, fit.degrees) < MISFIT
    return [
        maker, reader, truth["melanin_load"], truth["abl_fraction"], *(load), *(fraction),
        fit.chi_square, fit.degrees, found.log_odds, int(outside), int(misfit),
        int(found.preferred),
    ]  # fmt: skip


def _summarise(rows, out: Path) -> None:
    lines = []
    for maker in PROCESSES:
        for reader in PROCESSES:
            mine = [
                dict(zip(COLUMNS, r, strict=True)) for r in rows if (r[0], r[1]) == (maker, reader)
            ]
            ratio = np.array([r["read_load"] / r["load"] for r in mine])
            outside, misfit, prefers = (
                np.array([r[k] for r in mine], bool) for k in ("outside", "misfit", "prefers_other")
            )
            noticed = misfit | prefers
            lines.append([
                maker, reader, len(mine), *np.quantile(ratio, [0.16, 0.5, 0.84]),
                outside.mean(), misfit.mean(), prefers.mean(), noticed.mean(),
                noticed[outside].mean() if outside.any() else np.nan,
            ])  # fmt: skip
    columns = (
        "maker", "reader", "irides", "load_ratio_q16", "load_ratio_median", "load_ratio_q84",
        "outside_95", "misfit", "prefers_other", "noticed", "noticed_of_outside",
    )  # fmt: skip
    header = ("simulated; shares of irides; load_ratio: read over true",)
    common.write(out / "wrong_model_summary.csv", header, columns, lines)


if __name__ == "__main__":
    common.start(main, __doc__)
