"""Pictures in bands: no seams, whatever the bands' height; memory for a band and not for the
picture.
"""

import jax
import numpy as np
import pytest

import irisjax as ij
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
from render.small_scenes import QUICK, rays_of

UNEVEN = np.random.default_rng(0).uniform(0.5, 1.5, (16, 8))


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


def test_no_seams():
    """The last of three bands is smaller: its rows are drawn twice."""
    made = scene()
    found, heights, error = joined(made, memory=memory(7, 14))
    assert heights == [6, 6, 4] and 0 <= error < 0.1
    np.testing.assert_allclose(found, draw(made), atol=1e-12, rtol=0)


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


def test_samples_are_averaged_band_by_band():
    made = scene(camera=Camera(size=(7, 8)))
    expected = np.asarray(draw(scene())).reshape(8, 2, 7, 2, 3).mean((1, 3))
    found, heights, _ = joined(made, samples=2, memory=memory(2, 7, samples=2))
    assert heights == [2] * 4
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


def test_one_program_for_all_draw_bands(monkeypatch):
    traced, rays = [], Camera.rays
    monkeypatch.setattr(Camera, "rays", lambda *args: traced.append(1) or rays(*args))
    made = scene(camera=Camera(size=(20, 64)))
    iterator = draw_bands(made, memory=memory(4, 20))
    for _ in range(8):  # the first see no iris
        next(iterator)
    before = len(traced)
    assert len(list(iterator)) == 8
    assert len(traced) == before > 0


def test_a_band_is_drawn_only_when_asked_for(monkeypatch):
    made, illuminate = [], picture.illuminate
    monkeypatch.setattr(picture, "illuminate", lambda *a: made.append(1) or illuminate(*a))
    iterator = draw_bands(scene(), memory=memory(4, 14))
    assert next(iterator).pixels.shape == (4, 14, 3) and len(made) == 1


@pytest.mark.parametrize(("first", "rows"), [(-1, 3), (14, 3), (0, 0)])
def test_rows_outside_the_picture_are_refused(first, rows):
    with pytest.raises(ValueError, match="are not in a picture of 16"):
        Camera(size=(21, 16)).crop_rows(first, rows)


def test_a_part_has_the_rays_of_the_whole():
    part = Camera(0.3, 0.7, width=3.0, size=(1, 32)).crop_rows(30, 2, samples=8)
    assert part.shape == (16, 8)
    rays = jax.jit(lambda camera: rays_of(camera, bare())[1])
    whole = rays(Camera(0.3, 0.7, width=3.0, size=(8, 256)))
    np.testing.assert_allclose(rays(part), whole[-16:], atol=1e-15, rtol=0)
    assert Camera(size=(16384, 16384)).crop_rows(5, 1, 8).shape == (8, 131072)
