"""The part of a photograph that shows the eye, and which of its pixels show the iris."""

import math
from typing import NamedTuple

import numpy as np
import skimage.measure
from jaxtyping import Bool, Float

from irisjax.photo.edges import by_channel
from irisjax.photo.ellipse import Ellipse
from irisjax.photo.highlights import find_highlights, find_lashes, find_lids
from irisjax.photo.lash_shadows import find_lash_shadows, without_islands
from irisjax.photo.photograph import Photograph

LARGEST = 1100
"""Pixels across the iris that are used; more are averaged."""


class Part(NamedTuple):
    """A square of a photograph about the limbus.

    - `pixels`: linear; one is the mean of `reduction` × `reduction` of the photograph's, and
        `corner` is the column and row of the first of these.
    - `saturated`: pixels that may be cut off. `outside`: those beyond the photograph.
    - `limbus`: the outline on these pixels.
    """

    pixels: Float[np.ndarray, "side side 3"]
    saturated: Bool[np.ndarray, "side side"]
    outside: Bool[np.ndarray, "side side"]
    limbus: Ellipse
    reduction: int
    corner: tuple[int, int]

    def moved(self, outline: Ellipse) -> Ellipse:
        """An outline of the photograph on these pixels."""
        return outline.moved(-self.corner[0], -self.corner[1]).scaled(1 / self.reduction)

    def lids(self, pupil: Ellipse) -> Bool[np.ndarray, "side side"]:
        """Pixels within the limbus that lids cover; `pupil`: an outline on these pixels."""
        return find_lids(self.pixels, self.limbus, pupil)

    def clear(
        self, pupil: Ellipse, lids: Bool[np.ndarray, "side side"]
    ) -> Bool[np.ndarray, "side side"]:
        """Pixels between a pupil, an outline on these pixels, and the limbus that show the iris: no
        highlight, lash or lid."""
        ring = self.limbus.mask(self.outside.shape) & ~pupil.mask(self.outside.shape)
        covered = find_highlights(self.pixels, self.saturated & ring, ring)
        covered |= lids | find_lashes(self.pixels, self.limbus, lids)
        clear = ring & ~covered & ~self.outside
        clear &= ~find_lash_shadows(self.pixels, self.limbus, lids, clear)
        return without_islands(clear)


def part_of(photograph: Photograph, limbus: Ellipse) -> Part:
    """Cut out the part about a limbus, wide enough for every pixel of the camera's picture."""
    reduction = max(1, math.ceil(2 * limbus.semi_axes[0] / LARGEST))
    half = math.ceil(1.3 * limbus.semi_axes[0] / reduction + 4) * reduction
    x, y = tuple(int(np.floor(c)) - half for c in limbus.centre)
    side = 2 * half

    def cut(values, fill):
        rows, columns = (
            slice(max(0, c), min(n, c + side)) for n, c in zip(values.shape, (y, x), strict=False)
        )
        whole = np.full((side, side, *values.shape[2:]), fill, values.dtype)
        there = slice(rows.start - y, rows.stop - y), slice(columns.start - x, columns.stop - x)
        whole[there] = values[rows, columns]
        return whole

    pixels = cut(photograph.pixels, np.float32(0))
    masks = (
        cut(photograph.saturated, True),
        cut(np.zeros_like(photograph.saturated), True),
    )
    if reduction > 1:
        pixels = by_channel(pixels, lambda c: c.reduce(reduction))
        masks = [skimage.measure.block_reduce(m, reduction, np.max) for m in masks]
    made = Part(np.asarray(pixels, np.float32), *masks, limbus, reduction, (x, y))
    return made._replace(limbus=made.moved(limbus))
