"""Hidden cells of polar maps: filled by texture of the same radius, the rest exact."""

import numpy as np
import pytest

from irisjax.photo.filling import fill_by_texture

ANGLES, RADII = 192, 40
ANGLE = (np.arange(ANGLES) * (2 * np.pi / ANGLES))[:, None]
RADIUS = np.arange(RADII) / RADII


@pytest.mark.parametrize("first", [20, ANGLES - 10])
def test_a_texture_that_comes_again_is_filled_exactly(first):
    """Fibres that repeat four times round the iris, and a ring of another colour."""
    fibres = np.sin(28 * ANGLE) * (1 + RADIUS) + 2 * (RADIUS < 0.3)
    layers = np.stack([fibres, 3 - 2 * fibres])
    hidden = np.zeros((ANGLES, RADII), bool)
    hidden[np.arange(first, first + 24) % ANGLES, 5:25] = True
    seen = np.where(hidden, 99.0, layers)
    found = fill_by_texture(seen, hidden)
    np.testing.assert_array_equal(found[:, ~hidden], layers[:, ~hidden])
    np.testing.assert_allclose(found, layers, atol=1e-4)


def test_a_filled_region_is_as_rough_as_the_rest_and_as_bright_as_its_border():
    noise = np.random.default_rng(1).normal(size=(ANGLES, RADII))
    layers = (noise + 5 * np.cos(ANGLE))[None]
    hidden = np.zeros((ANGLES, RADII), bool)
    hidden[60:90, 10:30] = True
    filled = fill_by_texture(np.where(hidden, 0.0, layers), hidden)[0] - 5 * np.cos(ANGLE)
    assert filled[hidden].std() == pytest.approx(1, abs=0.25)
    assert filled[hidden].mean() == pytest.approx(0, abs=0.5)


def test_the_shade_beside_a_lid_does_not_reach_far_under_it():
    """A lid hides the outer half of a third of the iris, and shades what lies next to it."""
    layers = np.random.default_rng(2).normal(size=(1, ANGLES, RADII))
    hidden, shaded = np.zeros((2, ANGLES, RADII), bool)
    hidden[40:100, 20:] = True
    shaded[34:106, 14:] = True
    layers[0, shaded] -= 5
    filled = fill_by_texture(np.where(hidden, 0.0, layers), hidden)[0]
    assert filled[46:94, 26:].mean() == pytest.approx(0, abs=0.5)
    assert filled[46:94, 20].mean() < -1.5  # its edge is no seam


def test_the_dark_rim_goes_on_where_the_white_shines_through_it():
    """The white hides the last cells all round, a lid the outer half of a quarter of the iris."""
    layers = np.random.default_rng(3).normal(size=(1, ANGLES, RADII))
    layers[0, :, 30:] -= 6 * np.linspace(0.2, 1, RADII - 30)
    hidden = np.zeros((ANGLES, RADII), bool)
    hidden[:, 36:] = hidden[20:68, 20:] = True
    filled = fill_by_texture(np.where(hidden, 9.0, layers), hidden)[0]
    assert filled[:, 36:].max() < -1.5
    assert filled[26:62, 24:30].mean() == pytest.approx(0, abs=0.3)


def test_a_mirror_image_that_was_taken_for_iris_does_not_come_again():
    """Beside it the iris is as it is beside what is hidden."""
    layers = np.random.default_rng(4).normal(size=(1, ANGLES, RADII))
    layers[0, 98:148] = layers[0, 50:100]
    layers[0, 115:130, 15:25] = 20.0
    hidden = np.zeros((ANGLES, RADII), bool)
    hidden[60:90, 10:30] = True
    filled = fill_by_texture(np.where(hidden, 9.0, layers), hidden)[0]
    assert filled[hidden].max() < 6


def test_a_lid_over_an_iris_whose_edges_are_hidden_leaves_no_seam():
    """Pupil and white hide both edges all round: with the lid's they are one region, a ring."""
    layers = 5 * np.sin(ANGLE + 0 * RADIUS)[None]
    hidden = np.zeros((ANGLES, RADII), bool)
    hidden[:, :2] = hidden[:, 36:] = hidden[20:68, 20:] = True
    filled = fill_by_texture(np.where(hidden, 9.0, layers), hidden)[0]
    steps = np.diff(filled, axis=0, append=filled[:1])
    assert np.abs(steps).max() < 2.5  # half of what turned places may differ by, within 3 cells


def test_nothing_hidden_changes_nothing():
    layers = np.ones((2, 8, 4))
    assert fill_by_texture(layers, np.zeros((8, 4), bool)) is layers
