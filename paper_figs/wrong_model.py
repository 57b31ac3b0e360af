"""What melanin load and ABL fraction become when the model that reads is not the one that made the
data, without and with a smooth model error allowed.
"""

import matplotlib.pyplot as plt
import numpy as np

from paper_figs.common import read, save

ALLOWED = {"none": ("C0", "o", "no model error"), "0.02:80": ("C1", "x", "2 % over 80 nm allowed")}
READ = {
    "load": ("melanin load", "true load (µg/mm²)"),
    "fraction": ("ABL fraction", "true fraction"),
}


def main():
    """A column a pair of maker and reader; read over true, with the share of 95 % intervals that
    hold the truth.
    """
    rows = read("wrong_model.csv")
    pairs = list(dict.fromkeys((r["maker"], r["reader"]) for r in rows))
    figure, axes = plt.subplots(2, len(pairs), figsize=(2.9 * len(pairs), 5.4), sharey="row")
    for j, (maker, reader) in enumerate(pairs):
        for i, (name, (_, true)) in enumerate(READ.items()):
            ax = axes[i, j]
            for allowed, (colour, marker, label) in ALLOWED.items():
                mine = [
                    r
                    for r in rows
                    if (r["maker"], r["reader"], r["discrepancy"]) == (maker, reader, allowed)
                ]
                truth, found, low, high = (
                    np.array([float(r[n]) for r in mine])
                    for n in (name, f"read_{name}", f"{name}_low", f"{name}_high")
                )
                held = np.mean((low <= truth) & (truth <= high))
                ax.plot(
                    truth, found / truth, marker, color=colour, ms=3, mew=0.8, ls="none",
                    alpha=0.6, label=f"{label}: {100 * held:.1f} % held",
                )  # fmt: skip
            ax.axhline(1, color="0.4", lw=0.8)
            ax.set(yscale="log", xlabel=true)
            if name == "load":
                ax.set(xscale="log", title=f"made by {maker},\nread by {reader}")
            ax.legend(fontsize=6, loc="upper right")
    for ax, (what, _) in zip(axes[:, 0], READ.values(), strict=True):
        ax.set_ylabel(f"{what}, read over true")
    figure.suptitle(
        f"{len({r['load'] for r in rows})} simulated irides, noise 2 % + 2e-4; held: truths within "
        "their 95 % intervals",
        fontsize=9,
    )
    figure.tight_layout()
    save(figure, "wrong_model")


if __name__ == "__main__":
    main()
