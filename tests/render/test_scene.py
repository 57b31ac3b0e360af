"""Pictures against the exact solver, hand-made optics and geometry; extreme scenes."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import quick_jit
from irisjax.anatomy.eye import Cornea, Eye
from irisjax.render.bands import colour_bands
from irisjax.render.camera import Camera
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.picture import draw, respond
from irisjax.render.shading import sky_share
from render.small_scenes import (
    BARE,
    CLEAR,
    CLOSE,
    LIGHT,
    QUICK,
    SMALL,
    around,
    maps_of,
    ring,
    scene,
)
from render.tracing import trace


def places(camera):
    """Points (x, y) of the plane through the pupil that the pixels of a camera straight ahead aim
    at, mm.
    """
    (w, h), pitch = camera.size, float(camera.width) / camera.size[0]
    return np.meshgrid((np.arange(w) + 0.5 - w / 2) * pitch, -(np.arange(h) + 0.5 - h / 2) * pitch)


def brdf_in_bands(incidence, exits):
    """The solver's BRDF in colours, (exits, 3); one program for all numbers of exits."""
    bands, every = colour_bands(), np.ones(12 * 9)
    every[: len(exits)] = exits
    directions = {"cos_incidence": incidence, "cos_exit": every}
    found = ij.brdf(LIGHT, bands.wavelengths, **directions, solver=QUICK.solver).values
    return (np.asarray(bands.weights) @ np.asarray(found)).T[: len(exits)]


@pytest.mark.parametrize("polar", [0.0, 1.0])
def test_bare_uniform_iris_is_the_brdf(polar):
    """Every pixel: the solver's BRDF × the irradiance of the slanting light."""
    made = scene(polar=polar, azimuth=2.0, irradiance=2.0)
    picture = np.asarray(draw(made))
    r = np.hypot(*places(SMALL))
    seen = (r > 0.25 + float(made.eye.pupil_margin)) & (r < 5.5)
    assert not picture[r > 5.5].any()
    exits = 250 / np.hypot(250, r[seen])
    error = float(respond(made).error)
    true = 2.0 * np.cos(polar) * brdf_in_bands(np.cos(polar), exits)
    np.testing.assert_allclose(picture[seen], true, atol=2 * error * true.max())


def test_through_a_cornea(tables):
    """Light and camera on the axis: numpy's rays say what arrives, what leaves and where."""
    camera = Camera(size=(12, 9), width=11.0, distance=1e5)
    made = scene(CLOSE, irradiance=2.0, camera=camera)
    picture = np.asarray(draw(made, tables))
    row, column = 3, 6  # near the axis, outside the pupil
    x, y = (float(c[row, column]) for c in places(camera))
    # Rays from far away run parallel to the axis: the same way for light and for sight.
    axis, r = np.array([0.0, 0.0, -1.0]), np.hypot(x, y)
    step = 1e-4
    at = trace(CLOSE, np.array([[r - step, 0], [r, 0], [r + step, 0]]), axis)
    landed = at.point[:, 0]
    concentration = r / landed[1] * (2 * step) / (landed[2] - landed[0])
    after, n = at.met[-1][2][1], 1.336
    cosine = after[2]
    irradiance = 2.0 * at.share[1] * concentration
    expected = at.share[1] / n**2 * irradiance * brdf_in_bands(cosine, [cosine])[0]
    mirrored = around(made).T.reshape(picture.shape)
    np.testing.assert_allclose((picture - mirrored)[row, column], expected, rtol=5e-3)


def test_mirrored_light_mirrored_picture(tables):
    right, left, up = (
        np.asarray(draw(scene(CLOSE, 0.7, azimuth), tables)) for azimuth in (0.4, np.pi - 0.4, -0.4)
    )
    assert right.max() > 0
    np.testing.assert_allclose(left, right[:, ::-1], atol=1e-9)
    np.testing.assert_allclose(up, right[::-1], atol=1e-9)


def test_relief_hides_the_share_of_the_sky_that_lies_behind_it():
    """Before a long wall of elevation h lies (1 + cos h) / 2 of a sky; in the cone that a cornea
    leaves of it, a wall below 41° hides nothing.
    """
    shape, foot, bare = (512, 64), 39, ij.Eye(cornea=None, pupil_radius=2.0, iris_radius=5.0)
    wall = jnp.broadcast_to(jnp.where(jnp.arange(shape[1]) > foot, 1.0, 0.0), shape)
    distance, sky = 5 * 3.0 / 64, quick_jit(sky_share)
    for elevation in (0.4, 0.8):
        low = np.asarray(sky(wall * distance * np.tan(elevation), bare))
        np.testing.assert_allclose(low[:, foot - 4], (1 + np.cos(elevation)) / 2, atol=0.02)
        assert (low[:, foot + 1 :] == 1).all()
    below = ij.Eye(pupil_radius=2.0, iris_radius=5.0)
    assert float(sky(wall * distance * np.tan(0.7), below)[0, foot - 4]) == 1
    assert float(sky(wall * distance * np.tan(1.0), below)[0, foot - 4]) < 0.95


