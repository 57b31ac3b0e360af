"""After F09 Figs. 8, 9, 11 and 20: thickness of the stroma from photographs beside the truth, the
windows of the pigments, and luminance on an arc; all simulated but the ultrasound's three points.
"""

import numpy as np
from matplotlib.image import imread

from paper_figs.common import RESULTS, curves, plt, read, save, save_picture

EYES = "blue", "brown"
LAYERS = 0.07 + 0.05675
"""IPE and ABL, mm."""
MEASURED = (5.0, 3.5, 2.25), (0.372, 0.457, 0.645), (0.058, 0.080, 0.103)
"""Radii, thickness of irides and its standard deviation, mm  [F09 Fig. 8, ultrasound]."""
FILE = "clone_thickness"
arrays = np.load(RESULTS / f"{FILE}.npz")
scores = {(r["eye"], r["variant"]): r for r in read(f"{FILE}.csv")}


def generic_profile():
    """F09 Fig. 8."""
    figure, axes = plt.subplots(1, 2, figsize=(8.6, 3.4), sharey=True, layout="constrained")
    for axis, (eye, c) in zip(axes, curves(read(f"{FILE}_rings.csv"), "eye").items(), strict=True):
        r = c["radius_mm"]
        for which, colour, style, label in (
            ("true", "C2", "-", "truth of the photograph, mean ± SD round the eye"),
            ("estimate", "C1", "--", "estimated from the photograph, mean ± SD"),
        ):
            mean, spread = c[f"{which}_mm"] + LAYERS, c[f"{which}_sd_mm"]
            axis.fill_between(r, mean - spread, mean + spread, color=colour, alpha=0.18, lw=0)
            axis.plot(r, mean, style, color=colour, label=label)
        axis.plot(r, c["generic_mm"] + LAYERS, "k:", lw=1.4, label="generic profile")
        axis.errorbar(*MEASURED, fmt="o", color="C0", capsize=3, label="ultrasound, mean ± SD")
        axis.set(xlabel="distance from the axis (mm)", xlim=(1.8, 5.6))
        axis.set_title(f"{eye} eye", fontsize=9)
    axes[0].set(ylabel="thickness of the iris (mm)", ylim=(0, 0.85))
    axes[0].legend(fontsize=7, loc="lower left")
    figure.suptitle("After F09 Fig. 8 (photographs simulated)", fontsize=9)
    save(figure, "f09_fig8")


def deconvolution():
    """F09 Fig. 9."""
    names = "none", "0.5 mm", "1.0 mm", "beta 2 mm", "default"
    titles = (
        *("β = 0.35 mm,\nnot deconvolved", "β = 0.35 mm,\nσ = 0.5 mm", "β = 0.35 mm,\nσ = 1.0 mm"),
        *("β = 2 mm,\nnot deconvolved", "irisjax clone:\nevery texel"),
    )
    sheet = imread(RESULTS / f"{FILE}.jpg")
    side = sheet.shape[0] // len(EYES)
    figure, axes = plt.subplots(4, 6, figsize=(9.2, 6.8), layout="constrained")
    for row, eye in enumerate(EYES):
        upper, lower = axes[2 * row : 2 * row + 2]
        for column, name in enumerate(("true", *names)):
            for axis in (upper[column], lower[column]):
                axis.set(xticks=[], yticks=[])
                axis.grid(False)
                axis.spines[:].set_visible(False)
            cut = sheet[row * side : (row + 1) * side, column * side : (column + 1) * side]
            upper[column].imshow(cut)
            shown = lower[column].imshow(
                arrays[f"{eye} {name}"] / 1000, cmap="cividis", vmin=0, vmax=0.6
            )
            if column:
                score = scores[eye, name]
                r, spread = float(score["correlation"]), float(score["spread"])
                lower[column].set_xlabel(f"r = {r:.2f}, spread {spread:.2f}", fontsize=7)
        upper[0].set_ylabel(f"{eye} eye", fontsize=8)
        lower[0].set_ylabel("thickness", fontsize=8)
        lower[0].set_xlabel("truth", fontsize=7)
    for axis, title in zip(axes[0], ("photograph\n(simulated)", *titles), strict=True):
        axis.set_title(title, fontsize=8)
    bar = figure.colorbar(shown, ax=axes[:, 5], shrink=0.4, aspect=30)
    bar.ax.tick_params(labelsize=7)
    bar.set_label("stroma (mm)", fontsize=7)
    figure.suptitle(
        "After F09 Fig. 9: 2.6 mm of a photograph and of its clones (simulated; light × 2)",
        fontsize=9,
    )
    save_picture(figure, "f09_fig9")


