"""Figures of spectra, BRDFs and fits. matplotlib is imported when one is asked for."""

from irisjax.plot.brdf import brdf_figure as brdf_figure
from irisjax.plot.clone import differences as differences
from irisjax.plot.clone import luminance_profile as luminance_profile
from irisjax.plot.clone import side_by_side as side_by_side
from irisjax.plot.inference import corner_figure as corner_figure
from irisjax.plot.inference import fit_figure as fit_figure
from irisjax.plot.models import models_figure as models_figure
from irisjax.plot.pictures import SUFFIXES as SUFFIXES
from irisjax.plot.pictures import check_suffix as check_suffix
from irisjax.plot.pictures import picture as picture
from irisjax.plot.pictures import swatch as swatch
from irisjax.plot.spectra import spectra_figure as spectra_figure
from irisjax.plot.style import PALETTE as PALETTE
