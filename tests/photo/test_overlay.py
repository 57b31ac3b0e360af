"""Pictures of what was found in a photograph."""

from types import SimpleNamespace

import numpy as np

from irisjax.photo.clone import Posed
from irisjax.photo.masks import part_geometry
from irisjax.photo.outlines import Boundaries
from irisjax.photo.overlay import draw_overlay
from irisjax.photo.photograph import Ellipse, Photograph

SIZE = 1200  # px, which the overlay shows as they are
MIDDLE = 599.5, 599.5
LIMBUS, PUPIL = Ellipse(MIDDLE, (580.0, 580.0)), Ellipse(MIDDLE, (100.0, 100.0))


def posed(corner, clear):
    """Make the fields that the overlay reads of a photograph whose pose is known."""
    pixels = np.full((SIZE, SIZE, 3), 0.2, np.float32)
    found = object.__new__(Posed)
    vars(found).update(
        photograph=Photograph(pixels, np.zeros((SIZE, SIZE), bool)),
        boundaries=Boundaries(LIMBUS, PUPIL, 1.0, 1.0),
        pose=SimpleNamespace(corner=corner),
        clear=clear,
    )
    return found


def test_a_hidden_pixel_of_a_reduced_part_tints_those_it_is_the_mean_of():
    (x, y), _, reduction = part_geometry(LIMBUS)
    assert reduction == 2
    left, top, row, column = 20, 30, 100, 300
    clear = np.ones((600, 600), bool)
    shown = draw_overlay(posed((left, top), clear))
    clear[row, column] = False
    changed = (draw_overlay(posed((left, top), clear)) != shown).any(-1)
    expected = np.zeros_like(changed)
    first, begin = y + reduction * (top + row), x + reduction * (left + column)
    expected[first : first + reduction, begin : begin + reduction] = True
    np.testing.assert_array_equal(changed, expected)
