"""Pictures in bands of rows, so that memory is bounded whatever their size and number of
samples.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from irisjax.render.illumination import Illumination
from irisjax.render.scene import Scene
from irisjax.render.stages import Memory

_MEMORY = (
    1 << 28
)  # bytes for the pixels of a band; the programs and tables round them take three times that
_PIXEL, _CHANNEL = 1200, 24  # bytes for each of a band's, measured


class Band(NamedTuple):
    """Rows of a picture: `pixels` (rows, width, channels), and the `error` of a response that is a
    table.
    """

    pixels: np.ndarray
    error: float | None


def bands(
    scene: Scene,
    tables: Illumination | None = None,
    *,
    samples: int = 1,
    wavelengths=None,
    memory: int = _MEMORY,
    threads: int = 1,
) -> Iterator[Band]:
    """The picture of a scene from the top to the bottom, as `render` and with `wavelengths` as
    `prepare` give it.

    Each pixel is the mean of samples × samples points. `memory`: bytes that a band may need, beyond
    what any picture does. `threads`: that share the pixels.
    """
    tables = scene.tables() if tables is None else tables
    width, height = scene.camera.size
    channels = 3 if wavelengths is None else len(wavelengths)
    most = memory // (_PIXEL + _CHANNEL * channels)
    count = min(-(-(width * height * samples**2) // most), height)
    rows = -(-height // count)
    response, error, kept = None, None, Memory(threads)
    for start in range(0, height, rows):
        # The last band begins earlier, so that all have one shape: another would be compiled for.
        first = min(start, height - rows)
        camera = (
            scene.camera if count == samples == 1 else scene.camera.taking(first, rows, samples)
        )
        stage = kept.prepare(scene.replace(camera=camera), tables, wavelengths=wavelengths)
        if response is None:
            response = stage.response(scene.iris)
            error = None if response.error is None else float(response.error)
        picture = (
            np.asarray(kept.shown(stage, response))
            .reshape(rows, samples, width, samples, -1)
            .mean((1, 3))
        )
        yield Band(picture[start - first :], error)
