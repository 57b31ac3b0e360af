"""Whether intervals of `irisjax compare-groups` hold the truth: pairs of simulated studies.

Each study has two groups of 20 eyes: means and spreads of their parameters are drawn, eyes from the
groups, spectra (31 wavelengths, ILIT, noise of 2 % + 2e-4) from the eyes. Every eye is fitted by
least squares as in `irisjax fit --batch`, and draws of its likelihood are made as for
`--posteriors`. Both groups are inferred from the draws, and from
the fits. In the coordinates in which the fits' priors are standard normal, groups are either
ordinary (means normal with sd 0.5, spreads half-normal with 0.3) or as far out as the priors of the
comparison reach (1 and 1), where the likelihoods of many eyes are far from normal. For means,
spreads and differences: how many of 100 intervals of 95 % contain the truth; the same of plain
averages of the fits and of the true values of the eyes, by the textbook's intervals (Student's t,
chi-square, Welch's t). From the true values these hold 95 in the long run: their rows say how lucky
this draw of studies was. Everything is simulated. Writes groups.csv.
"""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy import stats

import irisjax as ij
from experiments import common
from irisjax.infer.fit import fit
from irisjax.infer.least_squares import levenberg_marquardt
from irisjax.infer.observation import with_values
from irisjax.infer.populations import KERNELS, WIDTH, likelihood_draws, population, tails

WAVELENGTHS = np.arange(400.0, 701.0, 10.0)
EYES = 20
NAMES = ("melanin_load", "abl_fraction", "pheomelanin_share", "hemoglobin", "saturation")
KINDS = {"ordinary": (0.5, 0.3), "whole prior": (1.0, 1.0)}


def main(key, quick: bool = False, out: Path = common.RESULTS) -> None:
    """Infer `pairs` pairs of groups of each kind."""
    pairs = 1 if quick else 50
    rows = [
        row
        for kind in KINDS
        # Odd numbers alone: pairs are independent, and the committed table is of these.
        for row in table(kind, [judged(key, kind, pair) for pair in range(1, 2 * pairs, 2)])
    ]
    header = (f"simulated; {pairs} pairs of groups of {EYES} eyes; ILIT, 31 wavelengths",)
    columns = ("groups", "quantity", "parameter", "intervals", "held_of_100", "half_width")
    common.write(out / "groups.csv", header, columns, rows)


def table(kind: str, pairs: list) -> list:
    """Return the rows of one kind of groups."""
    every = [one for pair in pairs for one in pair]
    rows = []
    for quantity in dict.fromkeys(q for q, *_ in every):
        held, width = (np.array([one[i] for one in every if one[0] == quantity]) for i in (1, 2))
        for k, name in enumerate(NAMES):
            found = len(held), 100 * held[:, k].mean(), np.median(width[:, k])
            rows.append([kind, quantity, name, *found])
    return rows


def judged(key, kind: str, pair: int) -> list:
    """Return quantity, whether its intervals hold the truth, and half their width, of one pair."""
    blank = ij.spectrum(WAVELENGTHS, np.full(31, 0.05), sd=np.full(31, 0.01), name="eye")
    problem = ij.problem(blank)
    kept = [problem.free.index(n) for n in NAMES]
    words = np.ravel(jax.random.key_data(key))
    random = np.random.default_rng([*words, list(KINDS).index(kind), pair])
    sd_of_mean, sd_of_spread = KINDS[kind]
    mean = sd_of_mean * random.standard_normal((2, len(NAMES)))
    spread = sd_of_spread * np.abs(random.standard_normal(mean.shape))
    eyes = mean[:, None] + spread[:, None] * random.standard_normal((2, EYES, len(NAMES)))
    truth = np.zeros((2 * EYES, len(problem.free)))
    truth[:, kept] = eyes.reshape(-1, len(NAMES))
    truth[:, problem.free.index("gain")] = random.standard_normal(len(truth))
    noise = random.standard_normal((len(truth), WAVELENGTHS.size))
    values, sd, z, covariance = jax.tree.map(np.asarray, _fitted(problem, truth, noise))
    draws = []
    for i in range(len(truth)):
        mine = problem.with_observations(
            with_values(problem.observations[0], jnp.asarray(values[i]), jnp.asarray(sd[i]))
        )
        starts = tails(mine, z[i], NAMES)
        draws.append(likelihood_draws(mine, starts, NAMES, key=jax.random.fold_in(key, i)))
    z = z[:, kept].reshape(eyes.shape)
    covariance = covariance[:, kept][:, :, kept].reshape(*eyes.shape, len(NAMES))
    drawn = np.reshape(draws, (2, EYES, KERNELS, len(NAMES)))
    made = []

    def judge(quantity, true, low, high):
        made.append((quantity, (low <= true) & (true <= high), (high - low) / 2))

    apart = mean[1] - mean[0]
    for tag in ("", " by least squares"):
        found = [
            population(
                z[g], covariance[g], None if tag else drawn[g], 1.0 if tag else WIDTH,
                key=jax.random.fold_in(key, 2 * pair + g),
            )
            for g in (0, 1)
        ]  # fmt: skip
        for g in (0, 1):
            for quantity, true in (("mean", mean[g]), ("spread", spread[g])):
                ends = np.percentile(getattr(found[g], quantity), (2.5, 97.5), axis=0)
                judge(quantity + tag, true, *ends)
        ends = np.percentile(found[1].mean - found[0].mean, (2.5, 97.5), axis=0)
        judge("difference" + tag, apart, *ends)
    for tag, each in (("plain {}", z), ("{} from true eyes", eyes)):
        # Student's t and chi-square; the difference by Welch's degrees of freedom.
        middle, between = each.mean(axis=1), each.std(axis=1, ddof=1)
        variance, degrees = between**2 / EYES, EYES - 1
        wide = stats.t.ppf(0.975, degrees) * np.sqrt(variance)
        low, high = (
            between * np.sqrt(degrees / stats.chi2.ppf(q, degrees)) for q in (0.975, 0.025)
        )
        for g in (0, 1):
            judge(tag.format("mean"), mean[g], middle[g] - wide[g], middle[g] + wide[g])
            judge(tag.format("spread"), spread[g], low[g], high[g])
        welch = degrees * variance.sum(axis=0) ** 2 / (variance**2).sum(axis=0)
        off, both = middle[1] - middle[0], np.sqrt(variance.sum(axis=0))
        both = stats.t.ppf(0.975, welch) * both
        judge(tag.format("difference"), apart, off - both, off + both)
    return made


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
        return eye.values, eye.sd, found.z, found.covariance

    return eqx.filter_vmap(one)(truth, noise)


if __name__ == "__main__":
    common.start(main, __doc__)
