"""The iris laid flat: refraction undone, holes filled, polar cells."""

import numpy as np
import pytest
from eyes_in_line import painted, seen
from scipy import ndimage

from irisjax.anatomy.eye import Eye
from irisjax.photo.pose import Pose, iris_points
from irisjax.photo.texture import (
    Unrefracted,
    fill_holes,
    follow_refraction,
    masked_mean,
    texels_of,
    to_polar,
    unrefract,
)
from irisjax.render.camera import Camera
from irisjax.tissue.maps import cell_centres


def _disc(size, radius):
    y, x = np.mgrid[:size, :size] - (size - 1) / 2
    return np.hypot(x, y) < radius


def test_known_pixels_stay_to_the_bit_and_holes_lie_between_them():
    pixels = np.random.default_rng(0).uniform(0.2, 0.7, (65, 90, 3))
    holes = np.zeros((65, 90), bool)
    holes[20:50, 30:70] = holes[:4] = True
    filled = fill_holes(np.where(holes[..., None], np.nan, pixels), holes)
    np.testing.assert_array_equal(filled[~holes], pixels[~holes])
    assert filled.min() >= 0.2 and filled.max() <= 0.7


def test_a_hole_in_a_ramp_is_bridged():
    ramp = np.broadcast_to(np.linspace(0, 1, 128), (128, 128))
    holes = _disc(128, 12)
    # The ramp rises by 0.19 across the hole.
    assert np.abs(fill_holes(ramp, holes) - ramp).max() < 0.06


def test_nothing_to_fill_from():
    with pytest.raises(ValueError, match="all 16 pixels are holes"):
        fill_holes(np.ones((4, 4)), np.ones((4, 4), bool))


def test_means_leave_holes_out():
    valid = ~_disc(64, 8)
    values = np.where(valid, 0.3, 1e4)
    np.testing.assert_allclose(masked_mean(values, valid, 5.0)[valid], 0.3, rtol=1e-5)
    with pytest.raises(ValueError, match="no texel is valid"):
        masked_mean(values, np.zeros_like(valid), 5.0)


@pytest.mark.parametrize("shape", [(48, 16), (768, 256)])
def test_angles_run_from_right_to_up_and_radii_outwards(shape):
    texture = _texture(256)
    assert texture.angle()[0, 128] == pytest.approx(np.pi / 2, abs=0.02)  # row 0 is the top
    picture = np.cos(texture.angle() - 0.4) + 0.2 * texture.radius()
    polar = to_polar(picture, 2.0, 5.5, shape)
    angle, radius = (np.asarray(x) for x in cell_centres(shape))
    expected = np.cos(angle[:, None] - 0.4) + 0.2 * (2.0 + 3.5 * radius)
    assert np.abs(polar - expected).max() < 0.01


def test_coarse_cells_are_means():
    checks = np.indices((256, 256)).sum(0) % 2.0
    polar = to_polar(checks, 2.0, 5.5, (32, 8))
    assert np.abs(polar - 0.5).max() < 0.1


def test_radii_that_are_no_iris():
    with pytest.raises(ValueError, match="pupil_radius = 6 mm"):
        to_polar(np.zeros((8, 8)), 6.0, 5.5)


SPACING, WIDTH = 0.8, 0.12  # mm, of the dots
SIZE = 256


@pytest.fixture(scope="module")
def pose():
    camera = Camera(polar=0.5236, azimuth=0.35, distance=300.0, width=14.0, size=(501, 451))
    return Pose(camera, (0, 0), Eye(), (0.0, 0.0), 2.0, 0.5236, 0.01, (0.5, 0.55), None, "given")


def _texture(size):
    return Unrefracted(np.zeros((size, size, 3)), np.ones((size, size), bool), 2.0, 5.5)


def _places(size):
    radius, angle = (v.astype(float) for v in texels_of(size))
    return radius, radius * np.cos(angle), radius * np.sin(angle)


@pytest.fixture(scope="module")
def where(pose):
    return follow_refraction(pose, SIZE)


