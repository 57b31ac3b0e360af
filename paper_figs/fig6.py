"""LB06 Fig. 6: reflectance at three pigmentation levels (simulated)."""

from paper_figs.common import spectra

spectra(
    "fig6_levels.csv",
    "level",
    str,
    "reflectance",
    "LB06 Fig. 6: pigmentation levels (simulated)",
    "fig6",
)
