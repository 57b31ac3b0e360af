"""The width of the deconvolution, told by comparing renderings."""

from pathlib import Path

import numpy as np
import pytest

from irisjax.io.photographs import read_photograph
from irisjax.photo.clone import CloneSettings, clone_to_pigments, compare_with_photograph

PHOTOGRAPH = Path(__file__).parent.parent.parent / "data" / "photographs" / "blue.jpg"


def cloned(sigma):
    photograph = read_photograph(PHOTOGRAPH)
    small = photograph.pixels[:-1:3, :-1:3], photograph.saturated[:-1:3, :-1:3]
    assert photograph.focal_px is not None
    focal = photograph.focal_px / 3
    photograph = photograph._replace(pixels=small[0], saturated=small[1], focal_px=focal)
    found = clone_to_pigments(photograph, CloneSettings(beta=0.35, sigma=sigma))
    return found.morphology.sigma_mm, float(
        np.sqrt((compare_with_photograph(found).rms ** 2).mean())
    )


@pytest.mark.heavy  # renders a dozen pictures
def test_the_width_with_the_nearest_rendering_is_found():
    """The photograph is of an iris in which no light spreads sideways."""
    width, off = cloned(None)
    assert width < 0.5
    for other in (0.0, 0.5, 1.5):
        assert off < cloned(other)[1]
