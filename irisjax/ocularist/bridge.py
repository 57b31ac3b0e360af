"""Between paint and tissue: an iris of pigments as a target for paint, and a painted iris as maps
of pigments, so that either kind of eye goes wherever the other does.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial import KDTree

from irisjax._types import as_float
from irisjax.anatomy.eye import Eye
from irisjax.numerics.checks import Range, check_range
from irisjax.ocularist.coats import Painting
from irisjax.ocularist.plan import SHAPE, Difference, difference, lab, texture_of
from irisjax.render.albedo import Matt
from irisjax.render.bands import colour_bands
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.separable import Separable
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps

EXPOSURE = Range(0.0, 1000.0, meaning="of tissue against paint", above=True)
EUMELANIN = np.geomspace(0.05, 4.0, 32)
"""Concentrations of eumelanin that are tried, relative to the iris's."""
PHEOMELANIN = np.geomspace(0.1, 6.0, 16)
"""The same of pheomelanin."""
STROMA = np.geomspace(0.25, 1.5, 12)
"""Thicknesses of the stroma that are tried, relative to the iris's."""
USUAL = 0.3
"""ΔE*ab that a texel leaves for pigments and a thickness e times nearer to the iris's own: colours
alone do not tell neighbours' pigments apart, and between texels maps are interpolated.
"""
# Over so wide a range of concentrations the usual degrees are off by 3 % of the brightest texel, as
# much as 2 ΔE*ab of dark ones; these by 0.3 %.
_DEGREES = (8, 7, 6, 6, 3)
_EXPOSURES = np.geomspace(1.0, 64.0, 37)
_TEXELS = 1000  # that choose the exposure


class Tissue(NamedTuple):
    """An iris of pigments that looks like a painted one.

    - `exposure`: factor by which its reflectance looks like the paint's. `left`: what remains of
        the colour difference, the albedo of the maps computed anew.
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
    """Linear sRGB reflectance of an iris of pigments without its cornea, as `match` takes targets.

    Tissue sends back a few per cent of the light, paint far more: a factor on the result makes them
    alike. `integrator`: ILIT's by default. Without maps all texels of (2, 2) are alike.
    """
    asked = Separable(degrees=_DEGREES) if integrator is None else integrator
    matt = Matt.of(iris, maps, eye, colour_bands(), asked)
    return jnp.maximum(matt.albedo(), 0.0)


def maps_of(
    painting: Painting,
    eye: Eye,
    iris: Iris | None = None,
    *,
    shape: tuple[int, int] = SHAPE,
    exposure: float | None = None,
    integrator: Separable | RadiativeIntegrator | None = None,
) -> Tissue:
    """Maps of both melanins and of the stroma's thickness that look most like paint in plan view.

    Each texel takes the nearest in L*a*b* of a table over `EUMELANIN`, `PHEOMELANIN` and `STROMA`.
    Paint has colours that tissue has not (greens, violets, anything light and saturated): `left`
    tells how far off they are. The maps hold no heights of coats.

    Args:
        painting: Seen as by `texture_of`.
        eye: Whose iris was painted.
        iris: What the maps are relative to; the default iris.
        shape: (angles, radii) of the maps.
        exposure: Factor on the tissue's reflectance before the two are compared; by default that,
            from 1 to 64, which leaves the least mean difference.
        integrator: What the tissue's colours are computed with, ILIT's by default.

    Raises:
        ValueError: as `texture_of` does, and for an exposure out of range.
    """
    check_range("exposure", exposure, EXPOSURE)
    iris = Iris() if iris is None else iris
    paint = texture_of(painting, eye, shape)
    wanted = np.asarray(lab(paint), np.float64).reshape(-1, 3)
    scales = np.stack(np.meshgrid(EUMELANIN, PHEOMELANIN, STROMA, indexing="ij"), -1)
    tried = _maps(scales.reshape(len(EUMELANIN), -1, 3), iris)
    colours = reflectance_of(iris, tried, eye, integrator).reshape(-1, 3)
    scales = scales.reshape(-1, 3)
    if exposure is None:
        some = wanted[:: max(1, len(wanted) // _TEXELS)]
        costs = [_nearest(some, colours, scales, factor)[0].mean() for factor in _EXPOSURES]
        exposure = float(_EXPOSURES[int(np.argmin(costs))])
    chosen = _nearest(wanted, colours, scales, exposure)[1]
    maps = _maps(scales[chosen].reshape(*shape, 3), iris)
    again = reflectance_of(iris, maps, eye, integrator) * as_float(exposure)
    left = difference(again, paint.astype(again.dtype))
    return Tissue(iris, maps, float(exposure), left)


def _maps(scales: np.ndarray, iris: Iris) -> IrisMaps:
    return IrisMaps(
        eumelanin=as_float(scales[..., 0]),
        pheomelanin=as_float(scales[..., 1]),
        stroma_depth=as_float(scales[..., 2]) * iris.stroma_thickness,
    )


def _nearest(wanted: np.ndarray, colours, scales: np.ndarray, exposure: float):
    """Distances and places in the table of the tissue nearest to each colour."""
    shown = np.asarray(lab(as_float(exposure) * colours), np.float64)
    table = KDTree(np.concatenate([shown, USUAL * np.log(scales)], 1))
    distance, place = table.query(np.concatenate([wanted, np.zeros_like(wanted)], 1))
    return np.asarray(distance), np.asarray(place)
