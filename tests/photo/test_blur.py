"""The width of the deconvolution, told by comparing renderings."""

from pathlib import Path

import numpy as np
import pytest

from irisjax.io.photographs import read_photograph
from irisjax.photo.clone import Settings, clone
from irisjax.photo.cloned import needed
from irisjax.photo.picture import compare

PHOTOGRAPH = Path(__file__).parent.parent.parent / "data" / "photographs" / "blue.jpg"


def cloned(sigma):
    photograph = read_photograph(PHOTOGRAPH)
    small = photograph.pixels[:-1:3, :-1:3], photograph.saturated[:-1:3, :-1:3]
    focal = needed(photograph.focal_px) / 3
    photograph = photograph._replace(pixels=small[0], saturated=small[1], focal_px=focal)
    *_, found = clone(photograph, Settings(beta=0.35, sigma=sigma), last="pigments")
    return needed(found.morphology).sigma_mm, float(np.sqrt((compare(found).rms ** 2).mean()))


@pytest.mark.heavy  # renders a dozen pictures
def test_the_width_with_the_nearest_rendering_is_found():
    """The photograph is of an iris in which no light spreads sideways."""
    width, off = cloned(None)
    assert width < 0.5
    for other in (0.0, 0.5, 1.5):
        assert off < cloned(other)[1]
