"""`Unrefracted`: the iris as it would look without cornea and perspective."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from irisjax.render import environment

HALF_WIDTH = 6.0
"""x and y of the iris plane that a texture covers on either side of the axis, mm."""
LUMINANCE = np.array(environment.LUMINANCE, np.float32)
"""Share of linear sRGB's components in luminance [IEC 61966-2-1]."""


class Unrefracted(NamedTuple):
    """A square texture of the iris plane, x and y from −6 to 6 mm: x right, row 0 at y = +6.

    - `pixels`: linear, on sRGB's primaries. `valid`: texels that show the iris, neither pupil nor
        hidden by lids, lashes and highlights.
    - `pupil_radius`, `iris_radius`: mm.
    """

    pixels: Float[np.ndarray, "size size 3"]
    valid: Bool[np.ndarray, "size size"]
    pupil_radius: float
    iris_radius: float

    @property
    def millimetres_per_texel(self) -> float:
        """Width of a texel, mm."""
        return 2 * HALF_WIDTH / len(self.valid)

    def radius(self) -> Float[np.ndarray, "size size"]:
        """Distance of the texels' middles from the axis, mm."""
        x, y = self._places()
        return np.hypot(x, y)

    def angle(self) -> Float[np.ndarray, "size size"]:
        """Angle of the texels' middles from +x towards +y, radians in (−π, π]."""
        x, y = self._places()
        return np.arctan2(y, x)

    def luminance(self) -> Float[np.ndarray, "size size"]:
        """Linear luminance."""
        return self.pixels.astype(np.float32) @ LUMINANCE

    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        size = len(self.valid)
        along = ((np.arange(size) + 0.5) * (2 * HALF_WIDTH / size) - HALF_WIDTH).astype(np.float32)
        return along[None, :], -along[:, None]
