"""`irisjax clone`: what it writes, prints and refuses."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from refusals import one_line

import irisjax as ij
from irisjax.io.scenes import read_scene

DATA = Path(__file__).parent.parent.parent / "data" / "photographs"
NAME = "green_tilted.jpg"
SUMMARY = {"limbus", "pupil", "settings", "seconds", "photograph", "notes"}
POSED = {"tilt_deg", "tilt_sd_deg", "distance_mm", "azimuth_deg", "pupil_radius_mm"}


@pytest.fixture(scope="module")
def truth():
    entries = json.loads((DATA / "truth.json").read_text())["photographs"]
    return next(entry for entry in entries if entry["file"] == NAME)


@pytest.fixture(scope="module")
def outlined(truth):
    """Options that give the outlines."""
    options = []
    for name in ("limbus", "pupil"):
        e = truth[name]
        numbers = [*e["centre_px"], *e["semi_axes_px"], np.degrees(e["angle"])]
        options += [f"--{name}", ",".join(f"{n:.6f}" for n in numbers)]
    return options


def _summary(folder):
    return json.loads((folder / "clone.json").read_text())


def _files(folder):
    return {p.name for p in folder.iterdir()}


@pytest.mark.heavy  # a picture of a million pixels is searched
def test_outlines(irisjax, tmp_path, truth):
    folder = tmp_path / "new" / "clone"
    status, out, err = irisjax("clone", DATA / NAME, "-o", folder, "--stop-after", "outlines")
    assert status == 0, err
    assert str(folder) in out
    assert _files(folder) == {"clone.json"}
    found = _summary(folder)
    assert set(found) >= SUMMARY and "tilt_deg" not in found
    for name in ("limbus", "pupil"):
        own, other = found[name], truth[name]
        radius = other["semi_axes_px"][0]
        np.testing.assert_allclose(own["centre_px"], other["centre_px"], atol=0.02 * radius)
        np.testing.assert_allclose(own["semi_axes_px"], other["semi_axes_px"], atol=0.02 * radius)
        assert own["semi_axes_px"][0] >= own["semi_axes_px"][1]
        assert 0.4 < own["confidence"] <= 1
        assert isinstance(own["angle_deg"], float)


def test_given_outlines_are_taken_and_a_clone_is_kept(irisjax, tmp_path, outlined):
    arguments = ("clone", DATA / NAME, "-o", tmp_path, "--stop-after", "outlines", *outlined)
    assert irisjax(*arguments)[0] == 0
    found = _summary(tmp_path)
    assert found["limbus"]["confidence"] == found["pupil"]["confidence"] == 1
    given = [float(n) for n in outlined[1].split(",")]
    own = found["limbus"]
    np.testing.assert_allclose(
        [*own["centre_px"], *own["semi_axes_px"], own["angle_deg"]], given, atol=1e-5
    )
    before = (tmp_path / "clone.json").read_bytes()
    one_line(irisjax(*arguments), "has a clone; --overwrite begins anew")
    assert (tmp_path / "clone.json").read_bytes() == before
    (tmp_path / "scene.toml").write_text("of a clone that came further")
    (tmp_path / "notes.txt").write_text("mine")
    assert irisjax(*arguments, "--overwrite")[0] == 0
    assert _files(tmp_path) == {"clone.json", "notes.txt"}


@pytest.mark.heavy  # compiles the refraction
def test_texture(irisjax, tmp_path, outlined, truth):
    focal = truth["camera"]["focal_px"]
    status, out, err = irisjax(
        *("clone", DATA / NAME, "-o", tmp_path, "--stop-after", "texture", *outlined),
        *("--focal-px", f"{focal:.3f}"),
    )
    assert status == 0, err
    assert all(line.startswith(f"irisjax: {DATA / NAME}: ") for line in err.splitlines())
    assert "degrees off the eye's axis" in out
    assert _files(tmp_path) == {"clone.json", "unrefracted.png", "visible.png"}
    found = _summary(tmp_path)
    assert set(found) >= SUMMARY | POSED
    assert found["tilt_deg"] == pytest.approx(30, abs=1)
    assert found["distance_mm"] == pytest.approx(truth["camera"]["distance"], rel=0.03)
    assert found["pupil_radius_mm"] == pytest.approx(truth["eye"]["pupil_radius"], abs=0.02)
    picture = np.asarray(Image.open(tmp_path / "unrefracted.png"))
    assert picture.shape[0] == picture.shape[1]
    middle = picture.shape[0] // 2
    # Centred on the pupil, 12 mm wide: black there and beyond the iris, tissue in between.
    bright = picture.max(-1)[middle]
    at = (np.arange(len(bright)) + 0.5) * 12 / len(bright) - 6
    assert bright[abs(at) > 5.6].max() == 0
    pupil, iris = bright[abs(at) < 1.4], bright[(at < -2.2) & (at > -4.5)]
    assert np.median(pupil) < 0.5 * np.median(iris)


WRONG = [
    (("missing.jpg",), "missing.jpg"),
    (("words.jpg",), "words.jpg"),
    (("grey.png", "--limbus", "1,2,3,4"), "--limbus '1,2,3,4': write X,Y,A,B,DEG, five numbers"),
    (("grey.png", "--limbus", "9,9,3,4,0"), "the semi-axes must be A >= B > 0"),
    (("grey.png", "--pupil", "9,9,nan,4,0"), "the semi-axes must be A >= B > 0"),
    (("grey.png", "--stop-after", "lunch"), "--stop-after: unknown 'lunch'; known: outlines, "),
    (("grey.png", "--media", "water"), "--media: unknown 'water'; known: cornea-aqueous, f09"),
    (("grey.png", "--method", "luck"), "--method: unknown 'luck'; known: least-squares, simplex"),
    (("grey.png", "--process", "lb06"), "--process: unknown 'lb06'"),
    (("grey.png", "--focal-px", "0"), "--focal-px: 0 is outside [10, 1e+06]"),
    (("grey.png", "--focal-px", "long"), "--focal-px: 'long' is not a number"),
    (("grey.png", "--iris-depth", "9"), "--iris-depth: 9 is outside [2.5, 8]"),
    (("grey.png", "--max-steps", "1"), "--max-steps: 1 is outside"),
    (("grey.png", "--deconvolution", "3"), "--deconvolution: 3 is outside [0, 2]; or write fit"),
    (("grey.png", "--deconvolution", "fit"), "--deconvolution means something only with --beta"),
    (("grey.png", "--maps", "missing.exr"), "missing.exr"),
    (("grey.png", "--second", "missing.jpg"), "missing.jpg"),
    (("grey.png", "--light", "30"), "--light '30': write POLAR,AZIMUTH"),
    (("grey.png", "--environment", "missing.exr"), "missing.exr"),
    (("grey.png", "--freckles", "missing.png"), "missing.png"),
    (("grey.png", "-o", "words.jpg"), "words.jpg: is a file, not a folder"),
    (("grey.png", "-o", "words.jpg/inside"), "words.jpg: is a file, not a folder"),
    (("grey.png",), "grey.png: no iris found; give --limbus"),
    ((), "Missing argument 'PHOTO'"),
]


@pytest.mark.parametrize(("arguments", "message"), WRONG, ids=[" ".join(a) for a, _ in WRONG])
def test_wrong_input_is_one_line(irisjax, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "words.jpg").write_text("not a picture")
    Image.new("RGB", (96, 72), (90, 90, 90)).save(tmp_path / "grey.png")
    extra = () if "-o" in arguments else ("-o", "clone")
    one_line(irisjax("clone", *arguments, *extra), message)
    assert _files(tmp_path) == {"words.jpg", "grey.png"}


def test_a_folder_must_be_given(irisjax):
    one_line(irisjax("clone", "eye.jpg"), "Missing option '-o' / '--output'")


@pytest.fixture(scope="module")
def painted(tmp_path_factory):
    """A flat disc, as bright at its edge as within, about a black one: no iris of the model's."""
    path = tmp_path_factory.mktemp("painted") / "disc.png"
    row, column = np.indices((420, 420))
    radius = np.hypot(row - 209.5, column - 209.5)
    picture = np.full((420, 420, 3), 215, np.uint8)
    picture[radius < 180] = 60, 130, 40
    picture[radius < 60] = 4
    Image.fromarray(picture).save(path)
    return path, ("--limbus", "209.5,209.5,180,180,0", "--pupil", "209.5,209.5,60,60,0")


