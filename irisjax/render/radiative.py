"""The iris by radiative transfer: each texel's BRDF, all orders of scattering, for every light by
itself.

What depends on directions alone (`angular`) is summed over the lights once.
"""

import dataclasses

import equinox as eqx
import numpy as np

from irisjax._types import Scalar
from irisjax.numerics.checks import is_known
from irisjax.render.angular import (
    AngularFunctions,
    AngularLight,
    light_of,
    mixtures_of,
    some_of,
    surface_indices,
)
from irisjax.render.bands import Bands
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.project import IrisPixels
from irisjax.render.shading import Facing, Front, fluxes_of
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
        """With the solver chosen, where none was: the table that comes with the package if it holds
        the indices and the layers of all texels, else `RadiativeExact`.
        """
        parts = iris, aqueous_index, bands, ranges
        table = shipped_table(iris.indices(aqueous_index)) if self.solver is None else None
        if table is not None:
            held = _holds(table, *parts)
            if is_known(held) and held:
                return dataclasses.replace(self, solver=table)
        solver = RadiativeExact(16, 8) if self.solver is None else self.solver
        solver = solver.prepare(_deepest(*parts), Light(1.0))
        return dataclasses.replace(self, solver=solver)

    def illuminate(
        self,
        pixels: IrisPixels,
        lights: Lights,
        front: Front,
        tables: Illumination | None,
        facing: Facing | None,
    ) -> AngularLight:
        """Sum the lights in the functions of directions. The directions of one scene need a few
        mixtures of these functions, which some of its pixels show; all of them are kept where
        something is traced, for derivatives.
        """
        angles = self.directions(front.iris, front.eye.aqueous_index)
        flux = fluxes_of(lights, front.eye, tables)
        turned, known = (pixels, facing), (flux, lights.factors, front.eye, angles)
        some = light_of(some_of(turned), *known, None)
        if not is_known(some):
            return light_of(turned, *known, None), None
        mixtures, shares = mixtures_of(some, angles)
        return light_of(turned, *known, mixtures), shares


def _deepest(iris: Iris, aqueous_index, bands: Bands, ranges: Scales) -> Layers:
    """Layers of the texel that has most of everything."""
    most = Scales(*(None if r is None else r[1] for r in ranges))
    return texel_layers(iris, aqueous_index, extinction(np.asarray(bands.wavelengths)), most)


@eqx.filter_jit
def _holds(table: RadiativeTabulated, iris: Iris, aqueous_index, bands: Bands, ranges: Scales):
    return table.holds(_deepest(iris, aqueous_index, bands, ranges))
