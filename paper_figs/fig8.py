"""LB06 Fig. 8: BRDF at 550 nm in the principal plane, polar, low and high (simulated), beside
radiative transfer.
"""

import numpy as np

from paper_figs.common import plt, read, save

figure, panels = plt.subplots(1, 2, figsize=(8.4, 3.4), subplot_kw={"projection": "polar"})
rows = read("fig8_brdf.csv")
for axes, incidence in zip(panels, ("0", "60"), strict=True):
    for i, level in enumerate(("low", "high")):
        mine = [r for r in rows if r["level"] == level and r["incidence_deg"] == incidence]
        angle = np.radians([float(r["exit_deg"]) for r in mine])
        column = {
            k: np.array([float(r[k]) for r in mine])
            for k in ("exact", "monte_carlo", "standard_error", "depth_resolved")
        }
        axes.plot(angle, column["exact"], color=f"C{i}", label=f"{level}, ILIT exact")
        axes.errorbar(
            angle[::3],
            column["monte_carlo"][::3],
            2 * column["standard_error"][::3],
            fmt="o",
            ms=2.5,
            lw=0.8,
            color=f"C{i}",
            label=f"{level}, ILIT Monte Carlo",
        )
        axes.plot(
            angle,
            column["depth_resolved"],
            "--",
            lw=1,
            color=f"C{i}",
            label=f"{level}, depth-resolved",
        )
    axes.plot([-np.radians(float(incidence))] * 2, [0, axes.get_rmax()], color="0.4", lw=1, ls=":")
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    axes.set_thetalim(-np.pi / 2, np.pi / 2)
    axes.set_thetagrids(range(-90, 91, 30))
    axes.set_title(f"incidence {incidence}° (dotted), BRDF in 1/sr", fontsize=9)
    axes.set_rgrids([0.004, 0.008], angle=80)
    axes.tick_params(labelsize=7)
handles, labels = panels[0].get_legend_handles_labels()
figure.legend(handles, labels, loc="lower center", ncols=3, fontsize=7)
figure.suptitle("LB06 Fig. 8: BRDF at 550 nm (simulated)", fontsize=10)
save(figure, "fig8")
