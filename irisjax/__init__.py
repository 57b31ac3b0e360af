"""irisjax: a predictive model of the human iris, from pigments to spectra, colour and BRDF.

`import irisjax as ij`; units are nm, mm, mg/ml, mmol/l and radians throughout.
"""

import importlib
from typing import TYPE_CHECKING

from irisjax.infer.noise import Noise as Noise
from irisjax.infer.observation import Observation as Observation
from irisjax.infer.observation import colour_data as colour_data
from irisjax.infer.observation import spectrum as spectrum
from irisjax.infer.problem import Problem as Problem
from irisjax.infer.problem import problem as problem
from irisjax.io.measured import Measured as Measured
from irisjax.io.measured import read_measured as read_measured
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

if TYPE_CHECKING:
    from irisjax.infer.fit import fit as fit
    from irisjax.infer.identifiability import information as information
    from irisjax.infer.posterior import sample as sample
    from irisjax.infer.summary import summarise as summarise

# Optimistix, emcee and arviz load when they are first used.
_LATER = {"fit": "fit", "information": "identifiability", "sample": "posterior", "summarise": "summary"}


def __getattr__(name: str):
    if name in _LATER:
        return getattr(importlib.import_module(f"irisjax.infer.{_LATER[name]}"), name)
    raise AttributeError(f"module 'irisjax' has no attribute {name!r}")


__version__ = "0.1.0"
