"""`Photograph`: pixels in proportion to light, and what the file says of the camera."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float


class Photograph(NamedTuple):
    """A colour photograph, top row first, held upright.

    - `pixels`: linear, on sRGB's primaries; 1 is the brightest that the file can hold.
    - `saturated`: pixels with a channel so close to that limit that it may be cut off.
    - `grey`: whether it has no colours.
    - `focal_px`: focal length in pixels as the file tells it, `None` where it does not.
    - `name`: of the file, for messages. `notes`: what was assumed in reading it, a sentence each.
    """

    pixels: Float[np.ndarray, "rows columns 3"]
    saturated: Bool[np.ndarray, "rows columns"]
    grey: bool = False
    focal_px: float | None = None
    name: str = "photograph"
    notes: tuple[str, ...] = ()

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.saturated.shape
