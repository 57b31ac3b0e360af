"""Painted irides after L03 Figs. 3, 4, 5, 8, 9 and 10, with what each panel shows."""

import matplotlib.image
import numpy as np

from irisjax.measure.colour import srgb_encode
from paper_figs.common import RESULTS, plt, read, save, save_picture


def strip(name, titles, title, figure_name, columns):
    """Equal pictures of a strip, so many in a row, in true colours."""
    picture = matplotlib.image.imread(RESULTS / f"{name}.jpg")
    side = picture.shape[0]
    rows = -(-len(titles) // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(1.75 * columns, 1.95 * rows + 0.4), squeeze=False
    )
    for axis in axes.ravel():
        axis.set_axis_off()
    for i, (axis, text) in enumerate(zip(axes.ravel(), titles, strict=False)):
        axis.imshow(picture[:, i * side : (i + 1) * side], interpolation="none")
        axis.set_title(text, fontsize=8)
    figure.suptitle(title, fontsize=9)
    figure.tight_layout()
    save_picture(figure, figure_name)


def mixtures():
    """Equal parts of every pair of paints, by HSL and by Kubelka and Munk."""
    rows = read("painted_mixtures.csv")
    names = list(dict.fromkeys(r["first"] for r in rows))
    figure, axes = plt.subplots(1, 2, figsize=(9.0, 4.4), sharey=True)
    ways = (
        ("hsl", "in HSL, as the paper"),
        ("kubelka-munk", "by Kubelka and Munk (made-up K, S)"),
    )
    for axis, (way, title) in zip(axes, ways, strict=True):
        image = np.zeros((len(names), len(names), 3))
        for r in (r for r in rows if r["mixing"] == way):
            place = names.index(r["first"]), names.index(r["second"])
            image[place] = [float(r[k]) for k in ("r_linear", "g_linear", "b_linear")]
        axis.imshow(np.asarray(srgb_encode(np.clip(image, 0, 1))))
        axis.set_title(title, fontsize=9)
        axis.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=7)
        axis.set_yticks(range(len(names)), names, fontsize=7)
        axis.grid(False)
    figure.suptitle(
        "After L03 Fig. 4: equal parts of two paints; the diagonal is the paint itself", fontsize=9
    )
    figure.tight_layout()
    save(figure, "l03_fig4")


strip(
    "painted_fig3",
    [
        *("base", "stroma: dots", "smeared dots", "radial smears", "collarette: spokes", "dots"),
        *("sphincter", "limbus", "pupil"),
    ],
    "After L03 Fig. 3: opacity maps of components, black is opaque (procedural)",
    "l03_fig3",
    5,
)
mixtures()
strip(
    "painted_fig5",
    ["blue (detail)", "blue (detail)", "blue (dit-dot)", "green (dit-dot)", "brown (smeared)"],
    "After L03 Fig. 5: the first five coats (simulated)",
    "l03_fig5",
    5,
)
strip(
    "painted_fig9",
    [f"{n} coats" if n > 1 else "base" for n in (1, 4, 7, 11, 14, 17, 20, 24, 27, 30)],
    "After L03 Figs. 8 and 9: a green eye of 30 coats as it is painted (simulated)",
    "l03_fig9",
    5,
)
strip(
    "painted_fig10",
    ["brown, 12 coats", "blue, 50 coats", "the same from 40° aside"],
    "After L03 Fig. 10 (simulated)",
    "l03_fig10",
    3,
)
