"""Lamps from their images on the cornea."""

import functools

import equinox as eqx
import numpy as np
import pytest

from irisjax.anatomy.eye import Cornea, Eye
from irisjax.photo.light import find_lighting, find_shade
from irisjax.photo.photograph import Ellipse
from irisjax.photo.pose import Pose
from irisjax.photo.texture import Unrefracted, texels_of
from irisjax.render.camera import Camera
from irisjax.render.environment import Environment
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.project import project_visible

LIMBUS = Ellipse((100.0, 100.0), (87.0, 85.0), 0.35 + np.pi / 2)
PUPIL = Ellipse((100.0, 100.0), (35.0, 34.0), 0.35 + np.pi / 2)
CAMERA = Camera(polar=0.2, azimuth=0.35, distance=300.0, width=12.65, size=(201, 201))
POSE = Pose(
    CAMERA, (0, 0), Eye(sclera=None), (0.0, 0.0), 2.0, 0.2, 0.01, (0.18, 0.22), None, "given"
)
DIM = np.full((*POSE.camera.shape, 3), 0.05)


@functools.cache
def view():
    return project_visible(POSE.eye, POSE.camera)


def _mirrored(towards, radius, shape=None):
    """A picture of a lamp of some angular radius on the cornea, over a dim iris; or of what has
    another shape: a function of the directions that pixels mirror.
    """
    seen = view().mirror
    number = np.arange(DIM[..., 0].size) if seen.index is None else np.asarray(seen.index)
    mirror = np.stack([np.asarray(c) for c in seen.mirror], -1)[number >= 0]
    row, column = np.divmod(number[number >= 0], POSE.camera.size[0])
    # The white mirrors too, elsewhere.
    cornea = np.hypot(row - 100, column - 100) < 70
    picture = DIM.copy()
    inside = mirror @ towards > np.cos(radius) if shape is None else shape(mirror)
    bright = cornea & inside
    picture[row[bright], column[bright]] = 1.0
    return picture


def _told(picture, reflected=None):
    if reflected is None:
        reflected = (picture > 0.5).all(-1) & (LIMBUS.radii(POSE.camera.shape) < 0.9)
    return find_lighting(picture, LIMBUS, PUPIL, reflected, POSE, view())


def _off(found, towards):
    """Angle between two directions, degrees."""
    return np.degrees(np.arccos(found @ towards / np.linalg.norm(found)))


def _direction(polar, azimuth):
    sin = np.sin(polar)
    return np.array([sin * np.cos(azimuth), sin * np.sin(azimuth), -np.cos(polar)])


@pytest.mark.parametrize(
    ("polar", "azimuth", "radius", "uneven"), [(0.7, -1.0, 0.08, False), (0.3, 2.0, 0.15, True)]
)
def test_a_highlight_tells_where_its_lamp_stands(polar, azimuth, radius, uneven):
    """One that rounding breaks up is one lamp, and a white that is cut off, beside the limbus, is
    none.
    """
    towards = _direction(polar, azimuth)
    picture = _mirrored(towards, radius)
    if uneven:
        row, column = np.indices(POSE.camera.shape)
        broken = ((row + column) % 5 == 0) | ((row - column) % 7 == 0)
        picture[(picture[..., 0] > 0.5) & broken] = 0.9
        picture[LIMBUS.radii(POSE.camera.shape) > 0.99] = 1.0
    light = _told(picture)
    assert (light.found, light.room) == (1, True)
    lights = light.lights()
    assert _off(np.asarray(lights.towards)[0], towards) < 2
    np.testing.assert_allclose(lights.irradiance, np.pi)
    assert float(lights.radius[0]) == pytest.approx(radius, rel=0.4)


def test_two_lamps_share_the_light_by_their_areas():
    one, other = _direction(0.5, 2.0), _direction(0.5, -1.0)
    picture = np.maximum(_mirrored(one, 0.12), _mirrored(other, 0.07))
    light = _told(picture)
    assert light.found == 2
    lights = light.lights()
    for found, towards in zip(np.asarray(lights.towards), (one, other), strict=True):
        assert _off(found, towards) < 2
    first, second = np.asarray(lights.irradiance)
    assert first + second == pytest.approx(np.pi) and first > 2 * second


def test_lamps_whose_images_are_not_cut_off_share_the_light_by_their_brightness():
    """A faint image was drawn as bright as a lamp's."""
    one, other = _direction(0.9, 2.0), _direction(0.9, -1.0)
    bright, faint = (_mirrored(towards, 0.08) > 0.5 for towards in (one, other))
    picture = np.where(bright, 0.65, np.where(faint, 0.11, DIM))
    reflected = (picture > 0.1).all(-1) & (LIMBUS.radii(POSE.camera.shape) < 0.9)
    light = _told(picture, reflected)
    towards, irradiance = (np.asarray(v) for v in (light.lamps.towards, light.lamps.irradiance))
    first, second = (irradiance[np.argmax(towards @ t)] for t in (one, other))
    assert first / second == pytest.approx(0.6 * bright.sum() / (0.06 * faint.sum()), rel=0.1)


