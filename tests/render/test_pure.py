"""A picture is a function: `jit`, `vmap` and `grad` through the public call; single precision."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import quick_jit, stack
from irisjax.render.picture import draw
from irisjax.tissue.maps import IrisMaps
from render.small_scenes import CLOSE, QUICK, ring, scene

EYE = ij.Eye(cornea=None, sclera=None)
MAPS = IrisMaps(
    stroma_depth=0.25 + 0.1 * np.random.default_rng(0).random((6, 4)), relief=np.zeros((6, 4))
)
SCENE = ij.Scene(
    ij.Iris.of_level("low"), MAPS, EYE, camera=ij.Camera(size=(12, 9), width=9.0), integrator=QUICK
)


def changed(scene, p):
    """Pigment, a map, a lamp's angle and irradiance, the camera's angle and field."""
    return scene.replace(
        iris=scene.iris.replace(eumelanin=scene.iris.eumelanin + p[0]),
        maps=scene.maps.replace(stroma_depth=scene.maps.stroma_depth + p[1]),
        lights=ij.Lights.distant(0.613 + p[2], 2.2, 3.0 + p[3]),
        camera=ij.Camera(0.1 + p[4], 0.2, 250.0, 9.0 + p[5], size=(12, 9)),
    )


def slopes(scene, tables=None):
    """Derivatives and finite differences of a weighted mean, from one batch of irides whose last
    one is another; its means are those of single pictures.
    """

    def mean(iris, p):
        picture = draw(changed(scene.replace(iris=iris), p), tables)
        weight = 1 + np.cos(np.arange(picture.size)).reshape(picture.shape)
        return (picture * weight).sum()

    step = 1e-6
    points = np.concatenate([step * np.eye(6), -step * np.eye(6), np.zeros((2, 6))])
    irides = [scene.iris] * 13 + [ij.Iris.of_level("high")]
    batched = quick_jit(jax.vmap(jax.value_and_grad(mean, argnums=1)))
    batch, found = map(np.asarray, batched(stack(irides), points))
    single = [mean(iris, np.zeros(6)) for iris in irides[-2:]]
    np.testing.assert_allclose(batch[-2:], single, rtol=1e-12)
    return found[-2], (batch[:6] - batch[6:12]) / (2 * step)


def test_derivatives_are_finite_differences_and_a_batch_is_its_irides():
    found, true = slopes(SCENE)
    assert (np.abs(found) > 1e-6).all()
    np.testing.assert_allclose(found, true, rtol=1e-4)


@pytest.mark.slow
def test_derivatives_through_a_cornea(tables):
    scene = SCENE.replace(eye=ij.Eye(cornea=ij.Cornea(scatter=None)))
    np.testing.assert_allclose(*slopes(scene, tables), rtol=1e-4)


@pytest.mark.slow  # half a minute of compiling
def test_single_precision(tables):
    maps = IrisMaps(stroma_depth=ring(lambda x, y: 0.28 + 0.1 * jnp.sin(3 * x)))

    def picture(x64):
        with jax.enable_x64(x64):
            cast = jax.tree.map(lambda x: jnp.asarray(np.asarray(x), float), (CLOSE, maps, tables))
            iris, camera = ij.Iris.of_level("low"), ij.Camera(size=(24, 18))
            made = scene(cast[0], 0.6, 2.0, iris=iris, maps=cast[1], camera=camera)
            return np.asarray(draw(made, cast[2]))

    coarse, fine = picture(False), picture(True)
    assert (fine.dtype, coarse.dtype) == (np.float64, np.float32)
    np.testing.assert_allclose(coarse, fine, rtol=1e-5, atol=1e-4)  # rtol: a highlight is 23
