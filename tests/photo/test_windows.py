"""Windows of the iris: their means, and the renderer as a matrix."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from window_scenes import BARE, BASE, CAMERA, EYE, LIGHTS, QUICK, SHAPE, maps, picture_of, view

from irisjax.anatomy.eye import Eye
from irisjax.photo.clone import SEARCHED, usual_iris
from irisjax.photo.light import Lighting
from irisjax.photo.pigments import (
    FREE_NAMES,
    PRIOR_COVARIANCE,
    iris_of_concentrations,
    parameter_values,
)
from irisjax.photo.windows import (
    ANGLES,
    MARGIN,
    OUTER_MARGIN,
    RINGS,
    TURNS,
    average_maps,
    choose_pixels,
    iris_alone,
    make_windows,
)
from irisjax.render.bands import colour_bands
from irisjax.render.environment import Environment
from irisjax.render.integrator import solve_response
from irisjax.render.picture import draw
from irisjax.render.project import project_visible
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.scene import ENVIRONMENT_LIGHTS, Scene
from irisjax.render.shading import scale_ranges

OTHER = BASE.replace(
    eumelanin=jnp.asarray(1.0), pheomelanin=jnp.asarray(0.3), abl_fraction=jnp.asarray(0.7)
)
alone = functools.cache(lambda bare=False: iris_alone(view(bare)))


def chosen(picture, clear=True, **known):
    """Windows' pixels of a picture (rows, columns) or (rows, columns, 3)."""
    picture = np.asarray(picture, float)
    colours = np.repeat(picture[..., None], 3, -1) if picture.ndim == 2 else picture
    return choose_pixels(colours, alone() & clear, view(), EYE, **known)


TRACED = []
radiance_of = eqx.filter_jit(lambda w, iris, room: TRACED.append(1) or w.radiance(iris, room))


def _means_are_the_renderers(found, rtol):
    """No window has more pixels than are taken of it, so every one of the picture counts."""
    assert found.present.all()
    np.testing.assert_allclose(radiance_of(found, OTHER, jnp.asarray(0.4)), found.colour, rtol=rtol)
    assert np.ptp(found.colour, axis=0).min() > 0.01 * found.colour.mean()


def test_the_iris_alone_is_a_disc_within_the_limbus():
    row, column = np.indices(SHAPE)
    away = np.hypot(row - 44.5, column - 44.5) * 13 / 90
    for seen in (alone(), alone(True)):
        assert seen[(away > 2.6) & (away < 4)].all() and not seen[away > 6].any()


@functools.cache
def lamps():
    """Return as many lamps as stand for a room, so that one program serves both."""
    return Environment.studio(32).to_lights(ENVIRONMENT_LIGHTS)


@pytest.fixture(scope="module")
def pixels():
    """Choose pixels of a picture by lamps in a room; the eye has no cornea, as the tables of one
    take seconds.
    """
    room = Environment.uniform(0.4)
    scene = Scene(OTHER, maps(), BARE, lamps(), room, CAMERA, integrator=QUICK)
    return choose_pixels(picture_of(view(True), scene), alone(True), view(True), BARE)


def windows_by(lights, pixels, room=False):
    return make_windows(pixels, BARE, BASE, maps(), lights, QUICK, None, room)


@pytest.fixture(scope="module")
def lit(pixels):
    return windows_by(Lighting(lamps()).lights(), pixels, room=True)


def test_a_windows_radiance_is_the_mean_of_the_rendered_pixels(lit):
    _means_are_the_renderers(lit, 1e-6)
    assert len(lit.colour) == ANGLES * RINGS


def test_photographs_by_any_light_share_the_programs_of_their_search(pixels, lit):
    dark, bright = (radiance_of(lit, OTHER, jnp.asarray(room)) for room in (0.0, 0.4))
    assert (bright > dark).all()
    traced, other = len(TRACED), windows_by(LIGHTS, pixels)
    dark, same = (radiance_of(other, OTHER, jnp.asarray(room)) for room in (0.0, 0.4))
    np.testing.assert_array_equal(dark, same)  # there is no room
    assert len(TRACED) == traced


