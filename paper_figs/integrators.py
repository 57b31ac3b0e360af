"""Both integrators against radiative transfer in the same layers, over stroma thickness and exit
angle (simulated).
"""

import numpy as np

from paper_figs.common import plt, read, save

NAMES = {"460": "C0", "540": "C2", "620": "C1", "luminance": "0.25"}
STYLES = {"depth_resolved": ("-", 1.6), "ilit": (":", 1.4), "single_scattering": ("--", 1.2)}
rows = [r for r in read("integrators.csv") if r["incidence_deg"] == "0"]
angles = sorted({float(r["exit_deg"]) for r in rows})
near = angles[1]  # where both the curves over thickness and the Monte Carlo's last cell are
figure, panels = plt.subplots(2, 3, figsize=(9.4, 6.0), sharey=True, layout="constrained")
for j, level in enumerate(("low", "moderate", "high")):
    for name, colour in NAMES.items():
        mine = [r for r in rows if r["level"] == level and r["wavelength_nm"] == name]
        over = (
            ("stroma_mm", [r for r in mine if abs(float(r["exit_deg"]) - near) < 1e-6]),
            (
                "exit_deg",
                sorted(
                    (r for r in mine if r["stroma_mm"] == "0.2855"),
                    key=lambda r: float(r["exit_deg"]),
                ),
            ),
        )
        for axes, (x, chosen) in zip(panels[:, j], over, strict=True):
            at = np.array([float(r[x]) for r in chosen])
            for model, (style, width) in STYLES.items():
                axes.plot(at, [float(r[model]) for r in chosen], style, lw=width, color=colour)
            seen = [r for r in chosen if r["monte_carlo"]]
            place, mean, error = (
                np.array([float(r[k]) for r in seen]) for k in (x, "monte_carlo", "standard_error")
            )
            axes.errorbar(place, mean, 2 * error, fmt="o", ms=3, lw=0.8, color=colour)
    panels[0, j].set(title=f"{level} pigmentation", xlabel="stroma thickness (mm)", yscale="log")
    panels[0, j].set_ylim(3e-4, 3e-2)  # single scattering at grazing falls as low as 1e-6
    panels[1, j].set(xlabel="exit angle in the chamber (°)")
for axes, where in zip(panels[:, 0], (f"exit {near:.0f}°", "stroma 0.2855 mm"), strict=True):
    axes.set_ylabel(f"BRDF (1/sr), {where}")
lines = [
    plt.Line2D([], [], color=c, lw=2, label=n if n == "luminance" else f"{n} nm")
    for n, c in NAMES.items()
]
labels = {
    "depth_resolved": "radiative transfer",
    "ilit": "ILIT (Separable)",
    "single_scattering": "F09 (SingleScattering)",
}
lines += [
    plt.Line2D([], [], color="k", ls=STYLES[m][0], lw=STYLES[m][1], label=text)
    for m, text in labels.items()
]
lines.append(
    plt.Line2D([], [], color="k", marker="o", ms=3, ls="", label="its Monte Carlo, ±2 s.e.")
)
figure.legend(handles=lines, loc="outside lower center", ncols=4, fontsize=8)
figure.suptitle(
    "The renderer's integrators against radiative transfer, light at 0° (simulated)", fontsize=10
)
save(figure, "integrators")
