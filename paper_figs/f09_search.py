"""After F09 Fig. 19: F09's search for the pigments under its premises, on the way and at the end,
beside the same without them and what `irisjax clone` makes; all simulated.
"""

import json

from matplotlib.image import imread

from paper_figs.common import RESULTS, curves, plt, read, save, save_picture

EYES = "blue", "brown"
STAGES = {
    "start": "simplex, 1 step",
    "middle": "simplex, 12 steps",
    "end": "simplex, end",
    "nothing known": "without the premises",
    "texels": "irisjax clone",
}
CHANNELS = ("r", "C1", "-"), ("g", "C2", "--"), ("b", "C0", ":")
PIGMENTS = ("abl_eumelanin", "ABL", "C0"), ("stroma_eumelanin", "stroma", "C1")
METHODS = (
    ("simplex", "simplex, exposure, light and scattering known", "o--"),
    ("nothing known", "simplex, without these", "x"),
    ("least squares", "least squares, which infers them", "s"),
)
FILE = "clone_search"


def pictures():
    """Pictures on the way, and shares of pixels that differ by at most so much."""
    sheet = imread(RESULTS / f"{FILE}.jpg")
    side = sheet.shape[0] // len(EYES)
    differences = read(f"{FILE}_differences.csv")
    figure, axes = plt.subplots(4, 6, figsize=(10.6, 6.8), layout="constrained")
    for row, eye in enumerate(EYES):
        for column, title in enumerate(("photograph (simulated)", *STAGES.values())):
            shown = axes[2 * row, column]
            place = slice(row * side, (row + 1) * side), slice(column * side, (column + 1) * side)
            shown.imshow(sheet[place])
            shown.set(xticks=[], yticks=[])
            shown.grid(False)
            shown.spines[:].set_visible(False)
            shown.set_title(title, fontsize=8)
        axes[2 * row, 0].set_ylabel(f"{eye} eye", fontsize=8)
        key, below = axes[2 * row + 1, 0], axes[2 * row + 1, 1:]
        key.set_axis_off()
        found = curves([r for r in differences if r["eye"] == eye], "stage")
        for stage, axis in zip(STAGES, below, strict=True):
            c = found[stage]
            for channel, colour, style in CHANNELS:
                label = {"r": "red", "g": "green", "b": "blue"}[channel]
                rms = 100 * c[f"rms_{channel}"][0]
                axis.plot(c["difference"], 100 * c[f"share_{channel}"], style, color=colour,
                          label=f"{label}: {rms:.1f} %")  # fmt: skip
            axis.set(xlim=(0, 60), ylim=(0, 101))
            axis.set_xlabel("difference, of 255 steps", fontsize=7)
            axis.tick_params(labelsize=7)
            axis.legend(fontsize=7, title="RMS", title_fontsize=7, frameon=True, edgecolor="none")
        below[0].set_ylabel("pixels, cumulative (%)", fontsize=7)
    figure.suptitle("After F09 Fig. 19 (simulated; light × 2)", fontsize=9)
    save_picture(figure, "f09_fig19")


def path():
    """Differences in the windows and eumelanin, over the steps of either search."""
    found, truth = read(f"{FILE}.csv"), _truth()
    figure, axes = plt.subplots(2, 2, figsize=(8.6, 5.4), sharex=True, layout="constrained")
    for column, eye in enumerate(EYES):
        off, melanin = axes[:, column]
        of_eye = curves([r for r in found if r["eye"] == eye], "method")
        for method, said, style in METHODS:
            c = of_eye[method]
            off.plot(c["steps"], 100 * c["rms"], style, color="k" if style[0] == "s" else "0.5",
                     ms=5, label=said)  # fmt: skip
            for name, layer, colour in PIGMENTS:
                melanin.plot(c["steps"], c[name], style, color=colour, ms=5, lw=1.2,
                             label=f"{layer}, {method}")  # fmt: skip
        for name, layer, colour in PIGMENTS:
            true = truth[eye]["_".join(reversed(name.split("_")))]
            melanin.axhline(true, color=colour, lw=3, alpha=0.3, label=f"{layer}, truth")
        off.set(yscale="log", ylim=(2, 100))
        off.set_yticks((2, 5, 10, 20, 50, 100), ("2", "5", "10", "20", "50", "100"))
        off.minorticks_off()
        off.set_title(f"{eye} eye", fontsize=9)
        melanin.set(xlabel="steps", xscale="log", yscale="log", ylim=(1e-3, 20))
    axes[0, 0].set_ylabel("difference in the windows, RMS (%)", fontsize=8)
    axes[1, 0].set_ylabel("eumelanin (mg/ml of the layer)", fontsize=8)
    axes[0, 0].legend(fontsize=7)
    axes[1, 1].legend(fontsize=7, loc="lower left", ncols=2)
    figure.suptitle("The search for the pigments (simulated)", fontsize=9)
    save(figure, "f09_search")


def _truth() -> dict[str, dict[str, float]]:
    """Concentrations that the photographs were made with."""
    text = (RESULTS.parents[1] / "data/photographs/truth.json").read_text(encoding="utf-8")
    every = json.loads(text)["photographs"]
    return {p["file"].removesuffix(".jpg"): p["concentrations"] for p in every}


pictures()
path()
