"""`irisjax render`: what it refuses, what it hands to the renderer, its pictures and animations."""

import importlib
from unittest.mock import Mock

import jax
import numpy as np
import pytest
from PIL import Image
from refusals import one_line

from irisjax import io
from irisjax.io.scenes import parse_scene, read_scene
from irisjax.measure.colour import OBSERVER, illuminant_power, srgb_encode, tristimulus_matrix
from irisjax.render.camera import Camera
from irisjax.render.picture import draw
from irisjax.render.project import project_visible
from scene_files import BARE, without_growth

render = importlib.import_module("irisjax.cli.render")  # the package holds the command by this name

SCENE = """
[iris]
level = "low"
[maps]
uniform = true
[eye]
cornea = "none"
[camera]
size = [8, 6]
"""
LAMP = "[[light]]\npolar_deg = 35.0\nazimuth_deg = 120.0\nirradiance = 0.6\n"
COLOURED = LAMP + "colour = [1.0, 0.8, 0.6]\n"
STUDIO = '[environment]\nkind = "studio"\n'
SPECTRAL = ("--spectral", "400:700:100", "-o", "layers.exr")


@pytest.fixture(autouse=True)
def _with_a_scene_in_its_folder(monkeypatch, tmp_path):
    without_growth(monkeypatch)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(BARE)


@pytest.fixture
def drawn(monkeypatch):
    """Nothing is drawn; what would have been."""
    calls = []
    monkeypatch.setattr(render, "_render_still", lambda *given: calls.append(given))
    return calls


def scene(tmp_path, *parts):
    (tmp_path / "scene.toml").write_text("".join([SCENE, *parts]))
    return "scene.toml"


def test_pictures_are_not_lost(irisjax, drawn, tmp_path):
    path = scene(tmp_path, LAMP)
    for name, said in (("eye.png", ()), ("frame_%02d.png", ("--animate", "light"))):
        (tmp_path / name.replace("%02d", "00")).write_bytes(b"mine")
        result = irisjax("render", path, *said, "-o", name)
        one_line(result, "exists; --overwrite replaces it")
        assert not drawn


@pytest.mark.parametrize(
    ("lights", "message"),
    [
        ([LAMP, COLOURED], "plain lamps: a light's colour has no spectrum; give --light"),
        ([STUDIO], "--spectral needs lamps: an environment has colours, not spectra; give --light"),
    ],
    ids=["coloured", "environment"],
)
def test_spectral_pictures_need_light_with_a_spectrum(irisjax, drawn, tmp_path, lights, message):
    path = scene(tmp_path, *lights)
    one_line(irisjax("render", path, *SPECTRAL), message)
    assert [p.name for p in tmp_path.iterdir()] == ["scene.toml"]
    # --light stands in for them, and an RGB picture takes colours.
    assert irisjax("render", path, "--light", "30,0", *SPECTRAL)[0] == 0
    (found, picture, _, _) = drawn.pop()
    assert found.lights.tint is None
    assert found.environment is None
    assert picture.spectral.values.tolist() == [400, 500, 600, 700]
    assert irisjax("render", path, "-o", "eye.exr")[0] == 0


def test_options_reach_the_scene(irisjax, drawn, tmp_path):
    path = scene(tmp_path, LAMP)
    said = ("--camera", "20,90,11", "--pupil-radius", "2", "--size", "32x24", "--exposure", "2")
    said = (*said, "--light", "30,90,2")
    how = ("--samples", "3", "--integrator", "single-scattering", "--bits", "16")
    assert irisjax("render", path, *said, *how, "-o", "eye.png") == (0, "", "")
    ((found, picture, exposure, output),) = drawn
    assert found.camera.size == (32, 24)
    np.testing.assert_allclose(
        [found.camera.polar, found.camera.azimuth, found.camera.width], [np.pi / 9, np.pi / 2, 11]
    )
    np.testing.assert_allclose(
        [*found.lights.towards[0], found.lights.irradiance[0]], [0, 0.5, -(0.75**0.5), 2], atol=1e-6
    )
    assert float(found.eye.pupil_radius) == 2
    assert type(found.integrator).__name__ == "SingleScattering"
    assert (picture.samples, picture.bits, exposure, str(output)) == (3, 16, 2, "eye.png")


