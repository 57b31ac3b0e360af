"""Run time against error, from `bench_accuracy_time.csv`."""

import numpy as np

from paper_figs.common import plt, read, save

MARKERS = {"exact": "o", "tabulated": "s", "analog": "x"}
rows = read("bench_accuracy_time.csv")
figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 4.2))


def line(axes, rows, time, **style):
    """One solver's sizes."""
    points = [(float(r["max_rel_error"]), float(r[time])) for r in rows]
    points = [p for p in points if np.isfinite(p).all()]
    if points:
        axes.plot(*zip(*sorted(points), strict=True), lw=1, ms=4, **style)


for i, (solver, marker) in enumerate(MARKERS.items()):
    for precision in ("float64", "float32"):
        mine = [
            r
            for r in rows
            if r["job"] == "ilit-2006" and r["solver"] == solver and r["precision"] == precision
        ]
        if not mine:
            continue
        faint = precision == "float32" and solver in ("exact", "tabulated")
        name = f"{solver}, {precision}" if solver in ("exact", "tabulated") else solver
        line(
            left,
            mine,
            "jitted_us" if solver in ("exact", "tabulated") else "single_us",
            marker=marker,
            color=f"C{i}",
            alpha=0.5 if faint else 1,
            label=name,
        )
        if solver in ("exact", "tabulated"):
            line(
                left,
                mine,
                "batch_us",
                marker=marker,
                color=f"C{i}",
                ls=":",
                alpha=0.5 if faint else 1,
                label=f"{name}, in a batch",
            )
left.set_title("ILIT (ilit-2006), 81 wavelengths", fontsize=10)
jobs = ("depth-resolved", "depth-resolved, index-matched", "one slab, isotropic, index-matched")
keys = sorted({(r["job"], r["solver"]) for r in rows if r["job"] in jobs})
for i, (job, solver) in enumerate(keys):
    mine = [r for r in rows if (r["job"], r["solver"]) == (job, solver)]
    sure = solver in ("exact", "tabulated")
    name = f"{solver}: {job.removeprefix('depth-resolved, ')}" if solver == "exact" else solver
    if solver == "analog":
        name = "analog Monte Carlo"
    style = {"marker": MARKERS.get(solver, "o"), "color": f"C{i}"}
    line(right, mine, "jitted_us" if sure else "single_us", label=name, **style)
    if sure:
        line(right, mine, "batch_us", ls=":", label=f"{name}, in a batch", **style)
right.set_title("radiative transfer, 81 wavelengths", fontsize=10)
for axes in (left, right):
    axes.set(
        xscale="log", yscale="log", xlabel="largest relative error", ylabel="time per spectrum (µs)"
    )
    axes.legend(fontsize=6)
figure.tight_layout()
save(figure, "bench")
