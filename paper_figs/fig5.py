"""LB06 Fig. 5, the modelled part: radiance of three irides under D65 (simulated; no measured curve
is drawn).
"""

from paper_figs.common import spectra

spectra(
    "fig5_radiance.csv",
    "level",
    str,
    "radiance, relative (1/sr)",
    "LB06 Fig. 5, model only (simulated)",
    "fig5",
)
