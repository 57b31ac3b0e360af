"""The integrators by name, for scene files, command line and viewer."""

from irisjax.render.integrator import AbstractIntegrator
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.separable import Separable
from irisjax.render.single_scattering import SingleScattering

Kind = type[Separable] | type[SingleScattering] | type[RadiativeIntegrator]

INTEGRATORS: dict[str, Kind] = {
    "separable": Separable,
    "single-scattering": SingleScattering,
    "radiative-transfer": RadiativeIntegrator,
}
"""`Separable` (ILIT, all orders of scattering), `SingleScattering` (F09) and `RadiativeIntegrator`
(radiative transfer, all orders).
"""


def integrator_name(integrator: AbstractIntegrator) -> str:
    """The name of an integrator's kind."""
    return next(name for name, kind in INTEGRATORS.items() if isinstance(integrator, kind))
