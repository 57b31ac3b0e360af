"""Freckles by their colour."""

import numpy as np
import pytest
from scipy import ndimage

from irisjax.photo.masks import find_freckles
from irisjax.photo.texture import Unrefracted, texels_of

BLUE = np.array([0.10, 0.14, 0.20])
BROWN = np.array([0.06, 0.035, 0.012])
SIZE = 256


def _iris(spots=(), colour=BLUE, noise=0.02, ring=False):
    """A streaky iris with spots ((x, y, diameter, colour), mm) and at need a brown ring."""
    draw = np.random.default_rng(1)
    radius, angle = texels_of(SIZE)
    streaks = 1 + 0.2 * np.sin(60 * angle + 3 * radius)
    pixels = colour * streaks[..., None]
    if ring:
        share = np.exp(-(((radius - 3.0) / 0.5) ** 2))[..., None]
        pixels = pixels * (1 - share) + 2 * BROWN * share
    for x, y, width, paint in spots:
        at = np.hypot(radius * np.cos(angle) - x, radius * np.sin(angle) - y) < width / 2
        pixels[at] = paint * pixels[at].sum(-1, keepdims=True) / pixels[at].sum(-1).mean()
    pixels = pixels * np.exp(noise * draw.standard_normal(pixels.shape))
    return Unrefracted(pixels, (radius > 2.05) & (radius < 5.45), 2.0, 5.5)


def _at(mask, x, y):
    return mask[int((6 - y) / 12 * SIZE), int((x + 6) / 12 * SIZE)]


@pytest.mark.parametrize("ring", [False, True])
def test_brown_spots_are_found_and_neither_crypts_nor_the_collarette(ring):
    crypt = 0.3 * BLUE
    spots = [(3.5, 1.0, 0.3, BROWN), (-1.0, -3.9, 0.9, BROWN), (-3.6, 1.0, 0.5, crypt)]
    found = find_freckles(_iris(spots, ring=ring))
    assert _at(found, 3.5, 1.0) and _at(found, -1.0, -3.9) and not _at(found, -3.6, 1.0)
    assert ndimage.label(found)[1] == 2


def test_nothing_is_found_where_nothing_is():
    """Nor is what is too large a freckle."""
    for iris in (_iris(), _iris(ring=True), _iris([(3.6, 0.0, 2.2, BROWN)])):
        assert not find_freckles(iris).any()


def test_none_without_colours_and_without_texels():
    spotted = _iris([(3.5, 1.0, 0.4, BROWN)])
    grey = spotted._replace(pixels=np.repeat(spotted.pixels[..., :1], 3, -1))
    assert not find_freckles(grey).any()
    assert not find_freckles(spotted._replace(valid=np.zeros((SIZE, SIZE), bool))).any()
