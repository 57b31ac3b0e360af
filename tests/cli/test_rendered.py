"""`irisjax render` in whole: the library's pictures, and animations."""

import jax
import numpy as np
import pytest
from refusals import one_line

from irisjax import io
from irisjax.cli.render import frames
from irisjax.io.scenes import parse_scene, read_scene
from irisjax.measure.colour import srgb_encode
from irisjax.render.camera import Camera
from irisjax.render.picture import draw
from scene_files import BARE


@pytest.fixture(autouse=True)
def _in_an_empty_folder(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)


def test_command_makes_the_librarys_picture(irisjax, tmp_path):
    (tmp_path / "scene.toml").write_text(BARE + "[picture]\nexposure = 3")
    assert irisjax("render", "scene.toml", "-o", "eye.exr") == (0, "", "")
    jax.config.update("jax_enable_x64", True)
    expected = 3 * np.asarray(draw(read_scene(tmp_path / "scene.toml").scene()))
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
    said = ("--light", "0,0,3.14159265", "--pupil-radius", "4", "--size", "16x12")
    status, _, err = irisjax("render", "scene.toml", *said, "--exposure", "1e4", "-o", "a.exr")
    assert (status, err) == (0, "")
    picture = io.read_image(tmp_path / "a.exr").pixels
    assert picture.shape == (12, 16, 3)
    # Light along the axis, a pupil of 8 mm: nothing within 4 mm, left and right alike.
    x = (np.arange(16) - 7.5) * 15 / 16
    assert not picture[6][abs(x) < 3.9].any() and picture[6][(abs(x) > 4.2) & (abs(x) < 5.4)].all()
    np.testing.assert_allclose(picture, picture[:, ::-1], rtol=1e-4)


def test_camera_of_the_options(irisjax, tmp_path):
    """From the picture's right by 60 degrees a flat round iris is half as wide as high, but for
    perspective.
    """
    (tmp_path / "scene.toml").write_text(BARE)
    said = ("--camera", "60,0,12", "--size", "48x48", "-o", "a.exr")
    assert irisjax("render", "scene.toml", *said) == (0, "", "")
    seen = io.read_image(tmp_path / "a.exr").pixels.sum(-1) > 0
    width, height = (np.ptp(np.flatnonzero(seen.any(axis))) + 1 for axis in (0, 1))
    assert abs(width - 48 * 11 / 12 / 2) <= 1.5 and abs(height - 48 * 11 / 12) <= 1.5


def test_samples_average_and_clipping_is_said(irisjax, tmp_path):
    (tmp_path / "scene.toml").write_text(BARE)
    irisjax("render", "scene.toml", "--size", "16x12", "-o", "fine.exr")
    irisjax("render", "scene.toml", "--samples", "2", "-o", "mean.exr")
    fine, mean = (io.read_image(tmp_path / f"{n}.exr").pixels for n in ("fine", "mean"))
    np.testing.assert_allclose(mean, fine.reshape(6, 2, 8, 2, 3).mean((1, 3)), atol=1e-6)
    status, out, err = irisjax("render", "scene.toml", "--exposure", "1e4", "-o", "bright.png")
    assert (status, out) == (0, "")
    assert err.startswith("irisjax: bright.png: ") and "out of sRGB's range are clipped" in err


def test_nothing_half_written(irisjax, tmp_path, monkeypatch):
    def broken(*_, **__):
        raise KeyboardInterrupt

    (tmp_path / "scene.toml").write_text(BARE)
    (tmp_path / "eye.png").write_bytes(b"older")
    monkeypatch.setattr("irisjax.render.picture.illuminate", broken)
    one_line(irisjax("render", "scene.toml"), "eye.png: exists; --overwrite replaces it")
    status = irisjax("render", "scene.toml", "--overwrite")
    assert status == (130, "", "irisjax: interrupted\n")
    assert (tmp_path / "eye.png").read_bytes() == b"older"
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.slow
def test_presets_render(irisjax, tmp_path):
    assert irisjax("render", "--preset", "hazel", "--size", "40x30", "-o", "eye.png")[0] == 0
    picture = io.read_image(tmp_path / "eye.png").pixels
    assert picture.shape == (30, 40, 3) and picture.max() > 0.3


@pytest.mark.slow  # 6 s of compiling
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


@pytest.mark.slow  # an eye is grown and tabulated
def test_a_lamp_goes_round_a_preset(irisjax):
    """A preset has no lamp, only a studio."""
    said = ("--animate", "light", "--size", "8x6", "--frames", 2, "-o", "a.gif")
    assert irisjax("render", "--preset", "green", *said)[0] == 0


def test_pigment_reaches_brown_from_any_eye():
    scene = parse_scene(
        '[iris]\npreset = "blue"\n[maps]\nuniform = true\n[eye]\ncornea = "none"'
    ).scene()
    light, dark = frames(scene.replace(camera=Camera(size=(8, 6))), "pigment", 2)
    assert dark.max(axis=(0, 1))[2] < 0.3 * light.max(axis=(0, 1))[2]


def test_an_animation_without_light_is_said_to_be_black(irisjax, tmp_path):
    path = tmp_path / "dark.toml"
    path.write_text(BARE)
    given = ("--light", "170,0", "--animate", "pupil", "--frames", 2, "-o", "dark.gif")
    status, _, err = irisjax("render", path, *given)
    assert status == 0
    assert "dark.gif: the picture is black: no light falls on what the camera sees" in err


def test_animations_return_to_their_first_frame(irisjax, tmp_path):
    from PIL import Image

    path = tmp_path / "bare.toml"
    path.write_text(BARE)
    options = ("--frames", 4, "--exposure", 8)
    assert irisjax("render", path, "--animate", "pigment", *options, "-o", "a.gif")[:2] == (0, "")
    with Image.open("a.gif") as gif:
        assert (gif.n_frames, gif.size, gif.info["loop"]) == (4, (8, 6), 0)
        assert b"simulated" in gif.info["comment"]
    bright = (*options[:2], "--exposure", 1e3, "-o", "f_%d.png")
    status, out, err = irisjax("render", path, "--animate", "pigment", *bright)
    assert (status, out) == (0, "") and "out of sRGB's range are clipped" in err
    assert sorted(p.name for p in tmp_path.glob("f_*")) == [f"f_{i}.png" for i in range(4)]
    assert irisjax("render", path, "--animate", "pupil", *options, "-o", "sheet.png")[:2] == (0, "")
    sheet = io.read_image("sheet.png").pixels
    assert sheet.shape == (12, 16, 3)
    narrow, half, wide, again = sheet[:6, :8], sheet[:6, 8:], sheet[6:, :8], sheet[6:, 8:]
    np.testing.assert_array_equal(half, again)  # on the way out and on the way back
    assert narrow.sum() > half.sum() > wide.sum()  # a wide pupil leaves less iris
    one_line(irisjax("render", path, "--animate", "iris", "-o", "a.gif"), "unknown 'iris'")
    wrong = irisjax("render", path, "--animate", "light", "-o", "f_%x.png")
    one_line(wrong, "f_%x.png: the name of numbered frames")


@pytest.mark.peer  # needs the extra irisjax[video]
def test_animations_as_mp4(irisjax, tmp_path):
    import av

    path = tmp_path / "bare.toml"
    path.write_text(BARE)
    options = ("--frames", 4, "--exposure", 8, "--size", "9x7")
    assert irisjax("render", path, "--animate", "pigment", *options, "-o", "a.mp4")[:2] == (0, "")
    with av.open("a.mp4") as movie:
        assert [(f.width, f.height) for f in movie.decode(video=0)] == [(9, 7)] * 4
