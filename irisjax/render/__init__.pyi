"""Public names of `irisjax.render`; each loads from its module when it is first used."""

from .compose import Stage as Stage
from .illumination import Illumination as Illumination
from .integrator import AbstractIntegrator as AbstractIntegrator
from .integrator import AbstractResponse as AbstractResponse
from .single_scattering import SingleScattering as SingleScattering
