"""The iris by radiative transfer: each texel's BRDF with all orders of scattering, for each light.

The functions of directions (`angular`) are summed over the lights once, whatever the pigments.
"""

import dataclasses

import equinox as eqx
import numpy as np

from irisjax._types import Scalar
from irisjax.numerics.checks import is_known
from irisjax.render.angular import (
    AngularFunctions,
    LightMoments,
    choose_mixtures,
    light_moments,
    sample_pixels,
    surface_indices,
)
from irisjax.render.bands import Bands
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.project import IrisPixels
from irisjax.render.shading import Facing, IrisModel, incident_flux
from irisjax.render.tabulated import AbstractTabulated
from irisjax.tissue.iris import Iris
from irisjax.tissue.layers import Layers
from irisjax.tissue.maps import Scales, texel_layers
from irisjax.tissue.pigments import extinction
from irisjax.transport.defaults import shipped_table
from irisjax.transport.light import Light
from irisjax.transport.process import DEPTH_RESOLVED, AbstractProcess, RadiativeTransfer
from irisjax.transport.radiative.exact import RadiativeExact
from irisjax.transport.radiative.tabulated import RadiativeTabulated
from irisjax.transport.solver import AbstractSolver


class RadiativeIntegrator(AbstractTabulated):
    """Integrator: radiative transfer in the layers of every texel, tabulated in pigment, thickness
    and directions.

    As with `Separable` a relief tilts the surface towards the light, and directions within the
    layers are those of the iris without it.

    Attributes:
        degrees: Degrees of the polynomials in ABL pigment, stroma thickness, eumelanin and
            pheomelanin.
        angular: Degrees of those in each cosine, for the azimuthal orders 0, 1 and 2.
        solver: Solver of the texels; `None` takes the table that comes with the package, or for
            other refractive indices `RadiativeExact`.
    """

    degrees: tuple[int, int, int, int] = eqx.field(static=True, default=(6, 4, 4, 4))
    angular: tuple[int, int, int] = eqx.field(static=True, default=(4, 3, 2))
    solver: AbstractSolver | None = None

    def __check_init__(self) -> None:
        if not isinstance(self.process, RadiativeTransfer):
            raise ValueError("the radiative integrator needs radiative transfer, not ILIT")

    @property
    def process(self) -> AbstractProcess:
        return DEPTH_RESOLVED if self.solver is None else self.solver.process

    def directions(self, iris: Iris, aqueous_index: Scalar) -> AngularFunctions:
        return AngularFunctions(indices=surface_indices(iris, aqueous_index), degrees=self.angular)

    def prepare(
        self, iris: Iris, aqueous_index: Scalar, bands: Bands, ranges: Scales
    ) -> "RadiativeIntegrator":
        """Choose the solver, where none was given: the table that comes with the package if it
        covers the indices and the layers of all texels, else `RadiativeExact`.
        """
        arguments = iris, aqueous_index, bands, ranges
        table = shipped_table(iris.indices(aqueous_index)) if self.solver is None else None
        if table is not None:
            holds = _table_holds(table, *arguments)
            if is_known(holds) and holds:
                return dataclasses.replace(self, solver=table)
        solver = RadiativeExact(16, 8) if self.solver is None else self.solver
        solver = solver.prepare(_densest_layers(*arguments), Light(1.0))
        return dataclasses.replace(self, solver=solver)

    def illuminate(
        self,
        pixels: IrisPixels,
        lights: Lights,
        model: IrisModel,
        tables: Illumination | None,
        facing: Facing | None,
    ) -> LightMoments:
        """Sum the functions of directions over the lights.

        The directions of one scene are described by a few mixtures of these functions, which are
        chosen from a sample of its pixels. Under a JAX transformation all functions are kept.
        """
        angles = self.directions(model.iris, model.eye.aqueous_index)
        flux = incident_flux(lights, model.eye, tables)
        pixels_and_facing, shared = (pixels, facing), (flux, lights.tint_factors, model.eye, angles)
        sampled = light_moments(sample_pixels(pixels_and_facing), *shared, None)
        if not is_known(sampled):
            return light_moments(pixels_and_facing, *shared, None), None
        mixtures, shares = choose_mixtures(sampled, angles)
        return light_moments(pixels_and_facing, *shared, mixtures), shares


def _densest_layers(iris: Iris, aqueous_index, bands: Bands, ranges: Scales) -> Layers:
    """Return the layers of a texel whose scales are all at their largest."""
    largest = Scales(*(None if r is None else r[1] for r in ranges))
    return texel_layers(iris, aqueous_index, extinction(np.asarray(bands.wavelengths)), largest)


@eqx.filter_jit
def _table_holds(
    table: RadiativeTabulated, iris: Iris, aqueous_index, bands: Bands, ranges: Scales
):
    return table.holds(_densest_layers(iris, aqueous_index, bands, ranges))
