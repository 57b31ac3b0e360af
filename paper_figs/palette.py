"""The README's picture: spectra of the three levels in their colours, and colours over load and ABL
fraction.
"""

import numpy as np

from paper_figs.common import curves, plt, read, save


def encode(linear):
    """sRGB transfer function; the picture is brightened first,
    by the one factor its caption names.
    """
    x = np.clip(linear, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


EXPOSURE = 8.0
figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.6), width_ratios=(1.15, 1))
levels = curves(read("fig6_levels.csv"), "level")
for i, (level, c) in enumerate(levels.items()):
    left.plot(c["wavelength_nm"], 100 * c["exact"], color=f"C{i}", label=f"{level} pigmentation")
left.set(
    xlabel="wavelength (nm)",
    ylabel="reflectance (%)",
    ylim=(0, None),
    title="ILIT, exact solver (simulated)",
)
left.legend()
rows = read("palette.csv")
loads = sorted({float(r["melanin_load"]) for r in rows})
fractions = sorted({float(r["abl_fraction"]) for r in rows})
image = np.zeros((len(fractions), len(loads), 3))
for r in rows:
    image[fractions.index(float(r["abl_fraction"])), loads.index(float(r["melanin_load"]))] = [
        float(r[k]) for k in ("r_linear", "g_linear", "b_linear")
    ]
edges = np.geomspace(loads[0], loads[-1], len(loads) + 1)
right.pcolormesh(
    edges, np.linspace(0, 100, len(fractions) + 1), encode(EXPOSURE * image), rasterized=True
)
right.set(xscale="log", xlabel="melanin load (µg/mm²)", ylabel="melanin in the ABL (%)",
          title=f"colour under D65, light × {EXPOSURE:.0f}")  # fmt: skip
right.set_xticks([0.01, 0.02, 0.05, 0.1, 0.2, 0.5], ["0.01", "0.02", "0.05", "0.1", "0.2", "0.5"])
right.minorticks_off()
right.grid(False)
figure.tight_layout()
save(figure, "palette")
