"""Coats, what light makes of them by hand, and the eye that they are painted for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from irisjax.ocularist.coats import (
    DEPTH,
    LIMBUS,
    SLOPE,
    Coat,
    Painting,
    over,
    profile_of,
    prosthesis,
    through,
)
from irisjax.ocularist.cones import Cones

RED = (0.5, 0.2, 0.1)
PROFILE = Cones.of([(3.0, 2.0), (3.2, 4.0), (3.5, 5.77)])


def coat(name, height=0.0, opacity=0.5, colour=RED):
    return Coat(name, jnp.full((4, 4), opacity), jnp.asarray(colour), jnp.asarray(height))


def painting(*coats):
    return Painting(coats, PROFILE)


@pytest.mark.parametrize(
    ("behind", "opacity", "paint", "light", "expected"),
    [
        (0.8, 0.25, 0.4, 2.0, 0.8),  # 0.75 × 0.8 + 0.25 × 0.4 × 2
        (0.3, 0.5, 0.2, 1.0, 0.25),  # 0.15 + 0.1
        (0.1, 1.0, 0.4, 2.0, 0.8),
    ],
)
def test_a_coat_over_what_lies_behind_it(behind, opacity, paint, light, expected):
    assert over(behind, opacity, paint, light) == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize(
    ("light", "opacity", "paint", "expected", "printed"),
    [
        (2.0, 0.25, 0.4, 1.7, 0.15),  # (0.75 + 0.1) × 2; 0.75 × 0.25 × 0.4 × 2
        (1.0, 0.5, 0.2, 0.6, 0.05),
        (1.0, 0.0, 0.4, 1.0, 0.0),  # clear varnish: black as it is printed
        (1.0, 1.0, 0.4, 0.4, 0.0),
        (1.0, 0.5, 1.0, 1.0, 0.25),  # white paint takes nothing
    ],
)
def test_light_below_a_coat(light, opacity, paint, expected, printed):
    assert through(light, opacity, paint) == pytest.approx(expected, abs=1e-15)
    assert through(light, opacity, paint, as_printed=True) == pytest.approx(printed, abs=1e-15)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"opacity": 1.2}, r"coat 'haze': opacity = 1.2 is outside \[0, 1\]"),
        ({"opacity": float("nan")}, r"coat 'haze': opacity = nan is outside"),
        ({"colour": (0.1, -0.2, 0.3)}, r"coat 'haze': colour = -0.2 is outside \[0, 1\]"),
        ({"height": 2.0}, r"coat 'haze': height = 2 mm is outside \[0, 1\] mm"),
    ],
)
def test_coats_out_of_range_are_one_clear_line(fields, words):
    with pytest.raises(ValueError, match=words) as error:
        coat("haze", **fields)
    assert "\n" not in str(error.value)


def test_coats_have_their_names_and_are_painted_from_the_bottom_up():
    with pytest.raises(ValueError, match=r"more than once: \['haze'\]"):
        painting(coat("haze"), coat("dots"), coat("haze", 0.1))
    painting(coat("base"), coat("dots", 0.1), coat("haze", 0.1), coat("top", 0.2))
    with pytest.raises(ValueError) as error:
        painting(coat("base"), coat("dots", 0.2), coat("haze", 0.15))
    line = str(error.value)
    assert all(w in line for w in ("'haze' at 0.15 mm", "'dots'", "below it, at 0.2 mm"))
    assert "\n" not in line


def test_radii_of_a_painting_rise():
    for profile in ([(3.0, 4.0), (3.0, 2.0)], [(3.0, 2.0), (2.0, 2.0), (2.0, 4.0)]):
        with pytest.raises(ValueError, match="must rise from the pupil to the root"):
            Painting((coat("base"),), Cones.of(profile))


def test_replacing_a_coat_keeps_the_others_and_its_own_arrays():
    before = painting(coat("base"), coat("dots", 0.1), coat("haze", 0.2))
    after = before.replace("dots", colour=jnp.asarray([0.0, 0.0, 1.0]))
    assert [c.name for c in after.coats] == ["base", "dots", "haze"]
    np.testing.assert_array_equal(after.coats[1].colour, [0, 0, 1])
    assert after.coats[1].opacity is before.coats[1].opacity
    assert all(a is b for a, b in zip(after.coats[::2], before.coats[::2], strict=True))
    assert after.profile is before.profile
    np.testing.assert_allclose(before.coats[1].colour, RED)


def test_replacing_is_checked():
    known = painting(coat("base"), coat("dots", 0.1))
    with pytest.raises(ValueError, match="no coat 'rays'; there are base, dots"):
        known.replace("rays", height=jnp.asarray(0.1))
    with pytest.raises(ValueError, match="opacity = 2 is outside"):
        known.replace("dots", opacity=jnp.full((4, 4), 2.0))
    with pytest.raises(ValueError, match=r"'dots' at 0.1 mm is painted after 'base'"):
        known.replace("base", height=jnp.asarray(0.2))


def test_the_spheres_of_the_prosthesis_meet_at_the_limbus():
    big, small, apart = 11.5, 7.8, 4.7
    along = (big**2 - small**2 + apart**2) / (2 * apart)  # from the big one's middle
    assert pytest.approx(np.sqrt(big**2 - along**2), abs=0.005) == LIMBUS
    eye = prosthesis()
    assert float(eye.limbus_radius) == pytest.approx(LIMBUS)
    # The cornea's sagitta at the limbus, by Pythagoras.
    rim = 7.8 - np.sqrt(7.8**2 - LIMBUS**2)
    sagitta = float(eye.cornea.anterior.sagitta(eye.limbus_radius))
    assert sagitta == pytest.approx(rim, rel=1e-12)
    assert eye.cornea.posterior is None  # its chamber is filled with its cornea
    assert float(eye.cornea.index) == float(eye.aqueous_index) == pytest.approx(1.376)


def test_the_profile_is_the_iris_of_the_eye():
    eye = prosthesis(1.5)
    profile = profile_of(eye)
    np.testing.assert_allclose(profile.radius, [1.5, LIMBUS])
    np.testing.assert_allclose(profile.z, [DEPTH + SLOPE * 1.5, DEPTH + SLOPE * LIMBUS])
    np.testing.assert_allclose(profile_of(eye.replace(iris_slope=None)).z, [DEPTH, DEPTH])
    # Its rays meet it where the eye's own do.
    origin = np.array([[2.0, 1.0, -1.0], [-3.0, 0.5, -1.0], [0.2, 4.8, -1.0]])
    direction = np.array([[0.1, 0.0, 1.0], [0.0, -0.2, 1.0], [0.3, -0.1, 1.0]])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    both = jax.jit(lambda *ray: (profile.meet(*ray), eye.meet_iris(*ray)))
    hit, expected = both(origin, direction)
    assert bool(hit.met.all())
    np.testing.assert_allclose(hit.distance, expected, rtol=1e-12)


def test_all_of_the_iris_lies_behind_the_cornea():
    eye, radius = prosthesis(), np.linspace(1.9, LIMBUS, 50)
    front = np.asarray(eye.cornea.anterior.sagitta(jnp.asarray(radius)))
    base = np.asarray(profile_of(eye).height(jnp.asarray(radius)))
    # Paint rises up to 0.4 mm above the base in the package's default coats.
    assert (base[:-10] - front[:-10]).min() > 0.4
    assert (base - front).min() > 0
