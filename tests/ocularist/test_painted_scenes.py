"""Pictures of painted irides: compositing by hand, where coats are seen and cast shadows, what is
kept, derivatives.
"""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from common import counting
from irisjax.ocularist import integrator
from irisjax.ocularist.coats import LIMBUS, SLOPE, Coat, Painting, profile_of, prosthesis
from irisjax.ocularist.integrator import Painted
from irisjax.ocularist.painting import studio
from irisjax.render.camera import Camera
from irisjax.render.environment import Environment
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.picture import draw
from irisjax.render.project import trace_iris
from irisjax.render.scene import Scene
from irisjax.render.separable import Separable
from irisjax.render.shading import IrisModel

EYE = prosthesis().replace(sclera=None, cornea=None)
FLAT = EYE.replace(iris_slope=None)
CAMERA = Camera(size=(128, 96), width=9.0, distance=1e4)
PITCH = 128 / 9.0  # pixels a mm
SOME = np.arange(24, 128 * 96, 48, dtype=np.int32)  # 256 pixels all over the picture
LAMP = Lights.distant(0.6, 2.2)
SIZE = 64
WHITE, BLACK = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
RED, GREEN, BLUE = (0.7, 0.2, 0.1), (0.3, 0.6, 0.2), (0.1, 0.2, 0.8)


@pytest.fixture(autouse=True)
def _coarse_shadows(monkeypatch):
    """Maps of light a quarter as fine as usual: still finer than the opacities here."""
    monkeypatch.setattr(integrator, "SHADOW", 96)


def in_chamber(polar):
    """Direction of light from polar angle `polar` towards +x, by Snell's law."""
    sine = np.sin(polar) / 1.336
    return np.array([-sine, 0.0, np.sqrt(1 - sine**2)])


@functools.cache
def tables():
    """Light as behind a flat cornea, whose direction is known by hand, up to 1 radian."""
    directions = np.stack([in_chamber(0.05 * k) for k in range(21)])
    flux = np.broadcast_to(directions[:, None, None], (21, 5, 5, 3))
    return Illumination(jnp.asarray(flux), EYE.iris_radius, 1.0)


def iris_pixels(index=SOME, polar=0.0, azimuth=0.0):
    camera = dataclasses.replace(CAMERA, polar=jnp.asarray(polar), azimuth=jnp.asarray(azimuth))
    return trace_iris(index, EYE, camera)


def coat(name, height=0.0, opacity=1.0, colour=WHITE):
    everywhere = jnp.asarray(np.broadcast_to(opacity, (SIZE, SIZE)), float)
    return Coat(name, everywhere, jnp.asarray(colour), jnp.asarray(height))


def scene(*coats, eye=EYE, lights=LAMP, camera=CAMERA, as_printed=False, **parts):
    painted = Painted(Painting(coats, profile_of(eye)), as_printed)
    return Scene(None, eye=eye, lights=lights, camera=camera, integrator=painted, **parts)


def picture(*coats, view=(), lights=LAMP, **parts):
    """Radiance of the paint at pixels, in the light of the tables."""
    painted = scene(*coats, **parts).integrator
    seen = painted.paint(painted.base(iris_pixels(*view), lights, EYE, tables()))
    return np.asarray(seen).T


FEW = {"size": (16, 16), "width": 13.0}  # a camera's, which is made in the precision of a test


def in_the_middle(drawn, size=CAMERA.size, width=9.0, index=SOME):
    """Pixels well inside the iris."""
    rows, columns = np.divmod(index, size[0])
    x, y = columns + 0.5 - size[0] / 2, rows + 0.5 - size[1] / 2
    r = np.hypot(x, y) * width / size[0]
    return np.asarray(drawn).reshape(-1, 3)[(r > 3) & (r < 4.6)]


def spots(seed, count=12):
    """Soft random opacity."""
    rng = np.random.default_rng(seed)
    at, wide = rng.uniform(-5, 5, (2, count)), rng.uniform(0.4, 1.5, count)
    each = zip(*at, wide, strict=True)
    return 1 - np.prod([1 - dot(x, y, w, 0.8) for x, y, w in each], axis=0)


