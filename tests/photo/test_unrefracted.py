"""Refraction undone: texels where the camera sees them, and a painted iris laid flat."""

import numpy as np
import pytest
from eyes_in_line import outlines, painted, seen
from scipy import ndimage

from irisjax.anatomy.eye import Eye
from irisjax.photo.pose import find_pose, iris_points
from irisjax.photo.texture import Unrefracted, follow_refraction, unrefract
from irisjax.render.camera import Camera

SPACING, WIDTH = 0.8, 0.12  # mm, of the dots


@pytest.fixture(scope="module")
def pose():
    camera = Camera(polar=0.5236, azimuth=0.35, distance=300.0, width=14.0, size=(1001, 901))
    return find_pose(*outlines(Eye(), camera), Eye())


def _texture(size):
    nothing = np.zeros((size, size), bool)
    return Unrefracted(np.zeros((size, size, 3), np.float32), nothing, 0.0, 5.5)


def _places(size):
    texture = _texture(size)
    radius, angle = texture.radius().astype(float), texture.angle().astype(float)
    return radius, radius * np.cos(angle), radius * np.sin(angle)


def test_interpolated_as_if_every_texel_were_followed(pose):
    size = 128
    radius, x, y = _places(size)
    found = follow_refraction(pose, size)
    iris = radius < 0.99 * float(pose.eye.iris_radius)
    every = seen(pose.eye, pose.camera, iris_points(pose.eye, x[iris], y[iris]))
    clear = np.asarray(every.visible) & found.visible[iris]
    off = np.hypot(found.column[iris] - every.column, found.row[iris] - every.row)
    assert off[clear].max() < 0.01
    assert (np.asarray(every.visible) == found.visible[iris]).mean() > 0.995


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


def test_a_painted_iris_lies_flat_where_it_was_painted(pose, dots):
    places, picture = dots
    size = 512
    flat = unrefract(picture, np.ones(picture.shape[:2], bool), pose, follow_refraction(pose, size))
    texel = flat.millimetres_per_texel
    guess = np.stack([-places[:, 1], places[:, 0]], -1) / texel + size / 2 - 0.5
    found = (_centres(flat.pixels[..., 0], guess, round(0.3 / texel)) + 0.5) * texel - 6
    off = np.hypot(found[:, 1] - places[:, 0], -found[:, 0] - places[:, 1])
    assert np.sqrt((off**2).mean()) < 0.03
    # As the camera sees them the dots are elsewhere, a plain stretch of the picture undone.
    shown = seen(pose.eye, pose.camera, iris_points(pose.eye, *places.T))
    at = np.stack([shown.column, shown.row, np.ones(len(places))], -1)
    plain = at @ np.linalg.lstsq(at, places, rcond=None)[0]
    assert np.sqrt(((plain - places) ** 2).sum(1).mean()) > 0.03


def test_what_a_mask_hides_is_not_valid(pose, dots):
    _, picture = dots
    clear = np.ones(picture.shape[:2], bool)
    clear[:, picture.shape[1] // 2 :] = False
    flat = unrefract(picture, clear, pose, follow_refraction(pose, 256))
    radius, x, _ = _places(256)
    where = follow_refraction(pose, 256)
    assert not flat.valid[where.column > picture.shape[1] / 2].any()
    ring = (radius > 2.2) & (radius < 4.8)
    assert flat.valid[ring & (where.column < picture.shape[1] / 2 - 2)].all()
    assert flat.valid[ring & (x < -0.5)].mean() > 0.9
    assert not flat.valid[(radius < 1.85) | (radius > 5.51)].any()
    assert (flat.pixels[radius > 5.51] == 0).all()


def test_a_picture_that_ends_within_the_iris(pose, dots):
    """Texels beyond the photograph's edge are neither filled nor valid."""
    _, picture = dots
    columns = picture.shape[1]
    cut = picture[:, : columns // 3]
    flat = unrefract(cut, np.ones(cut.shape[:2], bool), pose, follow_refraction(pose, 256))
    beyond = follow_refraction(pose, 256).column > columns // 3 - 1
    assert not flat.valid[beyond].any() and (flat.pixels[beyond] == 0).all()
    assert flat.valid.any()


def test_the_pupil_off_the_middle_is_left_out(pose, dots):
    _, picture = dots
    clear = np.ones(picture.shape[:2], bool)
    where = follow_refraction(pose, 256)
    flat = unrefract(picture, clear, pose._replace(pupil_centre=(0.4, 0.0)), where)
    _, x, y = _places(256)
    inside = np.hypot(x - 0.4, y) < float(pose.eye.pupil_radius) - 0.01
    assert not flat.valid[inside].any()
    assert flat.valid[(np.hypot(x - 0.4, y) > 2.0) & (np.hypot(x, y) < 4.5)].all()
