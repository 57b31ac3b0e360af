"""irisjax: a predictive model of the human iris, from pigments to spectra, colour and BRDF.

`import irisjax as ij`; units are nm, mm, mg/ml, mmol/l and radians throughout.
"""

from irisjax.measure.colour import Colour as Colour
from irisjax.measure.colour import colour as colour
from irisjax.measure.colour import colour_of as colour_of
from irisjax.measure.goniophotometer import Brdf as Brdf
from irisjax.measure.goniophotometer import brdf as brdf
from irisjax.measure.goniophotometer import principal_plane as principal_plane
from irisjax.measure.measurement import Measurement as Measurement
from irisjax.measure.measurement import wavelengths as wavelengths
from irisjax.measure.spectrophotometer import radiance as radiance
from irisjax.measure.spectrophotometer import reflectance as reflectance
from irisjax.tissue.indices import RefractiveIndices as RefractiveIndices
from irisjax.tissue.iris import Iris as Iris
from irisjax.tissue.layers import Layers as Layers
from irisjax.tissue.pigments import extinction as extinction
from irisjax.transport.exact import DIFFUSE as DIFFUSE
from irisjax.transport.exact import Exact as Exact
from irisjax.transport.montecarlo import MonteCarlo as MonteCarlo
from irisjax.transport.process import DEPTH_RESOLVED as DEPTH_RESOLVED
from irisjax.transport.process import ILIT_2006 as ILIT_2006
from irisjax.transport.process import ILIT_CORRECTED as ILIT_CORRECTED
from irisjax.transport.process import Process as Process
from irisjax.transport.solution import RESULTS as RESULTS
from irisjax.transport.solution import Solution as Solution
from irisjax.transport.tabulated import Tabulated as Tabulated

__version__ = "0.1.0"