WRONG = {
    "[irs]\nlevel = 1": "scene.toml, line 1: unknown section [irs]; known: iris, maps",
    "\n[iris]\nlevel = 'low'\ncolour = 'red'": "scene.toml, line 4: unknown 'colour' in iris; known: preset, level",
    "[iris]\nlevel = 'middling'": "scene.toml, line 2: iris.level = 'middling' must be one of low, moderate, high",
    "[iris]\neumelanin = -1": "scene.toml, line 2: iris.eumelanin = -1 must be a number in [0, 2000] mg/ml",
    "[iris]\neumelanin = true": "scene.toml, line 2: iris.eumelanin = True must be a number",
    "[iris]\npreset = 'blue'\nlevel = 'low'": "scene.toml, line 1: iris: give preset or level, not both",
    "[maps]\n\nseed = 1.5": "scene.toml, line 3: maps.seed = 1.5 must be a whole number in [0, 4294967295]",
    "[maps]\nuniform = 1": "scene.toml, line 2: maps.uniform = 1 must be true or false",
    '[picture]\nilluminant = "D56"': "scene.toml, line 2: picture.illuminant = 'D56' unknown illuminant 'D56'; known: A",
    "[camera]\nsize = [0, 5]": "scene.toml, line 2: camera.size = [0, 5] must be a whole number in [1, 16384], for each of the 2 numbers of [width, height]",
    "[camera]\nsize = '8x6'": "scene.toml, line 2: camera.size = '8x6' must be [width, height]",
    "[light]\npolar_deg = 3": "scene.toml, line 1: light must be written [[light]]",
    "[[camera]]\nwidth = 3": "scene.toml, line 1: camera must be written [camera]",
    "[[light]]\n[[light]]\npolar_deg = 200": "scene.toml, line 3: light.polar_deg = 200 must be a number in [0, 180]",
    "[[light]]\nposition = [1, 2, 3]": "scene.toml, line 1: light: a lamp's distance = 3.74166 mm is outside [20, inf) mm",
    "[[light]]\n[[light]]\nposition = [0, 0, 5]": "line 2: light: a lamp's distance = 5 mm is outside [20, inf) mm; change its position (scene.toml, line 3)",
    "[[light]]\nposition = [1, 2, -300]\npolar_deg = 1": "give a light a position or angles, not both",
    "[environment]\nlights = 3": "scene.toml, line 1: environment: needs file or kind",
    "[environment]\nfile = 'a.exr'\nkind = 'sky'": "environment: give file or kind, not both",
    "[environment]\nfile = 'missing.exr'": "scene.toml, line 2: missing.exr: No such file",
    "[camera]\nwidth = 9\nwidth = 8": "scene.toml, line 3: a key or section is written twice; keep one",
    "[maps]\nseed = 1\n[maps]": "scene.toml, line 3: a key or section is written twice; keep one",
    "[iris\nlevel = 1": "scene.toml: ",
    "iris = 3": "iris must be written [iris]",
    "iris = " + 2000 * "[": "scene.toml: nested too deeply",
}


@pytest.mark.parametrize("text", WRONG, ids=[repr(t)[:80] for t in WRONG])
def test_wrong_entries_are_one_line(irisjax, tmp_path, text):
    # Maps that vary would be grown first.
    plain = "" if "maps" in text else "\n[maps]\nuniform = true"
    (tmp_path / "scene.toml").write_text(text + plain)
    one_line(irisjax("render", "scene.toml", "--size", "4x3"), WRONG[text])
    assert [p.name for p in tmp_path.iterdir()] == ["scene.toml"]