def windows():
    """F09 Fig. 11."""
    figure, axes = plt.subplots(2, 3, figsize=(9.4, 6.0), layout="constrained",
                                width_ratios=(1.25, 1, 1.1))  # fmt: skip
    local, borders = read(f"{FILE}_profiles.csv"), read(f"{FILE}_windows.csv")
    for (profile, filtered, off), eye in zip(axes, EYES, strict=True):
        of_eye = curves([r for r in local if r["eye"] == eye], "angle_deg")
        for i, (angle, c) in enumerate(of_eye.items()):
            profile.plot(c["radius_mm"], c["true_mm"], "-", color=f"C{i}", lw=1.0, alpha=0.6)
            profile.plot(
                c["radius_mm"], c["estimate_mm"], "--", color=f"C{i}", label=f"at {angle}°"
            )
        profile.set(xlabel="distance from the axis (mm)", ylabel="stroma (mm)", ylim=(0, 1.0))
        profile.set_title(f"{eye} eye: local thickness", fontsize=8)
        key = "solid: truth; dashed: estimate"
        profile.legend(fontsize=7, ncols=2, title=key, title_fontsize=7, loc="upper right")
        mine = [r for r in borders if r["eye"] == eye and r["present"] == "1"]
        _polar(filtered, arrays[f"{eye} cells"], arrays[f"{eye} rim"])
        for r in mine:
            filtered.plot(*_outline(r), color="w", lw=0.6, alpha=0.8)
        filtered.set_title(
            "laid flat (light × 2), windows;\nlower half: after the filter", fontsize=8
        )
        shares = [100 * (_luminance(r, "photograph") / _luminance(r, "model") - 1) for r in mine]
        colours = plt.get_cmap("PuOr")
        reach = 20
        for r, share in zip(mine, shares, strict=True):
            off.fill(*_outline(r), color=colours(0.5 + share / (2 * reach)), lw=0)
        bar = plt.cm.ScalarMappable(plt.Normalize(-reach, reach), colours)
        figure.colorbar(bar, ax=off, shrink=0.8, label="photograph above model (%)")
        off.set_title("luminance of the windows", fontsize=8)
        for axis in (filtered, off):
            axis.set(aspect="equal", xlim=(-5.6, 5.6), ylim=(-5.6, 5.6), xlabel="x (mm)")
            axis.grid(False)
        filtered.set_ylabel("y (mm)")
    figure.suptitle("After F09 Fig. 11 (simulated)", fontsize=9)
    save_picture(figure, "f09_fig11")


def arcs():
    """F09 Fig. 20."""
    titles = {"none": "(a) not deconvolved", "0.5 mm": "(b) σ = 0.5 mm", "1.0 mm": "(c) σ = 1.0 mm"}
    figure, axes = plt.subplots(2, 3, figsize=(9.4, 4.6), sharex=True, sharey="row",
                                layout="constrained")  # fmt: skip
    rows = read(f"{FILE}_arcs.csv")
    for line, eye in zip(axes, EYES, strict=True):
        found = curves([r for r in rows if r["eye"] == eye], "variant")
        for axis, (name, title) in zip(line, titles.items(), strict=True):
            c = found[name]
            axis.plot(c["angle_deg"], c["photograph"], color="C3", lw=0.9, label="photograph")
            axis.plot(c["angle_deg"], c["rendered"], color="C0", lw=0.9, label="clone")
            axis.set_title(f"{eye} eye, {title}", fontsize=8)
            axis.set(xlim=(0, 360), xticks=(0, 90, 180, 270, 360))
        line[0].set_ylabel("luminance (encoded)", fontsize=8)
    for axis in axes[-1]:
        axis.set_xlabel("angle round the eye (degrees)", fontsize=8)
    axes[0, 0].legend(fontsize=7)
    figure.suptitle("After F09 Fig. 20: luminance 3.5 mm from the axis (simulated)", fontsize=9)
    save(figure, "f09_fig20")


def _polar(axis, colours, rim) -> None:
    """Polar cells (angles, radii, 3), 8 bits, in their place."""
    angles, radii = colours.shape[:2]
    turn = np.linspace(0, 2 * np.pi, angles + 1)[:, None]
    out = np.linspace(*rim, radii + 1)
    colours = np.where(colours.any(-1, keepdims=True), colours, 190)  # nothing is known there
    axis.pcolormesh(out * np.cos(turn), out * np.sin(turn), colours, rasterized=True)


def _outline(row):
    """x and y round a window."""
    angle = np.radians(float(row["angle_deg"]) + np.linspace(0, 22.5, 12))
    inner, outer = float(row["inner_mm"]), float(row["outer_mm"])
    radius = np.r_[np.full(12, inner), np.full(12, outer), inner]
    around = np.r_[angle, angle[::-1], angle[:1]]
    return radius * np.cos(around), radius * np.sin(around)


def _luminance(row, which: str) -> float:
    return sum(
        weight * float(row[f"{which}_{c}"])
        for weight, c in zip((0.2126, 0.7152, 0.0722), "rgb", strict=True)
    )


generic_profile()
deconvolution()
windows()
arcs()