@pytest.mark.heavy  # compiles the search
def test_what_the_model_cannot_follow_is_doubtful(irisjax, tmp_path, painted):
    path, outlines = painted
    asked = "--focal-px", "1500", "--stop-after", "pigments"
    status, out, err = irisjax("clone", path, "-o", tmp_path / "clone", *outlines, *asked)
    assert status == 3, err
    found = _summary(tmp_path / "clone")
    assert any("far from what is usual" in doubt for doubt in found["doubts"])
    assert any("camera 46 mm away" in doubt for doubt in found["doubts"])
    assert all(f"WARNING: {doubt}" in err for doubt in found["doubts"])
    assert len(found["picture_rms"]) == 3
    assert f"RMS: {100 * found['picture_rms'][0]:.1f}, " in out
    assert {"maps.exr", "scene.toml", "convergence.csv"} <= _files(tmp_path / "clone")


@pytest.mark.heavy
def test_what_was_found_before_a_stage_failed_is_written(irisjax, tmp_path, painted):
    """All but a sector of the iris is hidden: too little for pigments."""
    path, outlines = painted
    seen = np.zeros((1024, 1024, 3), np.uint8)
    seen[:512, 520:545] = 255
    Image.fromarray(seen).save(tmp_path / "seen.png")
    asked = "clone", path, "-o", tmp_path / "clone", *outlines, "--visible", tmp_path / "seen.png"
    status, _, err = irisjax(*asked)
    assert status == 3
    assert "WARNING: pigments: only " in err and "what is before it is written" in err
    files = {"clone.json", "unrefracted.png", "visible.png", "maps.exr"}
    assert files <= _files(tmp_path / "clone") and "scene.toml" not in _files(tmp_path / "clone")
    visible = np.asarray(Image.open(tmp_path / "clone" / "visible.png"))[..., 0] > 127
    assert visible.any() and not visible[:, :500].any() and not visible[525:].any()
    small = tmp_path / "small.png"
    Image.fromarray(seen[:64, :64]).save(small)
    one_line(irisjax(*asked[:-1], small, "--overwrite"), "the mask of what is visible is (64, 64)")