OPTIONS = {
    "": "give a SCENE file or --preset",
    "scene.toml --preset blue": "give a SCENE file or --preset",
    "scene.toml --lids": "lids need an eye with a cornea and a sclera",
    "--preset pink": (
        "--preset: unknown 'pink'; known: blue, grey, green, hazel, amber, brown, dark-brown"
    ),
    "missing.toml": "missing.toml: No such file",
    ".": ".: Is a directory",
    "scene.toml -o eye.jpg": "eye.jpg: must end in .png or .exr",
    "scene.toml -o missing/eye.png": "missing: no such folder",
    "scene.toml --tone agx -o eye.exr": "--tone is for PNG and movies",
    "scene.toml --exposure bright": "or write white",
    "scene.toml --exposure white --spectral 400:700:100 -o a.exr": (
        "--exposure white: not with --spectral"
    ),
    "scene.toml --exposure white": "the camera sees no white of the eye",
    "scene.toml --bits 12": "--bits 12 must be 8 or 16",
    "scene.toml --size 8": "--size '8': write WIDTHxHEIGHT",
    "scene.toml --size ²x8": "--size '²x8': write WIDTHxHEIGHT",
    "scene.toml --size 16385x8": "--size 16385x8: must be from 1 to 16384 along a side",
    "scene.toml --light 30,0,-1": "'30,0,-1': a lamp's irradiance = -1 is outside [0, 1e+06]",
    "scene.toml --pupil-radius 6": "--pupil-radius: 6 is outside [0.25, 4.75] mm",
    "scene.toml --pupil-radius 0,5": "--pupil-radius: '0,5' is not a number in [0.25, 4.75] mm",
    "scene.toml --camera 30": "--camera '30': write POLAR,AZIMUTH",
    "scene.toml --camera 30,0,200": "'30,0,200': camera width = 200 mm is outside [0.1, 100]",
    "--preset blue --lids --camera 70,0": "the camera is 70° off the axis; lids are drawn up to 45°",
    "scene.toml --frames 3": "--frames means something only with --animate",
    "scene.toml --exposure nan": "--exposure: nan is outside (0, inf)",
    "scene.toml --spectral red": "--spectral: 'red' is not a grid",
    "scene.toml --spectral 400:700:10 -o x.png": "must end in .exr",
    "scene.toml --animate light --spectral 400:700:100 -o a.exr": "--animate: not with --spectral",
    "scene.toml --integrator f09": "--integrator: unknown 'f09'; known: separable",
    "scene.toml --bits many": "--bits",
    "scene.toml --bits 16 -o eye.exr": "--bits is for PNG",
    "scene.toml --animate light -o f_%x.png": "f_%x.png: the name of numbered frames",
}


@pytest.mark.parametrize("words", OPTIONS)
def test_wrong_options_are_one_line(irisjax, tmp_path, words):
    one_line(irisjax("render", *words.split()), OPTIONS[words])
    assert [p.name for p in tmp_path.iterdir()] == ["scene.toml"]


@pytest.fixture
def draw_to(done):
    """Draw the scene into a file; returns what is said of it."""

    def run(name, *options):
        out, err = done("render", "scene.toml", *options, "-o", name)
        assert out == ""
        return err

    return run


def test_command_makes_the_librarys_picture(draw_to, tmp_path):
    (tmp_path / "scene.toml").write_text(BARE + "[picture]\nexposure = 3")
    assert draw_to("eye.exr") == ""
    jax.config.update("jax_enable_x64", True)
    expected = 3 * np.asarray(draw(read_scene(tmp_path / "scene.toml").scene()))
    found = io.read_image("eye.exr")
    np.testing.assert_allclose(found.pixels, expected, atol=1e-6)
    assert "simulated" in str(found.metadata)
    # PNG: sRGB to the nearest step; equal runs, equal bytes.
    for name in ("one.png", "two.png"):
        assert draw_to(name, "--bits", "16") == ""
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()
    steps = np.asarray(srgb_encode(np.clip(expected, 0, 1)))
    np.testing.assert_allclose(io.read_image("one.png").pixels, steps, atol=1 / 65535)


def test_samples_average_and_clipping_is_said(draw_to):
    draw_to("fine.exr")
    draw_to("mean.exr", "--size", "4x3", "--samples", "2")
    fine, mean = (io.read_image(f"{n}.exr").pixels for n in ("fine", "mean"))
    np.testing.assert_allclose(mean, fine.reshape(3, 2, 4, 2, 3).mean((1, 3)), atol=1e-6)
    err = draw_to("bright.png", "--exposure", "1e4")
    assert err.startswith("irisjax: bright.png: ") and "out of sRGB's range are clipped" in err


def test_nothing_half_written(irisjax, tmp_path, monkeypatch):
    (tmp_path / "eye.png").write_bytes(b"older")
    interrupted = Mock(side_effect=KeyboardInterrupt)
    monkeypatch.setattr("irisjax.render.picture.illuminate", interrupted)
    status = irisjax("render", "scene.toml", "--overwrite")
    assert status == (130, "", "irisjax: interrupted\n")
    assert (tmp_path / "eye.png").read_bytes() == b"older"
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.peer
def test_a_lamp_goes_round_where_the_scene_has_a_studio_alone(draw_to, tmp_path):
    scene(tmp_path, STUDIO)
    draw_to("a.gif", "--animate", "light", "--frames", 2, "--exposure", 8)
    with Image.open("a.gif") as gif:
        assert np.asarray(gif.convert("RGB")).max() > 50


