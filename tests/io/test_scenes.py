"""Scene files: what they say is the scene."""

import functools
import math
import re
import tomllib
from pathlib import Path

import equinox as eqx
import numpy as np
import pytest

from irisjax import io
from irisjax.io import scenes
from irisjax.io.scenes import SECTIONS, parse_scene, read_scene, scene_text
from irisjax.io.sections import checked
from irisjax.render.environment import Environment
from irisjax.tissue import FRACTIONS
from scene_files import BARE, without_growth


def test_file_becomes_the_scene_it_says():
    text = BARE.replace('cornea = "none"', "pupil_radius = 1.5\nsclera = false\niris_slope = 0.1")
    text = text.replace("[camera]", "[camera]\npolar_deg = 45\ndistance = 300")
    file = parse_scene(text + "[picture]\nexposure = 2")
    scene = file.scene()
    assert file.exposure == 2 and scene.maps is scene.veins is scene.eye.sclera is None
    iris, eye, camera = scene.iris, scene.eye, scene.camera
    assert (float(iris.eumelanin), float(iris.pheomelanin)) == pytest.approx((0.05, 0.0194))
    assert (float(eye.pupil_radius), float(eye.iris_slope)) == (1.5, 0.1)
    assert (float(camera.polar), float(camera.distance)) == pytest.approx((math.pi / 4, 300))
    assert camera.size == (8, 6)
    turn, away = np.pi / 18, np.linalg.norm([10, 20, 40])
    polar = [0.5 * np.cos(turn), 0.5 * np.sin(turn), -np.sqrt(0.75)]
    expected = [polar, np.array([10, 20, -40]) / away]
    np.testing.assert_allclose(scene.lights.towards, expected, atol=1e-7)
    np.testing.assert_allclose(scene.lights.irradiance, [np.pi, 1.5])
    np.testing.assert_allclose(scene.lights.distance, [np.inf, away])


@pytest.fixture(autouse=True)
def _small(monkeypatch):
    """Scenes with maps of few texels."""
    without_growth(monkeypatch)
    monkeypatch.setattr(scenes, "lids", functools.partial(scenes.lids, texels=64))


def test_another_pupil_grows_the_maps_for_it_or_presses_those_of_a_file(tmp_path):
    file = parse_scene("[eye]\nsclera = false\n")
    scene = file.scene()
    wide = file.with_pupil(scene, 3.2)
    stated = parse_scene("[eye]\nsclera = false\npupil_radius = 3.2\n").scene()
    for name, found in stated.maps.present().items():
        np.testing.assert_array_equal(wide.maps.present()[name], found)
    io.write_maps(tmp_path / "maps.exr", scene.maps)
    kept = parse_scene('[maps]\nfile = "maps.exr"\n[eye]\nsclera = false\n', folder=tmp_path)
    before = kept.scene()
    after = kept.with_pupil(before, 3.2)
    # Areas of the innermost and outermost rings, from the circles round them.
    rings = [np.diff(np.linspace(r, 5.5, 33) ** 2)[[0, -1]] for r in (1.9, 3.2)]
    thicker = (after.maps.stroma_depth / before.maps.stroma_depth)[:, [0, -1]]
    np.testing.assert_allclose(thicker, np.tile(rings[0] / rings[1], (96, 1)), rtol=1e-5)
    np.testing.assert_array_equal(after.maps.relief, before.maps.relief)


def test_empty_file_is_the_default_eye():
    scene = parse_scene("").scene()
    assert scene.lights is not None and len(scene.lights) == 1 and scene.environment is None
    assert scene.maps is not None and scene.eye.cornea is not None and scene.veins is not None
    assert scene.camera.size == (800, 600)


def test_one_chamber_has_one_index():
    found = parse_scene(BARE.replace('cornea = "none"', 'cornea = "f09"\nsclera = false')).scene()
    assert float(found.eye.aqueous_index) == pytest.approx(1.376)


