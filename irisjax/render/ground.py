"""The subsurface map of an iris that is marched through, and the light at each of its places  [F09
Section 6.1].
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from irisjax.anatomy.eye import Eye
from irisjax.numerics.interpolation import polar_bilinear
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import FRECKLE, IrisMaps


class Local(NamedTuple):
    """The subsurface map  [F09 Section 6.1], each relative to the uniform iris; `None`: one
    everywhere.
    """

    abl_thickness: Any = None
    stroma_thickness: Any = None
    freckles: Any = None
    eumelanin: Any = None
    pheomelanin: Any = None


class Ground(eqx.Module):
    """What all pixels share: the subsurface map, each light's flux vectors on the grid of a
    `Field`, the lights' tint, and the eye."""

    textures: Local
    flux: Float[Array, "lights 3 rows columns"]
    tint: Float[Array, "lights 3"] | None
    eye: Eye

    def at(self, point: Float[Array, "3 pixels"]) -> Local:
        """The map at points of the iris."""
        present = [t for t in self.textures if t is not None]
        if not present:
            return self.textures
        radius = self.eye.relative_radius(jnp.sqrt(point[0] ** 2 + point[1] ** 2))
        found = iter(polar_bilinear(jnp.stack(present), jnp.arctan2(point[1], point[0]), radius))
        return Local(*(None if t is None else next(found) for t in self.textures))


@eqx.filter_jit
def local_textures(maps: IrisMaps | None, iris: Iris) -> Local:
    """The subsurface map of an iris with maps."""
    if maps is None:
        return Local()
    dark = None if maps.freckles is None else 1 + (FRECKLE - 1) * maps.freckles
    abl = None if maps.abl_depth is None else maps.abl_depth / iris.abl_thickness
    return Local(abl, maps.stroma_scale(iris), dark, maps.eumelanin, maps.pheomelanin)
