"""Scenes: what they refuse, and that they can be changed inside a program."""

import math

import jax
import jax.numpy as jnp
import pytest

import irisjax as ij
from irisjax.anatomy.lids import Lids
from irisjax.optics.conicoid import Conicoid

EYE = ij.Eye()
SCENE = ij.Scene(ij.Iris(), eye=EYE.replace(lids=Lids()), camera=ij.Camera(size=(16, 12)))


def test_an_eye_and_a_scene_from_outside_can_be_changed_inside_a_program():
    """Their checks took numbers that are known for traced ones, and ended in JAX's words."""

    @jax.jit
    def changed(radius, eumelanin):
        scene = SCENE.replace(iris=SCENE.tissue.replace(eumelanin=eumelanin))
        assert not scene.grazing()  # known, since the lamps are
        return scene.eye.replace(pupil_radius=radius).pupil_radius

    assert changed(2.0, 0.3) == 2.0


@pytest.mark.parametrize(
    ("state", "message"),
    [
        (lambda: ij.Scene(ij.Iris(), lights=None), "needs lights or an environment"),
        (lambda: SCENE.replace(lights=ij.Lights.distant([], [])), "needs lights or an environment"),
        (lambda: SCENE.replace(wavelengths=()), "list of at least one number"),
        (
            lambda: SCENE.replace(lights=ij.Lights.distant(0.1, 0.2, illuminant="A")),
            "the lights are A, the scene is D65",
        ),
        (
            lambda: SCENE.replace(camera=ij.Camera(polar=math.radians(50))),
            "camera is 50° off the axis; lids are drawn up to 45°",
        ),
        (lambda: ij.Camera(size=(0, 5)), "camera size"),
        (lambda: ij.Camera(size=(5, 20000)), "camera size"),
        (lambda: ij.Camera(azimuth=jnp.asarray(jnp.nan)), "camera azimuth = nan is outside"),
        (lambda: ij.Cornea(index=jnp.asarray(-1.0)), r"index = -1 is outside \[1, 3\]"),
        (lambda: ij.Cornea(scatter=jnp.asarray(-1.0)), "scatter = -1 nm⁴ is outside"),
        (lambda: ij.Cornea(Conicoid(-7.8, 0.75)), "anterior radius = -7.8 mm is outside"),
    ],
)
def test_what_would_draw_nothing_but_nan_is_refused(state, message):
    with pytest.raises(ValueError, match=message):
        state()


def test_an_environment_needs_no_lamps_beside_it():
    none, studio = ij.Lights.distant([], []), ij.Environment.studio()
    assert len(SCENE.replace(lights=none, environment=studio).all_lights()) > 0


def test_wavelengths_may_be_an_array():
    assert SCENE.replace(wavelengths=ij.wavelengths(450, 550, 50)).wavelengths == (450, 500, 550)
