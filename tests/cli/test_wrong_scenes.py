"""Wrong scene files and options of `irisjax render` end in one line, with nothing written."""

import pytest
from refusals import one_line

from scene_files import BARE


@pytest.fixture(autouse=True)
def _in_an_empty_folder(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)


WRONG = {
    "[irs]\nlevel = 1": "scene.toml, line 1: unknown section [irs]; known: iris, maps",
    "\n[iris]\nlevel = 'low'\ncolour = 'red'": "scene.toml, line 4: unknown 'colour' in iris; known: preset, level",
    "[iris]\nlevel = 'middling'": "scene.toml, line 2: iris.level = 'middling' must be one of low, moderate, high",
    "[iris]\neumelanin = -1": "scene.toml, line 2: iris.eumelanin = -1 must be a number in [0, 2000] mg/ml",
    "[iris]\neumelanin = nan": "scene.toml, line 2: iris.eumelanin = nan must be a number",
    "[iris]\neumelanin = 'lots'": "scene.toml, line 2: iris.eumelanin = 'lots' must be a number",
    "[iris]\neumelanin = true": "scene.toml, line 2: iris.eumelanin = True must be a number",
    "[iris]\npreset = 'blue'\nlevel = 'low'": "scene.toml, line 1: iris: give preset or level, not both",
    "[maps]\n\nseed = 1.5": "scene.toml, line 3: maps.seed = 1.5 must be a whole number in [0, 4294967295]",
    "[maps]\nuniform = 1": "scene.toml, line 2: maps.uniform = 1 must be true or false",
    "[eye]\ncornea = 'thick'": "scene.toml, line 2: eye.cornea = 'thick' must be one of two-surfaces, f09, none",
    "[iris]\npupil_radius = 2": "scene.toml, line 2: unknown 'pupil_radius' in iris; known: preset",
    '[picture]\nilluminant = "D56"': "scene.toml, line 2: picture.illuminant = 'D56' unknown illuminant 'D56'; known: A",
    "[eye]\npupil_radius = 7": "scene.toml, line 2: eye.pupil_radius = 7 must be a number in [0.25, 4.75] mm",
    "[camera]\nsize = [0, 5]": "scene.toml, line 2: camera.size = [0, 5] must be a whole number in [1, 16384]",
    "[camera]\nsize = '8x6'": "scene.toml, line 2: camera.size = '8x6' must be [width, height]",
    "[light]\npolar_deg = 3": "scene.toml, line 1: light must be written [[light]]",
    "[[camera]]\nwidth = 3": "scene.toml, line 1: camera must be written [camera]",
    "[[light]]\n[[light]]\npolar_deg = 200": "scene.toml, line 3: light.polar_deg = 200 must be a number in [0, 180]",
    "[[light]]\nposition = [1, 2]": "scene.toml, line 2: light.position = [1, 2] must be [x, y, z] in mm",
    "[[light]]\ncolour = [1, 2, -1]": "scene.toml, line 2: light.colour = [1, 2, -1] must be a number in [0, 1e+06]",
    "[iris]\nabl_thickness = 40": "scene.toml, line 2: iris.abl_thickness = 40 must be a number in [0, 3] mm",
    "[[light]]\nposition = [1, 2, 3]": "scene.toml, line 1: light: a lamp's distance = 3.74166 mm is outside [20, inf) mm",
    "[[light]]\nposition = [1, 2, -300]\npolar_deg = 1": "give a light a position or angles, not both",
    "[environment]\nkind = 'sea'": "scene.toml, line 2: environment.kind = 'sea' must be one of studio, sky",
    "[environment]\nlights = 3": "scene.toml, line 1: environment: needs file or kind",
    "[environment]\nfile = 'missing.exr'": "scene.toml, line 2: missing.exr: No such file",
    "[picture]\nilluminant = 'moon'": "unknown illuminant 'moon'",
    "[picture]\nexposure = 0": "scene.toml, line 2: picture.exposure = 0 must be a number in [1e-06, 1e+06]",
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
    (("scene.toml", "--size", "²x8"), "--size '²x8': write WIDTHxHEIGHT"),
    (("scene.toml", "--size", "0x8"), "--size 0x8: must be from 1 to 16384 along a side"),
    (("scene.toml", "--size", "16385x8"), "--size 16385x8: must be from 1 to 16384 along a side"),
    (("scene.toml", "--light", "30"), "--light '30': write POLAR,AZIMUTH"),
    (("scene.toml", "--light", "30,nan"), "--light '30,nan': write POLAR,AZIMUTH"),
    (
        ("scene.toml", "--light", "30,0,-1"),
        "'30,0,-1': a lamp's irradiance = -1 is outside [0, 1e+06]",
    ),
    (("scene.toml", "--pupil-radius", "6"), "--pupil-radius: 6 is outside [0.25, 4.75] mm"),
    (("scene.toml", "--pupil-radius", "0,5"), "--pupil-radius: '0,5' is not a number"),
    (("scene.toml", "--light", "30,0,1e7"), "a lamp's irradiance = 1e+07 is outside [0, 1e+06]"),
    (("scene.toml", "--camera", "30"), "--camera '30': write POLAR,AZIMUTH"),
    (
        ("scene.toml", "--camera", "30,0,200"),
        "'30,0,200': camera width = 200 mm is outside [0.1, 100]",
    ),
    (("scene.toml", "--frames", "3"), "--frames means something only with --animate"),
    (("scene.toml", "--exposure", "nan"), "--exposure: nan is outside (0, inf)"),
    (("scene.toml", "--exposure", "-1"), "--exposure: -1 is outside (0, inf)"),
    (("scene.toml", "--samples", "0"), "--samples"),
    (("scene.toml", "--seed", "-1"), "--seed"),
]


@pytest.mark.parametrize(("arguments", "message"), OPTIONS, ids=[" ".join(a) for a, _ in OPTIONS])
def test_wrong_options_are_one_line(irisjax, tmp_path, arguments, message):
    (tmp_path / "scene.toml").write_text(BARE)
    one_line(irisjax("render", *arguments), message)
    assert [p.name for p in tmp_path.iterdir()] == ["scene.toml"]
