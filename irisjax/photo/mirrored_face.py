"""The face's mirror image on the rim of a cornea that is seen from aside."""

import numpy as np
from jaxtyping import Bool, Float

from irisjax.photo.ellipse import Ellipse
from irisjax.photo.filling import masked_mean
from irisjax.photo.unrefracted import LUMINANCE
from irisjax.render.project import MirrorPixels, onto_picture

BEYOND = 90.0
"""Degrees from the eye's axis: lines that lead further back end on the face. Where nose or brow
stand out, lines do so that lead less far.
"""
SHARE = 0.1
"""Of a pixel's light, above which the mirror image hides the iris."""
_AROUND = 1.03, 1.25  # of the limbus: white and skin, as bright as what is mirrored
_SMOOTH = 0.01  # of the limbus's radius: against noise

Mask = Bool[np.ndarray, "rows columns"]


def find_mirrored_face(
    pixels: Float[np.ndarray, "rows columns 3"],
    outside: Mask,
    limbus: Ellipse,
    mirror: MirrorPixels | None,
) -> Mask:
    """Pixels whose light is the mirrored face's by more than `SHARE`.

    There the film of tears mirrors the more the more grazing it is seen, up to a sixth at the rim
    of an eye that is turned 30 degrees. No pixel of an eye that looks into the camera is one.

    Args:
        pixels: Linear.
        outside: Of these, beyond the photograph.
        limbus: On these.
        mirror: What the tear film mirrors at them.
    """
    shape = pixels.shape[:2]
    if mirror is None:
        return np.zeros(shape, bool)
    row, column = np.ogrid[: shape[0], : shape[1]]
    radius = limbus.relative_radius(column, row)
    inside, around = radius < 1, (radius > _AROUND[0]) & (radius < _AROUND[1]) & ~outside
    back = onto_picture(mirror, np.asarray(mirror.mirror[2]), shape)
    reflectance = onto_picture(mirror, np.asarray(mirror.reflectance), shape)
    face = inside & (back > -np.cos(np.radians(BEYOND))) & (reflectance > 0)
    if not (face.any() and around.any()):
        return np.zeros(shape, bool)
    luminance = pixels @ LUMINANCE
    seen = masked_mean(luminance, inside, _SMOOTH * limbus.semi_axes[0])
    return face & (reflectance * np.median(luminance[around]) > SHARE * seen)
