"""Public names of `irisjax.render`; each loads from its module when it is first used."""

from .illumination import Illumination as Illumination
from .integrator import AbstractIntegrator as AbstractIntegrator
from .integrator import AbstractResponse as AbstractResponse
from .picture import draw_bands as draw_bands
from .picture import draw_on_cores as draw_on_cores
from .picture import illuminate as illuminate
from .picture import respond as respond
from .picture import shade as shade
from .picture import texture as texture
from .project import project_visible as project_visible
from .single_scattering import SingleScattering as SingleScattering
from .single_scattering import TabulatedSingleScattering as TabulatedSingleScattering
