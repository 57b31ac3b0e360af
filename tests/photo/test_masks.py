"""Masks of highlights, lashes, lids and shadows of lashes, which hide the iris, and of freckles."""

import functools

import numpy as np
import pytest
from scipy import ndimage

from irisjax.photo.masks import (
    find_freckles,
    find_highlights,
    find_lash_shadows,
    find_lashes,
    find_lids,
    find_reflections,
    remove_islands,
)
from irisjax.photo.photograph import Ellipse
from irisjax.photo.texture import Unrefracted, texels_of

SHAPE = (360, 480)
LIMBUS, PUPIL = Ellipse((240, 180), (110, 108)), Ellipse((240, 180), (40, 39))
RING = LIMBUS.mask(SHAPE) & ~PUPIL.mask(SHAPE)
ROW, COLUMN = np.indices(SHAPE)
NONE = np.zeros(SHAPE, bool)
SKIN, SKY = np.array([0.5, 0.3, 0.2]), np.array([0.05, 0.07, 0.12])


def _eye(grey=False):
    return _painted(grey).copy()


@pytest.fixture(params=[False, True], ids=["colour", "grey"])
def grey(request):
    """Photographs with and without colours."""
    return request.param


@functools.cache
def _painted(grey):
    """White, a streaky iris with a dark rim, a pupil; skin far above and below."""
    draw = np.random.default_rng(2)
    pixels = np.broadcast_to([0.6, 0.57, 0.52], (*SHAPE, 3)).copy()
    angle = np.arctan2(180 - ROW, COLUMN - 240)
    radius = LIMBUS.relative_radius(COLUMN, ROW)
    iris = np.array([0.10, 0.14, 0.20]) * (1 + 0.3 * np.sin(50 * angle + 5 * radius))[..., None]
    iris = iris * np.clip((1.1 - radius) / 0.25, 0.35, 1)[..., None]
    pixels[radius < 1] = iris[radius < 1]
    pixels[PUPIL.mask(SHAPE)] = 0.004
    pixels[np.abs(ROW - 180) > 165] = SKIN
    pixels = pixels * np.exp(0.03 * draw.standard_normal(pixels.shape))
    return np.repeat(pixels.mean(-1, keepdims=True), 3, -1) if grey else pixels


def test_highlights_are_marked_with_their_glow_and_little_else(grey):
    pixels = _eye(grey)
    away = np.hypot(COLUMN - 310, ROW - 150)
    pixels = np.minimum(pixels + 4 * np.exp(-((away / 6) ** 2))[..., None], 1)
    dim = np.hypot(COLUMN - 180, ROW - 230) < 4
    pixels[dim] += 0.5
    found = find_highlights(pixels, (pixels >= 0.99).any(-1), RING)
    assert found[away < 8].all() and found[dim].mean() > 0.8
    assert not found[RING & (away > 25) & (np.hypot(COLUMN - 180, ROW - 230) > 14)].any()
    assert not found[~RING].any()


def test_a_window_that_is_not_burnt_out_is_found(grey):
    """A wide reflection through which the iris shows; a ring of another colour is none."""
    pixels = _eye(grey)
    radius = LIMBUS.relative_radius(COLUMN, ROW)
    pixels[(radius < 0.55) & RING] *= 1.0 if grey else np.array([2.0, 1.4, 0.5])
    window = (np.abs(COLUMN - 310) < 22) & (np.abs(ROW - 200) < 25) & RING
    pixels[window] += np.full(3, 0.35) if grey else np.array([0.25, 0.32, 0.42])
    found = find_reflections(pixels, LIMBUS, PUPIL, RING)
    assert found[window].mean() > 0.9
    away = ndimage.distance_transform_edt(~window)
    assert not found[away > 8].any()


def test_a_faint_sky_over_the_pupil_is_followed_over_the_iris():
    """A brown iris hardly shows it; the black pupil does."""
    pixels = _eye()
    pixels[RING] *= [1.6, 0.8, 0.3]
    sky = (np.abs(COLUMN - 240) < 80) & (np.abs(ROW - 165) < 18)
    alone = pixels.copy()
    alone[sky & RING] += SKY
    assert not find_reflections(alone, LIMBUS, PUPIL, RING).any()
    pixels[sky] += SKY
    found = find_reflections(pixels, LIMBUS, PUPIL, RING)
    assert found[sky & RING].mean() > 0.9
    assert not found[ndimage.distance_transform_edt(~sky) > 10].any()


def _lashes():
    """Curved streaks from above that end in the iris."""
    drawn, down = np.zeros(SHAPE, bool), np.linspace(0, 1, 400)
    row = np.round(45 + 70 * down).astype(int)
    for start, end in ((190, 215), (240, 232), (300, 270)):
        column = np.round(start + (end - start) * down**2).astype(int)
        drawn[row, column] = drawn[row, column + 1] = True
    return drawn


def test_lashes_that_cross_the_limbus_are_found(grey):
    pixels, drawn = _eye(grey), _lashes()
    pixels[drawn] = 0.006
    found = find_lashes(pixels, LIMBUS, NONE)
    assert found[drawn & RING & (ROW < 108)].mean() > 0.8
    assert (found & RING).sum() < 6 * (drawn & RING).sum()


def test_a_dark_ring_along_the_limbus_is_no_lash():
    """It hangs from the lid on both sides, as thin and dark as a lash that crosses it."""
    pixels, radius = _eye(), LIMBUS.relative_radius(COLUMN, ROW)
    pixels *= 1 - 0.6 * np.exp(-(((radius - 0.95) / 0.03) ** 2))[..., None]
    drawn, lid = _lashes(), RING & (ROW < 95)
    pixels[drawn] = 0.006
    found = find_lashes(pixels, LIMBUS, lid) & RING
    assert found[drawn & RING & (ROW > 95) & (ROW < 112)].mean() > 0.8
    assert not found[ROW > 150].any()


