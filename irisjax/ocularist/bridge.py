"""Between paint and tissue: an iris of pigments as a target for paint, and a painted iris as the
maps of one of pigments.
"""

from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial import cKDTree

from irisjax._types import as_float
from irisjax.anatomy.eye import Eye
from irisjax.numerics.checks import Range, check_range
from irisjax.ocularist.coats import Painting
from irisjax.ocularist.plan import SHAPE, Difference, difference, lab, texture_of
from irisjax.render.albedo import Matt
from irisjax.render.bands import colour_bands
from irisjax.render.integrator import AbstractIntegrator
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.separable import Separable
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps

EXPOSURE = Range(0.0, 1000.0, above=True)
EUMELANIN = np.geomspace(0.005, 30.0, 28)
PHEOMELANIN = np.geomspace(0.02, 60.0, 14)
"""Concentrations that are tried, relative to the iris's."""
STROMA = np.geomspace(0.05, 3.0, 18)
"""Thicknesses of the stroma that are tried, relative to the iris's."""
_EXPOSURES = np.geomspace(1.0, 32.0, 31)


class Tissue(NamedTuple):
    """An iris of pigments that looks like a painted one.

    - `exposure`: factor by which its reflectance looks like the paint's. `left`: what remains of
        the colour difference, the maps asked for their albedo once more.
    """

    iris: Iris
    maps: IrisMaps
    exposure: float
    left: Difference
