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
    from irisjax.io.scenes import read_scene as read_scene
    from irisjax.render.camera import Camera as Camera
    from irisjax.render.environment import Environment as Environment
    from irisjax.render.lights import Lights as Lights
    from irisjax.render.memory import Memory as Memory
    from irisjax.render.scene import Scene as Scene
    from irisjax.render.scene import prepare as prepare
    from irisjax.render.separable import Separable as Separable
    from irisjax.render.vessels import veins as veins
    from irisjax.tissue.anatomy import Cornea as Cornea
    from irisjax.tissue.anatomy import Eye as Eye
    from irisjax.tissue.anatomy import Sclera as Sclera
    from irisjax.tissue.maps import IrisMaps as IrisMaps
    from irisjax.tissue.procedural import preset as preset
    from irisjax.tissue.procedural import procedural as procedural

# What spectra do not need loads when it is first used: optimistix, emcee, arviz, the renderer.
_LATER = {
    "fit": "infer.fit",
    "information": "infer.identifiability",
    "sample": "infer.posterior",
    "summarise": "infer.summary",
    "read_scene": "io.scenes",
    "Camera": "render.camera",
    "Environment": "render.environment",
    "Lights": "render.lights",
    "Memory": "render.memory",
    "Scene": "render.scene",
    "prepare": "render.scene",
    "Separable": "render.separable",
    "veins": "render.vessels",
    "Cornea": "tissue.anatomy",
    "Eye": "tissue.anatomy",
    "Sclera": "tissue.anatomy",
    "IrisMaps": "tissue.maps",
    "preset": "tissue.procedural",
    "procedural": "tissue.procedural",
}


def __getattr__(name: str):
    if name in _LATER:
        return getattr(importlib.import_module(f"irisjax.{_LATER[name]}"), name)
    raise AttributeError(f"module 'irisjax' has no attribute {name!r}")


def __dir__():
    return sorted({name for name in globals() if name not in ("TYPE_CHECKING", "importlib")} | _LATER.keys())


__version__ = "0.1.0"
