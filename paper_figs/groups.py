"""How many of 100 intervals of means and differences of groups contain the truth, by the comparison
(from draws of likelihoods and from least-squares fits), by plain averages of the fits, and by the
textbook's intervals from the true values of the eyes.
"""

import matplotlib.pyplot as plt
import numpy as np

from paper_figs.common import read, save

LINES = {
    "mean": ("C0", "o", "mean, from draws"),
    "difference": ("C0", "D", "difference, from draws"),
    "mean by least squares": ("C2", "o", "mean, from fits"),
    "difference by least squares": ("C2", "D", "difference, from fits"),
    "plain mean": ("C1", "o", "mean, plain average"),
    "plain difference": ("C1", "D", "difference, plain average"),
    "mean from true eyes": ("0.6", "o", "mean, from true eyes"),
    "difference from true eyes": ("0.6", "D", "difference, from true eyes"),
}


def main():
    """A panel a kind of groups."""
    rows = read("groups.csv")
    kinds = list(dict.fromkeys(r["groups"] for r in rows))
    figure, axes = plt.subplots(1, len(kinds), figsize=(8.4, 3.2), sharey=True)
    for ax, kind in zip(axes, kinds, strict=True):
        for i, (quantity, (colour, marker, label)) in enumerate(LINES.items()):
            mine = [r for r in rows if (r["groups"], r["quantity"]) == (kind, quantity)]
            held = [float(r["held_of_100"]) for r in mine]
            x = np.arange(len(mine)) + 0.1 * (i - 3.5)
            ax.plot(x, held, marker, color=colour, ms=4, ls="none", label=label)
        ax.axhline(95, color="0.4", lw=0.8)
        names = [r["parameter"].replace("_", "\n") for r in mine]
        ax.set_xticks(range(len(mine)), names, fontsize=6)
        ax.set(title=f"groups: {kind}", ylim=(0, 102))
    axes[0].set_ylabel("intervals of 95 % that hold, of 100")
    axes[0].legend(fontsize=6, loc="lower left")
    figure.tight_layout()
    save(figure, "groups")


if __name__ == "__main__":
    main()
