"""`irisjax clone`: what it writes, prints and refuses."""

import json
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image
from refusals import one_line

import irisjax as ij
from common import rows_by
from irisjax.cli.clone import report
from irisjax.io.scenes import read_scene
from irisjax.photo import clone as cloning
from irisjax.photo import texture
from irisjax.photo.doubts import doubts_of
from irisjax.photo.outlines import Boundaries
from irisjax.photo.photograph import Ellipse
from irisjax.photo.pigments import FREE_NAMES, PRIORS, PigmentFit, PigmentPosterior
from irisjax.photo.pose import Pose
from irisjax.photo.texture import follow_refraction
from irisjax.photo.thickness import Morphology
from irisjax.photo.windows import WhiteSeen, Windows
from irisjax.render.camera import Camera

DATA = Path(__file__).parent.parent.parent / "data" / "photographs"
NAME = "green_tilted.jpg"
SUMMARY = {"limbus", "pupil", "settings", "seconds", "photograph", "notes"}
FLAT = (
    "clone.json",
    "outlines.png",
    "unrefracted.png",
    "visible.png",
    "freckles.png",
    "deconvolved.png",
)
ENDS = "q2.5", "lab", "q97.5"
POSED = {"tilt_deg", "tilt_sd_deg", "distance_mm", "azimuth_deg", "pupil_radius_mm"}


@pytest.fixture(scope="module")
def truth():
    """Return the true outlines in the photograph at an eighth of its size."""
    entries = json.loads((DATA / "truth.json").read_text())["photographs"]
    found = next(entry for entry in entries if entry["file"] == NAME)
    for name in ("limbus", "pupil"):
        e = found[name]
        centre = [(c + 0.5) / 8 - 0.5 for c in e["centre_px"]]
        e |= {"centre_px": centre, "semi_axes_px": [a / 8 for a in e["semi_axes_px"]]}
    found["camera"]["focal_px"] /= 8
    return found


@pytest.fixture(scope="module")
def photo(tmp_path_factory):
    path = tmp_path_factory.mktemp("eighth") / "eighth.png"
    with Image.open(DATA / NAME) as image:
        image.reduce(8).save(path)
    return path


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


def test_outlines(done, tmp_path, truth, photo):
    folder = tmp_path / "new" / "clone"
    out, _ = done("clone", photo, "-o", folder, "--stop-after", "outlines")
    assert str(folder) in out
    assert _files(folder) == {"clone.json", "outlines.png"}
    overlay = np.asarray(Image.open(folder / "outlines.png")).astype(int)
    assert ((overlay == (0, 255, 0)).all(-1).sum() > 100) and overlay.shape[:2] == (135, 163)
    found = _summary(folder)
    assert found["eyes_found"] == 1 and found["crop_px"][0] == 0
    assert set(found) >= SUMMARY and "tilt_deg" not in found
    for name in ("limbus", "pupil"):
        own, other = found[name], truth[name]
        radius = other["semi_axes_px"][0]
        np.testing.assert_allclose(own["centre_px"], other["centre_px"], atol=0.02 * radius)
        np.testing.assert_allclose(own["semi_axes_px"], other["semi_axes_px"], atol=0.02 * radius)
        assert own["semi_axes_px"][0] >= own["semi_axes_px"][1]
        assert 0.4 < own["confidence"] <= 1
        assert isinstance(own["angle_deg"], float)


def test_given_outlines_are_taken_and_a_clone_is_kept(irisjax, tmp_path, outlined, photo):
    arguments = ("clone", photo, "-o", tmp_path, "--stop-after", "outlines", *outlined)
    assert irisjax(*arguments)[0] == 0
    found = _summary(tmp_path)
    assert found["limbus"]["confidence"] == found["pupil"]["confidence"] == 1
    given = [float(n) for n in outlined[1].split(",")]
    own = found["limbus"]
    np.testing.assert_allclose(
        [*own["centre_px"], *own["semi_axes_px"], own["angle_deg"]], given, atol=1e-5
    )
    before = (tmp_path / "clone.json").read_bytes()
    one_line(irisjax(*arguments), "has a clone; --overwrite starts again")
    assert (tmp_path / "clone.json").read_bytes() == before
    (tmp_path / "scene.toml").write_text("of a clone that came further")
    (tmp_path / "notes.txt").write_text("mine")
    assert irisjax(*arguments, "--overwrite")[0] == 0
    assert _files(tmp_path) == {"clone.json", "outlines.png", "notes.txt"}


