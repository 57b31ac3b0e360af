"""Eyes of invented colours by ILIT and by radiative transfer, and their colours beside the classes
of photographed irides at which they aim (simulated but for the latter).
"""

from experiments.common import RESULTS
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
figure = plt.figure(figsize=(9.4, 6.2), layout="constrained")
above, below = figure.subfigures(2, 1, height_ratios=(2.6, 3.6))
sheet = plt.imread(RESULTS / "eye_colours.png")
axes = above.subplots()
axes.imshow(sheet)
side = sheet.shape[0] / len(MODELS)
axes.set_xticks([(i + 0.5) * side for i in range(len(COLOURS))], list(COLOURS))
axes.set_yticks(
    [(i + 0.5) * side for i in range(len(MODELS))], [name for _, name in MODELS.values()]
)
axes.tick_params(length=0)
axes.spines[:].set_visible(False)
axes.grid(False)
panels = below.subplots(1, 2)
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
        mark, _ = MODELS[row["integrator"]]
        inside = COLOURS[row["colour"]] if mark == "o" else "none"  # both are seen where they meet
        axes.plot(lab[x], lab[y], mark, color=COLOURS[row["colour"]], mfc=inside, mew=1.5)
    axes.set(xlabel=xl, ylabel=yl)
marks = [
    plt.Line2D([], [], color="k", marker=m, mfc="k" if m == "o" else "none", ls="", label=label)
    for m, label in MODELS.values()
]
marks.append(plt.Line2D([], [], color="k", marker="D", mfc="w", ls="", ms=4, label="class, ±1 SD"))
marks += [plt.Line2D([], [], color=c, lw=3, label=name) for name, c in COLOURS.items()]
below.legend(handles=marks, fontsize=7, loc="outside right center")
figure.suptitle("Procedural eye colours in pictures, by both models (simulated)", fontsize=10)
save(figure, "eye_colours")
