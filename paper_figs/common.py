"""Reading saved results and saving figures; the figures' only shared code."""

import csv
import io
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

HERE = Path(__file__).parent
RESULTS = HERE.parent / "experiments" / "results"
plt.style.use(HERE / "style.mplstyle")


def read(name: str) -> list[dict[str, str]]:
    """Rows of a results file."""
    with (RESULTS / name).open(encoding="utf-8") as f:
        return list(csv.DictReader(line for line in f if not line.startswith("#")))


def curves(rows, by: str) -> dict[str, dict[str, np.ndarray]]:
    """Columns as arrays, one set for each value of the column `by`, in file order."""
    out: dict[str, dict[str, list[float]]] = {}
    for row in rows:
        columns = out.setdefault(row[by], {k: [] for k in row if k != by})
        for name, column in columns.items():
            try:
                column.append(float(row[name]))
            except ValueError:
                column.append(np.nan)
    return {k: {n: np.array(c) for n, c in v.items()} for k, v in out.items()}


def save(figure, name: str) -> None:
    """Save next to the scripts."""
    figure.savefig(HERE / f"{name}.png")
    plt.close(figure)


def save_picture(figure, name: str) -> None:
    """The same of pictures with noise, whose files are large: coarser, in 64 steps of colour."""
    figure.savefig(data := io.BytesIO(), dpi=130)
    plt.close(figure)
    steps = np.asarray(Image.open(data).convert("RGB")) // 4 * 4
    Image.fromarray(np.where(steps == 252, 255, steps).astype(np.uint8)).save(
        HERE / f"{name}.png", optimize=True
    )


def spectra(
    name: str, by: str, label, ylabel: str, title: str, figure_name: str, log: bool = False
) -> None:
    """Exact curves with their Monte Carlo points and error bars."""
    figure, axes = plt.subplots()
    for i, (key, c) in enumerate(curves(read(name), by).items()):
        axes.plot(c["wavelength_nm"], c["exact"], color=f"C{i}", label=label(key))
        every = slice(None, None, 4)
        axes.errorbar(
            c["wavelength_nm"][every], c["monte_carlo"][every], 2 * c["standard_error"][every],
            fmt="o", ms=3, color=f"C{i}", capsize=2, lw=0.8,
        )  # fmt: skip
    axes.set(xlabel="wavelength (nm)", ylabel=ylabel, title=title)
    if log:
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0)
    axes.legend(title="line: exact; points: Monte Carlo, ±2 s.e.", title_fontsize=7)
    save(figure, figure_name)
