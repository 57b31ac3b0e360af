"""LB06 Fig. 7: reflectance for three shares of the melanin in the ABL (simulated)."""

from paper_figs.common import spectra

spectra(
    "fig7_abl_fraction.csv",
    "abl_fraction",
    lambda f: f"{100 * float(f):.0f} % in the ABL",
    "reflectance",
    "LB06 Fig. 7: where the melanin lies, moderate level (simulated)",
    "fig7",
)
