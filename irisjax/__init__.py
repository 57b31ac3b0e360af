"""irisjax: a predictive model of the human iris, from pigments to spectra, colour and BRDF.

`import irisjax as ij`; units are nm, mm, mg/ml, mmol/l and radians throughout.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from irisjax.anatomy.eye import Cornea as Cornea
    from irisjax.anatomy.eye import Eye as Eye
    from irisjax.anatomy.eye import Sclera as Sclera
    from irisjax.anatomy.media import Media as Media
    from irisjax.grow.presets import preset as preset
    from irisjax.grow.procedural import procedural as procedural
    from irisjax.grow.vessels import veins as veins
    from irisjax.infer.analysis import Analysis as Analysis
    from irisjax.infer.analysis import analyse as analyse
    from irisjax.infer.analysis import summarise as summarise
    from irisjax.infer.fit import fit as fit
    from irisjax.infer.identifiability import information as information
    from irisjax.infer.model_comparison import compare_models as compare_models
    from irisjax.infer.noise import Noise as Noise
    from irisjax.infer.observation import Observation as Observation
    from irisjax.infer.observation import colour_data as colour_data
    from irisjax.infer.observation import spectrum as spectrum
    from irisjax.infer.posterior import sample as sample
    from irisjax.infer.problem import Problem as Problem
    from irisjax.infer.problem import problem as problem
    from irisjax.io.measured import Measured as Measured
    from irisjax.io.measured import read_measured as read_measured
    from irisjax.io.scenes import read_scene as read_scene
    from irisjax.measure.colorimeter import Colorimeter as Colorimeter
    from irisjax.measure.colorimeter import colour as colour
    from irisjax.measure.colour import Colour as Colour
    from irisjax.measure.colour import colour_of as colour_of
    from irisjax.measure.goniophotometer import Brdf as Brdf
    from irisjax.measure.goniophotometer import Goniophotometer as Goniophotometer
    from irisjax.measure.goniophotometer import brdf as brdf
    from irisjax.measure.goniophotometer import principal_plane as principal_plane
    from irisjax.measure.instrument import AbstractInstrument as AbstractInstrument
    from irisjax.measure.measurement import Measurement as Measurement
    from irisjax.measure.measurement import wavelengths as wavelengths
    from irisjax.measure.observe import observe as observe
    from irisjax.measure.polarimeter import Analyser as Analyser
    from irisjax.measure.polarimeter import Polarimeter as Polarimeter
    from irisjax.measure.polarimeter import PolarisedMeasurement as PolarisedMeasurement
    from irisjax.measure.radiometer import Radiometer as Radiometer
    from irisjax.measure.radiometer import radiance as radiance
    from irisjax.measure.spectrophotometer import Spectrophotometer as Spectrophotometer
    from irisjax.measure.spectrophotometer import reflectance as reflectance
    from irisjax.render.camera import Camera as Camera
    from irisjax.render.compose import prepare as prepare
    from irisjax.render.environment import Environment as Environment
    from irisjax.render.lights import Lights as Lights
    from irisjax.render.radiative import RadiativeIntegrator as RadiativeIntegrator
    from irisjax.render.scene import Scene as Scene
    from irisjax.render.separable import Separable as Separable
    from irisjax.render.stages import Memory as Memory
    from irisjax.tissue.indices import RefractiveIndices as RefractiveIndices
    from irisjax.tissue.iris import Iris as Iris
    from irisjax.tissue.layers import Layers as Layers
    from irisjax.tissue.maps import IrisMaps as IrisMaps
    from irisjax.tissue.pigments import extinction as extinction
    from irisjax.tissue.scattering import PowerLaw as PowerLaw
    from irisjax.transport.ilit.exact import IlitExact as IlitExact
    from irisjax.transport.ilit.tabulated import IlitTabulated as IlitTabulated
    from irisjax.transport.incidence import DIFFUSE as DIFFUSE
    from irisjax.transport.incidence import HEMISPHERE as HEMISPHERE
    from irisjax.transport.montecarlo import MonteCarlo as MonteCarlo
    from irisjax.transport.montecarlo import photon_mesh as photon_mesh
    from irisjax.transport.process import DEPTH_RESOLVED as DEPTH_RESOLVED
    from irisjax.transport.process import ILIT_2006 as ILIT_2006
    from irisjax.transport.process import ILIT_CORRECTED as ILIT_CORRECTED
    from irisjax.transport.process import POLARISED as POLARISED
    from irisjax.transport.process import Ilit as Ilit
    from irisjax.transport.process import RadiativeTransfer as RadiativeTransfer
    from irisjax.transport.radiative.adding import AddingDoubling as AddingDoubling
    from irisjax.transport.radiative.exact import RadiativeExact as RadiativeExact
    from irisjax.transport.radiative.polarised.montecarlo import (
        PolarisedMonteCarlo as PolarisedMonteCarlo,
    )
    from irisjax.transport.radiative.tabulated import RadiativeTabulated as RadiativeTabulated
    from irisjax.transport.solution import RESULTS as RESULTS
    from irisjax.transport.solution import Polarisation as Polarisation
    from irisjax.transport.solution import Solution as Solution
    from irisjax.transport.solver import AbstractSolver as AbstractSolver

# All loads when it is first used: a spectrum needs neither optimistix nor emcee nor the renderer.
_HOMES = {
    "anatomy.eye": (
        "Cornea",
        "Eye",
        "Sclera",
    ),
    "anatomy.media": ("Media",),
    "grow.presets": ("preset",),
    "grow.procedural": ("procedural",),
    "grow.vessels": ("veins",),
    "infer.analysis": ("Analysis", "analyse", "summarise"),
    "infer.fit": ("fit",),
    "infer.identifiability": ("information",),
    "infer.model_comparison": ("compare_models",),
    "infer.noise": ("Noise",),
    "infer.observation": (
        "Observation",
        "colour_data",
        "spectrum",
    ),
    "infer.posterior": ("sample",),
    "infer.problem": (
        "Problem",
        "problem",
    ),
    "io.measured": (
        "Measured",
        "read_measured",
    ),
    "io.scenes": ("read_scene",),
    "measure.colorimeter": (
        "Colorimeter",
        "colour",
    ),
    "measure.colour": (
        "Colour",
        "colour_of",
    ),
    "measure.goniophotometer": (
        "Brdf",
        "Goniophotometer",
        "brdf",
        "principal_plane",
    ),
    "measure.instrument": ("AbstractInstrument",),
    "measure.measurement": (
        "Measurement",
        "wavelengths",
    ),
    "measure.observe": ("observe",),
    "measure.polarimeter": (
        "Analyser",
        "Polarimeter",
        "PolarisedMeasurement",
    ),
    "measure.radiometer": (
        "Radiometer",
        "radiance",
    ),
    "measure.spectrophotometer": (
        "Spectrophotometer",
        "reflectance",
    ),
    "render.camera": ("Camera",),
    "render.environment": ("Environment",),
    "render.lights": ("Lights",),
    "render.compose": ("prepare",),
    "render.scene": ("Scene",),
    "render.radiative": ("RadiativeIntegrator",),
    "render.separable": ("Separable",),
    "render.stages": ("Memory",),
    "tissue.indices": ("RefractiveIndices",),
    "tissue.iris": ("Iris",),
    "tissue.layers": ("Layers",),
    "tissue.maps": ("IrisMaps",),
    "tissue.pigments": ("extinction",),
    "tissue.scattering": ("PowerLaw",),
    "transport.ilit.exact": ("IlitExact",),
    "transport.ilit.tabulated": ("IlitTabulated",),
    "transport.incidence": (
        "DIFFUSE",
        "HEMISPHERE",
    ),
    "transport.montecarlo": (
        "MonteCarlo",
        "photon_mesh",
    ),
    "transport.process": (
        "DEPTH_RESOLVED",
        "ILIT_2006",
        "ILIT_CORRECTED",
        "POLARISED",
        "Ilit",
        "RadiativeTransfer",
    ),
    "transport.radiative.adding": ("AddingDoubling",),
    "transport.radiative.exact": ("RadiativeExact",),
    "transport.radiative.polarised.montecarlo": ("PolarisedMonteCarlo",),
    "transport.radiative.tabulated": ("RadiativeTabulated",),
    "transport.solution": (
        "RESULTS",
        "Polarisation",
        "Solution",
    ),
    "transport.solver": ("AbstractSolver",),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}
_PARTS = (
    "anatomy",
    "export",
    "grow",
    "infer",
    "io",
    "measure",
    "numerics",
    "optics",
    "plot",
    "render",
    "tissue",
    "transport",
    "view",
)


def __getattr__(name: str):
    if name in _HOME:
        value = getattr(importlib.import_module(f"irisjax.{_HOME[name]}"), name)
    elif name in _PARTS:
        value = importlib.import_module(f"irisjax.{name}")
    else:
        raise AttributeError(f"module 'irisjax' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__():
    return sorted(
        {name for name in globals() if name not in ("TYPE_CHECKING", "importlib")}
        | _HOME.keys()
        | {*_PARTS}
    )


__version__ = "0.1.0"
