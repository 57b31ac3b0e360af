"""A picture is a function: `jit`, `vmap` and `grad` through the public call; single precision; and
bands of rows: no seams, whatever their height, in memory for a band and not for the picture.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import counting, quick_jit, stack
from irisjax.anatomy.eye import Eye
from irisjax.render import picture
from irisjax.render.camera import Camera
from irisjax.render.environment import Environment
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.picture import draw, draw_bands
from irisjax.render.scene import Scene
from irisjax.render.single_scattering import SingleScattering
from irisjax.tissue.maps import IrisMaps
from render import small_scenes
from render.small_scenes import CLOSE, QUICK, ring

UNEVEN = np.random.default_rng(0).uniform(0.5, 1.5, (16, 8))
SMOOTH = IrisMaps(stroma_depth=0.2 + 0.1 * UNEVEN, relief=np.zeros((16, 8)))


def bare():
    return Eye(cornea=None, sclera=None, pupil_radius=1.0)


def scene(**parts):
    maps = IrisMaps(stroma_depth=UNEVEN * 0.4, relief=0.05 * UNEVEN)
    lights = Lights.distant([0.4, 0.9], [0.2, 3.0])
    kept = {"eye": bare(), "lights": lights, "camera": Camera(size=(14, 16)), "integrator": QUICK}
    return Scene(ij.Iris.of_level("low"), maps, **{**kept, **parts})


def memory(rows, width, channels=3, samples=1):
    """Just enough for bands of so many rows."""
    return (1200 + 24 * channels) * rows * width * samples**2


def joined(made, **options):
    found = list(draw_bands(made, **options))
    pixels = [band.pixels for band in found]
    return np.concatenate(pixels), list(map(len, pixels)), found[0].error


@pytest.fixture(scope="module")
def tall():
    """A scene whose first and last rows see no iris, and its picture."""
    made = scene(camera=Camera(size=(8, 32)))
    return made, np.asarray(draw(made))


def test_no_seams_and_one_program_for_all_bands(tall, monkeypatch):
    """The last band is smaller: its rows are drawn twice. A band is drawn when it is asked for."""
    counts = counting(monkeypatch, rays=Camera, illuminate=picture)
    iterator = draw_bands(tall[0], memory=memory(6, 8))
    found = [next(iterator) for _ in range(3)]  # the first sees no iris
    assert counts["illuminate"] == 3
    before = counts["rays"]
    found += iterator
    assert counts["rays"] == before > 0
    assert [len(band.pixels) for band in found] == [6] * 5 + [2] and 0 <= found[0].error < 0.1
    pixels = np.concatenate([band.pixels for band in found])
    assert not pixels[:6].any() and pixels[14:18].any()
    np.testing.assert_allclose(pixels, tall[1], atol=1e-12, rtol=0)


@pytest.mark.peer
def test_no_seams_through_a_cornea():
    """Sclera, mirror images, environment and caustics; the upper bands see no iris."""
    made = scene(
        eye=Eye(),
        lights=Lights.distant([0.4, 1.6], [0.2, 3.0]),
        environment=Environment.studio(16),
        environment_lights=3,
        camera=Camera(0.2, 1.0, width=24.0, size=(12, 16)),
    )
    tables = Illumination.build(made.eye, size=17, n_rays=512)
    found = joined(made, tables=tables, memory=memory(2, 12))[0]
    np.testing.assert_allclose(found, draw(made, tables), atol=1e-12, rtol=0)


def test_samples_are_averaged_band_by_band(tall):
    made = scene(camera=Camera(size=(4, 16)))
    expected = tall[1].reshape(16, 2, 4, 2, 3).mean((1, 3))
    found, heights, _ = joined(made, samples=2, memory=memory(3, 4, samples=2))
    assert heights == [3] * 5 + [1]
    np.testing.assert_allclose(found, expected, atol=1e-12, rtol=0)


@pytest.mark.peer
def test_spectral_and_single_scattering():
    grid = (450.0, 550.0, 650.0, 700.0)
    whole = joined(scene(wavelengths=grid))[0]
    assert whole.shape == (16, 14, 4)
    found, heights, _ = joined(scene(wavelengths=grid), memory=memory(4, 14, 4))
    assert heights == [4] * 4
    np.testing.assert_allclose(found, whole, atol=1e-12, rtol=0)
    marched = scene(integrator=SingleScattering())
    found, _, error = joined(marched, memory=memory(4, 14))
    assert error is None
    np.testing.assert_allclose(found, draw(marched), atol=1e-12, rtol=0)


@pytest.mark.parametrize(("first", "rows"), [(-1, 3), (14, 3), (0, 0)])
def test_rows_outside_the_picture_are_refused(first, rows):
    with pytest.raises(ValueError, match="are not in a picture of 16"):
        Camera(size=(21, 16)).crop_rows(first, rows)


def test_samples_are_allowed_beyond_the_largest_picture():
    assert Camera(size=(16384, 16384)).crop_rows(5, 1, 8).shape == (8, 131072)


def changed(scene, p):
    """Pigment, a map, a lamp's angle and irradiance, the camera's angle and field. The angles are
    none at which light is tabulated, where a picture has two derivatives.
    """
    return scene.replace(
        iris=scene.iris.replace(eumelanin=scene.iris.eumelanin + p[0]),
        maps=scene.maps.replace(stroma_depth=scene.maps.stroma_depth + p[1]),
        lights=Lights.distant(np.array([0.41, 0.92]) + p[2], [0.2, 3.0], 3.0 + p[3]),
        camera=Camera(0.1 + p[4], 0.2, 250.0, 15.0 + p[5], size=(8, 32)),
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
    found, true = slopes(scene().replace(maps=SMOOTH))
    assert (np.abs(found) > 1e-6).all()
    np.testing.assert_allclose(found, true, rtol=1e-4)


@pytest.mark.slow
def test_derivatives_through_a_cornea(tables):
    made = scene(eye=Eye(cornea=ij.Cornea(scatter=None))).replace(maps=SMOOTH)
    np.testing.assert_allclose(*slopes(made, tables), rtol=1e-4)


@pytest.mark.slow  # half a minute of compiling
def test_single_precision(tables):
    maps = IrisMaps(stroma_depth=ring(lambda x, y: 0.28 + 0.1 * np.sin(3 * x)))

    def picture(x64):
        with jax.enable_x64(x64):
            cast = jax.tree.map(lambda x: jnp.asarray(np.asarray(x), float), (CLOSE, maps, tables))
            iris, camera = ij.Iris.of_level("low"), ij.Camera(size=(24, 18))
            made = small_scenes.scene(cast[0], 0.6, 2.0, iris=iris, maps=cast[1], camera=camera)
            return np.asarray(draw(made, cast[2]))

    coarse, fine = picture(False), picture(True)
    assert (fine.dtype, coarse.dtype) == (np.float64, np.float32)
    np.testing.assert_allclose(coarse, fine, rtol=1e-5, atol=1e-4)  # rtol: a highlight is 23