def test_interpolated_as_if_every_texel_were_followed(pose, where):
    radius, x, y = _places(SIZE)
    iris = radius < 0.99 * float(pose.eye.iris_radius)
    iris &= np.arange(SIZE**2).reshape(SIZE, SIZE) % 7 == 0  # enough of them
    column, row, visible = seen(pose.eye, pose.camera, iris_points(pose.eye, x[iris], y[iris]))
    clear = visible & where.visible[iris]
    off = np.hypot(where.column[iris] - column, where.row[iris] - row)
    assert off[clear].max() < 0.01
    assert (visible == where.visible[iris]).mean() > 0.995


def _dots(x, y):
    """Bright dots on a square grid of the iris."""
    u, v = ((c + SPACING / 2) % SPACING - SPACING / 2 for c in (x, y))
    return 0.2 + 0.6 * np.exp(-(u**2 + v**2) / (2 * WIDTH**2))


def _centres(picture, guess, reach):
    """Middles of mass (row, column) of dots within `reach` pixels of where they may be."""
    found = []
    for row, column in guess:
        r, c = round(row), round(column)
        part = np.maximum(picture[r - reach : r + reach + 1, c - reach : c + reach + 1] - 0.25, 0)
        dr, dc = ndimage.center_of_mass(part)
        found.append((r - reach + dr, c - reach + dc))
    return np.array(found)


@pytest.fixture(scope="module")
def dots(pose):
    """Places (dots, 2), mm, clear of pupil and limbus, and the painted picture."""
    side = SPACING * np.arange(-6, 7)
    places = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
    away = np.hypot(*places.T)
    return places[(away > 2.3) & (away < 4.9)], painted(pose.eye, pose.camera, _dots)


def test_a_painted_iris_lies_flat_where_it_was_painted(pose, dots, where):
    places, picture = dots
    flat = unrefract(picture, np.ones(picture.shape[:2], bool), pose, where)
    texel = flat.millimetres_per_texel
    guess = np.stack([-places[:, 1], places[:, 0]], -1) / texel + SIZE / 2 - 0.5
    found = (_centres(flat.pixels[..., 0], guess, round(0.3 / texel)) + 0.5) * texel - 6
    off = np.hypot(found[:, 1] - places[:, 0], -found[:, 0] - places[:, 1])
    assert np.sqrt((off**2).mean()) < 0.03
    # As the camera sees them the dots are elsewhere, a plain stretch of the picture undone.
    column, row, _ = seen(pose.eye, pose.camera, iris_points(pose.eye, *places.T))
    at = np.stack([column, row, np.ones(len(places))], -1)
    plain = at @ np.linalg.lstsq(at, places, rcond=None)[0]
    assert np.sqrt(((plain - places) ** 2).sum(1).mean()) > 0.03


def test_what_a_mask_hides_is_not_valid(pose, dots, where):
    clear = np.ones(dots[1].shape[:2], bool)
    middle = clear.shape[1] / 2
    clear[:, int(middle) :] = False
    flat = unrefract(dots[1], clear, pose, where)
    radius, x, _ = _places(SIZE)
    assert not flat.valid[where.column > middle].any()
    ring = (radius > 2.2) & (radius < 4.8)
    assert flat.valid[ring & (where.column < middle - 2)].all()
    assert flat.valid[ring & (x < -0.5)].mean() > 0.9
    assert not flat.valid[(radius < 1.85) | (radius > 5.51)].any()
    assert (flat.pixels[radius > 5.51] == 0).all()


def test_a_picture_that_ends_within_the_iris(pose, dots, where):
    """Texels beyond the photograph's edge are neither filled nor valid."""
    end = dots[1].shape[1] // 3
    cut = dots[1][:, :end]
    flat = unrefract(cut, np.ones(cut.shape[:2], bool), pose, where)
    beyond = where.column > end - 1
    assert not flat.valid[beyond].any() and (flat.pixels[beyond] == 0).all()
    assert flat.valid.any()


def test_the_pupil_off_the_middle_is_left_out(pose, dots, where):
    clear = np.ones(dots[1].shape[:2], bool)
    flat = unrefract(dots[1], clear, pose._replace(pupil_centre=(0.4, 0.0)), where)
    _, x, y = _places(SIZE)
    away = np.hypot(x - 0.4, y)
    assert not flat.valid[away < float(pose.eye.pupil_radius) - 0.01].any()
    assert flat.valid[(away > 2.0) & (np.hypot(x, y) < 4.5)].all()
