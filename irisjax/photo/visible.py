"""A mask of the flat iris, painted by hand, as pixels of the photograph."""

import numpy as np
from jaxtyping import Bool

from irisjax.photo.refraction import SIZE
from irisjax.photo.unrefracted import HALF_WIDTH
from irisjax.render.project import View, onto_picture


def pixels_shown(
    view: View, visible: Bool[np.ndarray, "size size"], shape: tuple[int, int]
) -> Bool[np.ndarray, "rows columns"]:
    """Pixels of the part that show what a mask of the flat iris says to be seen."""
    if visible.shape != (SIZE, SIZE):
        raise ValueError(f"the mask of what is visible is {visible.shape}, not {(SIZE, SIZE)}")
    seen = view.iris
    if seen is None:
        return np.zeros(shape, bool)
    x, y = (np.asarray(c) for c in seen.point[:2])
    texel = 2 * HALF_WIDTH / SIZE
    column, row = (np.clip(((c + HALF_WIDTH) / texel).astype(int), 0, SIZE - 1) for c in (x, -y))
    return onto_picture(seen, visible[row, column].astype(np.float32), shape) > 0.5