def texels():
    line = ((2 * np.arange(SIZE) + 1) / SIZE - 1) * LIMBUS
    return np.meshgrid(line, -line)


def dot(x, y, wide=0.3, opacity=1.0):
    u, v = texels()
    return opacity * np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * wide**2))


def by_hand(*coats):
    """Eq. 1 and Eq. 2 from the uppermost down, over a white coat's picture; (opacity, colour)."""
    light, left, seen = np.ones(3), 1.0, np.zeros(3)
    for opacity, colour in coats:
        seen = seen + left * opacity * np.asarray(colour) * light
        light = light * (1 - opacity * (1 - np.asarray(colour)))
        left *= 1 - opacity
    return seen


KINDS = (1.0, RED), (0.6, GREEN), (0.3, BLUE)


@pytest.mark.parametrize(
    ("heights", "stack"),
    [((0.1, 0.1, 0.1), KINDS), ((0.0, 0.15, 0.3), (KINDS[2], *KINDS[:2]))],
    ids=["equal", "apart"],
)
def test_uniform_coats_are_composed_as_the_equations_say(heights, stack):
    coats = [coat(str(i), h, *k) for i, (h, k) in enumerate(zip(heights, stack, strict=True))]
    ratio = in_the_middle(picture(*coats)) / in_the_middle(picture(coat("white", heights[2])))
    np.testing.assert_allclose(ratio, np.tile(by_hand(*stack[::-1]), (len(ratio), 1)), rtol=1e-9)


def test_single_precision(float32):
    eye, lamp = prosthesis().replace(sclera=None, cornea=None), Lights.distant(0.6, 2.2)
    white = (1.0, WHITE)  # uppermost it hides what lies below
    painted, plain = (
        draw(scene(*(coat(str(i), 0.1 * i, *k) for i, k in enumerate(kinds)), eye=eye, lights=lamp,
                   camera=Camera(**FEW)))
        for kinds in (KINDS, (*KINDS[:2], white))
    )  # fmt: skip
    assert painted.dtype == jnp.float32
    ratio = np.divide(*(in_the_middle(p, **FEW, index=np.arange(256)) for p in (painted, plain)))
    np.testing.assert_allclose(ratio, np.tile(by_hand(*KINDS[::-1]), (len(ratio), 1)), rtol=1e-5)


def test_shadows_as_printed_blacken_what_lies_under_varnish():
    base, varnish = coat("base", colour=RED), coat("varnish", 0.1, 0.0)
    printed = picture(base, varnish, as_printed=True)
    np.testing.assert_allclose(in_the_middle(printed), 0, atol=1e-15)
    np.testing.assert_array_equal(picture(base, varnish), picture(base))
    half = coat("half", 0.1, 0.5, BLUE)
    drawn, white = picture(base, half, as_printed=True), picture(coat("white"))
    ratio = in_the_middle(drawn) / in_the_middle(white)
    paint = np.asarray(BLUE)
    expected = 0.5 * paint + 0.5 * np.asarray(RED) * (0.5 * 0.5 * paint)
    np.testing.assert_allclose(ratio, np.tile(expected, (len(ratio), 1)), rtol=1e-9)


def test_no_pixel_is_brighter_than_white_paint():
    rng, heights = np.random.default_rng(0), (0.0, 0.12, 0.3)
    coats = [coat(str(i), h, spots(i), rng.random(3)) for i, h in enumerate(heights)]
    white = picture(*(coat(str(h), h) for h in heights))  # in its soft edges as opaque
    drawn = picture(*coats)
    assert drawn.max() > 0.1 * white.max()
    assert (drawn <= white + 1e-12).all()
    assert drawn.min() >= -1e-12


STEPS = "_opacity_at", "_crossed", "_paint_over", "_light_under"


