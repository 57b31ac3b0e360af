"""The iris by ILIT, with all orders of scattering.

ILIT's BRDF is separable: f(μ_i, μ_o, λ) = (1 − F(μ_i)) g(μ_o, λ), so that the sum over lights does
not depend on the response.
"""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from irisjax._types import Scalar
from irisjax.optics.fresnel import fresnel_at, refract
from irisjax.render import angular
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.polynomials import chebyshev_coefficients
from irisjax.render.project import IrisPixels
from irisjax.render.shading import Facing, IrisModel, entering_flux, irradiance_at
from irisjax.render.tabulated import AbstractTabulated
from irisjax.tissue.iris import Iris
from irisjax.transport.ilit.exact import IlitExact
from irisjax.transport.light import Directions
from irisjax.transport.process import AbstractProcess, Ilit
from irisjax.transport.solver import AbstractSolver

_CHECK_COSINES = np.array([0.15, 0.6, 0.95])


class Separable(AbstractTabulated):
    """Integrator: ILIT's separable response, tabulated in pigment and thickness  [LB06].

    Attributes:
        degrees: Degrees of the polynomials in ABL pigment, stroma thickness, eumelanin,
            pheomelanin and exit cosine.
        solver: Solver of the texels, of ILIT.
    """

    pixels_apart: ClassVar[bool] = True
    degrees: tuple[int, int, int, int, int] = eqx.field(static=True, default=(8, 5, 4, 4, 3))
    solver: AbstractSolver = eqx.field(default_factory=lambda: IlitExact(20))

    def __check_init__(self) -> None:
        if not isinstance(self.process, Ilit):
            raise ValueError("the separable integrator needs ILIT: no other process is separable")

    @property
    def process(self) -> AbstractProcess:
        return self.solver.process

    def directions(self, iris: Iris, aqueous_index: Scalar) -> "ExitFunctions":
        indices = angular.surface_indices(iris, aqueous_index)
        return ExitFunctions(indices=indices, degree=self.degrees[4])

    def lit(self, model: IrisModel, lights: Lights, tables: Illumination | None) -> IrisModel:
        return model.with_flux(lights, tables)

    def illuminate(
        self,
        pixels: IrisPixels,
        lights: Lights,
        model: IrisModel,
        tables: Illumination | None,
        facing: Facing | None,
    ) -> angular.LightMoments:
        flux = model.flux
        if flux is None:
            flux = entering_flux(lights, model.eye, model.iris, tables, relief=facing is not None)
        return irradiance_at((pixels, facing), flux, model.eye), None


class ExitFunctions(angular.AbstractAngularFunctions):
    """Polynomials in the exit cosine within the ABL, times the shares that cross its surface on the
    way in and out.

    Attributes:
        degree: Degree of the polynomials.
    """

    degree: int = eqx.field(static=True)
    indices: tuple[Scalar, Scalar]

    def functions(
        self,
        cos_incidence: angular.PerPixel,
        cos_exit: angular.PerPixel,
        across: angular.PerPixel | None,
    ) -> angular.Functions:
        return self.exit_functions(cos_exit) * fresnel_at(cos_incidence, *self.indices)[1]

    def exit_functions(self, cos_exit: angular.PerPixel) -> angular.Functions:
        _, rows, transmitted = self.cross_surface(cos_exit, self.degree)
        return rows * transmitted

    def nodes(self) -> tuple[angular.Nodes, angular.Nodes]:
        exits = refract(self.inside_nodes(self.degree), *self.indices[::-1])
        check_cosines = _CHECK_COSINES[np.minimum(np.arange(exits.size), len(_CHECK_COSINES) - 1)]
        normal_incidence = jnp.ones_like(exits[:1])
        return (normal_incidence, Directions(exits)), (normal_incidence, Directions(check_cosines))

    def coefficients(self, brdf: angular.NodeBrdf) -> angular.Coefficients:
        inside = self.inside_nodes(self.degree)
        entering = fresnel_at(jnp.ones_like(self.indices[0]), *self.indices)[1]
        transmitted = entering * self.transmission(inside)[:, None]
        return chebyshev_coefficients(brdf[:, 0] / transmitted, 1)
