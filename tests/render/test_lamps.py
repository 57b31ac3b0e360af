"""Lamps that are near, and what lights the white: against rays traced in numpy, integrals, and
formulae by hand.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from irisjax.anatomy.eye import Cornea, Eye
from irisjax.anatomy.sclera import VeinMap
from irisjax.measure.colour import tristimulus_matrix
from irisjax.render import outside, shading
from irisjax.render.bands import BAND_GRID
from irisjax.render.camera import Camera
from irisjax.render.environment import Environment
from irisjax.render.illumination import trace_flux
from irisjax.render.lights import Lights
from irisjax.render.outside import bulk_reflectance
from irisjax.render.project import ScleraPixels, project, trace_sclera
from irisjax.render.refraction import UNIQUE_POLAR, RefractionFunction, limbus_window
from irisjax.render.scene import Scene
from irisjax.tissue.maps import IrisMaps
from render.small_scenes import around, rays_of
from render.tracing import above, disc, meet, normals, soft_edge, towards, trace

CLEAR = Cornea(scatter=None)
EYE = Eye(sclera=None, cornea=CLEAR)
WHITE = Eye(cornea=CLEAR)
IRIS = ij.Iris.of_level("low")


def test_near_lamp_on_the_iris(tables):
    """Rays that part from the lamp itself, counted where they land."""
    k, area = disc(5.65, 200_000)
    way = 50.0 * towards(0.5) - above(CLEAR.anterior, k)
    length = np.linalg.norm(way, axis=1)
    traced = trace(EYE, k, way / length[:, None])
    power = np.where(traced.inside, traced.power, 0) * area * (50.0 / length) ** 2
    power = power * soft_edge(np.hypot(*k.T), 5.5)
    field = shading.incident_flux(Lights.points(50.0 * towards(0.5), 1.0), EYE, tables)[0]
    line = np.linspace(-1, 1, field.shape[-1]) * float(EYE.iris_radius)
    x, y = np.meshgrid(line, line)
    for place in ((0.0, 0.0), (-2.5, 0.0), (0.0, 2.5)):
        landed = np.hypot(traced.point[:, 0] - place[0], traced.point[:, 1] - place[1]) < 0.8
        true = power[landed].sum() / (np.pi * 0.8**2)
        found = np.asarray(field[2])[np.hypot(x - place[0], y - place[1]) < 0.8].mean()
        # 3,000 rays a place, evenly spread: 0.5 %, and the tables' own error.
        assert found == pytest.approx(true, rel=0.015), place


def test_far_points_are_distant(tables):
    far = Lights.distant(np.arctan2(13**0.5, 5), np.arctan2(2, 3), 1.0)
    pair = Lights.points([3e6, 2e6, -5e6], 1.0), far
    fields = [np.asarray(shading.incident_flux(lights, EYE, tables)) for lights in pair]
    np.testing.assert_allclose(*fields, atol=1e-5)


def pixels(normal, point=(0.0, 0.0, 0.0)):
    one = [jnp.full(3, v) for v in (*normal, *point)]
    return ScleraPixels(jnp.arange(3), tuple(one[3:]), tuple(one[:3]), jnp.zeros(3), jnp.ones(3))


def lit(lights, *of):
    """Radiance of a white that sends back all, times π."""
    return float(outside.sclera_radiance((pixels(*of), jnp.ones((1, 3))), lights)[0, 0])


def test_round_white_keeps_its_power():
    """In an even room it has the room's radiance; far from the terminator it is a matt white, 3 %
    less bright.
    """
    i = np.arange(4000) + 0.5
    polar, azimuth = np.arccos(1 - 2 * i / 4000), i * np.pi * (3 - np.sqrt(5))
    room = Lights.distant(polar, azimuth, 4 * np.pi / 4000)
    assert lit(room, (0.6, 0.0, -0.8)) == pytest.approx(np.pi, rel=1e-3)
    facing = 0.0, 0.0, -1.0
    straight, slant, past = (lit(Lights.distant(a, 0.0, 1.0), facing) for a in (0.0, 1.1, 1.8))
    assert slant / straight == pytest.approx(np.cos(1.1)) and straight == pytest.approx(1 / 1.03)
    assert 0 < past < 0.02


def test_white_has_no_edge_where_the_cornea_begins():
    """The white below the clear cornea goes on as the globe does: lit from the other side, a normal
    that turned with the cornea's would darken it by half from one pixel to the next.
    """
    camera = Camera(distance=1e5, width=14.0, size=(1400, 1))
    row = np.arange(1200, 1300, dtype=np.int32)  # 5 to 6 mm from the axis, 0.01 mm each
    white = trace_sclera(row, WHITE, camera)
    assert 0 < float(white.share[60]) < 1  # it has begun to blend
    for polar in (0.0, 0.6, 1.2):
        lamp = Lights.distant(polar, np.pi, 1.0)
        shown = np.asarray(outside.sclera_radiance((white, jnp.ones((1, len(row)))), lamp))[0]
        assert np.abs(np.diff(shown)).max() < 0.005, polar


def test_near_lamp_on_the_white():
    """Inverse squares and the direction of the lamp from the point itself."""
    point, lamp = np.array([8.0, 0.0, 4.5]), np.array([20.0, 5.0, -25.0])
    way = lamp - point
    normal = np.array([0.7, 0.1, -np.sqrt(1 - 0.5)])
    cosine = normal @ way / np.linalg.norm(way)
    assert cosine > 0.3
    expected = cosine / 1.03 * (lamp @ lamp) / (way @ way)
    assert lit(Lights.points(lamp, 1.0), normal, point) == pytest.approx(expected, rel=1e-9)
    # Beside a light at infinity too.
    both = Lights.points(lamp, 1.0) + Lights.distant(0.0, 0.0, 1.0)
    far = lit(Lights.distant(0.0, 0.0, 1.0), normal, point)
    assert lit(both, normal, point) == pytest.approx(expected + far, rel=1e-9)


@pytest.mark.peer
def test_near_lamp_is_mirrored_where_it_stands(tables):
    """The image lies where a line of sight that is mirrored by hand on the cornea's conicoid points
    at the lamp.
    """
    lamp, camera = np.array([15.0, 10.0, -40.0]), Camera(size=(240, 180), width=11.0)
    origin, d = (np.asarray(v) for v in rays_of(camera, WHITE))
    point = origin + meet(CLEAR.anterior, origin, d)[..., None] * d
    normal = normals(CLEAR.anterior, point)
    mirror = d - 2 * (d * normal).sum(-1, keepdims=True) * normal
    off = np.linalg.norm(
        (lamp - point) / np.linalg.norm(lamp - point, axis=-1, keepdims=True) - mirror, axis=-1
    )
    expected = np.array(np.unravel_index(np.nanargmin(off), off.shape))
    lights = Lights.points(lamp, 1.0, radius=0.05)
    picture = around(Scene(IRIS, eye=WHITE, lights=lights, camera=camera))[1].reshape(180, 240)
    bright = np.argwhere(picture > 0.5 * picture.max())
    np.testing.assert_allclose(bright.mean(0), expected, atol=0.6)
    assert picture.max() == pytest.approx(
        (0.337 / 2.337) ** 2 / (np.pi * np.sin(0.05) ** 2), rel=0.03
    )


@pytest.mark.peer
def test_white_in_an_even_room(tables):
    """All of the room lights it, that behind the eye too: seen from the side where the iris is not
    lit from.
    """
    room = Environment(jnp.ones((32, 64, 3)))
    made = Scene(IRIS, eye=WHITE, lights=None, environment=room, environment_lights=200)
    made = made.replace(camera=Camera(polar=1.4, size=(24, 18), width=20.0))
    view = project(made.eye, made.camera)
    whole = np.asarray(view.sclera.share) == 1
    # The tear film mirrors the room's radiance of 1.
    matt = (around(made, view)[1] - np.asarray(view.mirror.reflectance))[whole]
    green = matt / (1 - np.asarray(view.sclera.reflectance)[whole])
    # Reflectance times the room's radiance of 1; with 50 lights for the room 2 %, with 200 0.3,
    # with 800 0.1.
    assert np.ptp(green) / green.mean() < 0.01
    weights = np.asarray(tristimulus_matrix(BAND_GRID, "linear sRGB", "D65")[0])[1]
    np.testing.assert_allclose(
        green.mean(), weights @ np.asarray(bulk_reflectance(ij.Sclera(), BAND_GRID)), rtol=2e-3
    )


@pytest.mark.peer
def test_vessels_have_their_colours_of_81_wavelengths():
    """The picture in RGB and the one of all wavelengths, weighed."""
    drawn = VeinMap(*(jnp.full((4, 4), v) for v in (0.035, 0.9, 0.3)))
    made = Scene(IRIS, eye=WHITE, veins=drawn, camera=Camera(polar=1.4, azimuth=0.3, size=(16, 12)))
    made = made.replace(integrator=ij.Separable(solver=ij.IlitExact(4), degrees=(2, 2, 2, 2, 2)))
    white = np.asarray(project(made.eye, made.camera).sclera.share) > 0
    spectral = around(made.replace(wavelengths=tuple(map(float, BAND_GRID))))[:, white]
    power = np.asarray(ij.measure.illuminant_power("D65", BAND_GRID))
    weights = np.asarray(tristimulus_matrix(BAND_GRID, "linear sRGB", "D65")[0])
    np.testing.assert_allclose(around(made)[:, white], weights / power @ spectral, atol=2e-4)


@pytest.mark.peer
def test_cone_is_lit_alike_by_both_tables():
    """Counted rays and searched ones at the angle where one gives way to the other; cells of a cone
    are longer.
    """
    eye = EYE.replace(iris_slope=0.3, iris_depth=3.8)
    size, extent = 65, 5.5
    counted = trace_flux(eye, jnp.asarray(UNIQUE_POLAR), size, jnp.asarray(extent), 100_000)
    line = jnp.linspace(-1, 1, size) * extent
    points = jnp.stack(jnp.meshgrid(line, line), axis=-1)
    made = RefractionFunction.build(eye, n_azimuth=24, n_radius=40)
    found = made.at(points, jnp.asarray(towards(UNIQUE_POLAR)))
    searched = limbus_window(eye, found.entry)[..., None] * found.flux
    inside = np.hypot(*np.meshgrid(line, line)) < 3.0
    ratio = np.asarray(counted[..., 2])[inside].sum() / np.asarray(searched[..., 2])[inside].sum()
    assert ratio == pytest.approx(1, abs=0.01)


def test_what_cannot_be_is_named():
    with pytest.raises(ValueError, match=r"a lamp.s radius = 0 radians is outside \(0, 3.14159\]"):
        Lights.distant(0.3, 0.0, radius=0.0)
    with pytest.raises(ValueError, match=r"a lamp's radius = 2 is above pi/2 radians"):
        Scene(IRIS, lights=Lights.distant(0.3, 0.0, radius=2.0))
    for wrong, said in {
        "towards": (np.array([[0, 0, -2.0]]), "length of a lamp's direction = 2 is outside"),
        "irradiance": (-1.0, r"a lamp's irradiance = -1 is outside \[0, 1e\+06\]"),
        "tint": (np.array([1.0, np.nan, 1.0]), r"a lamp's tint = nan is outside \[0, 1e\+06\]"),
        "tint ": (np.array([1.0, -0.5, 1.0]), r"a lamp's tint = -0.5 is outside \[0, 1e\+06\]"),
        "distance": (-30.0, r"a lamp's distance = -30 mm is outside \[20, inf\) mm"),
        "distance ": (np.nan, r"a lamp's distance = nan mm is outside \[20, inf\) mm"),
        "radius": (np.ones(3), r"lights: radius has shape \(3,\); it must be \(1,\)"),
    }.items():
        one = {"towards": np.array([[0, 0, -1.0]]), "irradiance": 1.0}
        with pytest.raises(ValueError, match=said[1]):
            Lights(**{**one, wrong.strip(): said[0]})
    with pytest.raises(
        ValueError, match=r"have shapes \(2,\), \(3,\), \(1,\), \(1,\); each must be"
    ):
        Lights.distant([0.3, 0.4], [0.1, 0.2, 0.3])
    iris = IRIS.replace(stroma_thickness=0.0)
    with pytest.raises(ValueError, match="stroma_thickness = 0 mm leaves no concentrations"):
        Scene(iris, IrisMaps(stroma_depth=np.ones((4, 4))))


def test_one_number_stands_for_all_lights():
    """A lamp's default radius beside arrays, which once failed behind a cornea."""
    lights = Lights(np.array([[0, 0, -1.0], [0.6, 0, -0.8]]), np.ones(2))
    assert lights.radius.shape == (2,) and (lights.radius == 0.03).all()
    np.testing.assert_array_equal((lights + lights).radius, np.full(4, 0.03))


@pytest.mark.slow  # 20 s of compiling
def test_gradient_to_a_near_lamps_place(tables):
    """Aside; on the axis, where azimuths have none, it is finite."""

    @jax.jit
    def brightness(x, y):
        lights = Lights.points(jnp.stack([x, y, jnp.asarray(-60.0)]), 1.0)
        return shading.incident_flux(lights, EYE, tables, 41)[0, 2, 15:25, 18:28].sum()

    step, gradient = 1e-3, jax.jit(jax.grad(brightness))
    rise = float(brightness(20.0 + step, 10.0) - brightness(20.0 - step, 10.0)) / (2 * step)
    assert float(gradient(20.0, 10.0)) == pytest.approx(rise, rel=1e-3)
    assert np.isfinite(gradient(0.0, 0.0))


def test_lamps_within_a_jit():
    """Their radius is known there, their irradiance is not."""
    lights = Lights.distant(0.3, 0.0)
    made = jax.jit(lambda e: dataclasses.replace(lights, irradiance=e).irradiance)(jnp.ones(1))
    assert float(made[0]) == 1
