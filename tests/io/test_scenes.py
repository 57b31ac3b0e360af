"""Scene files and the command that renders them: pictures as the library's, one line for every
wrong entry.
"""

import math
import re
import tomllib
from pathlib import Path

import jax
import numpy as np
import pytest

from irisjax import cli, io
from irisjax.cli.animate import frames
from irisjax.io.entries import SECTIONS
from irisjax.io.scenes import parse_scene, read_scene
from irisjax.measure.colour import srgb_encode
from irisjax.render.camera import Camera
from irisjax.render.compose import render
from irisjax.render.environment import Environment

BARE = """
[iris]
level = "low"
eumelanin = 0.05

[maps]
uniform = true

[eye]
cornea = "none"

[camera]
size = [8, 6]

[[light]]
polar_deg = 30
azimuth_deg = 10

[[light]]
position = [10, 20, -40]
irradiance = 1.5
"""


@pytest.fixture(autouse=True)
def _precision_kept():
    # The command switches x64 on; the tests that share this process must not notice.
    before = jax.config.read("jax_enable_x64")
    yield
    jax.config.update("jax_enable_x64", before)


@pytest.fixture
def irisjax(capsys, monkeypatch, tmp_path):
    """Run the command in this process, in an empty folder; gives status, standard output and
    standard error.
    """
    monkeypatch.setenv("TERMINAL_WIDTH", "200")
    monkeypatch.delenv("IRISJAX_DEBUG", raising=False)
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        status = cli.run([str(a) for a in arguments])
        return status, *capsys.readouterr()

    return run


def one_line(result, message):
    status, out, err = result
    assert (status, out) == (2, "")
    assert err.startswith("irisjax: ") and err.count("\n") == 1 and err.endswith("\n")
    assert message in err, err


def test_file_becomes_the_scene_it_says():
    text = (
        BARE.replace('cornea = "none"', "pupil_radius = 1.5\nsclera = false\niris_slope = 0.1")
        + "[picture]\nexposure = 2"
    )
    text = text.replace("[camera]", "[camera]\npolar_deg = 45\ndistance = 300")
    file = parse_scene(text)
    scene = file.scene()
    assert (
        file.exposure == 2
        and scene.maps is None
        and scene.veins is None
        and scene.eye.sclera is None
    )
    assert (float(scene.iris.eumelanin), float(scene.iris.pheomelanin)) == pytest.approx(
        (0.05, 0.0194)
    )
    assert (float(scene.eye.pupil_radius), float(scene.eye.iris_slope)) == (1.5, 0.1)
    assert (float(scene.camera.polar), float(scene.camera.distance)) == pytest.approx(
        (math.pi / 4, 300)
    )
    assert scene.camera.size == (8, 6)
    away = np.linalg.norm([10, 20, 40])
    expected = [
        [0.5 * np.cos(np.pi / 18), 0.5 * np.sin(np.pi / 18), -np.sqrt(0.75)],
        np.array([10, 20, -40]) / away,
    ]
    np.testing.assert_allclose(scene.lights.towards, expected, atol=1e-7)
    np.testing.assert_allclose(scene.lights.irradiance, [np.pi, 1.5])
    np.testing.assert_allclose(scene.lights.distance, [np.inf, away])


def test_empty_file_is_the_default_eye():
    scene = parse_scene("").scene()
    assert scene.lights is not None and len(scene.lights) == 1 and scene.environment is None
    assert scene.maps is not None and scene.eye.cornea is not None and scene.veins is not None
    assert scene.camera.size == (800, 600)


def test_one_chamber_has_one_index():
    found = parse_scene(BARE.replace('cornea = "none"', 'cornea = "f09"\nsclera = false')).scene()
    assert float(found.eye.aqueous_index) == pytest.approx(1.376)


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
            SECTIONS[section][key](value)
            found.setdefault(section, set()).add(key)
    assert found == {name: set(checks) for name, checks in SECTIONS.items()}


def test_seeds_grow_other_maps():
    def relief(seed):
        return np.asarray(
            parse_scene(f'[iris]\npreset = "blue"\n[maps]\nseed = {seed}\n[eye]\nsclera = false')
            .scene()
            .maps.relief
        )

    first = relief(1)
    np.testing.assert_array_equal(first, relief(1))
    assert np.abs(first - relief(2)).max() > 0.01


