"""The clone's rendering against its photograph, on one scale."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from irisjax.measure.colour import srgb_encode
from irisjax.photo.cloned import Clone, needed
from irisjax.photo.unrefracted import LUMINANCE
from irisjax.photo.window_pixels import iris_alone
from irisjax.render.stages import Memory


class Comparison(NamedTuple):
    """Photograph and rendering of one camera.

    - `photograph`, `rendered`: sRGB-encoded, the photograph with exposure, white balance and
        contrast taken off and then given the fitted exposure, (rows, columns, 3).
    - `clear`: pixels that are compared: those of the iris that nothing hides. `rms`: of their
        differences per channel, of the full range.
    """

    photograph: Float[np.ndarray, "rows columns 3"]
    rendered: Float[np.ndarray, "rows columns 3"]
    clear: Bool[np.ndarray, "rows columns"]
    rms: Float[np.ndarray, "3"]

    def arc(
        self, clone: Clone, radius: float, count: int = 720
    ) -> tuple[
        Float[np.ndarray, " count"], Float[np.ndarray, " count"], Float[np.ndarray, " count"]
    ]:
        """Angles (degrees) round the eye, and encoded luminance of both pictures on an arc of the
        iris at a distance from its axis, mm; what is not clear is NaN.
        """
        texture = needed(clone.texture)
        size = len(texture.valid)
        where = needed(clone.refraction)
        angle = np.arange(count) * (2 * np.pi / count)
        texel, middle = texture.millimetres_per_texel, size / 2 - 0.5
        column = np.rint(middle + radius * np.cos(angle) / texel).astype(int)
        row = np.rint(middle - radius * np.sin(angle) / texel).astype(int)
        there = tuple(
            np.clip(np.rint(v[row, column]).astype(int), 0, n - 1)
            for v, n in zip((where.row, where.column), self.clear.shape, strict=True)
        )
        photograph, rendered = (
            np.where(self.clear[there], picture[there] @ LUMINANCE, np.nan)
            for picture in (self.photograph, self.rendered)
        )
        return np.degrees(angle), photograph, rendered


def compare(clone: Clone, threads: int = 1) -> Comparison:
    """Render a clone with its photograph's camera and compare.

    **Raises:** `ValueError` before the pigments are known.
    """
    scene = clone.scene()
    values = needed(clone.fit).values
    stage = (memory := Memory(threads)).prepare(scene, clone.tables, clone.view)
    exposure = needed(clone.exposure)
    rendered = exposure[1] * np.asarray(memory.shown(stage, stage.response(scene.tissue)))
    # As the model's camera has it: exposure × radiance^contrast.
    radiance = np.maximum(needed(clone.part) / exposure, 0)
    photograph = exposure[1] * radiance ** (1 / values["contrast"])
    both = [np.clip(np.asarray(srgb_encode(p)), 0, 1) for p in (photograph, rendered)]
    clear = needed(clone.clear) & iris_alone(needed(clone.pose))
    off = (both[0] - both[1])[clear]
    return Comparison(both[0], both[1], clear, np.sqrt((off**2).mean(0)))
