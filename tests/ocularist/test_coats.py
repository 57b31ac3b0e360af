"""Coats, and the eye that they are painted for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from irisjax.ocularist.coats import DEPTH, LIMBUS, SLOPE, Coat, Painting, profile_of, prosthesis
from irisjax.ocularist.cones import Cones

RED = (0.5, 0.2, 0.1)
PROFILE = Cones.of([(3.0, 2.0), (3.2, 4.0), (3.5, 5.77)])


def coat(name, height=0.0, opacity=0.5, colour=RED):
    return Coat(name, jnp.full((4, 4), opacity), jnp.asarray(colour), jnp.asarray(height))


def painting(*coats):
    return Painting(coats, PROFILE)


def base_and_dots():
    return painting(coat("base"), coat("dots", 0.1))


def on_radii(*radius):
    return Painting((coat("base"),), Cones.of([(3 + 0.1 * i, r) for i, r in enumerate(radius)]))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: coat("haze", opacity=1.2), r"coat 'haze': opacity = 1.2 is outside \[0, 1\]"),
        (lambda: coat("haze", opacity=np.nan), r"coat 'haze': opacity = nan is outside"),
        (lambda: coat("haze", colour=(0.1, -0.2, 0.3)), r"coat 'haze': colour = -0.2 is outside"),
        (lambda: coat("haze", 2.0), r"coat 'haze': height = 2 mm is outside \[0, 1\] mm"),
        (lambda: painting(coat("haze"), coat("haze", 0.1)), r"more than once: \['haze'\]"),
        (lambda: on_radii(4.0, 2.0), "must rise from the pupil to the root"),
        (lambda: on_radii(2.0, 2.0, 4.0), "must rise from the pupil to the root"),
        (lambda: base_and_dots().replace("rays"), "no coat 'rays'; there are base, dots"),
        (lambda: base_and_dots().replace("dots", opacity=jnp.full((4, 4), 2.0)), "opacity = 2 is outside"),
        (lambda: base_and_dots().replace("base", height=jnp.asarray(0.2)),
         r"'dots' at 0.1 mm is painted after 'base' and lies below it, at 0.2 mm"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_one_clear_line(make, words):
    with pytest.raises(ValueError, match=words) as error:
        make()
    assert "\n" not in str(error.value)


def test_replacing_a_coat_keeps_the_others_and_its_own_arrays():
    before = painting(coat("base"), coat("dots", 0.1), coat("haze", 0.2))
    after = before.replace("dots", colour=jnp.asarray([0.0, 0.0, 1.0]))
    assert [c.name for c in after.coats] == ["base", "dots", "haze"]
    np.testing.assert_array_equal(after.coats[1].colour, [0, 0, 1])
    assert after.coats[1].opacity is before.coats[1].opacity
    assert all(a is b for a, b in zip(after.coats[::2], before.coats[::2], strict=True))
    assert after.profile is before.profile
    np.testing.assert_allclose(before.coats[1].colour, RED)


def test_the_spheres_of_the_prosthesis_meet_at_the_limbus():
    big, small, apart = 11.5, 7.8, 4.7
    along = (big**2 - small**2 + apart**2) / (2 * apart)  # from the big one's middle
    assert pytest.approx(np.sqrt(big**2 - along**2), abs=0.005) == LIMBUS
    eye = prosthesis()
    assert float(eye.limbus_radius) == pytest.approx(LIMBUS)
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