@pytest.mark.peer
def test_spectral_layers_add_up_to_the_picture(draw_to):
    """81 layers under the colour-matching functions give the RGB picture, to the ten bands' own
    error.
    """
    draw_to("rgb.exr")
    draw_to("layers.exr", "--spectral", "380:780:5")
    image = io.read_image("layers.exr")
    grid = 380 + 5.0 * np.arange(81)
    order = [image.channels.index(name) for name in io.spectral_channels(grid)]
    reflected = image.pixels[..., order] / illuminant_power("D65", grid)
    rgb = reflected @ np.asarray(tristimulus_matrix(grid, "linear sRGB", "D65", OBSERVER)[0]).T
    expected = io.read_image("rgb.exr")
    expected = expected.pixels[..., [expected.channels.index(c) for c in "RGB"]]
    np.testing.assert_allclose(rgb, expected, atol=0.01 * expected.max())


def test_pigment_reaches_brown_from_any_eye():
    scene = parse_scene(
        '[iris]\npreset = "blue"\n[maps]\nuniform = true\n[eye]\ncornea = "none"'
    ).scene()
    light, dark = render.animation_frames(scene.replace(camera=Camera(size=(8, 6))), "pigment", 2)
    assert dark.max(axis=(0, 1))[2] < 0.3 * light.max(axis=(0, 1))[2]


def test_an_animation_without_light_is_said_to_be_black(draw_to):
    options = (*2 * ("--light", "170,0"), "--animate", "pupil", "--frames", 2)
    err = draw_to("dark.gif", *options)
    assert "dark.gif: the picture is black: no light falls on what the camera sees" in err


def test_animations_return_to_their_first_frame(draw_to):
    draw_to("a.gif", "--animate", "pigment", "--frames", 4, "--exposure", 8)
    bright = ("--frames", 2, "--exposure", 1e3)
    assert "out of sRGB's range are clipped" in draw_to("b.gif", "--animate", "pigment", *bright)
    with Image.open("a.gif") as gif:
        assert (gif.n_frames, gif.size, gif.info["loop"]) == (4, (8, 6), 0)
        assert b"simulated" in gif.info["comment"]
    draw_to("sheet.png", "--animate", "pupil", "--frames", 4, "--exposure", 8)
    sheet = io.read_image("sheet.png").pixels
    assert sheet.shape == (12, 16, 3)
    narrow, half, wide, again = sheet[:6, :8], sheet[:6, 8:], sheet[6:, :8], sheet[6:, 8:]
    np.testing.assert_array_equal(half, again)  # on the way out and on the way back
    assert narrow.sum() > half.sum() > wide.sum()  # a wide pupil leaves less iris


def test_a_camera_swings_from_the_right_to_the_left(draw_to, monkeypatch, tmp_path):
    """The frames are still pictures from where the cosine of the round puts it."""
    places = []

    def project_and_note(eye, camera, **known):
        places.append(camera.position(eye))
        return project_visible(eye, camera, **known)

    monkeypatch.setattr("irisjax.cli.render.project_visible", project_and_note)
    draw_to("f_%d.png", "--animate", "camera", "--frames", 4, "--exposure", 8)
    assert sorted(p.name for p in tmp_path.glob("f_*")) == [f"f_{i}.png" for i in range(4)]
    aside = 250 * np.sin(np.radians([50, 0, -50, 0]))
    np.testing.assert_allclose(np.asarray(places)[-4:, 0], aside, atol=1e-3)
    draw_to("still.png", "--camera", "50,0", "--exposure", 8)
    pictures = [io.read_image(name).pixels for name in ("f_0.png", "still.png", "f_1.png")]
    np.testing.assert_allclose(pictures[0], pictures[1], atol=1 / 255)
    assert np.abs(pictures[0] - pictures[2]).max() > 0.5


@pytest.mark.peer  # needs the extra irisjax[video]
def test_animations_as_mp4(draw_to):
    import av

    options = ("--animate", "pigment", "--frames", 4, "--exposure", 8, "--size", "9x7")
    draw_to("a.mp4", *options)
    with av.open("a.mp4") as movie:
        assert [(f.width, f.height) for f in movie.decode(video=0)] == [(9, 7)] * 4
