"""Pictures after LB06 Fig. 9 and F09 Figs. 1 and 14 to 18, with what each panel shows."""

import matplotlib.image
import numpy as np

from paper_figs.common import RESULTS, plt, save


def panels(name, titles, title, figure_name, rows=()):
    """A strip, or with `rows` a square, of equal pictures, true colours."""
    picture = matplotlib.image.imread(RESULTS / f"{name}.png")[..., :3]
    lines, columns = max(len(rows), 1), len(titles)
    height, width = picture.shape[0] // lines, picture.shape[1] // columns
    figure, axes = plt.subplots(
        lines, columns, figsize=(2.1 * columns, 2.1 * lines + 0.5), squeeze=False
    )
    for i in range(lines):
        for j in range(columns):
            axis = axes[i, j]
            axis.imshow(
                picture[i * height : (i + 1) * height, j * width : (j + 1) * width],
                interpolation="none",
            )
            axis.set(xticks=[], yticks=[], title=titles[j] if i == 0 else "")
            axis.title.set_fontsize(8)
            axis.spines[:].set_visible(False)
            if rows and j == 0:
                axis.set_ylabel(rows[i], fontsize=8)
    figure.suptitle(title, fontsize=9)
    figure.tight_layout()
    save(figure, figure_name)


panels(
    "render_lb06_fig9",
    [
        f"{level}: eumelanin {eu} mg/ml"
        for level, eu in (("high", 1.008), ("moderate", 0.814), ("low", 0.120))
    ],
    "After LB06 Fig. 9 (simulated; three stops above the exposure of the white, AgX)",
    "lb06_fig9",
    [f"{share} % of the melanin in the ABL" for share in (20, 50, 80)],
)
panels(
    "render_f09_fig14",
    ["refraction at the cornea", "no cornea"],
    "After F09 Fig. 14: camera 60° aside (simulated)",
    "f09_fig14",
)
panels(
    "render_f09_fig16",
    ["brown", "blue"],
    "After F09 Fig. 16: a caustic, light 97° aside from the left (simulated; light × 3)",
    "f09_fig16",
)
panels(
    "render_f09_fig1",
    ["two lamps", "a caustic, light 97° aside"],
    "After F09 Fig. 1: its concentrations (simulated; light × 40)",
    "f09_fig1",
)
panels(
    "render_f09_fig17",
    ["no freckles", "60 freckles"],
    "After F09 Fig. 17: green iris (simulated)",
    "f09_fig17",
)
panels(
    "render_f09_fig18",
    ["no veins", "density 1", "density 2"],
    "After F09 Fig. 18: camera 40° aside (simulated)",
    "f09_fig18",
)

saved = np.load(RESULTS / "render_f09_fig15.npz")
figure, axes = plt.subplots(1, 3, figsize=(9.2, 3.1), layout="constrained")
extent = 2 * [float(saved["line"][0]), float(saved["line"][-1])]
for axis, polar, light in zip(axes, saved["polar"], saved["irradiance"].astype(float), strict=True):
    radius = np.hypot(*np.meshgrid(saved["line"], saved["line"]))
    shown = axis.imshow(
        np.where(radius <= 5.5, light, np.nan),
        origin="lower",
        extent=extent,
        cmap="cividis",
        vmin=0,
    )
    kind = "refraction" if polar < 1.4 else "caustic"
    axis.set(
        xlabel="x (mm)", title=f"{kind}\nlight from the right, {np.degrees(polar):.0f}° off axis"
    )
    axis.title.set_fontsize(8)
    axis.grid(False)
    figure.colorbar(shown, ax=axis, shrink=0.8, label="irradiance (facing sheet: 1)")
axes[0].set(ylabel="y (mm)")
figure.suptitle("After F09 Fig. 15 (simulated)", fontsize=9)
save(figure, "f09_fig15")