WRONG = {
    "[irs]\nlevel = 1": "scene.toml, line 1: unknown section [irs]; known: iris, maps",
    "\n[iris]\nlevel = 'low'\ncolour = 'red'": "scene.toml, line 4: unknown 'colour' in iris; known: preset, level",
    "[iris]\nlevel = 'middling'": "scene.toml, line 2: iris.level = 'middling' must be one of low, moderate, high",
    "[iris]\neumelanin = -1": "scene.toml, line 2: iris.eumelanin = -1 must be a number, 0 or more",
    "[iris]\neumelanin = nan": "scene.toml, line 2: iris.eumelanin = nan must be a number",
    "[iris]\neumelanin = 'lots'": "scene.toml, line 2: iris.eumelanin = 'lots' must be a number",
    "[iris]\neumelanin = true": "scene.toml, line 2: iris.eumelanin = True must be a number",
    "[iris]\npreset = 'blue'\nlevel = 'low'": "scene.toml, line 1: iris: give preset or level, not both",
    "[maps]\n\nseed = 1.5": "scene.toml, line 3: maps.seed = 1.5 must be a whole number from 0 to 4294967295",
    "[maps]\nuniform = 1": "scene.toml, line 2: maps.uniform = 1 must be true or false",
    "[eye]\ncornea = 'thick'": "scene.toml, line 2: eye.cornea = 'thick' must be one of two-surfaces, f09, none",
    "[iris]\npupil_radius = 2": "scene.toml, line 2: unknown 'pupil_radius' in iris; known: preset",
    '[picture]\nilluminant = "D56"': "scene.toml, line 2: picture.illuminant = 'D56' unknown illuminant 'D56'; known: A",
    "[eye]\npupil_radius = 7": "scene.toml, line 2: eye: pupil_radius = 7 is outside [0.25, 4.75] mm",
    "[camera]\nsize = [0, 5]": "scene.toml, line 2: camera.size = [0, 5] must be a whole number from 1 to 16384",
    "[camera]\nsize = '8x6'": "scene.toml, line 2: camera.size = '8x6' must be [width, height]",
    "[light]\npolar_deg = 3": "scene.toml, line 1: light must be written [[light]]",
    "[[camera]]\nwidth = 3": "scene.toml, line 1: camera must be written [camera]",
    "[[light]]\n[[light]]\npolar_deg = 200": "scene.toml, line 3: light.polar_deg = 200 must be a number from 0 to 180",
    "[[light]]\nposition = [1, 2]": "scene.toml, line 2: light.position = [1, 2] must be [x, y, z] in mm",
    "[[light]]\ncolour = [1, 2, -1]": "scene.toml, line 2: light.colour = [1, 2, -1] must be a number from 0 to 1000",
    "[iris]\nabl_thickness = 40": "scene.toml, line 2: iris.abl_thickness = 40 must be a number from 0 to 3",
    "[[light]]\nposition = [1, 2, 3]": "scene.toml, line 1: light: a lamp's distance = 3.74166 mm is outside [20, inf) mm",
    "[[light]]\nposition = [1, 2, -300]\npolar_deg = 1": "give a light a position or angles, not both",
    "[environment]\nkind = 'sea'": "scene.toml, line 2: environment.kind = 'sea' must be one of studio, sky",
    "[environment]\nlights = 3": "scene.toml, line 1: environment: needs file or kind",
    "[environment]\nfile = 'missing.exr'": "scene.toml, line 2: missing.exr: No such file",
    "[picture]\nilluminant = 'moon'": "unknown illuminant 'moon'",
    "[picture]\nexposure = 0": "scene.toml, line 2: picture.exposure = 0 must be a number from 1e-06",
    "[iris\nlevel = 1": "scene.toml: ",
    "iris = 3": "iris must be written [iris]",
}


@pytest.mark.parametrize("text", WRONG, ids=[repr(t) for t in WRONG])
def test_wrong_entries_are_one_line(irisjax, tmp_path, text):
    (tmp_path / "scene.toml").write_text(text)
    one_line(irisjax("render", "scene.toml", "--size", "4x3"), WRONG[text])
    assert [p.name for p in tmp_path.iterdir()] == ["scene.toml"]


