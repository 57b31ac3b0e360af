"""Pictures with holes."""

import numpy as np
import pytest

from irisjax.photo.texture import fill_holes, masked_mean


def _disc(size, radius):
    y, x = np.mgrid[:size, :size] - (size - 1) / 2
    return np.hypot(x, y) < radius


@pytest.mark.parametrize("shape", [(96, 96), (65, 90)])
def test_known_pixels_stay_to_the_bit_and_holes_lie_between_them(shape):
    pixels = np.random.default_rng(0).uniform(0.2, 0.7, (*shape, 3))
    holes = np.zeros(shape, bool)
    holes[20:50, 30:70] = holes[:4] = True
    filled = fill_holes(np.where(holes[..., None], np.nan, pixels), holes)
    np.testing.assert_array_equal(filled[~holes], pixels[~holes])
    assert filled.min() >= 0.2 and filled.max() <= 0.7


def test_a_hole_in_a_ramp_is_bridged():
    ramp = np.broadcast_to(np.linspace(0, 1, 128), (128, 128))
    holes = _disc(128, 12)
    assert (
        np.abs(fill_holes(ramp, holes) - ramp).max() < 0.06
    )  # the ramp rises by 0.19 across the hole


def test_nothing_to_fill_from():
    with pytest.raises(ValueError, match="all 16 pixels are holes"):
        fill_holes(np.ones((4, 4)), np.ones((4, 4), bool))


def test_means_leave_holes_out():
    valid = ~_disc(64, 8)
    values = np.where(valid, 0.3, 1e4)
    np.testing.assert_allclose(masked_mean(values, valid, 5.0)[valid], 0.3, rtol=1e-5)
    with pytest.raises(ValueError, match="no texel is valid"):
        masked_mean(values, np.zeros_like(valid), 5.0)
