"""Eye colours beside photographed irides."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from common import rows_of
from irisjax.grow import presets
from irisjax.grow.presets import PHOTOGRAPHED_COLOURS, PRESETS
from irisjax.io.scenes import parse_scene
from irisjax.measure.colour import XYZ_TO_SRGB, lab_of
from irisjax.render.integrators import INTEGRATORS
from irisjax.render.picture import draw
from irisjax.tissue.maps import IrisMaps

SHAPE = (128, 48)  # as in `test_procedural.py`, so that one program grows both
RESULTS = Path(__file__).parents[2] / "experiments" / "results"
WHITE = 0.6  # reflectance of the white of the eye


def test_presets_are_what_the_experiment_found(monkeypatch):
    monkeypatch.setattr(presets, "procedural", lambda *_, **__: IrisMaps())  # grown below
    rows = rows_of(RESULTS / "eye_colours_pigments.csv")
    assert len(rows) == 2 * len(PRESETS)
    for row in rows:
        process = INTEGRATORS[row["integrator"]]().process
        iris, _ = PRESETS[row["colour"]](process=process, shape=SHAPE, key=jax.random.key(0))
        iris = {**vars(iris), "hemoglobin": iris.oxyhemoglobin + iris.deoxyhemoglobin}
        for name in list(row)[2:-1]:
            np.testing.assert_allclose(iris[name], float(row[name]), rtol=1e-6, err_msg=str(row))


def test_presets_of_one_key_have_patterns_of_their_own():
    depths = [make(shape=SHAPE, key=jax.random.key(0))[1].stroma_depth for make in PRESETS.values()]
    own = [np.ravel(np.log(d) - np.log(d).mean(0)) for d in depths]
    assert abs(np.corrcoef(own) - np.eye(len(own))).max() < 0.2


@pytest.mark.parametrize("colour", PRESETS)
def test_pigment_is_denser_where_the_stroma_is_thin(colour):
    """A gap in a brown iris is dark brown: with as much pigment as elsewhere it would be blue."""
    _, maps = PRESETS[colour](shape=SHAPE, key=jax.random.key(0))
    thickness, pigment = (
        np.log(m) - np.log(m).mean(0) for m in (maps.stroma_depth, maps.eumelanin)
    )
    assert np.corrcoef(thickness.ravel(), pigment.ravel())[0, 1] < -0.4


SIDE, WIDTH = 128, 13.0  # of the picture, pixels and mm


def scene(colour, integrator):
    text = f"""[iris]\npreset = "{colour}"\n[environment]\nkind = "studio"\n[maps]\nseed = 3
        [camera]\nsize = [{SIDE}, {SIDE}]\nwidth = {WIDTH}\nimages = 0.0"""
    return parse_scene(text).scene(integrator)


@pytest.fixture(scope="module")
def tables():
    """Tabulate the light on the iris once: it depends on nothing in which these eyes differ."""
    return scene("blue", "separable").tables()


@pytest.mark.peer
@pytest.mark.parametrize("integrator", ["separable", "radiative-transfer"])
@pytest.mark.parametrize("colour", PRESETS)
def test_pictures_have_the_colours_of_photographs(colour, integrator, tables):
    """Iris and white are told apart by their places in the picture: behind its cornea a pupil of
    1.9 mm looks 2.15 mm wide, and iris and white blend within 0.25 mm of the limbus, whose radius
    is 5.5 mm.
    """
    picture = np.asarray(draw(scene(colour, integrator), tables), np.float64)
    across = (np.arange(SIDE) + 0.5 - SIDE / 2) * WIDTH / SIDE
    distance = np.hypot(across, across[:, None])
    iris = picture[(distance > 2.2) & (distance < 5.25)].mean(0)
    white = picture[(distance > 5.75) & (distance < WIDTH / 2)].mean(0)
    to_white = np.linalg.inv(XYZ_TO_SRGB)
    to_white /= to_white.sum(1, keepdims=True)
    xyz = to_white @ iris / (to_white[1] @ white)
    mean, sd = map(np.array, PHOTOGRAPHED_COLOURS[colour])
    off = (np.asarray(lab_of(jnp.asarray(WHITE * xyz))) - mean) / sd
    assert np.abs(off).max() < 1, off
    assert 0.1 < xyz[1] < 0.35
