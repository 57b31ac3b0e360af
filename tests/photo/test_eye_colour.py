"""Colours of made eyes against the white beside them."""

import jax
import numpy as np
import pytest

from irisjax.photo.eye_colour import RINGS, depth_in_iris, measure_eye_colour
from irisjax.photo.masks import Part
from irisjax.photo.overlay import draw_colours
from irisjax.photo.photograph import Ellipse
from irisjax.photo.white import find_white

SIZE, RADIUS = 200, 70.0
LIMBUS = Ellipse((99.5, 99.5), (RADIUS, RADIUS))
PUPIL = Ellipse((100.5, 98.5), (22.0, 22.0))
INNER, OUTER, WHITE = (38.0, 9.0, 22.0), (36.0, -4.0, -8.0), (80.0, 3.5, 8.0)
SKIN = np.array([0.45, 0.26, 0.18])
BORDER = 0.36
KEY = jax.random.key(0)


def linear(lab):
    """Linear sRGB under D65, by colour-science."""
    import colour  # for a second, also in the worker that runs other files

    d65 = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    no = {"apply_cctf_encoding": False, "chromatic_adaptation_transform": None}
    return colour.XYZ_to_sRGB(colour.Lab_to_XYZ(lab, d65), d65, **no)


@pytest.fixture(scope="module")
def eye():
    """Two colours, a white turned a little from the light, lids of skin, and 1 % of noise."""
    shape = (SIZE, SIZE)
    depth, radius = depth_in_iris(shape, PUPIL, LIMBUS), LIMBUS.radii(shape)
    pixels = np.where((depth < BORDER)[..., None], linear(INNER), linear(OUTER))
    pixels = np.where((radius > 1)[..., None], linear(WHITE) / np.exp(0.15), pixels)
    pixels[depth < 0] = 0.001
    row = np.arange(SIZE)[:, None] * np.ones(SIZE)
    pixels[(abs(row - 99.5) > 0.8 * RADIUS) & (radius > 1)] = SKIN
    return pixels * (1 + 0.01 * np.random.default_rng(1).standard_normal(pixels.shape))


def part_with(pixels):
    off = np.zeros(pixels.shape[:2], bool)
    return Part(pixels, (pixels > 0.995).any(-1), off, LIMBUS, 1, (0, 0))


def measured(pixels, clear=None):
    shape = pixels.shape[:2]
    ring = LIMBUS.mask(shape) & ~PUPIL.mask(shape)
    return measure_eye_colour(part_with(pixels), PUPIL, ring if clear is None else clear, key=KEY)


def test_colours_of_rings_are_in_their_intervals(eye):
    import colour

    found = measured(0.8 * eye)
    assert found.doubts == () and len(found.white.sides) == 2
    for name, lab in (("pupillary ring", INNER), ("ciliary ring", OUTER)):
        region = found.regions[name]
        np.testing.assert_allclose(region.lab, lab, atol=1.0)
        assert (region.low < lab).all() and (lab < region.high).all()
        assert (region.high - region.low > 4).all() and region.share > 0.99
        encoded = colour.cctf_encoding(linear(lab), function="sRGB")
        np.testing.assert_allclose(region.srgb, encoded, atol=0.02)
    one, other = found.dominant
    np.testing.assert_allclose(one.lab, OUTER, atol=1.0)
    np.testing.assert_allclose(other.lab, INNER, atol=1.0)
    assert one.share + other.share == pytest.approx(1)
    # The white's error is common to both.
    middle, low, high = found.difference
    apart = np.subtract(INNER, OUTER)
    assert (low < apart).all() and (apart < high).all() and (high - low < 12).all()
    np.testing.assert_allclose(middle, apart, atol=1.5)
    picture = draw_colours(found, part_with(eye), PUPIL)
    assert (abs(picture - found.regions["pupillary ring"].srgb).max(-1) < 0.003).sum() > 3000


def test_white_balance_and_exposure_hardly_matter(eye):
    plain = measured(0.8 * eye)
    other = measured(0.5 * eye * (1.35, 1.0, 0.7))
    for name, region in plain.regions.items():
        np.testing.assert_allclose(other.regions[name].lab, region.lab, atol=0.5)


def test_what_hides_the_iris_does_not_count(eye):
    """A mirrored window, the lid's skin, and half of a ring that a mask takes away."""
    pixels, plain = eye.copy(), measured(eye)
    pixels[60:90, 110:135] += 0.3
    pixels[30:48, 80:125] = SKIN
    found = measured(pixels)
    assert not found.visible[65:85, 115:130].any() and not found.visible[32:46, 82:122].any()
    labs = (f.regions["whole iris"].lab for f in (found, plain))
    np.testing.assert_allclose(*labs, atol=1)
    half = np.ones(eye.shape[:2], bool)
    half[:, 100:] = False
    shown, whole = measured(eye, half).regions["ciliary ring"], plain.regions["ciliary ring"]
    assert shown.share == pytest.approx(0.5, abs=0.02)
    assert (shown.low < whole.lab).all() and (whole.lab < shown.high).all()


def test_a_white_that_is_not_seen_is_doubted_or_refused(eye):
    shape = eye.shape[:2]
    outside, left = LIMBUS.radii(shape) > 1, np.arange(SIZE) < 99.5
    one_side = np.where((outside & left)[..., None], SKIN, eye)
    found = measured(one_side)
    assert "on one side" in found.doubts[0]
    one, two = (f.regions["whole iris"] for f in (found, measured(eye)))
    assert one.high[0] - one.low[0] > 1.2 * (two.high[0] - two.low[0])
    with pytest.raises(ValueError, match="no white of the eye is seen"):
        measured(np.where(outside[..., None], SKIN, eye))
    with pytest.raises(ValueError, match="no white of the eye is seen"):
        find_white(part_with(np.where(outside[..., None], 1.0, eye)), None, eye[85, 60:70])
    with pytest.raises(ValueError, match="only 0 % of the iris is visible"):
        measured(eye, np.zeros(shape, bool))
    burnt = np.where((outside & (np.arange(SIZE)[:, None] < 110))[..., None], 1.0, eye)
    assert "% of the white is overexposed" in " ".join(measured(burnt).doubts)
    assert set(RINGS) < set(found.regions)
