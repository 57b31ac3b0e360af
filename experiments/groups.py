"""Whether intervals of `irisjax compare-groups` hold the truth: pairs of simulated studies.

Each study has two groups of 20 eyes: means and spreads of their parameters are drawn, eyes from the
groups, spectra (31 wavelengths, ILIT, noise of 2 % + 2e-4) from the eyes. Every eye is fitted by
least squares as in `irisjax fit --batch`, and both groups are inferred from the fits. In the
coordinates in which the fits' priors are standard normal, groups are either ordinary (means normal
with sd 0.5, spreads half-normal with 0.3) or as far out as the priors of the comparison reach (1
and 1), where the likelihoods of many eyes are far from normal. For means, spreads and differences:
how many of 100 intervals of 95 % contain the truth; the same of plain averages of the fits with
their standard errors. Everything is simulated. Writes groups.csv.
"""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import irisjax as ij
from experiments import common
from irisjax.infer.fit import fit
from irisjax.infer.least_squares import levenberg_marquardt
from irisjax.infer.observation import with_values
from irisjax.infer.populations import population

WAVELENGTHS = np.arange(400.0, 701.0, 10.0)
EYES = 20
NAMES = ("melanin_load", "abl_fraction", "pheomelanin_share", "hemoglobin", "saturation")
KINDS = {"ordinary": (0.5, 0.3), "whole prior": (1.0, 1.0)}


def main(key, quick: bool = False, out: Path = common.RESULTS) -> None:
    """Infer `pairs` pairs of groups of each kind."""
    pairs = 2 if quick else 100
    rows = [row for kind in KINDS for row in study(key, kind, pairs)]
    header = (f"simulated; {pairs} pairs of groups of {EYES} eyes; ILIT, 31 wavelengths",)
    columns = ("groups", "quantity", "parameter", "intervals", "held_of_100", "half_width")
    common.write(out / "groups.csv", header, columns, rows)


def study(key, kind: str, pairs: int) -> list:
    """Return the rows of one kind of groups."""
    blank = ij.spectrum(WAVELENGTHS, np.full(31, 0.05), sd=np.full(31, 0.01), name="eye")
    problem = ij.problem(blank)
    kept = [problem.free.index(n) for n in NAMES]
    random = np.random.default_rng(np.ravel(jax.random.key_data(key)))
    shape = (pairs, 2, len(NAMES))
    sd_of_mean, sd_of_spread = KINDS[kind]
    mean = sd_of_mean * random.standard_normal(shape)
    spread = sd_of_spread * np.abs(random.standard_normal(shape))
    eyes = mean[..., None, :] + spread[..., None, :] * random.standard_normal((pairs, 2, EYES, 5))
    truth = np.zeros((pairs * 2 * EYES, len(problem.free)))
    truth[:, kept] = eyes.reshape(-1, len(NAMES))
    truth[:, problem.free.index("gain")] = random.standard_normal(len(truth))
    noise = random.standard_normal((len(truth), WAVELENGTHS.size))
    parts = [_fits(problem, truth[i : i + 80], noise[i : i + 80]) for i in range(0, len(truth), 80)]
    z, covariance = (np.concatenate(x) for x in zip(*parts, strict=True))
    z = z[:, kept].reshape(eyes.shape)
    covariance = covariance[:, kept][:, :, kept].reshape(*eyes.shape, len(NAMES))
    counts = {q: [] for q in ("mean", "spread", "difference", "plain mean", "plain difference")}
    widths = {q: [] for q in counts}

    def judge(quantity, true, low, high):
        counts[quantity].append((low <= true) & (true <= high))
        widths[quantity].append((high - low) / 2)

    for i in range(pairs):
        found = [
            population(z[i, g], covariance[i, g], key=jax.random.fold_in(key, 2 * i + g))
            for g in (0, 1)
        ]
        for g in (0, 1):
            judge("mean", mean[i, g], *np.percentile(found[g].mean, (2.5, 97.5), axis=0))
            judge("spread", spread[i, g], *np.percentile(found[g].spread, (2.5, 97.5), axis=0))
        apart = mean[i, 1] - mean[i, 0]
        ends = np.percentile(found[1].mean - found[0].mean, (2.5, 97.5), axis=0)
        judge("difference", apart, *ends)
        plain, error = z[i].mean(axis=1), 2.093 * z[i].std(axis=1, ddof=1) / np.sqrt(EYES)
        for g in (0, 1):
            judge("plain mean", mean[i, g], plain[g] - error[g], plain[g] + error[g])
        off, both = plain[1] - plain[0], np.hypot(*error)
        judge("plain difference", apart, off - both, off + both)
    return [
        [kind, quantity, name, len(held), 100 * held[:, k].mean(), np.median(width[:, k])]
        for quantity in counts
        for held, width in [(np.array(counts[quantity]), np.array(widths[quantity]))]
        for k, name in enumerate(NAMES)
    ]


@eqx.filter_jit
def _fitted(problem, truth, noise):
    def one(z, normal):
        model = problem.predict(z)[0]
        sd = 0.02 * model + 2e-4
        eye = with_values(problem.observations[0], model + sd * normal, sd)
        # The options are those of a batch of the command.
        search = levenberg_marquardt(1e-5, 1e-5)
        found = fit(
            problem.with_observations(eye), solver=search, starts=2, rounds=1,
            key=jax.random.key(0, impl="threefry2x32"),
        )  # fmt: skip
        return found.z, found.covariance

    return eqx.filter_vmap(one)(truth, noise)


def _fits(problem, truth, noise):
    return jax.tree.map(np.asarray, _fitted(problem, jnp.asarray(truth), jnp.asarray(noise)))


if __name__ == "__main__":
    common.start(main, __doc__)