def test_a_coat_that_changes_is_painted_with_those_below_alone(monkeypatch):
    names = "base", "low", "middle", "top"
    made = scene(*(coat(n, 0.1 * i, spots(i), RED) for i, n in enumerate(names)))
    painting = made.integrator.painting
    base = made.integrator.base(iris_pixels(), LAMP, EYE, tables())
    done, steps = counting(monkeypatch, **dict.fromkeys(STEPS, integrator)), {}
    first = made.integrator.paint(base, steps)

    def again(**changes):
        """Steps that a change of the middle coat takes."""
        painted = Painted(painting.replace("middle", **changes))
        done.update(dict.fromkeys(STEPS, 0))
        found = painted.paint(base, dict(steps))
        counts = tuple(done.values())
        front = IrisModel(EYE, None, None)
        whole = painted.illuminate(iris_pixels(), LAMP, front, tables(), None)
        np.testing.assert_allclose(found, whole, atol=1e-12)
        assert np.abs(np.asarray(found - first)).max() > 1e-3
        return counts

    # The light on the middle coat has not changed; what lies above is not painted again.
    assert again(colour=jnp.asarray(BLUE)) == (0, 0, 3, 2)
    assert again(opacity=coat("other", 0.0, spots(9)).opacity) == (1, 1, 3, 2)
    done.update(dict.fromkeys(STEPS, 0))
    assert made.integrator.paint(base, steps) is first
    assert not any(done.values())


def test_painted_scenes_have_colours_and_no_spectra():
    painted = scene(coat("base", colour=RED), eye=FLAT, camera=Camera(**FEW))
    with pytest.raises(ValueError, match="leave out the wavelengths"):
        draw(painted.replace(wavelengths=(500.0, 600.0)))
    with pytest.raises(ValueError, match="the iris is painted"):
        _ = painted.tissue
    with pytest.raises(ValueError, match="an integrator of paint"):
        Scene(None, eye=EYE, lights=LAMP, camera=CAMERA, integrator=Separable())


def test_derivatives_by_colour_and_opacity_are_those_of_finite_differences():
    shape = jnp.asarray(spots(3))
    coats = coat("base", colour=RED), coat("spots", 0.1, shape), coat("haze", 0.2, spots(4), BLUE)
    made = scene(*coats)
    painting = made.integrator.painting
    base = made.integrator.base(iris_pixels(), LAMP, EYE, tables())

    @jax.jit
    @jax.value_and_grad
    def mean(given):
        colour, thickness, height = given
        changed = painting.replace("spots", colour=colour, opacity=thickness * shape, height=height)
        return Painted(changed).paint(base).mean()

    at = jnp.asarray(GREEN), jnp.asarray(0.7), jnp.asarray(0.1)
    slopes, step = mean(at)[1], 1e-5
    for i in range(2):
        for j in np.ndindex(at[i].shape):
            move = jnp.zeros_like(at[i]).at[j].set(step)
            ends = [mean((*at[:i], at[i] + s * move, *at[i + 1 :]))[0] for s in (1.0, -1.0)]
            numeric = float(ends[0] - ends[1]) / (2 * step)
            assert abs(numeric) > 1e-4
            assert float(slopes[i][j]) == pytest.approx(numeric, rel=1e-6)
    assert np.isfinite(float(slopes[2]))


def test_where_no_light_arrives_the_derivative_by_it_is_a_number():
    """The derivative was NaN in every picture with a place in the shade."""
    painted, pixels = scene(coat("base")).integrator, iris_pixels(SOME[:8])
    half_dark = eqx.tree_at(lambda t: t.flux, tables(), tables().flux.at[:, :3].set(0.0))

    @jax.jit
    @jax.grad
    def slope(irradiance):
        lamp = Lights.distant(0.6, 2.2, irradiance)
        return painted.paint(painted.base(pixels, lamp, EYE, half_dark)).sum()

    assert np.isfinite(float(slope(3.0)))


def test_white_paint_is_a_white_sheet():
    """Without a cornea: 1 in irradiance π from straight ahead, its cosine from aside, half of it
    for half of the light, and as bright as light from all round.
    """
    room = Environment.uniform().to_lights(7)  # on a facing surface 0.6 % brighter than the room

    def seen(lights):
        drawn = draw(scene(coat("white"), eye=FLAT, lights=lights, camera=Camera(**FEW)))
        return in_the_middle(drawn, **FEW, index=np.arange(256))

    for polar, irradiance in ((0.7, np.pi), (0.0, np.pi / 2)):
        lamp = Lights.distant(np.full(7, polar), 0.4, irradiance / 7)
        lamp = dataclasses.replace(lamp, tint=room.tint)  # one program for all lights
        np.testing.assert_allclose(seen(lamp) / (irradiance / np.pi * np.cos(polar)), 1, rtol=1e-3)
    np.testing.assert_allclose(seen(room), 1, rtol=1 / 32)


