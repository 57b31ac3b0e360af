"""Paint and tissue: an iris of pigments as a target for paint, and a painted iris as maps of
pigments.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial import KDTree

from irisjax._types import as_float
from irisjax.anatomy.eye import Eye
from irisjax.measure.colour import lab_of_srgb
from irisjax.ocularist.coats import Painting
from irisjax.ocularist.plan import TEXTURE_SHAPE, Difference, difference, texture_of
from irisjax.render.albedo import Matt
from irisjax.render.bands import colour_bands
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.separable import Separable
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps

EUMELANIN = np.geomspace(0.05, 4.0, 32)
"""Trial concentrations of eumelanin, relative to the iris's."""
PHEOMELANIN = np.geomspace(0.1, 6.0, 16)
"""Trial concentrations of pheomelanin, likewise."""
STROMA = np.geomspace(0.25, 1.5, 12)
"""Trial thicknesses of the stroma, likewise."""

# ΔE*ab that a factor of e from the iris's own pigments and thickness costs. Colours alone leave the
# pigments of neighbouring texels undetermined, and maps are interpolated between texels.
_PULL = 0.3
# Over this range of concentrations the default degrees err by 3 % of the brightest texel, up to
# 2 ΔE*ab for dark ones; these by 0.3 %.
_DEGREES = (8, 7, 6, 6, 3)
_EXPOSURES = np.geomspace(1.0, 64.0, 37)
_TEXELS = 1000  # that choose the exposure


class Tissue(NamedTuple):
    """An iris of pigments that looks like a painted one.

    Attributes:
        iris: Iris that the maps are relative to.
        maps: Maps of the pigments and of the stroma's thickness.
        exposure: Factor on the tissue's reflectance that makes it look like the paint.
        left: The remaining colour difference, of the albedo that the maps themselves give.
    """

    iris: Iris
    maps: IrisMaps
    exposure: float
    left: Difference


def reflectance_of(
    iris: Iris,
    maps: IrisMaps | None,
    eye: Eye,
    integrator: Separable | RadiativeIntegrator | None = None,
) -> Float[Array, "angles radii 3"]:
    """Linear sRGB reflectance of an iris of pigments without its cornea, a target for `match`.

    Tissue reflects a few per cent of the light, paint far more: multiply the result by a factor.
    Without maps the result has equal texels, of shape (2, 2, 3). The default integrator is ILIT's.
    """
    asked = Separable(degrees=_DEGREES) if integrator is None else integrator
    matt = Matt.build(iris, maps, eye, colour_bands(), asked)
    return jnp.maximum(matt.albedo(), 0.0)


def nearest_tissue(
    painting: Painting, eye: Eye, *, shape: tuple[int, int] = TEXTURE_SHAPE
) -> Tissue:
    """Find maps of both melanins and of the stroma's thickness that look most like paint in plan
    view.

    Each texel takes the nearest in L*a*b* of a table over `EUMELANIN`, `PHEOMELANIN` and `STROMA`.
    Some colours of paint (greens, violets, anything light and saturated) are none of tissue; `left`
    of the result is the remaining difference, at the exposure, from 1 to 64, that leaves the least
    on average. The heights of coats are not used.

    Args:
        painting: The painted iris.
        eye: Eye whose iris was painted.
        shape: (angles, radii) of the maps.

    Raises:
        ValueError: as for `texture_of`.
    """
    iris = Iris()
    paint = texture_of(painting, eye, shape)
    wanted = np.asarray(lab_of_srgb(paint), np.float64).reshape(-1, 3)
    scales = np.stack(np.meshgrid(EUMELANIN, PHEOMELANIN, STROMA, indexing="ij"), -1)
    tried = _maps(scales.reshape(len(EUMELANIN), -1, 3), iris)
    colours = reflectance_of(iris, tried, eye).reshape(-1, 3)
    scales = scales.reshape(-1, 3)
    some = wanted[:: max(1, len(wanted) // _TEXELS)]
    costs = [_nearest(some, colours, scales, factor)[0].mean() for factor in _EXPOSURES]
    exposure = float(_EXPOSURES[int(np.argmin(costs))])
    chosen = _nearest(wanted, colours, scales, exposure)[1]
    maps = _maps(scales[chosen].reshape(*shape, 3), iris)
    again = reflectance_of(iris, maps, eye) * as_float(exposure)
    return Tissue(iris, maps, exposure, difference(again, paint.astype(again.dtype)))


def _maps(scales: np.ndarray, iris: Iris) -> IrisMaps:
    eumelanin, pheomelanin, stroma = as_float(np.moveaxis(scales, -1, 0))
    depth = stroma * iris.stroma_thickness
    return IrisMaps(eumelanin=eumelanin, pheomelanin=pheomelanin, stroma_depth=depth)


def _nearest(wanted: np.ndarray, colours, scales: np.ndarray, exposure: float):
    """Distances to the nearest tissue of the table, and its indices."""
    shown = np.asarray(lab_of_srgb(as_float(exposure) * colours), np.float64)
    table = KDTree(np.concatenate([shown, _PULL * np.log(scales)], 1))
    distance, place = table.query(np.concatenate([wanted, np.zeros_like(wanted)], 1))
    return np.asarray(distance), np.asarray(place)