OPTIONS = [
    ((), "give a SCENE file or --preset"),
    (("scene.toml", "--preset", "blue"), "give a SCENE file or --preset"),
    (("--preset", "pink"), "--preset: unknown 'pink'; known: brown, hazel, green, blue, grey"),
    (("missing.toml",), "missing.toml: No such file"),
    ((".",), ".: Is a directory"),
    (("scene.toml", "-o", "eye.jpg"), "eye.jpg: must end in .png or .exr"),
    (("scene.toml", "-o", "missing/eye.png"), "missing: no such folder"),
    (("scene.toml", "--bits", "12"), "--bits 12 must be 8 or 16"),
    (("scene.toml", "--size", "8"), "--size '8': write WIDTHxHEIGHT"),
    (("scene.toml", "--size", "0x8"), "camera size (0, 8)"),
    (("scene.toml", "--size", "16385x8"), "--size 16385x8: at most 16384 along a side"),
    (("scene.toml", "--light", "30"), "--light '30': write POLAR,AZIMUTH"),
    (("scene.toml", "--light", "30,nan"), "--light '30,nan': write POLAR,AZIMUTH"),
    (("scene.toml", "--light", "30,0,-1"), "a lamp's irradiance = -1 is outside [0, inf)"),
    (("scene.toml", "--pupil", "12"), "--pupil: 12 is outside 0.5 to 9.5; it is a diameter"),
    (
        ("scene.toml", "--pupil", "0,5"),
        "--pupil: '0,5' is not a number; it is a diameter from 0.5 to 9.5 mm",
    ),
    (("scene.toml", "--camera", "30"), "--camera '30': write POLAR,AZIMUTH"),
    (
        ("scene.toml", "--camera", "30,0,200"),
        "--camera '30,0,200': camera width = 200 mm is outside [0.1, 100] mm",
    ),
    (("scene.toml", "--frames", "3"), "--frames 3 is for --animate"),
    (("scene.toml", "--exposure", "nan"), "--exposure nan must be above 0"),
    (("scene.toml", "--exposure", "-1"), "--exposure -1 must be above 0"),
    (("scene.toml", "--samples", "0"), "--samples"),
    (("scene.toml", "--seed", "-1"), "--seed"),
]


@pytest.mark.parametrize(("arguments", "message"), OPTIONS, ids=[" ".join(a) for a, _ in OPTIONS])
def test_wrong_options_are_one_line(irisjax, tmp_path, arguments, message):
    (tmp_path / "scene.toml").write_text(BARE)
    one_line(irisjax("render", *arguments), message)
    assert [p.name for p in tmp_path.iterdir()] == ["scene.toml"]


def test_command_makes_the_librarys_picture(irisjax, tmp_path):
    (tmp_path / "scene.toml").write_text(BARE + "[picture]\nexposure = 3")
    assert irisjax("render", "scene.toml", "-o", "eye.exr") == (0, "", "")
    jax.config.update("jax_enable_x64", True)
    expected = 3 * np.asarray(render(read_scene(tmp_path / "scene.toml").scene()))
    found = io.read_image(tmp_path / "eye.exr")
    np.testing.assert_allclose(found.pixels, expected, atol=1e-6)
    assert "simulated" in str(found.metadata)
    # PNG: sRGB to the nearest step; equal runs, equal bytes.
    for name in ("one.png", "two.png"):
        assert irisjax("render", "scene.toml", "--bits", "16", "-o", name) == (0, "", "")
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()
    steps = np.asarray(srgb_encode(np.clip(expected, 0, 1)))
    np.testing.assert_allclose(io.read_image(tmp_path / "one.png").pixels, steps, atol=1 / 65535)


def test_options_go_before_the_file(irisjax, tmp_path):
    (tmp_path / "scene.toml").write_text(BARE)
    status, _, err = irisjax(
        "render", "scene.toml", "--light", "0,0,3.14159265", "--pupil", "8", "--size", "9x7", "--exposure", "1e4", "-o", "a.exr"
    )  # fmt: skip
    assert (status, err) == (0, "")
    picture = io.read_image(tmp_path / "a.exr").pixels
    assert picture.shape == (7, 9, 3)
    # Light along the axis, a pupil of 8 mm: nothing within 4 mm, left and right alike.
    x = (np.arange(9) - 4) * 15 / 9
    assert not picture[3][abs(x) < 4].any() and picture[3][(abs(x) > 4.2) & (abs(x) < 5.4)].all()
    np.testing.assert_allclose(picture, picture[:, ::-1], rtol=1e-4)


