"""Where closed formulas fail (residuals by wavelength), and whether the posteriors are
calibrated.
"""

import matplotlib.pyplot as plt
import numpy as np

from paper_figs.common import read, save


def residuals():
    """One panel a level: what each formula leaves of an ILIT spectrum."""
    rows = [
        r
        for r in read("analytic_residuals.csv")
        if r["target"] == "ilit-2006" and r["model"] != "ILIT (LB06)"
    ]
    levels = list(dict.fromkeys(r["level"] for r in rows))
    figure, axes = plt.subplots(
        1, len(levels), figsize=(3.4 * len(levels), 3.2), sharey=True, squeeze=False
    )
    for ax, level in zip(axes[0], levels, strict=True):
        for i, model in enumerate(dict.fromkeys(r["model"] for r in rows)):
            mine = [r for r in rows if r["model"] == model and r["level"] == level]
            ax.plot(
                [float(r["wavelength_nm"]) for r in mine],
                [float(r["residual_percent"]) for r in mine],
                color=f"C{i}",
                linestyle=("-", "--", "-.", ":")[i % 4],
                label=model,
            )
        ax.axhspan(-2, 2, color="0.92", lw=0)
        ax.set(xlabel="wavelength (nm)", title=level)
    axes[0, 0].set_ylabel("fit / ILIT − 1 (%)")
    axes[0, -1].legend(fontsize=7)
    figure.suptitle(
        "Closed formulas fitted to simulated spectra, all parameters free (grey: 2 % noise)",
        fontsize=9,
    )
    figure.tight_layout()
    save(figure, "analytic")


def calibration():
    """Ranks of the truths among posterior draws, as the difference from uniform with its 95 %
    band.
    """
    from scipy import stats

    rows = read("calibration_ranks.csv")
    names = list(dict.fromkeys(r["parameter"] for r in rows))
    figure, ax = plt.subplots(figsize=(5.4, 3.6))
    draws = int(rows[0]["draws"])
    grid = np.arange(draws + 1)
    n = len(rows) // len(names)
    for i, name in enumerate(names):
        ranks = np.array([int(r["rank"]) for r in rows if r["parameter"] == name])
        share = np.searchsorted(np.sort(ranks), grid, side="right") / n
        ax.plot(grid, share - (grid + 1) / (draws + 1), color=f"C{i}", label=name, lw=1.2)
    p = (grid + 1) / (draws + 1)
    low, high = (stats.binom.ppf(q, n, p) / n - p for q in (0.025, 0.975))
    ax.fill_between(grid, low, high, color="0.88", lw=0, label="95 %, each rank by itself")
    ax.set(
        xlabel=f"rank of the truth among {draws} posterior draws",
        ylabel="share of eyes up to it − uniform",
        title=f"Calibration on {n} simulated eyes",
    )
    ax.legend(fontsize=7, ncols=4, loc="upper center", bbox_to_anchor=(0.45, -0.18))
    save(figure, "calibration")


if __name__ == "__main__":
    residuals()
    calibration()