@pytest.mark.slow  # compiles for minutes
def test_a_whole_clone(irisjax, tmp_path, outlined):
    status, out, err = irisjax(
        *("clone", DATA / NAME, "-o", tmp_path, *outlined, "--max-steps", "150")
    )
    assert status == 3 and "raise --max-steps" in err  # so few steps are not enough
    assert "abl_eumelanin" in out and "difference of the pictures" in out
    files = {
        "clone.json",
        "unrefracted.png",
        "visible.png",
        "freckles.png",
        "deconvolved.png",
        "maps.exr",
    }
    files |= {"scene.toml", "side_by_side.png", "differences.png", "luminance.png"}
    assert _files(tmp_path) >= files
    found = _summary(tmp_path)
    assert set(found) >= SUMMARY | POSED | {"posterior", "chain", "estimate", "units"}
    assert not found["chain"]["converged"]
    for entry in found["posterior"].values():
        assert entry["q2.5"] <= entry["median"] <= entry["q97.5"] and entry["sd"] > 0
    scene = read_scene(tmp_path / "scene.toml").scene()
    for name in ("scattering_scale", "eumelanin", "pheomelanin"):
        assert float(getattr(scene.iris, name)) > 0
    assert scene.maps is not None
    maps = ij.io.read_maps(tmp_path / "maps.exr")
    np.testing.assert_allclose(scene.maps.stroma_depth, maps.stroma_depth)