def test_camera_of_the_options(irisjax, tmp_path):
    """From the picture's right by 60 degrees a flat round iris is half as wide as high, but for
    perspective.
    """
    (tmp_path / "scene.toml").write_text(BARE)
    assert irisjax(
        "render", "scene.toml", "--camera", "60,0,12", "--size", "48x48", "-o", "a.exr"
    ) == (0, "", "")
    seen = io.read_image(tmp_path / "a.exr").pixels.sum(-1) > 0
    width, height = (np.ptp(np.flatnonzero(seen.any(axis))) + 1 for axis in (0, 1))
    assert abs(width - 48 * 11 / 12 / 2) <= 1.5 and abs(height - 48 * 11 / 12) <= 1.5


def test_coloured_lamps():
    """A red lamp, a blue one and both: the picture of a plain one, channel by channel."""
    text = BARE[: BARE.index("[[light]]")]
    plain, red, blue = (
        parse_scene(f"{text}[[light]]\n{colour}").scene()
        for colour in ("", "colour = [1, 0, 0]", "colour = [0, 0, 2]")
    )
    picture = np.asarray(render(plain))
    np.testing.assert_allclose(render(red), picture * [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(
        render(red.replace(lights=red.lights + blue.lights)), picture * [1, 0, 2], atol=1e-12
    )


def test_samples_average_and_clipping_is_said(irisjax, tmp_path):
    (tmp_path / "scene.toml").write_text(BARE)
    irisjax("render", "scene.toml", "--size", "16x12", "-o", "fine.exr")
    irisjax("render", "scene.toml", "--samples", "2", "-o", "mean.exr")
    fine, mean = (io.read_image(tmp_path / f"{n}.exr").pixels for n in ("fine", "mean"))
    np.testing.assert_allclose(mean, fine.reshape(6, 2, 8, 2, 3).mean((1, 3)), atol=1e-6)
    status, out, err = irisjax("render", "scene.toml", "--exposure", "1e4", "-o", "bright.png")
    assert (status, out) == (0, "")
    assert err.startswith("irisjax: bright.png: ") and "out of sRGB's range are clipped" in err


def test_environment_from_a_file(irisjax, tmp_path):
    io.write_exr(tmp_path / "room.exr", np.asarray(Environment.studio(16).radiance))
    text = (
        BARE[: BARE.index("[[light]]")]
        + '[environment]\nfile = "room.exr"\nlights = 5\nstrength = 2'
    )
    scene = parse_scene(text, folder=tmp_path).scene()
    assert scene.lights is None and len(scene.all_lights()) == 5
    np.testing.assert_allclose(
        scene.environment.radiance, 2 * Environment.studio(16).radiance, rtol=1e-5
    )


def test_nothing_half_written(irisjax, tmp_path, monkeypatch):
    def broken(*_, **__):
        raise KeyboardInterrupt

    (tmp_path / "scene.toml").write_text(BARE)
    (tmp_path / "eye.png").write_bytes(b"older")
    monkeypatch.setattr("irisjax.render.stages.prepare", broken)
    assert irisjax("render", "scene.toml") == (130, "", "irisjax: interrupted\n")
    assert (tmp_path / "eye.png").read_bytes() == b"older"
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.slow
def test_presets_render(irisjax, tmp_path):
    assert irisjax("render", "--preset", "hazel", "--size", "40x30", "-o", "eye.png")[0] == 0
    picture = io.read_image(tmp_path / "eye.png").pixels
    assert picture.shape == (30, 40, 3) and picture.max() > 0.3


def test_spectral_layers_add_up_to_the_picture(irisjax, tmp_path):
    """81 layers under the colour-matching functions give the RGB picture, to the ten bands' own
    error.
    """
    from irisjax.measure.colour import OBSERVER, illuminant_power, tristimulus_matrix

    path = tmp_path / "bare.toml"
    path.write_text(BARE)
    assert irisjax("render", path, "-o", "rgb.exr") == (0, "", "")
    assert irisjax("render", path, "--spectral", "380:780:5", "-o", "layers.exr") == (0, "", "")
    image = io.read_image("layers.exr")
    grid = 380 + 5.0 * np.arange(81)
    order = [image.channels.index(name) for name in io.spectral_channels(grid)]
    reflected = image.pixels[..., order] / illuminant_power("D65", grid)
    rgb = reflected @ np.asarray(tristimulus_matrix(grid, "linear sRGB", "D65", OBSERVER)[0]).T
    expected = io.read_image("rgb.exr")
    expected = expected.pixels[..., [expected.channels.index(c) for c in "RGB"]]
    np.testing.assert_allclose(rgb, expected, atol=0.01 * expected.max())
    one_line(irisjax("render", path, "--spectral", "400:700:10", "-o", "x.png"), "must end in .exr")
    one_line(
        irisjax("render", "--preset", "blue", "--spectral", "400:700:10", "-o", "x.exr"),
        "not spectra",
    )


@pytest.mark.slow  # an eye is grown and tabulated
def test_a_lamp_goes_round_a_preset(irisjax):
    """A preset has no lamp, only a studio."""
    assert (
        irisjax(
            "render",
            "--preset",
            "green",
            "--animate",
            "light",
            "--size",
            "8x6",
            "--frames",
            2,
            "-o",
            "a.gif",
        )[0]
        == 0
    )


def test_pigment_reaches_brown_from_any_eye():
    scene = parse_scene(
        '[iris]\npreset = "blue"\n[maps]\nuniform = true\n[eye]\ncornea = "none"'
    ).scene()
    light, dark = frames(scene.replace(camera=Camera(size=(8, 6))), "pigment", 2)
    assert dark.max(axis=(0, 1))[2] < 0.3 * light.max(axis=(0, 1))[2]


def test_animations_return_to_their_first_frame(irisjax, tmp_path):
    from PIL import Image

    path = tmp_path / "bare.toml"
    path.write_text(BARE)
    options = ("--frames", 4, "--exposure", 8)
    assert irisjax("render", path, "--animate", "pigment", *options, "-o", "a.gif")[:2] == (0, "")
    with Image.open("a.gif") as gif:
        assert (gif.n_frames, gif.size, gif.info["loop"]) == (4, (8, 6), 0)
        assert b"simulated" in gif.info["comment"]
    status, out, err = irisjax(
        "render", path, "--animate", "pigment", *options[:2], "--exposure", 1e3, "-o", "f_%d.png"
    )
    assert (status, out) == (0, "") and "out of sRGB's range are clipped" in err
    assert sorted(p.name for p in tmp_path.glob("f_*")) == [f"f_{i}.png" for i in range(4)]
    assert irisjax("render", path, "--animate", "pupil", *options, "-o", "sheet.png")[:2] == (0, "")
    sheet = io.read_image("sheet.png").pixels
    assert sheet.shape == (12, 16, 3)
    narrow, half, wide, again = sheet[:6, :8], sheet[:6, 8:], sheet[6:, :8], sheet[6:, 8:]
    np.testing.assert_array_equal(half, again)  # on the way out and on the way back
    assert narrow.sum() > half.sum() > wide.sum()  # a wide pupil leaves less iris
    one_line(irisjax("render", path, "--animate", "iris", "-o", "a.gif"), "unknown 'iris'")
    one_line(
        irisjax("render", path, "--animate", "light", "-o", "f_%x.png"),
        "f_%x.png: the name of numbered frames",
    )


@pytest.mark.peer  # needs the extra irisjax[video]
def test_animations_as_mp4(irisjax, tmp_path):
    import av

    path = tmp_path / "bare.toml"
    path.write_text(BARE)
    options = ("--frames", 4, "--exposure", 8, "--size", "9x7")
    assert irisjax("render", path, "--animate", "pigment", *options, "-o", "a.mp4")[:2] == (0, "")
    with av.open("a.mp4") as movie:
        assert [(f.width, f.height) for f in movie.decode(video=0)] == [(9, 7)] * 4
