"""Maps of an iris from its unrefracted photograph: freckles and the stroma's thickness  [F09 4.2].

Its parts are in `freckles`, `filling`, `thickness` and `polar`; `highlights` has what hides the
iris.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from irisjax.photo.directions import along_fibres
from irisjax.photo.filling import fill
from irisjax.photo.freckles import find_freckles
from irisjax.photo.polar import SHAPE, to_polar
from irisjax.photo.thickness import (
    BETA,
    ITERATIONS,
    SIGMA,
    WIDTH,
    contrast,
    deconvolve,
    intensity,
    local_normalisation,
    relative_luminance,
    relative_thickness,
    thickness,
    unshade,
)
from irisjax.photo.unrefracted import Unrefracted
from irisjax.tissue.maps import IrisMaps

BLUR = 0.02
"""Standard deviation of the Gaussian that freckles are smoothed with against noise, mm."""


class Darkness(NamedTuple):
    """Luminance of an iris with a share of a freckle over its own, falling with the share."""

    shares: Float[np.ndarray, " shares"]
    ratios: Float[np.ndarray, " shares"]

    def share(self, seen, around, freckles, texel: float) -> Float[np.ndarray, "size size"]:
        """Of a freckle that makes what is `around` as dark as what is `seen`; that of the darkest
        one where it is darker still.
        """
        ratio = np.where(freckles, seen / np.maximum(around, 1e-6), 1).astype(np.float32)
        ratio = ndimage.gaussian_filter(ratio, BLUR / texel)
        falling = np.minimum.accumulate(self.ratios)
        return np.interp(ratio, falling[::-1], self.shares[::-1]).astype(np.float32)


class Morphology(NamedTuple):
    """What a photograph tells of the iris's shape.

    - `maps`: `stroma_depth`, and `freckles` where there are any; the ABL is as thick everywhere.
    - `freckles`: mask of texels. `filled`: the texture without them, complete between pupil and
        root.
    - `normalised` [F09 Eq. 5], `deconvolved` [Eq. 6] and `thickness` (mm) [Eq. 7] of the texels;
        the latter is complete, the others 0 where the texture is not valid.
    - `clamped`: number of valid texels whose thickness came out below what a stroma has.
    - `sigma_mm`: of the deconvolution.
    """

    maps: IrisMaps
    freckles: Bool[np.ndarray, "size size"]
    filled: Float[np.ndarray, "size size 3"]
    normalised: Float[np.ndarray, "size size"]
    deconvolved: Float[np.ndarray, "size size"]
    thickness: Float[np.ndarray, "size size"]
    clamped: int
    sigma_mm: float


def maps_of(
    texture: Unrefracted,
    freckles: Bool[np.ndarray, "size size"] | None = None,
    *,
    sigma_mm: float = SIGMA,
    beta: float = BETA,
    response: float | None = None,
    slopes: tuple[float, float] = (0.0, 0.0),
    shade: Bool[np.ndarray, "size size"] | None = None,
    darkness: Darkness | None = None,
    width_mm: float = WIDTH,
    iterations: int = ITERATIONS,
    shape: tuple[int, int] = SHAPE,
) -> Morphology:
    """Freckles found and filled, thickness from what is left  [F09 Section 4.2].

    **Arguments:**

    - `freckles`: the user's mask, in place of `find_freckles`.
    - `sigma_mm`, `iterations`: of the deconvolution. `width_mm`: of the neighbourhood of Eq. 5.
    - `beta`: thickness per encoded pixel value, mm  [Eq. 7]. `response`: in its place, the model's
        (`relative_thickness`); the photograph is then taken as linear luminance.
    - `slopes`: of the shading by relief to be taken off, see `unshade`; needs `response`.
    - `darkness`: of freckles, by which a share is told from the photograph's luminance; without it
        freckles are whole ones.
    - `shade`: texels that lamps hardly reach; used with `response`.
    - `shape`: (angles, radii) of the maps.

    **Raises:** `ValueError` for a texture without valid texels, a mask of another size and numbers
    out of range.
    """
    valid, texel = texture.valid, texture.millimetres_per_texel
    if freckles is None:
        freckles = find_freckles(texture)
    elif freckles.shape != valid.shape:
        raise ValueError(f"the freckle mask is {freckles.shape}, the texture {valid.shape}")
    if response is None and slopes != (0, 0):
        raise ValueError("slopes of the shading need a response of luminance to thickness")
    known = valid & ~freckles
    if not known.any():
        raise ValueError("the texture has no texel that shows the iris beside freckles")
    filled = fill(texture.pixels, ~known)
    # Freckles and small holes take part as they are filled; what lies outside does not.
    radius = texture.radius()
    shown = valid | freckles
    luminance = texture._replace(pixels=filled).luminance()
    if response is None:
        relative = relative_luminance(luminance, shown, width_mm, texel)
        normalised = local_normalisation(intensity(relative), shown, width_mm, texel)
    else:
        normalised = contrast(luminance, shown, shade, texel, width_mm)
        normalised = along_fibres(normalised, shown, texture, response)
        normalised = unshade(normalised, shown, slopes, response, texel)
    normalised = np.maximum(normalised, np.float32(-0.99))
    deconvolved = deconvolve(normalised, shown, sigma_mm, texel, iterations)
    smooth = fill(deconvolved, ~shown)
    found, clamped = (
        thickness(radius, smooth, beta)
        if response is None
        else relative_thickness(radius, smooth, response)
    )
    rim = texture.pupil_radius, texture.iris_radius, shape
    spots = freckles.astype(np.float32)
    if darkness is not None:
        spots *= darkness.share(texture.luminance(), luminance, freckles, texel)
    maps = IrisMaps(
        stroma_depth=jnp.asarray(to_polar(found, *rim)),
        freckles=_share(to_polar(spots, *rim)) if freckles.any() else None,
    )
    low = int((clamped & shown).sum())
    return Morphology(maps, freckles, filled, normalised, deconvolved, found, low, sigma_mm)


def _share(values: np.ndarray) -> jax.Array:
    """Rounding of means of 0 and 1 taken off."""
    return jnp.asarray(np.clip(values, 0, 1))
