"""Figures of spectra, BRDFs and fits. matplotlib is imported when one is asked for."""

from irisjax.plot.clone import differences as differences
from irisjax.plot.clone import luminance_profile as luminance_profile
from irisjax.plot.clone import side_by_side as side_by_side
from irisjax.plot.fits import corner_figure as corner_figure
from irisjax.plot.fits import fit_figure as fit_figure
from irisjax.plot.fits import models_figure as models_figure
from irisjax.plot.measurements import brdf_figure as brdf_figure
from irisjax.plot.measurements import spectra_figure as spectra_figure
from irisjax.plot.pictures import PALETTE as PALETTE
from irisjax.plot.pictures import SUFFIXES as SUFFIXES
from irisjax.plot.pictures import check_suffix as check_suffix
from irisjax.plot.pictures import picture as picture
from irisjax.plot.pictures import swatch as swatch
