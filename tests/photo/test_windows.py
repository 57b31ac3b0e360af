"""Windows of the iris: their means, and the renderer as a matrix."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from window_scenes import BASE, CAMERA, EYE, LIGHTS, POSE, QUICK, SHAPE, VIEW, maps, windows

from irisjax.photo.average import TURNS, average_maps
from irisjax.photo.lamps import Lighting
from irisjax.photo.unrefracted import LUMINANCE
from irisjax.photo.window_pixels import (
    ANGLES,
    MARGIN,
    OUTER_MARGIN,
    RINGS,
    choose_pixels,
    iris_alone,
)
from irisjax.photo.windows import windows_of
from irisjax.render.environment import Environment
from irisjax.render.illumination import Illumination
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.scene import Scene

OTHER = BASE.replace(
    eumelanin=jnp.asarray(1.0), pheomelanin=jnp.asarray(0.3), abl_fraction=jnp.asarray(0.7)
)


def _rendered(iris, integrator):
    scene = Scene(iris, maps(), eye=EYE, lights=LIGHTS, camera=CAMERA, integrator=integrator)
    return np.asarray(scene.render(caustics=False))


def _means_are_the_renderers(integrator, rtol):
    """No window has more pixels than are taken of it, so every one of the picture counts."""
    found = windows(_rendered(OTHER, integrator), integrator=integrator)
    assert found.present.all()
    np.testing.assert_allclose(found.radiance(OTHER), found.colour, rtol=rtol)
    assert np.ptp(found.colour, axis=0).min() > 0.01 * found.colour.mean()
    return found


@pytest.mark.heavy  # compiles the renderer
def test_a_windows_radiance_is_the_mean_of_the_rendered_pixels():
    found = _means_are_the_renderers(QUICK, 1e-6)
    assert len(found.colour) == ANGLES * RINGS
    assert found.thickness_response(BASE) > 0


@pytest.mark.heavy  # compiles the renderer
def test_a_freckles_darkness_is_the_rendered_one():
    """The ratio hardly depends on the direction: within a hundredth."""
    shares = np.array([0.0, 0.1, 0.5, 1.0])
    found = windows(np.ones((*SHAPE, 3))).freckle_response(BASE, shares)
    assert found[0] == 1
    assert (np.diff(found) < 0).all()
    bare = maps().replace(stroma_depth=None)
    seen = iris_alone(POSE)
    pictures = [
        np.asarray(
            Scene(
                BASE,
                bare.replace(freckles=jnp.full((4, 4), share)),
                eye=EYE,
                lights=LIGHTS,
                camera=CAMERA,
                integrator=QUICK,
            ).render(caustics=False)
        )[seen]
        @ LUMINANCE
        for share in (0.0, 0.5)
    ]
    lit = pictures[0] > 0
    # The median: lamps are mirrored in both.
    assert np.median(pictures[1][lit] / pictures[0][lit]) == pytest.approx(found[2], abs=0.01)


@pytest.mark.slow
def test_the_same_by_radiative_transfer():
    # Its nodes are placed for the iris that it begins with: less than half of a ring's noise.
    _means_are_the_renderers(RadiativeIntegrator(), 0.002)


@pytest.mark.heavy
@pytest.mark.parametrize("room", [True, False], ids=["a room beside lamps", "a studio alone"])
def test_light_from_all_round_is_the_renderers(room):
    """What stands so low that the cornea folds it, and what the tear film mirrors, count too."""
    around = Environment.uniform(0.4) if room else Environment.studio(32)
    lamps = LIGHTS if room else None
    scene = Scene(OTHER, maps(), EYE, lamps, around, CAMERA, integrator=QUICK)
    assert scene.grazing()
    tables = scene.tables()
    picture = np.asarray(scene.render(tables))
    chosen = choose_pixels(picture, iris_alone(POSE), VIEW, EYE, None if room else around)
    low, high = float(EYE.pupil_radius) + MARGIN, 5.5 - OUTER_MARGIN
    assert low < chosen.radius.min() and chosen.radius.max() < high
    lights = Lighting(lamps, None if room else around).lights()
    made = windows_of(chosen, EYE, BASE, maps(), lights, QUICK, tables, room)
    np.testing.assert_allclose(made.radiance(OTHER, 0.4), made.colour, rtol=1e-6)


@pytest.mark.heavy
def test_hidden_pixels_do_not_count():
    picture = np.random.default_rng(0).uniform(0.1, 0.2, (*SHAPE, 3))
    hidden = np.zeros(SHAPE, bool)
    hidden[:, : SHAPE[1] // 2] = True
    whole, part = windows(picture), windows(np.where(hidden[..., None], 50.0, picture), ~hidden)
    assert whole.present.all()
    assert 0.3 < part.present.mean() < 0.7
    assert part.colour.max() < 0.2


@pytest.mark.heavy
def test_windows_in_the_shade_do_not_count():
    light = np.random.default_rng(0).uniform(0.18, 0.2, (*SHAPE, 3))
    row, column = np.indices(SHAPE)
    shade = np.hypot(row - 44.5, column - 80) < 20
    found = windows(np.where(shade[..., None], 0.3 * light, light))
    assert 0.05 < 1 - found.present.mean() < 0.4
    assert found.colour[found.present].min() > 0.1


@pytest.mark.heavy
def test_the_light_tells_the_shade_where_it_is_known():
    """A part that is dark of itself counts; what lies in the shade does not, however bright."""
    row, column = np.indices(SHAPE)
    spot = np.hypot(row - 44.5, column - 80) < 20
    even, spotted = np.full(SHAPE, 0.2), np.where(spot, 0.05, 0.2)
    seen = iris_alone(POSE)

    def present(picture, light=None):
        colours = np.repeat(picture[..., None], 3, -1)
        return choose_pixels(colours, seen, VIEW, EYE, light=light).present

    shaded = ~present(spotted)
    assert shaded.any()
    assert present(spotted, even).all()
    np.testing.assert_array_equal(present(even, spotted), ~shaded)


@pytest.mark.heavy
def test_features_of_an_average_iris_have_no_place():
    """Turned maps give the same windows where every pixel sees them at all turns; maps that stand
    still do not.
    """
    chosen = choose_pixels(np.ones((*SHAPE, 3)), iris_alone(POSE), VIEW, EYE)
    seen = jax.tree.map(lambda x: jnp.repeat(x, TURNS, -1), chosen.seen)
    every = chosen._replace(seen=seen, window=np.repeat(chosen.window, TURNS))
    usual = average_maps(EYE)
    turned = jax.tree.map(lambda m: jnp.roll(m, 5 * m.shape[0] // TURNS, 0), usual)
    tables = Illumination.build(EYE, caustics=False)

    def radiance(maps, turns, seen=every):
        made = windows_of(seen, EYE, BASE, maps, LIGHTS, QUICK, tables, turns=turns)
        return np.asarray(made.radiance(OTHER))

    np.testing.assert_allclose(radiance(turned, TURNS), radiance(usual, TURNS), rtol=1e-5)
    chance = np.log(radiance(usual, TURNS, chosen) / radiance(usual, TURNS))
    assert np.sqrt(np.mean(chance**2)) < 0.015  # a third of what irides differ by, 0.05
    still = np.abs(radiance(turned, 1) / radiance(usual, 1) - 1)
    assert np.median(still) > 0.01
    assert float(usual.relief.max()) > 0.02


@pytest.mark.heavy
def test_too_little_iris_is_refused():
    with pytest.raises(ValueError, match="only 0 windows of the iris are free"):
        windows(np.ones((*SHAPE, 3)), np.zeros(SHAPE, bool))


def test_the_iris_alone_is_a_disc_within_the_limbus():
    alone = iris_alone(POSE)
    row, column = np.indices(SHAPE)
    away = np.hypot(row - 44.5, column - 44.5) * 13 / 90
    assert alone[(away > 2.6) & (away < 4)].all()
    assert not alone[away > 6].any()