def test_a_lid_over_the_iris_is_found(grey):
    pixels = _eye(grey)
    lid = ROW < 100 + ((COLUMN - 240) / 40) ** 2
    paint = np.full(3, SKIN.mean()) if grey else SKIN
    pixels[lid] = paint * np.exp(0.03 * np.random.default_rng(3).standard_normal((lid.sum(), 3)))
    found = find_lids(pixels, LIMBUS, PUPIL)
    assert found[lid & RING].mean() > 0.9
    assert not found[RING & (ndimage.distance_transform_edt(~lid) > 6)].any()


def test_a_lid_behind_dark_lashes_is_found_beside_a_window():
    """A window on one side of the iris, which the other side does not have."""
    pixels = _eye()
    lid = ROW < 105 + ((COLUMN - 240) / 60) ** 2
    pixels[lid] = SKIN * np.where((COLUMN // 3) % 3 == 0, 0.05, 0.8)[lid, None]
    pixels[(np.abs(COLUMN - 170) < 20) & (np.abs(ROW - 170) < 25)] = 0.9
    found = find_lids(pixels, LIMBUS, PUPIL)
    assert found[lid & RING].mean() > 0.85
    assert not found[RING & (ndimage.distance_transform_edt(~lid) > 12)].any()


def test_nothing_hides_an_open_eye(grey):
    pixels = _eye(grey)
    for ring in (RING, NONE):
        assert not find_highlights(pixels, NONE, ring).any()
        assert not find_reflections(pixels, LIMBUS, PUPIL, ring).any()
    assert not find_lashes(pixels, LIMBUS, NONE).any()
    assert not find_lids(pixels, LIMBUS, PUPIL).any()


SIDE, RADIUS = 400, 180.0
ROUND_LIMBUS = Ellipse((200.0, 200.0), (RADIUS, RADIUS), 0.0)
SQUARE_ROW, SQUARE_COLUMN = np.indices((SIDE, SIDE))
IRIS = ROUND_LIMBUS.mask((SIDE, SIDE))
LID = IRIS & (SQUARE_ROW < 100)


def _shaded_eye():
    """Noise of 1 %, a faint streak below the lid and one far from it, and a round crypt."""
    light = 0.2 * (1 + 0.01 * np.random.default_rng(3).normal(size=(SIDE, SIDE)))
    lean = SQUARE_COLUMN - 150 - 0.3 * (SQUARE_ROW - 100)
    below = (np.abs(lean) < 1.5) & (SQUARE_ROW >= 105) & (SQUARE_ROW < 160)
    far = (np.abs(lean) < 1.5) & (SQUARE_ROW >= 260) & (SQUARE_ROW < 315)
    crypt = np.hypot(SQUARE_ROW - 140, SQUARE_COLUMN - 260) < 10
    light = np.where(below | far | crypt, 0.7 * light, light)
    return np.repeat(light[..., None], 3, -1).astype(np.float32), below, far, crypt


def test_a_faint_streak_below_a_lid_is_found_and_nothing_without_one():
    pixels, below, far, crypt = _shaded_eye()
    found = find_lash_shadows(pixels, ROUND_LIMBUS, LID, IRIS & ~LID)
    assert found[below].mean() > 0.9
    assert not found[far | crypt].any()
    assert found.sum() < 4 * below.sum()
    assert not find_lash_shadows(pixels, ROUND_LIMBUS, np.zeros_like(LID), IRIS).any()


def test_slivers_along_a_lid_are_no_iris():
    clear = IRIS & ~LID
    sliver = IRIS & (SQUARE_ROW > 60) & (SQUARE_ROW < 64)
    np.testing.assert_array_equal(remove_islands(clear | sliver), clear)


BLUE = np.array([0.10, 0.14, 0.20])
BROWN = np.array([0.06, 0.035, 0.012])
TEXELS = 256


def _flat(spots=(), colour=BLUE, noise=0.02, ring=False):
    """A streaky iris with spots ((x, y, diameter, colour), mm) and at need a brown ring."""
    draw = np.random.default_rng(1)
    radius, angle = texels_of(TEXELS)
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
    return mask[int((6 - y) / 12 * TEXELS), int((x + 6) / 12 * TEXELS)]


@pytest.mark.parametrize("ring", [False, True])
def test_brown_spots_are_found_and_neither_crypts_nor_the_collarette(ring):
    crypt = 0.3 * BLUE
    spots = [(3.5, 1.0, 0.3, BROWN), (-1.0, -3.9, 0.9, BROWN), (-3.6, 1.0, 0.5, crypt)]
    found = find_freckles(_flat(spots, ring=ring))
    assert _at(found, 3.5, 1.0) and _at(found, -1.0, -3.9) and not _at(found, -3.6, 1.0)
    assert ndimage.label(found)[1] == 2


def test_no_freckles_where_there_are_none():
    """Nor where one would be too large, without colours and without texels."""
    spotted = _flat([(3.5, 1.0, 0.4, BROWN)])
    grey = spotted._replace(pixels=np.repeat(spotted.pixels[..., :1], 3, -1))
    hidden = spotted._replace(valid=np.zeros((TEXELS, TEXELS), bool))
    for iris in (_flat(), _flat(ring=True), _flat([(3.6, 0.0, 2.2, BROWN)]), grey, hidden):
        assert not find_freckles(iris).any()