def test_the_eye_of_f09s_figure_1():
    """A preset's maps with melanins in per cent of volume; one that is missing is named."""
    shares = dict(zip(FRACTIONS, (7.56, 5.84, 4.61, 2.11), strict=True))
    lines = [f"{name} = {value}" for name, value in shares.items()]
    text = "\n".join(["[iris]", 'preset = "green"', *lines, "[eye]", "sclera = false"])
    iris = parse_scene(text).scene().tissue
    assert iris.absorption == "f09"
    assert iris.volume_fractions() == pytest.approx(shares, rel=1e-5)
    with pytest.raises(ValueError, match=r"scene, line 1: iris: .*give stroma_pheomelanin_percent"):
        parse_scene("\n".join(["[iris]", *lines[:3]])).scene()


def test_the_file_that_explains_everything_names_every_entry():
    """Each key of each section once, with a value that is allowed."""
    path = Path(__file__).parents[2] / "data/scenes/everything.toml"
    read_scene(path)
    section, found = "", {}
    for line in path.read_text(encoding="utf-8").splitlines():
        if header := re.match(r"\[+(\w+)", line):
            section = header[1]
        elif entry := re.match(r"(?:# )?(\w+ = .*)", line):
            ((key, value),) = tomllib.loads(entry[1]).items()
            checked(value, SECTIONS[section][key])
            found.setdefault(section, set()).add(key)
    assert found == {name: set(checks) for name, checks in SECTIONS.items()}


UNLIT = BARE[: BARE.index("[[light]]")]
FULL = """
[iris]
preset = "hazel"
pheomelanin_abl_fraction = 0.3
stroma_index = 1.38
absorption = "f09"
[maps]
seed = 7
[eye]
cornea = "f09"
veins = 1.7
limbal_ring = 0.3
limbal_ring_fade = 0.4
pupil_centre = [-0.2, 0.1]
attenuation = 1e-4
[lids]
upper = 3.5
nose = "right"
[camera]
polar_deg = 12.5
size = [12, 8]
images = 0.25
[[light]]
position = [60, 80, -300]
colour = [1.0, 0.8, 0.6]
[[light]]
azimuth_deg = -100
radius_deg = 3
[environment]
kind = "uniform"
strength = 0.3
lights = 6
[picture]
integrator = "single-scattering"
illuminant = "A"
"""
ALONE = BARE + '[environment]\nkind = "sky"\nlights = 3\n'


@pytest.mark.parametrize(
    ("text", "given"),
    [
        (FULL, {"iris": {"preset": "hazel"}, "maps": {"seed": 7}}),
        (BARE, {}),
        (ALONE, {"environment": {"kind": "sky"}}),
    ],
)
def test_a_scene_as_a_file_is_read_back(text, given):
    scene = parse_scene(text).scene()
    if "environment" not in given and scene.environment is not None:
        scene = scene.replace(environment=Environment.uniform(0.3, rows=512))
    again = parse_scene(scene_text(scene, given, "written")).scene()
    assert eqx.tree_equal(scene, again, rtol=1e-6, atol=1e-6)


def test_seeds_grow_other_maps():
    def relief(seed):
        scene = parse_scene(f"[maps]\nseed = {seed}\n[eye]\nsclera = false").scene()
        return np.asarray(scene.maps.relief)

    first = relief(1)
    np.testing.assert_array_equal(first, relief(1))
    assert np.abs(first - relief(2)).max() > 0.01


def test_coloured_lamps():
    """A red lamp beside a plain one; without colours there are no tints."""
    coloured = parse_scene(f"{UNLIT}[[light]]\ncolour = [1, 0, 0]\n[[light]]\n").scene()
    np.testing.assert_allclose(coloured.lights.tint, [[1, 0, 0], [1, 1, 1]])
    assert parse_scene(BARE).scene().lights.tint is None


def test_environment_from_a_file(tmp_path):
    radiance = np.asarray(Environment.studio(16).radiance)
    io.write_exr(tmp_path / "room.exr", radiance)
    text = '[environment]\nfile = "room.exr"\nlights = 5\nstrength = 2'
    scene = parse_scene(UNLIT + text, folder=tmp_path).scene()
    assert scene.lights is None and len(scene.all_lights()) == 5
    np.testing.assert_allclose(scene.environment.radiance, 2 * radiance, rtol=1e-5)
