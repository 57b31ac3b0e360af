"""Maps of an iris from its texture, checked against the package's own pictures."""

import numpy as np
import pytest

from irisjax.photo.texture import Unrefracted
from irisjax.photo.thickness import Darkness, shape_maps

SIZE = 192


def _texture():
    bare = Unrefracted(np.zeros((SIZE, SIZE, 3)), np.ones((SIZE, SIZE), bool), 1.9, 5.5)
    radius, angle = bare.radius(), bare.angle()
    streaks = 1 + 0.3 * np.sin(24 * angle)
    pixels = np.array([0.1, 0.14, 0.2]) * streaks[..., None]
    return bare._replace(pixels=pixels, valid=(radius > 1.9) & (radius < 5.5))


def test_bright_streaks_are_thick_and_the_iris_thins_outwards():
    texture = _texture()
    found = shape_maps(texture, shape=(192, 32))
    depth = np.asarray(found.maps.stroma_depth)
    assert depth.shape == (192, 32)
    angle = (np.arange(192) + 0.5) * 2 * np.pi / 192
    assert np.corrcoef(depth[:, 20], np.sin(24 * angle))[0, 1] > 0.95
    assert depth[:, 2].mean() > depth[:, 16].mean() > depth[:, 30].mean()
    assert found.maps.freckles is None and found.maps.abl_depth is None and found.clamped == 0


def test_freckles_of_the_user_are_filled_and_handed_on():
    texture = _texture()
    spot = np.hypot(texture.radius() * np.cos(texture.angle()) - 3.5, 0) < 0.3
    spot &= np.abs(texture.radius() * np.sin(texture.angle())) < 0.3
    spoilt = texture._replace(pixels=np.where(spot[..., None], 1e-3, texture.pixels))
    found = shape_maps(spoilt, spot, shape=(192, 32))
    clean = shape_maps(texture, np.zeros_like(spot), shape=(192, 32))
    assert np.asarray(found.maps.freckles).max() > 0.9
    difference = np.abs(np.asarray(found.maps.stroma_depth) - clean.maps.stroma_depth)
    assert difference.max() < 0.05 and np.median(difference) < 1e-4


def test_a_freckle_is_as_dark_as_in_the_photograph():
    """Where the model's are darker; the darkest there is where they are not."""
    texture = _texture()
    radius, angle = texture.radius(), texture.angle()
    middle = np.hypot(radius * np.cos(angle) - 3.5, radius * np.sin(angle))
    spot, darkness = middle < 0.5, Darkness(np.array([0, 0.5, 1.0]), np.array([1, 0.5, 0.4]))
    for seen, share in ((0.75, 0.25), (0.45, 0.75), (0.2, 1.0)):
        dark = np.where(spot, seen, 1.0)[..., None] * texture.pixels
        known = {"response": 0.5, "darkness": darkness, "shape": (192, 32)}
        # About a spot as large the surroundings are filled in: the streaks are lost there.
        flat = texture._replace(pixels=np.where(middle[..., None] < 1, [0.1, 0.14, 0.2], dark))
        flat = flat._replace(pixels=np.where(spot[..., None], seen, 1.0) * flat.pixels)
        found = np.asarray(shape_maps(flat, spot, **known).maps.freckles)
        assert found.max() == pytest.approx(share, abs=0.02)
        assert found.min() == 0


def test_hidden_texels_do_not_tell():
    texture = _texture()
    valid = texture.valid & ~(texture.radius() * np.sin(texture.angle()) > 4)
    spoilt = np.where(valid[..., None], texture.pixels, np.nan)
    found = shape_maps(texture._replace(valid=valid, pixels=spoilt))
    again = shape_maps(texture._replace(valid=valid))
    np.testing.assert_array_equal(found.thickness, again.thickness)


def test_what_cannot_be():
    texture = _texture()
    with pytest.raises(ValueError, match="no texel that shows the iris"):
        shape_maps(texture._replace(valid=np.zeros_like(texture.valid)))
    with pytest.raises(ValueError, match="the freckle mask is"):
        shape_maps(texture, np.zeros((2, 2), bool))
    with pytest.raises(ValueError, match="need a response"):
        shape_maps(texture, slopes=(0.1, 0.0))
