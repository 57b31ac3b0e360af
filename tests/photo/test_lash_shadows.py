"""Faint lashes below a lid are taken out of a texture; what is not below a lid, or wide, stays."""

import numpy as np

from irisjax.photo.masks import find_lash_shadows, without_islands
from irisjax.photo.photograph import Ellipse

SIDE, RADIUS = 400, 180.0
LIMBUS = Ellipse((200.0, 200.0), (RADIUS, RADIUS), 0.0)
ROW, COLUMN = np.indices((SIDE, SIDE))
IRIS = LIMBUS.mask((SIDE, SIDE))
LID = IRIS & (ROW < 100)


def _eye():
    """Noise of 1 %, a faint streak below the lid and one far from it, and a round crypt."""
    light = 0.2 * (1 + 0.01 * np.random.default_rng(3).normal(size=(SIDE, SIDE)))
    lean = COLUMN - 150 - 0.3 * (ROW - 100)
    below = (np.abs(lean) < 1.5) & (ROW >= 105) & (ROW < 160)
    far = (np.abs(lean) < 1.5) & (ROW >= 260) & (ROW < 315)
    crypt = np.hypot(ROW - 140, COLUMN - 260) < 10
    light = np.where(below | far | crypt, 0.7 * light, light)
    return np.repeat(light[..., None], 3, -1).astype(np.float32), below, far, crypt


def test_a_faint_streak_below_a_lid_is_found_and_nothing_else():
    pixels, below, far, crypt = _eye()
    found = find_lash_shadows(pixels, LIMBUS, LID, IRIS & ~LID)
    assert found[below].mean() > 0.9
    assert not found[far | crypt].any()
    assert found.sum() < 4 * below.sum()


def test_without_a_lid_nothing_is_taken():
    pixels, *_ = _eye()
    assert not find_lash_shadows(pixels, LIMBUS, np.zeros_like(LID), IRIS).any()


def test_slivers_along_a_lid_are_no_iris():
    clear = IRIS & ~LID
    sliver = IRIS & (ROW > 60) & (ROW < 64)
    np.testing.assert_array_equal(without_islands(clear | sliver), clear)
