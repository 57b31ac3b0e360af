"""Painted irides after L03 Figs. 3 to 10, with what each panel shows."""

import matplotlib.image
import numpy as np

from irisjax.measure.colour import srgb_encode
from irisjax.ocularist.coats import profile_of, prosthesis
from irisjax.ocularist.cones import shell
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


def geometry():
    """Cross-section of the eye, and its outside as a few truncated cones."""
    eye = prosthesis()
    figure, (whole, coarse) = plt.subplots(1, 2, figsize=(9.0, 4.6), sharey=True)
    bodies = shell(eye)
    iris = {"iris": profile_of(eye)}
    for axis, parts in ((whole, bodies | iris), (coarse, shell(eye, 5) | iris)):
        for (name, cones), colour in zip(parts.items(), ("C0", "0.4", "C1"), strict=True):
            z, radius = np.asarray(cones.z), np.asarray(cones.radius)
            for side in (1, -1):
                label = name if side == 1 else None
                axis.plot(z, side * radius, color=colour, label=label)
            if axis is coarse:
                axis.vlines(z, -radius, radius, color=colour, lw=0.6)
        axis.axhline(0, color="0.7", lw=0.6, ls="-.")
        axis.set_aspect("equal")
        axis.set_xlabel("z (mm)")
        axis.grid(False)
    cornea, white, rim = eye.cornea.anterior.radius, eye.sclera.radius, eye.limbus_radius
    front, edge = float(cornea), float(bodies["cornea"].z[-1])
    back = edge + float(np.sqrt(white**2 - rim**2))
    for place, radius, angle, shift, name in (
        (front, cornea, 152, 0.7, f"$r_2$ = {cornea:.1f} mm"),
        (back, white, 58, -1.2, f"$r_1$ = {white:.1f} mm"),
    ):
        way = float(radius) * np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
        whole.plot(place, 0, "k.")
        arrow = {"arrowstyle": "->", "lw": 0.8}
        whole.annotate("", (place + way[0], way[1]), (place, 0), arrowprops=arrow)
        whole.text(place + 0.55 * way[0] + 0.3, 0.55 * way[1] + shift, name, fontsize=8)
    whole.annotate("", (back, -1), (front, -1), arrowprops={"arrowstyle": "<->", "lw": 0.8})
    whole.text(front - 0.6, -2.4, f"$d$ = {back - front:.1f} mm", fontsize=8)
    whole.text(edge + 2.4, float(rim) + 0.4, f"limbus, {rim:.2f} mm\nfrom the axis", fontsize=8)
    whole.set_ylabel("distance from the axis (mm)")
    whole.set_title("the eye's outside from two spheres (Fig. 6)", fontsize=9)
    whole.legend(loc="lower right", fontsize=7)
    ends = shell(eye, 5)["white"]
    for i, (z, radius) in enumerate(zip(np.asarray(ends.z), np.asarray(ends.radius), strict=True)):
        if i < 4:
            side = ("right", "right", "center", "left")[i]
            coarse.text(z, radius + 0.3, f" $q_{i + 1}$, $d_{i + 1}$ ", fontsize=8, ha=side)
    coarse.set_title(
        "as cones between circles at $q_i$ of radii $d_i$, here few (Fig. 7)", fontsize=9
    )
    figure.tight_layout()
    save(figure, "l03_fig6")


geometry()
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
    "painted_fig8",
    ["photograph", "clone", "paint matched to it"],
    "In place of L03 Fig. 8: a simulated photograph, its clone, and a painted copy",
    "l03_fig8",
    3,
)
strip(
    "painted_fig9",
    [f"{n} coats" if n > 1 else "base" for n in (1, 4, 7, 11, 14, 17, 20, 24, 27, 30)],
    "After L03 Fig. 9: a green eye of 30 coats as it is painted (simulated)",
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
