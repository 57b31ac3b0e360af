"""Polar maps of square textures."""

import numpy as np
import pytest

from irisjax.photo.texture import Unrefracted, to_polar
from irisjax.tissue.maps import cell_centres


def _texture(size):
    return Unrefracted(np.zeros((size, size, 3)), np.ones((size, size), bool), 2.0, 5.5)


@pytest.mark.parametrize("shape", [(48, 16), (768, 256)])
def test_angles_run_from_right_to_up_and_radii_outwards(shape):
    texture = _texture(256)
    picture = np.cos(texture.angle() - 0.4) + 0.2 * texture.radius()
    polar = to_polar(picture, 2.0, 5.5, shape)
    angle, radius = (np.asarray(x) for x in cell_centres(shape))
    expected = np.cos(angle[:, None] - 0.4) + 0.2 * (2.0 + 3.5 * radius)
    assert np.abs(polar - expected).max() < 0.01


def test_texture_axes():
    texture = _texture(64)
    assert texture.angle()[0, 32] == pytest.approx(np.pi / 2, abs=0.02)  # row 0 is the top
    assert abs(texture.angle()[32, 63]) < 0.02
    assert texture.radius()[32, 63] == pytest.approx(
        6 - texture.millimetres_per_texel / 2, rel=1e-2
    )


def test_coarse_cells_are_means():
    checks = np.indices((256, 256)).sum(0) % 2.0
    polar = to_polar(checks, 2.0, 5.5, (32, 8))
    assert np.abs(polar - 0.5).max() < 0.1


def test_radii_that_are_no_iris():
    with pytest.raises(ValueError, match="pupil_radius = 6 mm"):
        to_polar(np.zeros((8, 8)), 6.0, 5.5)