def window(x, y):
    """Every other pixel of 32 x 32 round a place, in pixels right of and above the middle."""
    columns = np.round(63.5 + x) + np.arange(-15, 17, 2)
    rows = np.round(47.5 - y) + np.arange(-15, 17, 2)
    return (rows[:, None] * 128 + columns).ravel().astype(np.int32)


def centroid(values, index):
    return np.array([(values * at).sum() / values.sum() for at in (index % 128, index // 128)])


def test_dots_on_high_coats_move_against_the_base():
    """A distant camera sees a point (0, 0, -height) moved by its own right and up."""
    x, y, height, view = 2.8, -0.7, 0.3, (0.5, 1.0)
    right, up = map(np.asarray, Camera(*view).axes()[1:])
    place = np.array([x, y, SLOPE * (np.hypot(x, y) - 1.9)])  # from the middle of the pupil
    seen = window(PITCH * place @ right, PITCH * place @ up)
    low, high = (
        centroid(picture(coat("dot", h, dot(x, y)), view=(seen, *view))[:, 0], seen)
        for h in (0.0, height)
    )
    expected = -height * PITCH * np.array([right[2], -up[2]])
    assert np.linalg.norm(expected) > 1.5
    np.testing.assert_allclose(high - low, expected, atol=0.1)


def test_shadows_fall_aside_from_the_lamp():
    x, y, height = -2.9, 1.2, 0.3
    at = window(PITCH * x, PITCH * y)
    base, faint = coat("base", 0.1), coat("dot", 0.1 + height, dot(x, y, 0.2, 0.02), BLACK)

    def shadow(polar):
        at, down, bent = (x, y), height, in_chamber(polar)
        for _ in range(10):  # and on along the cone's fall under the shadow
            at = np.array([x, y]) + bent[:2] / bent[2] * down
            down = height + SLOPE * (np.hypot(*at) - np.hypot(x, y))
        return at

    def seen(polar):
        lights = Lights.distant(polar, 0.0)
        lit, dotted = (
            picture(*c, view=(at,), lights=lights)[:, 0] for c in ([base], [base, faint])
        )
        return centroid(np.where(lit > 0, 1 - dotted / np.where(lit > 0, lit, 1.0), 0.0), at)

    # The dot is so faint that it and its shadow, each as dark, add up: half-way between the two.
    expected = PITCH * (shadow(0.9) - shadow(0.0)) / 2 * [1, -1]
    assert abs(expected[0]) > 1.5
    np.testing.assert_allclose(seen(0.9) - seen(0.0), expected, atol=0.1)


def test_coats_near_each_other_are_lit_together(monkeypatch):
    shapes = [spots(seed) for seed in (5, 6, 7)]
    kinds = zip((0.1, 0.11, 0.12), shapes, (RED, GREEN, BLUE), strict=True)
    coats = [coat(str(i), *kind) for i, kind in enumerate(kinds)]
    together = picture(*coats)
    monkeypatch.setattr(integrator, "NEAR", -1.0)
    apart = picture(*coats)
    texel = 2 * LIMBUS / SIZE
    steepest = max(np.hypot(*np.gradient(s, texel)).max() for s in shapes)
    # Light and sight, 45° from the normal at most, cross paint 0.03 mm away that much aside of
    # each other, and the lowest coat has two above it. Light maps round by a texel's share.
    bound = 2 * steepest * (0.03 * 2) * picture(coat("white", 0.12)).max()
    assert 0 < np.abs(together - apart).max() < bound


def test_a_painting_is_shown_on_the_eye_it_was_made_for():
    painting = Painting((coat("white", 0.1),), profile_of(EYE))
    assert studio(painting, EYE).eye is EYE
    wider = EYE.replace(pupil_radius=3.5)
    with pytest.raises(ValueError, match=r"eye's is of 3\.5 to .* mm; paint it for this eye"):
        studio(painting, wider)
