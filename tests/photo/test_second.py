"""A second photograph shows what a highlight hides in the first."""

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import rotate, zoom

from irisjax.io.photographs import read_photograph
from irisjax.photo.clone import CloneSettings, Given, flatten_iris, outline_eye, pose_eye
from irisjax.photo.photograph import Photograph

PHOTOGRAPHS = Path(__file__).parent.parent.parent / "data" / "photographs"

pytestmark = pytest.mark.heavy  # outlines, and refraction that compiles for seconds


@pytest.fixture(scope="module")
def first():
    return read_photograph(PHOTOGRAPHS / "blue.jpg")


def _last(photograph, **given):
    given = Given(**given)
    return flatten_iris(pose_eye(outline_eye(photograph, given), CloneSettings(), given), given)


def _burnt(photograph, centre, radius):
    """With a disc burnt out, and the photograph itself without any highlight in another place."""
    row, column = np.indices(photograph.shape)
    disc = np.hypot(row - centre[1], column - centre[0]) < radius
    pixels = np.where(disc[..., None], np.float32(1), photograph.pixels)
    return photograph._replace(pixels=pixels, saturated=photograph.saturated | disc)


def test_texture_under_a_highlight_is_the_seconds(first):
    alone = _last(first)
    limbus, pupil = alone.boundaries.limbus, alone.boundaries.pupil
    x, y = limbus.centre
    away = 0.68 * limbus.semi_axes[0]
    burnt = _burnt(first, (x - 0.7 * away, y + 0.7 * away), 0.08 * limbus.semi_axes[0])
    # Another camera: turned by four degrees and a tenth smaller, a little darker.
    turned = zoom(
        rotate(first.pixels, 4.0, reshape=False, order=1, mode="nearest"), (0.9, 0.9, 1), order=1
    )
    second = Photograph(0.8 * turned, (turned > 0.99).any(-1), name="second")
    outlines = {"limbus": limbus, "pupil": pupil}
    without, found = _last(burnt, **outlines), _last(burnt, **outlines, second=second)
    hidden = alone.texture.valid & ~without.texture.valid
    assert hidden.sum() > 1000
    assert found.texture.valid[hidden].mean() > 0.95
    told = found.second.registration
    assert told.correlation > 0.9 and told.residual < 0.5
    assert told.scale == pytest.approx(0.9, rel=0.005)
    seen, true = (t.texture.luminance()[hidden] for t in (found, alone))
    assert np.corrcoef(seen, true)[0, 1] > 0.95
    # Pigments are told from the first: its pixels are left as they are.
    np.testing.assert_array_equal(found.part, without.part)


def test_another_eye_is_refused(first):
    other = read_photograph(PHOTOGRAPHS / "brown.jpg")
    with pytest.raises(ValueError, match=r"brown\.jpg: its iris does not come to lie on"):
        _last(first, second=other)