def test_a_wide_highlight_is_a_window_of_its_own_shape():
    """A window of two panes comes back with its bar, and lights the eye from where it stands."""
    towards = _direction(0.6, 2.4)
    right = np.cross(towards, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, towards)

    def panes(direction):
        x, y = direction @ right, direction @ up
        bar = np.abs(x) < 0.06
        return (direction @ towards > 0) & (np.abs(x) < 0.4) & (np.abs(y) < 0.25) & ~bar

    light = _told(_mirrored(towards, 0, panes))
    assert (light.found, light.room, light.lamps) == (2, True, None)
    x, y = np.meshgrid(np.linspace(-0.6, 0.6, 121), np.linspace(-0.4, 0.4, 81))
    depth = np.sqrt(1 - x**2 - y**2)
    places = x[..., None] * right + y[..., None] * up + depth[..., None] * towards
    shown = np.asarray(eqx.filter_jit(Environment.lookup)(light.environment, places))[..., 1]
    there = panes(places)
    # Texels are 0.02 wide, and edges as soft.
    assert (shown[there] > 0.5 * shown.max()).mean() > 0.9
    assert (shown[~there] < 0.5 * shown.max()).mean() > 0.9
    assert shown[(np.abs(x) < 0.03) & (np.abs(y) < 0.2)].max() < 0.5 * shown.max()
    lights = light.lights()
    assert float(lights.irradiance.sum()) == pytest.approx(np.pi)
    assert _off(np.asarray(lights.irradiance) @ np.asarray(lights.towards), towards) < 2
    assert float(light.surroundings(0.2).radiance.min()) == pytest.approx(0.2)


def test_a_thin_wide_highlight_beside_a_bright_white_lights_the_eye():
    """Nothing of it was left where a filter took it for fibres, or the white was as bright."""
    picture = DIM.copy()
    radius = LIMBUS.radii(POSE.camera.shape)
    picture[radius > 0.9] = 1.0
    row, column = np.indices(POSE.camera.shape)
    across, beside = np.abs(column - 100) < 36, (column // 2 == 50) & (row > 39) & (row < 60)
    picture[across & np.isin(row // 2, [20, 23, 26, 29]) | beside] = 1.0  # two pixels thick
    light = _told(picture)
    assert light.found == 1 and light.room
    assert float(light.lights().irradiance.sum()) == pytest.approx(np.pi)


@pytest.mark.parametrize(("value", "burnt_out"), [(0.6, False), (1.0, True)])
def test_the_image_of_a_wide_light_tells_the_exposure(value, burnt_out):
    """A disc's radiance over the normal reflectance of water, seen where that hardly rises."""
    towards, radius = _direction(0.5, 2.0), 0.35
    picture = _mirrored(towards, radius)
    picture[picture > 0.5] = value
    light = _told(picture)
    assert (light.found, light.lamps, light.burnt_out) == (1, None, burnt_out)
    radiance = value / (0.336 / 2.336) ** 2
    solid_angle = 2 * np.pi * (1 - np.cos(radius))
    # Less what the iris has under the image; pixels at the disc's edge count in full.
    assert light.exposure == pytest.approx(radiance * solid_angle / np.pi, rel=0.1)
    assert _off(np.asarray(light.lights().towards).mean(0), towards) < 2


@pytest.mark.parametrize("reflected", [False, True])
def test_without_a_highlight_light_comes_from_all_round(reflected):
    """Nor is a mirror image one that adds no light: of nothing, shares are no numbers."""
    spot = (_mirrored(_direction(0.9, 2.0), 0.08) > 0.5).all(-1)
    light = _told(DIM, spot & reflected)
    assert (light.found, light.room, light.lamps) == (0, False, None)
    lights = light.lights()
    assert len(lights.irradiance) > 10
    mean = np.asarray(lights.irradiance) @ np.asarray(lights.towards)
    np.testing.assert_allclose(mean[:2], 0, atol=0.05)


def test_the_limbus_shades_the_side_of_the_lamp():
    """A lamp low on the right leaves the right rim dark; light from all round fills the shadow."""
    eye, (radius, angle) = Eye(cornea=Cornea(posterior=None)), texels_of(128)
    valid = (radius > 2.0) & (radius < 5.2)
    texture = Unrefracted(np.ones((128, 128, 3), np.float32), valid, 2.0, 5.5)
    lamp, tables = Lights.distant(0.9, 0.0), Illumination.build(eye, caustics=False, size=33)
    shade, filled = (find_shade(texture, lamp, r, eye, tables) & valid for r in (0.0, 20.0))
    right, left = np.cos(angle) > 0.9, np.cos(angle) < -0.9
    assert shade[right & valid & (radius > 4.9)].mean() > 0.9
    assert not shade[right & (radius < 3.5)].any()
    # Opposite it fades more slowly, where the cornea is steep.
    assert shade[right].sum() > 1.5 * shade[left].sum()
    assert not filled[radius < 5].any()
