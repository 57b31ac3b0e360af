"""A second photograph of the same eye, laid on the first."""

import numpy as np

from irisjax.photo.boundaries import find_boundaries
from irisjax.photo.cloned import Second
from irisjax.photo.ellipse import Ellipse
from irisjax.photo.part import part_of
from irisjax.photo.photograph import Photograph
from irisjax.photo.register import register

MOST_OFF = 0.015
"""Of the limbus's radius, by which textures of a second photograph may be off: other eyes, which
the registration forces onto the first, are off by 0.02 to 0.03.
"""


def second_of(
    second: Photograph, first: Photograph, limbus: Ellipse, pupil: Ellipse, cut: tuple[slice, slice]
) -> Second:
    """The second photograph on the pixels of a part of the first, `cut` out of what `part_of` cuts
    out for these outlines.

    **Raises:** `ValueError` where it is of another eye.
    """
    told = register(second, first, limbus, find_boundaries(second).limbus)
    off = told.residual / limbus.semi_axes[0]
    if not off < MOST_OFF:
        raise ValueError(
            f"{second.name}: its iris does not come to lie on the one of {first.name}: they are "
            f"off by {100 * off:.1f} % of the limbus's radius, {100 * MOST_OFF:g} % is the most"
        )
    there = Photograph(told.pixels.astype(np.float32), ~told.valid, second.grey)
    part = part_of(there, limbus)
    inner = part.moved(pupil)
    return Second(told, part.pixels[cut], part.clear(inner, part.lids(inner))[cut])
