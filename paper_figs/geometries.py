"""Geometries of reflectance measurements, drawn: what the model reads as which."""

import matplotlib.pyplot as plt
import numpy as np

from paper_figs.common import save

LIGHT, SEEN, TISSUE = "C1", "C0", "#c9b8a8"


def _ray(ax, start, end, colour):
    arrow = {"arrowstyle": "-|>", "color": colour, "lw": 1.6, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", end, start, arrowprops=arrow)


def _toward(degrees, length=1.0):
    a = np.radians(degrees)
    return length * np.sin(a), length * np.cos(a)


def main():
    """Draw five geometries, the sample below, lamp and detector above."""
    figure, axes = plt.subplots(1, 5, figsize=(9, 2.3))
    titles = (
        "8°/d, d/8\nspecular included",
        "8°/d, d/8\nspecular excluded",
        "45°/0°",
        "camera, diffuse light",
        "contact probe",
    )
    for ax, title in zip(axes, titles, strict=True):
        ax.fill_between([-1.2, 1.2], -0.35, 0, color=TISSUE, lw=0)
        ax.set(xlim=(-1.25, 1.25), ylim=(-0.62, 1.75), aspect="equal")
        ax.set_title(title, fontsize=8)
        ax.axis("off")
    for ax, trap in zip(axes[:2], (False, True), strict=True):
        around = np.radians(np.linspace(-70, 250, 200))
        ax.plot(0.75 * np.cos(around), 0.72 + 0.75 * np.sin(around), color="0.3", lw=2)
        _ray(ax, _toward(8, 1.65), (0, 0), LIGHT)
        for angle in (-60, -35, 35, 60):
            _ray(ax, (0, 0), _toward(angle, 0.6), SEEN)
        if trap:
            ax.plot(*_toward(-8, 1.46), "s", color="k", ms=8)
            ax.text(-0.35, 1.55, "trap", fontsize=7, ha="right")
            _ray(ax, (0, 0), _toward(-8, 1.4), "0.55")
        else:
            _ray(ax, (0, 0), _toward(-8, 1.4), SEEN)
    _ray(axes[2], _toward(-45, 1.5), (0, 0), LIGHT)
    _ray(axes[2], (0, 0), _toward(0, 1.5), SEEN)
    for angle in (-70, -35, 35, 70):
        _ray(axes[3], _toward(angle, 1.1), (0, 0), LIGHT)
    _ray(axes[3], (0, 0), _toward(0, 1.5), SEEN)
    axes[4].fill_between([-0.3, 0.3], 0, 1.5, color="0.85", lw=0)
    _ray(axes[4], (-0.12, 1.45), (-0.12, 0), LIGHT)
    _ray(axes[4], (0.12, 0), (0.12, 1.45), SEEN)
    for side in (-1, 1):
        _ray(axes[4], (0.3 * side, -0.17), (0.95 * side, -0.17), "0.25")
    axes[4].text(0, -0.56, "lost sideways", fontsize=7, ha="center")
    for colour, name in ((LIGHT, "light"), (SEEN, "what the instrument reads")):
        axes[2].plot([], [], color=colour, label=name)
    figure.tight_layout(pad=0.3, rect=(0, 0.08, 1, 1))
    figure.legend(loc="lower center", ncol=2, fontsize=7, frameon=False)
    save(figure, "geometries")


if __name__ == "__main__":
    main()
