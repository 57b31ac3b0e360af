"""`irisjax render`: what is refused before anything is drawn, what is handed to the renderer."""

import importlib

import pytest
from refusals import one_line

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


@pytest.fixture
def drawn(tmp_path, monkeypatch):
    """Nothing is drawn; what would have been."""
    monkeypatch.chdir(tmp_path)
    calls = []
    monkeypatch.setattr(render, "_still", lambda *given: calls.append(given))
    return calls


def scene(tmp_path, *parts):
    (tmp_path / "scene.toml").write_text("".join([SCENE, *parts]))
    return "scene.toml"


def test_bits_are_of_a_png(irisjax, drawn, tmp_path):
    path = scene(tmp_path, LAMP)
    one_line(irisjax("render", path, "--bits", "16", "-o", "eye.exr"), "--bits is for PNG")
    assert not drawn
    assert irisjax("render", path, "-o", "eye.exr")[0] == 0


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
        (
            [COLOURED],
            "--spectral needs plain lamps: a light's colour has no spectrum; give --light",
        ),
        ([LAMP, COLOURED], "--spectral needs plain lamps"),
        ([STUDIO], "--spectral needs lamps: an environment has colours, not spectra; give --light"),
    ],
    ids=["coloured", "one of two", "environment"],
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
    how = ("--samples", "3", "--integrator", "single-scattering", "--bits", "16")
    assert irisjax("render", path, *said, *how, "-o", "eye.png") == (0, "", "")
    ((found, picture, exposure, output),) = drawn
    assert found.camera.size == (32, 24)
    assert float(found.camera.width) == 11
    assert float(found.eye.pupil_radius) == 2
    assert type(found.integrator).__name__ == "SingleScattering"
    assert (picture.samples, picture.bits, exposure, str(output)) == (3, 16, 2, "eye.png")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--samples", "9"), "--samples: 9 is outside [1, 8]"),
        (("--frames", "1", "--animate", "light"), "--frames: 1 is outside [2, 1000]"),
        (("--spectral", "red"), "--spectral: 'red' is not a grid"),
        (("--animate", "light", *SPECTRAL), "--animate: not with --spectral"),
        (("--integrator", "f09"), "--integrator: unknown 'f09'; known: separable"),
        (("--bits", "many"), "--bits"),
    ],
    ids=lambda x: " ".join(x) if isinstance(x, tuple) else "",
)
def test_wrong_input_is_one_line(irisjax, drawn, tmp_path, arguments, message):
    one_line(irisjax("render", scene(tmp_path, LAMP), *arguments), message)
    assert not drawn
