"""Eye colours by ILIT and by radiative transfer, beside the classes of photographed irides at which
they aim (simulated but for the latter).
"""

from irisjax.grow.presets import PHOTOGRAPHED_COLOURS
from paper_figs.common import plt, read, save

COLOURS = {
    "blue": "C0",
    "grey": "0.5",
    "green": "C2",
    "hazel": "C1",
    "amber": "#d9a400",
    "brown": "#7a3b00",
    "dark-brown": "k",
}
MODELS = {"separable": ("o", "ILIT"), "radiative-transfer": ("s", "radiative transfer")}
rows = read("eye_colours.csv")
figure, panels = plt.subplots(1, 2, figsize=(9.4, 3.6), layout="constrained")
for axes, (x, y, xl, yl) in zip(panels, ((1, 2, "a*", "b*"), (2, 0, "b*", "L*")), strict=True):
    for colour, (mean, spread) in PHOTOGRAPHED_COLOURS.items():
        axes.errorbar(
            mean[x],
            mean[y],
            spread[y],
            spread[x],
            fmt="D",
            ms=4,
            lw=0.8,
            mfc="w",
            color=COLOURS[colour],
        )
    for row in rows:
        lab = [float(row[k]) for k in ("L", "a", "b")]
        axes.plot(lab[x], lab[y], MODELS[row["integrator"]][0], color=COLOURS[row["colour"]])
    axes.set(xlabel=xl, ylabel=yl)
marks = [
    plt.Line2D([], [], color="k", marker=m, ls="", label=label) for m, label in MODELS.values()
]
marks.append(plt.Line2D([], [], color="k", marker="D", mfc="w", ls="", ms=4, label="class, ±1 SD"))
marks += [plt.Line2D([], [], color=c, lw=3, label=name) for name, c in COLOURS.items()]
figure.legend(handles=marks, fontsize=7, loc="outside right center")
figure.suptitle("Procedural eye colours in pictures, by both models (simulated)", fontsize=10)
save(figure, "eye_colours")