def test_rows_run_down_and_columns_right():
    """A dome slopes outwards everywhere: light from the right is stronger on its right, from above
    at the top.
    """
    slope, polar = 0.2, 0.5
    dome = maps_of(relief=ring(lambda x, y: 1 - slope * np.hypot(x, y)) - 0.5)
    x, y = places(SMALL)
    inside = (np.hypot(x, y) > 1.0) & (np.hypot(x, y) < 5.0)
    flat = np.asarray(draw(scene(polar=polar, maps=maps_of())))
    for azimuth, along in ((0.0, x), (np.pi / 2, y), (np.pi, -x)):
        picture = np.asarray(draw(scene(polar=polar, azimuth=azimuth, maps=dome)))[inside]
        tilt = slope * along / np.hypot(x, y)
        expected = (np.cos(polar) + tilt * np.sin(polar)) / np.cos(polar) / np.hypot(1, slope)
        np.testing.assert_allclose((picture / flat[inside])[:, 1], expected[inside], rtol=2e-3)


def test_maps_lie_where_they_are_drawn():
    """Dark above and right, in the eye's frame: the viewer sees it above and right."""
    corner = maps_of(eumelanin=ring(lambda x, y: 1 + 5.0 * ((x > 0) & (y > 0))))
    picture = np.asarray(draw(scene(maps=corner)))[..., 1]
    six = LIGHT.replace(eumelanin=6 * float(LIGHT.eumelanin))
    light, dark = (np.asarray(draw(scene(iris=i)))[..., 1] for i in (LIGHT, six))
    x, y = places(SMALL)
    seen = (np.hypot(x, y) < 5) & (np.hypot(x, y) > 1) & (np.minimum(abs(x), abs(y)) > 0.3)
    expected = np.where((x > 0) & (y > 0), dark, light)
    np.testing.assert_allclose(picture[seen], expected[seen], rtol=1e-2)
    assert (dark[seen] < 0.8 * light[seen]).all()
    # From the right the camera sees the right half wider, its own left and right as they were.
    aside = Camera(polar=0.6, size=(12, 9), width=11.0)
    turned = np.asarray(draw(scene(maps=corner, camera=aside)))[..., 1]
    assert turned[1:4, 7:9].mean() < 0.8 * turned[1:4, 3:5].mean()


def test_cornea_of_air_is_no_cornea():
    air = CLOSE.replace(cornea=Cornea(index=1.0, scatter=None), aqueous_index=1.0)
    made = Illumination.build(air, caustics=False, size=65)
    inside = (
        np.hypot(*places(SMALL)) < 4.5
    )  # slanting light reaches the rest from beyond the limbus
    both = (air, made), (BARE.replace(aqueous_index=1.0), None)
    pictures = [np.asarray(draw(scene(eye, 0.3, 1.0), t))[inside] for eye, t in both]
    np.testing.assert_allclose(*pictures, rtol=2e-3, atol=1e-6)


PIGMENTS = ("eumelanin", "pheomelanin", "oxyhemoglobin", "deoxyhemoglobin", "lutein", "zeaxanthin")
CLEAR_IRIS = LIGHT.replace(**dict.fromkeys(PIGMENTS, 0.0))
EXTREMES = {
    "light behind": (CLOSE, {"polar": 3.0}),
    "light across": (CLOSE, {"polar": np.pi / 2}),
    "camera behind": (CLOSE, {"camera": Camera(polar=3.1, size=(12, 9))}),
    "camera above": (CLOSE, {"camera": Camera(polar=np.pi / 2, azimuth=np.pi / 2, size=(12, 9))}),
    "pupil 1 mm": (CLOSE.replace(pupil_radius=0.5), {}),
    "pupil 9 mm": (CLOSE.replace(pupil_radius=4.5), {}),
    "sclera": (Eye(cornea=CLEAR), {"polar": 1.3, "camera": Camera(size=(12, 9), width=30.0)}),
    "bare, light behind": (BARE, {"polar": 3.0}),
    "bare, camera across": (BARE, {"polar": 1.5, "camera": Camera(polar=1.5, size=(12, 9))}),
    "no pigment": (BARE, {"iris": CLEAR_IRIS}),
    "no pigment and no layers": (
        BARE,
        {"iris": CLEAR_IRIS, "maps": maps_of(abl_depth=0.0, stroma_depth=0.0)},
    ),
    # A relief has no slope there, and the pupil no light.
    "one pixel that looks at the middle": (
        BARE,
        {
            "camera": Camera(size=(1, 1), width=8.0),
            "maps": maps_of(relief=ring(lambda x, y: 0.01 * y)),
        },
    ),
}


@pytest.mark.parametrize("name", list(EXTREMES))
def test_extremes_are_finite_and_no_darker_than_black(name, tables):
    eye, options = EXTREMES[name]
    made = scene(eye, **options)
    picture = np.asarray(draw(made, None if eye.cornea is None else tables))
    width, height = made.camera.size
    assert picture.shape == (height, width, 3)
    assert np.isfinite(picture).all() and (picture > -1e-3).all()
    # Colours out of sRGB's gamut may be negative in red, never in luminance.
    assert (picture @ [0.2126, 0.7152, 0.0722] >= -1e-12).all()
    if "behind" in name and eye.sclera is None:
        assert not picture.any()


def test_lights_add_up():
    """One of them coloured: its picture is a plain one's, channel by channel."""
    one, plain = Lights.distant(0.6, 2.0, 1.5), Lights.distant(0.4, -0.5, 2.5)
    two = dataclasses.replace(plain, tint=jnp.array([[1.0, 0.0, 2.0]]))
    both, first, second, white = (
        np.asarray(draw(scene(BARE, lights=which))) for which in (one + two, one, two, plain)
    )
    np.testing.assert_allclose(both, first + second, atol=1e-9)
    np.testing.assert_allclose(second, white * [1, 0, 2], atol=1e-12)