@pytest.fixture
def known_pose(truth, monkeypatch):
    """The camera of the photograph is the true one, which compiles for long to find; what it sees
    is traced once.
    """
    camera, pupil_radius = truth["camera"], truth["eye"]["pupil_radius"]
    side, pose_eye, posed = 145, cloning.pose_eye, []
    width = side * 8 * camera["width"] / truth["size_px"][0]

    def pose(limbus, pupil, eye, *, focal_px, **_):
        angles = camera["polar"], camera["azimuth"]
        x, y = (round(c) - side // 2 for c in limbus.centre)
        return Pose(
            camera=Camera(*angles, camera["distance"], width, size=(side, side)),
            corner=(x, y),
            eye=eye.replace(pupil_radius=pupil_radius),
            pupil_centre=(0.0, 0.0),
            pupil_radius=pupil_radius,
            tilt=camera["polar"],
            tilt_sd=0.1,
            tilt_interval=(0.3, 0.7),
            distance=5.5 * focal_px / limbus.semi_axes[0],
            side="pupil",
        )

    def pose_once(*given):
        if not posed:
            posed.append(pose_eye(*given))
        return posed[0]

    monkeypatch.setattr(cloning, "find_pose", pose)
    monkeypatch.setattr(cloning, "pose_eye", pose_once)


@pytest.mark.usefixtures("known_pose")
def test_what_is_before_a_failed_stage_is_written(
    irisjax, tmp_path, outlined, truth, photo, monkeypatch
):
    """All up to the thickness, of which a mask hides all but a sector; wrong masks are refused."""
    no_light = Mock(side_effect=ValueError("only 3 windows of the iris are free"))
    monkeypatch.setattr(texture, "TEXTURE_SIZE", 256)
    monkeypatch.setattr(cloning, "follow_refraction", partial(follow_refraction, size=256))
    monkeypatch.setattr(cloning, "light_eye", no_light)
    seen = np.zeros((256, 256, 3), np.uint8)
    seen[:128, 128:] = 255
    Image.fromarray(seen).save(tmp_path / "seen.png")
    Image.fromarray(seen[:64, :64]).save(tmp_path / "small.png")
    folder, focal = tmp_path / "clone", truth["camera"]["focal_px"]
    asked = "clone", photo, "-o", folder, *outlined, "--focal-px", f"{focal:.3f}", "--visible"
    status, out, err = irisjax(*asked, tmp_path / "seen.png")
    assert status == 3
    assert "WARNING: pigments: only 3 windows" in err and "the stages before it are written" in err
    assert "degrees off the eye's axis" in out
    assert _files(folder) == {*FLAT, "maps.exr"}
    found = _summary(folder)
    assert set(found) >= SUMMARY | POSED | {"stroma_thickness_mm", "visible_share"}
    assert any("only 3 windows" in doubt for doubt in found["doubts"]["model"])
    assert found["tilt_deg"] == pytest.approx(30)
    assert found["distance_mm"] == pytest.approx(truth["camera"]["distance"], rel=0.03)
    assert found["pupil_radius_mm"] == pytest.approx(truth["eye"]["pupil_radius"])
    visible = np.asarray(Image.open(folder / "visible.png"))[..., 0] > 127
    assert visible.any() and not visible[:, :125].any() and not visible[132:].any()
    picture = np.asarray(Image.open(folder / "unrefracted.png"))
    assert picture.shape[0] == picture.shape[1]
    # Centred on the pupil, 12 mm wide: black there and beyond the iris, tissue in between.
    bright = picture.max(-1)[picture.shape[0] // 2]
    at = (np.arange(len(bright)) + 0.5) * 12 / len(bright) - 6
    assert bright[abs(at) > 5.6].max() == 0
    pupil, iris = bright[abs(at) < 1.4], bright[(at < -2.2) & (at > -4.5)]
    assert np.median(pupil) < 0.5 * np.median(iris)
    wrong = irisjax(*asked, tmp_path / "small.png", "--overwrite")
    one_line(wrong, "the mask of what is visible is (64, 64)")
    assert irisjax(*asked[:-1], "--stop-after", "pose", "--overwrite")[0] == 0
    assert _files(folder) == {"clone.json", "outlines.png"}


WRONG = {
    "missing.jpg": "missing.jpg",
    "words.jpg": "words.jpg",
    "grey.png --limbus 1,2,3,4": "--limbus '1,2,3,4': write X,Y,A,B,DEG, five numbers",
    "grey.png --limbus 9,9,3,4,0": "the semi-axes must be A >= B > 0",
    "grey.png --pupil 9,9,nan,4,0": "the semi-axes must be A >= B > 0",
    "grey.png --stop-after lunch": "--stop-after: unknown 'lunch'; known: outlines, ",
    "grey.png --media f09 --process depth-resolved": (
        "radiative transfer has no table for the refractive indices of media f09"
    ),
    "grey.png --process ilit-2006 --integrator single-scattering": (
        "--integrator names the process too; give no --process"
    ),
    "grey.png --focal-px 0": "--focal-px: 0 is outside [10, 1e+06]",
    "grey.png --deconvolution 3": "--deconvolution: 3 is outside [0, 2]; or write fit",
    "grey.png --deconvolution fit": "--deconvolution means something only with --beta",
    "grey.png --maps missing.exr": "missing.exr",
    "grey.png --light 30": "--light '30': write POLAR,AZIMUTH",
    "grey.png --environment missing.exr": "missing.exr",
    "grey.png --freckles missing.png": "missing.png",
    "grey.png -o words.jpg": "words.jpg: is a file, not a folder",
    "grey.png -o words.jpg/inside": "words.jpg: is a file, not a folder",
    "grey.png": "grey.png: no iris found; give --limbus",
    "": "give the PHOTO of an eye, or --batch with a folder of photographs",
    ".": ".: is a folder; --batch clones all photographs in it",
    "grey.png --batch .": "give the PHOTO of an eye, or --batch with a folder",
    "grey.png --resume": "--resume means something only with --batch",
    "grey.png --colour --stop-after pose": "--colour does not go with --stop-after",
    "grey.png --colour --beta 0.3 --light 9,9 --seed 1": "--colour does not go with --beta, --light:",
    "--batch nowhere": "nowhere: no photographs there",
    "--batch . --limbus 9,9,4,4,0": "--batch does not go with --limbus",
}


@pytest.mark.parametrize("words", WRONG)
def test_wrong_input_is_one_line(irisjax, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "words.jpg").write_text("not a picture")
    Image.new("RGB", (96, 72), (90, 90, 90)).save(tmp_path / "grey.png")
    extra = () if "-o" in words.split() else ("-o", "clone")
    one_line(irisjax("clone", *words.split(), *extra), WRONG[words])
    assert _files(tmp_path) == {"words.jpg", "grey.png"}


def test_a_folder_must_be_given(irisjax):
    one_line(irisjax("clone", "eye.jpg"), "Missing option '-o' / '--output'")


def test_what_the_model_cannot_follow_is_doubtful(capsys, tmp_path):
    """Each doubt has its sentence, in the report too."""
    prior = {name: 0.0 for name in FREE_NAMES}
    values = {name: float(p.value(0.0)) for name, p in PRIORS.items()}
    z = np.array([*(prior | {"abl_eumelanin": 3.5}).values()])
    rms = np.array([0.5, 0.4, 0.3])
    fit = PigmentFit(values | {"abl_eumelanin": 90.0}, z, np.eye(z.size), rms, 60, False)
    dark = np.zeros((2, 2))
    windows, found = object.__new__(Windows), object.__new__(cloning.Sampled)
    white = WhiteSeen(np.full(3, 0.1), np.full(3, 0.5), np.ones(3), np.eye(3) / 0.2)
    parts = {"colour": np.ones((4, 3)), "present": np.ones(4, bool), "white": white}
    parts |= {"in_room": np.zeros(()), "exposure": np.zeros(()), "at_least": np.array(True)}
    for name, value in parts.items():
        object.__setattr__(windows, name, value)
    outlines = (Ellipse((600.0, 450.0), (r * 1.16, r)) for r in (100.0, 40.0))
    camera = {"distance": 46.0, "tilt": 0.1, "tilt_interval": (0.0, 0.3), "stretched": 0.8}
    vars(found).update(
        photograph=SimpleNamespace(grey=True, shape=(900, 1200)),
        boundaries=Boundaries(*outlines, 1.0, 1.0, eyes=2),
        pose=SimpleNamespace(**camera, pupil_radius=2.0, eye=ij.Eye()),
        lighting=SimpleNamespace(found=0),
        windows=windows,
        fit=fit,
        estimate=lambda: Morphology(ij.IrisMaps(), dark, dark, 0, 0.0, 0.05),
        texels=SimpleNamespace(gain=4.0, outside=0.2),
        posterior=PigmentPosterior({}, {}, np.zeros((1, 10)), 150.2, 32, False),
    )
    told = doubts_of(found, np.array([0.06, 0.04, 0.03]))
    doubts = [doubt.sentence for doubt in told]
    assert {doubt.kind for doubt in told} == {"outlines", "light", "model"}
    for words in (
        "camera 46 mm away",
        "both flat, by 16 and 16 %: the file may be stretched",
        "no colours",
        "off by factors of 1.65, 1.49, 1.35 in R, G, B",
        "abl_eumelanin is 90 mg/ml, far from what is usual",
        "did not converge",
        "differs from the photograph by 6.0, 4.0, 3.0 % RMS",
        "need 4 times the exposure that its brightness tells",
        "white of the eye is 0.2, 0.2, 0.2 times (R, G, B) what it usually is",
        "20 % of the iris has colours that the model cannot make",
        "their samples count as 150 independent ones, not as 4096",
    ):
        assert sum(words in doubt for doubt in doubts) == 1, words
    report(found, True, tmp_path, told)
    out, err = capsys.readouterr()
    assert all(f"WARNING: {doubt}" in err for doubt in doubts)
    assert "crossed polarisers" in err and "light from all round is assumed" in err
    assert "of 2 eyes the one in columns 445 to 754, rows 295 to 604 is cloned (--eye" in out
    assert "the pigments are not printed" in out and "mean of the texels" not in out
    assert "camera: 5.7 (0.0 to 17.2) degrees" in out and str(tmp_path) in out
    # The thickness by one response is doubted where texels have none of their own.
    usual = "the thickness is that of a usual iris, whose response is 0.05"
    assert not any(usual in doubt for doubt in doubts)
    good = fit._replace(z=0 * z, rms=np.full(3, 0.01), converged=True)
    doubtful = found.boundaries._replace(limbus_confidence=0.2)
    for changed, words in (
        ({"texels": None}, usual),
        ({"fit": good}, "thickness hardly shows"),
        ({"boundaries": doubtful}, "limbus is doubtful (confidence 0.20)"),
    ):
        vars(found).update(changed)
        assert any(words in doubt.sentence for doubt in doubts_of(found))


def test_colours_of_an_eye_and_of_a_folder(irisjax, tmp_path, photo, truth, monkeypatch):
    """One photograph alone, and the same among others, one of which is broken; a folder that a
    stopped run left half made is made again, and no other.
    """
    eyes, folder = tmp_path / "eyes", tmp_path / "all"
    eyes.mkdir()
    (eyes / "a.png").write_bytes(photo.read_bytes())
    with Image.open(photo) as image:
        image.convert("L").convert("RGB").save(eyes / "grey.png")
    limbus, pupil = (
        Ellipse(tuple(e["centre_px"]), tuple(e["semi_axes_px"]), e["angle"])
        for e in (truth["limbus"], truth["pupil"])
    )
    known = Boundaries(limbus, pupil, 0.9, 0.9, eyes=2)
    monkeypatch.setattr(cloning, "outline_eye", lambda p, given: cloning.Outlined(p, known))
    status, out, err = irisjax("clone", photo, "--colour", "-o", tmp_path / "one")
    assert (status, _files(tmp_path / "one")) == (0, {"colour.json", "colour.png", "outlines.png"})
    assert "ciliary ring (45 to 90 % of the way from pupil to limbus, " in out, err
    assert "the pupillary ring differs from the ciliary ring by L* +" in out
    assert "rows 0 to 134 is looked at (--eye takes another)" in out  # nothing is cloned
    found = json.loads((tmp_path / "one" / "colour.json").read_text())
    ring = found["regions"]["ciliary ring"]
    assert all(low < x < high for low, x, high in zip(*(ring[n] for n in ENDS), strict=True))
    (eyes / "a.jpg").write_text("not a picture")
    run = "clone", "--batch", eyes, "--colour", "-o", folder
    status, out, err = irisjax(*run)
    assert status == 3 and "2 of 3 photographs failed: a.jpg, grey.png" in err
    rows = rows_by("file", folder / "clones.csv")
    assert rows["a.png"]["status"] == "ok" and "not a picture" in rows["a.jpg"]["doubts"]
    assert "the photograph has no colours; look at" in rows["grey.png"]["doubts"]
    assert _files(folder / "grey") == {"outlines.png"}
    assert float(rows["a.png"]["ciliary_ring_L"]) == pytest.approx(ring["lab"][0], rel=1e-4)
    assert float(rows["a.png"]["limbus_confidence"]) > 0.5 and rows["a.png"]["dominant_1_b_low"]
    with Image.open(folder / "contact_sheet.jpg") as sheet:
        assert sheet.size == (2 * 488, 2 * (278 + 30))
    one_line(irisjax(*run), "exists; --resume continues it, --overwrite starts again")
    made = folder / "a.png" / "colour.json"
    made.write_text("as it was")
    assert irisjax(*run, "--resume")[0] == 3 and made.read_text() == "as it was"
    made.unlink()
    (eyes / "grey.png").unlink()
    (eyes / "a.jpg").rename(eyes / "b.jpg")
    assert irisjax(*run[:2], eyes / "*.png", *run[3:], "--resume")[0] == 0
    assert json.loads((folder / "a" / "colour.json").read_text())["regions"]
    kept = (folder / "clones.csv").read_text().splitlines()[1:]  # of other photographs too
    assert [line.split(",")[:2] for line in kept] == [
        ["a.jpg", "failed"],
        ["a.png", "ok"],
        ["grey.png", "failed"],
    ]
    with Image.open(folder / "contact_sheet.jpg") as sheet:
        assert sheet.size == (2 * 488, 2 * (278 + 30))


@pytest.mark.slow  # compiles for minutes
def test_a_whole_clone(done, tmp_path, outlined, photo):
    out, _ = done("clone", photo, "-o", tmp_path, *outlined)
    assert "difference of the pictures" in out
    files = (
        *(name for name in FLAT if name != "deconvolved.png"),  # of a thickness by Eq. 7
        "maps.exr",
        "deviations.exr",
        "scene.toml",
        "side_by_side.png",
        "differences.png",
    )
    assert _files(tmp_path) >= {*files, "luminance.png"}
    found = _summary(tmp_path)
    assert set(found) >= SUMMARY | POSED | {"posterior", "sampling", "estimate", "units"}
    assert found["sampling"]["converged"]
    melanin = found["texels"]["abl_melanin"]
    printed = f"mean of the texels: {melanin['mean']:.3g} ({melanin['q2.5']:.3g} to "
    assert printed in out and melanin["q2.5"] < melanin["mean"] < melanin["q97.5"]
    for entry in found["posterior"].values():
        assert entry["q2.5"] <= entry["median"] <= entry["q97.5"] and entry["sd"] > 0
    scene = read_scene(tmp_path / "scene.toml").scene()
    for name in ("scattering_scale", "eumelanin", "pheomelanin"):
        assert float(getattr(scene.iris, name)) > 0
    assert scene.maps is not None
    maps = ij.io.read_maps(tmp_path / "maps.exr")
    np.testing.assert_allclose(scene.maps.stroma_depth, maps.stroma_depth)