def test_thickness_brightens_and_freckles_darken(lit):
    assert lit.thickness_response(BASE) > 0
    # Two at a time, as for the thickness, so that the same programs serve.
    darkness = [lit.freckle_response(BASE, np.array([0.0, s]))[1] for s in (0.0, 0.1, 0.5, 1.0)]
    assert darkness[0] == 1 and (np.diff(darkness) < 0).all()
    # It is that of a bare iris whether or not one of the shares is none.
    dark = lit.freckle_response(BASE, np.array([0.5, 1.0]))
    assert dark[1] == pytest.approx(darkness[3], rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("room", [True, False], ids=["a room beside lamps", "a studio alone"])
def test_the_same_by_radiative_transfer(room):
    # Its nodes are placed for the iris that it begins with: less than half of a ring's noise.
    around = Environment.uniform(0.4) if room else Environment.studio(32)
    (lamps, beside), integrator = (LIGHTS, None) if room else (None, around), RadiativeIntegrator()
    scene = Scene(OTHER, maps(), EYE, lamps, around, CAMERA, integrator=integrator)
    tables = scene.tables()
    even = np.ones(SHAPE)  # windows in the shade of the limbus count here as well
    pixels = choose_pixels(np.asarray(draw(scene, tables)), alone(), view(), EYE, beside, even)
    lights = Lighting(lamps, beside).lights()
    found = make_windows(pixels, EYE, BASE, maps(), lights, integrator, tables, room)
    _means_are_the_renderers(found, 0.002)


def test_what_the_tears_mirror_of_a_uniform_room_is_their_veil():
    pixels = chosen(np.ones(SHAPE), environment=Environment.uniform(0.4))
    np.testing.assert_allclose(pixels.mirrored, 0.4 * pixels.veil[:, None] * np.ones(3), rtol=1e-6)
    assert pixels.veil.min() > 0.01
    low, high = float(EYE.pupil_radius) + MARGIN, 5.5 - OUTER_MARGIN
    away = np.hypot(*np.asarray(pixels.seen.point)[:2])[pixels.window < ANGLES * RINGS]
    assert low < away.min() and away.max() < high


def test_hidden_pixels_do_not_count():
    picture = np.random.default_rng(0).uniform(0.1, 0.2, (*SHAPE, 3))
    hidden = np.zeros(SHAPE, bool)
    hidden[:, : SHAPE[1] // 2] = True
    whole, part = chosen(picture), chosen(np.where(hidden[..., None], 50.0, picture), ~hidden)
    assert whole.present.all() and 0.3 < part.present.mean() < 0.7
    assert part.colour.max() < 0.2
    with pytest.raises(ValueError, match="only 0 windows of the iris are free"):
        chosen(picture, False)


def test_windows_in_the_shade_do_not_count():
    """By the light where it is known: a part that is dark of itself counts, and what lies in the
    shade or beside it does not, however bright.
    """
    row, column = np.indices(SHAPE)
    spot = np.hypot(row - 44.5, column - 80) < 20
    even, spotted = np.full(SHAPE, 0.2), np.where(spot, 0.05, 0.2)
    shaded = ~chosen(spotted).present
    assert 0.05 < shaded.mean() < 0.4
    assert chosen(spotted, light=even).present.all()
    dark = np.argwhere(shaded.reshape(RINGS, ANGLES))
    ring, angle = np.indices((RINGS, ANGLES))
    beside = [(abs(ring - r) <= 1) & (abs((angle - a + 1) % ANGLES - 1) <= 1) for r, a in dark]
    lit = ~np.any(beside, axis=0).ravel()
    np.testing.assert_array_equal(chosen(even, light=spotted).present, lit)
    hidden = chosen(even, ~spot, light=spotted)  # shade that a highlight hides is shade
    assert hidden.present.any() and not (hidden.present & ~lit).any()


@pytest.mark.slow
def test_features_of_an_average_iris_have_no_place():
    """Turned maps give the same windows where every pixel sees them at all turns; maps that stand
    still do not.
    """
    # Windows hold as many pixels here as those that are taken of a photograph.
    camera = dataclasses.replace(CAMERA, size=(150, 150))
    view = project_visible(EYE, camera)
    pixels = choose_pixels(np.ones((150, 150, 3)), iris_alone(view), view, EYE)
    seen = jax.tree.map(lambda x: jnp.repeat(x, TURNS, -1), pixels.seen)
    every = pixels._replace(seen=seen, window=np.repeat(pixels.window, TURNS))
    usual = average_maps(EYE)
    moved = jax.tree.map(lambda m: jnp.roll(m, 5 * m.shape[0] // TURNS, 0), usual)
    tables = Scene(BASE, eye=EYE, lights=LIGHTS).tables()

    def radiance(maps, turned, seen=every):
        made = make_windows(seen, EYE, BASE, maps, LIGHTS, QUICK, tables, turned=turned)
        return np.asarray(made.radiance(OTHER))

    np.testing.assert_allclose(radiance(moved, True), radiance(usual, True), rtol=1e-5)
    chance = np.log(radiance(usual, True, pixels) / radiance(usual, True))
    assert np.sqrt(np.mean(chance**2)) < 0.015  # a third of what irides differ by, 0.05
    still = np.abs(radiance(moved, False) / radiance(usual, False) - 1)
    assert np.median(still) > 0.01
    assert float(usual.relief.max()) > 0.02


@pytest.mark.peer
def test_the_table_of_a_search_by_radiative_transfer_errs_less_than_windows_do():
    """The table errs by at most half of the least error that a window is assumed to have, for irides
    of the prior.
    """
    maps = average_maps(Eye())
    base, half = usual_iris(jnp.mean(maps.stroma_depth)), 0.5 * np.sqrt(np.diag(PRIOR_COVARIANCE))
    ranges = scale_ranges(base, maps.replace(freckles=None))
    known = Eye().aqueous_index, colour_bands(cornea=Eye().cornea), ranges
    made = RadiativeIntegrator(**SEARCHED).prepare(base, *known)
    for z in np.random.default_rng(1).normal(size=(6, len(FREE_NAMES))):
        iris = iris_of_concentrations(parameter_values(z), base)
        assert solve_response(made, iris, *known).error < half.min()
