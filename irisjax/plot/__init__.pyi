"""Public names of `irisjax.plot`; each loads from its module when it is first used."""

from .clone import differences as differences
from .clone import luminance_profile as luminance_profile
from .clone import side_by_side as side_by_side
from .fits import corner_figure as corner_figure
from .fits import fit_figure as fit_figure
from .fits import models_figure as models_figure
from .maps import flags_figure as flags_figure
from .maps import maps_figure as maps_figure
from .measurements import brdf_figure as brdf_figure
from .measurements import spectra_figure as spectra_figure
from .pictures import PALETTE as PALETTE
from .pictures import SUFFIXES as SUFFIXES
from .pictures import check_suffix as check_suffix
from .pictures import picture as picture
from .pictures import swatch as swatch
