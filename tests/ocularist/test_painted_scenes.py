"""Pictures of painted irides: compositing by hand, what is kept, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from paintings import (
    BLACK,
    BLUE,
    CAMERA,
    EYE,
    GREEN,
    LAMP,
    RED,
    by_hand,
    coat,
    in_the_middle,
    picture,
    scene,
    spots,
    tables,
)

from common import counting
from irisjax.ocularist import composite
from irisjax.ocularist.coats import Painting, profile_of, prosthesis
from irisjax.ocularist.integrator import Painted
from irisjax.render.camera import Camera
from irisjax.render.environment import Environment
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.picture import draw
from irisjax.render.project import look
from irisjax.render.scene import Scene
from irisjax.render.separable import Separable


def test_a_clear_coat_changes_no_pixel():
    below = coat("base", colour=RED), coat("spots", 0.1, spots(0), BLUE)
    without, clear = picture(*below), picture(*below, coat("clear", 0.2, 0.0, GREEN))
    assert without.max() > 0.1
    np.testing.assert_array_equal(clear, without)


def test_an_opaque_coat_hides_all_below():
    top = coat("top", 0.2, 1.0, GREEN)
    below = coat("base", colour=RED), coat("spots", 0.1, spots(1), BLUE)
    alone, covered = picture(top), picture(*below, top)
    np.testing.assert_allclose(in_the_middle(covered), in_the_middle(alone), atol=1e-14)


@pytest.mark.parametrize("heights", [(0.1, 0.1, 0.1), (0.0, 0.15, 0.3)], ids=["equal", "apart"])
@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1)])
def test_uniform_coats_are_composed_as_the_equations_say(heights, order):
    kinds = [(1.0, RED), (0.6, GREEN), (0.3, BLUE)]
    stack = [kinds[i] for i in order]
    coats = [coat(str(i), h, *k) for i, (h, k) in enumerate(zip(heights, stack, strict=True))]
    ratio = in_the_middle(picture(*coats)) / in_the_middle(picture(coat("white", heights[2])))
    np.testing.assert_allclose(ratio, np.tile(by_hand(*stack[::-1]), (len(ratio), 1)), rtol=1e-9)


def test_single_precision(float32):
    eye = prosthesis().replace(sclera=None)
    tables = Illumination.build(eye, caustics=False, size=33)

    def drawn(*coats):
        painted = Painted(Painting(coats, profile_of(eye)))
        camera, lamp = Camera(size=(48, 36), width=13.0), Lights.distant(0.6, 2.2)
        return draw(Scene(None, eye=eye, lights=lamp, camera=camera, integrator=painted), tables)

    stack = (1.0, RED), (0.6, GREEN), (0.3, BLUE)
    coats = [coat(str(i), 0.1 * i, *k) for i, k in enumerate(stack)]
    # Less the cornea's mirror images, which a black iris has too.
    painted, white, bare = (
        drawn(*c) for c in (coats, [coat("white", 0.2)], [coat("bare", 0.2, colour=BLACK)])
    )
    assert painted.dtype == jnp.float32
    ratio = in_the_middle(np.asarray(painted - bare)) / in_the_middle(np.asarray(white - bare))
    np.testing.assert_allclose(ratio, np.tile(by_hand(*stack[::-1]), (len(ratio), 1)), rtol=1e-5)


def test_shadows_as_printed_blacken_what_lies_under_varnish():
    base, varnish = coat("base", colour=RED), coat("varnish", 0.1, 0.0)
    printed = picture(base, varnish, as_printed=True)
    np.testing.assert_allclose(in_the_middle(printed), 0, atol=1e-15)
    np.testing.assert_array_equal(picture(base, varnish), picture(base))
    half = coat("half", 0.1, 0.5, BLUE)
    ratio = in_the_middle(picture(base, half, as_printed=True)) / in_the_middle(picture(coat("w")))
    paint = np.asarray(BLUE)
    expected = 0.5 * paint + 0.5 * np.asarray(RED) * (0.5 * 0.5 * paint)
    np.testing.assert_allclose(ratio, np.tile(expected, (len(ratio), 1)), rtol=1e-9)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_no_pixel_is_brighter_than_white_paint(seed):
    rng, heights = np.random.default_rng(seed), (0.0, 0.12, 0.3)
    coats = [coat(str(i), h, spots(10 * seed + i), rng.random(3)) for i, h in enumerate(heights)]
    # Paint stands out over the root as its height lets it: white at each of them.
    white = np.max([picture(coat("white", h)) for h in heights], 0)
    drawn = picture(*coats)
    assert drawn.max() > 0.1 * white.max()
    assert (drawn <= white + 1e-12).all()
    assert drawn.min() >= -1e-12


STEPS = "opacity_at", "crossed", "paint_over", "light_under"


def test_a_coat_that_changes_is_painted_with_those_below_alone(monkeypatch):
    names = "base", "low", "middle", "top"
    made = scene(*(coat(n, 0.1 * i, spots(i), RED) for i, n in enumerate(names)))
    pixels = look(made.eye, made.camera).iris
    painting, parts = made.integrator.painting, (pixels, made.lights, made.eye)
    base = made.integrator.base(*parts, tables())
    layers = tuple(made.integrator.layers(base))
    done = counting(monkeypatch, **dict.fromkeys(STEPS, composite))

    def again(**changes):
        """Steps that a change of the middle coat takes."""
        painted = Painted(painting.replace("middle", **changes))
        done.update(dict.fromkeys(STEPS, 0))
        found = list(painted.layers(base, layers))[-1].state.radiance
        steps = tuple(done.values())
        whole = painted.illuminate(*parts, None, None, tables())
        np.testing.assert_allclose(found, whole, atol=1e-12)
        assert np.abs(np.asarray(found - layers[-1].state.radiance)).max() > 1e-3
        return steps

    # The light on the middle coat has not changed; what lies above is not painted again.
    assert again(colour=jnp.asarray(BLUE)) == (0, 0, 3, 2)
    assert again(opacity=coat("other", 0.0, spots(9)).opacity) == (1, 1, 3, 2)
    done.update(dict.fromkeys(STEPS, 0))
    assert list(made.integrator.layers(base, layers))[-1] is layers[-1]
    assert not any(done.values())


def test_painted_scenes_have_colours_and_no_spectra():
    painted = scene(coat("base", colour=RED))
    with pytest.raises(ValueError, match="leave out the wavelengths"):
        draw(painted.replace(wavelengths=(500.0, 600.0)), tables())
    with pytest.raises(ValueError, match="the iris is painted"):
        _ = painted.tissue


def test_a_scene_without_an_iris_needs_paint():
    with pytest.raises(ValueError, match="an integrator of paint"):
        Scene(None, eye=EYE, lights=LAMP, camera=CAMERA, integrator=Separable())


def test_derivatives_by_colour_and_opacity_are_those_of_finite_differences():
    shape = jnp.asarray(spots(3))
    base, haze = coat("base", colour=RED), coat("haze", 0.2, spots(4), BLUE)
    painting = scene(base, coat("spots", 0.1, shape), haze).integrator.painting

    def mean(given):
        colour, thickness, height = given
        changed = painting.replace("spots", colour=colour, opacity=thickness * shape, height=height)
        return draw(scene(*changed.coats), tables()).mean()

    at = jnp.asarray(GREEN), jnp.asarray(0.7), jnp.asarray(0.1)
    slopes, step = jax.grad(mean)(at), 1e-5
    for i in range(2):
        for j in np.ndindex(at[i].shape):
            move = jnp.zeros_like(at[i]).at[j].set(step)
            ends = [mean((*at[:i], at[i] + s * move, *at[i + 1 :])) for s in (1.0, -1.0)]
            numeric = float(ends[0] - ends[1]) / (2 * step)
            assert abs(numeric) > 1e-4
            assert float(slopes[i][j]) == pytest.approx(numeric, rel=1e-6)
    assert np.isfinite(float(slopes[2]))


def test_white_paint_is_a_white_sheet():
    """Without a cornea: 1 in irradiance π from straight ahead, its cosine from aside, and half of
    it for half of the light.
    """
    bare_eye = EYE.replace(cornea=None, iris_slope=None)
    for polar, irradiance in ((0.0, np.pi), (0.7, np.pi), (0.0, np.pi / 2)):
        sheet = Painted(Painting((coat("white"),), profile_of(bare_eye)))
        lamp = Lights.distant(polar, 0.4, irradiance)
        drawn = draw(Scene(None, eye=bare_eye, lights=lamp, camera=CAMERA, integrator=sheet))
        seen = in_the_middle(np.asarray(drawn)) / (irradiance / np.pi * np.cos(polar))
        np.testing.assert_allclose(seen, 1, rtol=1e-3)


LAMPS = 64


def test_white_paint_in_light_from_all_round_is_no_brighter_than_that():
    """As bright without a cornea; behind one that mirrors some of it, and lets none in beyond the
    limbus, darker.
    """

    def drawn(eye, tables):
        painted = Painted(Painting((coat("white"),), profile_of(eye)))
        around = Environment.uniform()
        lit = Scene(
            None,
            eye=eye,
            lights=None,
            environment=around,
            camera=CAMERA,
            integrator=painted,
            environment_lights=LAMPS,
        )
        return in_the_middle(np.asarray(draw(lit, tables)))

    # A lamp stands for 1/64 of the hemisphere, the outermost for cells that a tilted iris halves.
    np.testing.assert_allclose(drawn(EYE.replace(cornea=None), None), 1, rtol=1 / LAMPS)
    behind = drawn(EYE, tables())
    assert behind.min() > 0.4
    assert behind.max() < 1
