"""`irisjax paint`: what it writes and refuses."""

import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from refusals import one_line

import irisjax as ij
from irisjax.cli import paint as command
from irisjax.io.recipes import read_recipe
from irisjax.io.scenes import read_scene
from irisjax.ocularist import painting
from irisjax.ocularist.plan import Difference
from irisjax.ocularist.tissue import Tissue
from irisjax.tissue.maps import IrisMaps

RECIPE = Path(__file__).parent.parent.parent / "data" / "recipes" / "green.toml"
SMALL = ("--size", "120x90", "--texels", "64")
BASE = '[[coat]]\ncomponent = "base"\npaints = "ultramarine"\n'
REECH = BASE.replace("base", "sphincter") + "parameters = { reech = 1 }"
OWN_PAINTS = '[painting]\npaints = "own.csv"\nmixing = "hsl"\n'
PALETTE = '[palette]\nsky = "blue"\n'
SCAN = '[[coat]]\ncomponent = "scan"\npaints = "ultramarine"\nparameters = '


@pytest.fixture
def one_coat(tmp_path):
    path = tmp_path / "one.toml"
    path.write_text('[[coat]]\ncomponent = "base"\npaints = "burnt sienna"\n')
    return path


def _pixels(path):
    return np.asarray(Image.open(path)).astype(int)


@pytest.fixture
def bloodless(monkeypatch):
    """The white of the eye has no veins, which take a quarter of a second to grow."""
    monkeypatch.setattr(painting, "veins", lambda *_, **__: None)


@pytest.fixture
def undrawn(monkeypatch, bloodless):
    """Pictures of the eye are left grey: they compile for long; the scenes that would be drawn."""
    scenes = []

    def grey(scene, *_, **__):
        scenes.append(scene)
        return np.full((*scene.camera.size[::-1], 3), 0.2)

    monkeypatch.setattr(command, "draw", grey)
    monkeypatch.setattr(command, "draw_bands", lambda *a, **_: [SimpleNamespace(pixels=grey(*a))])
    monkeypatch.setattr(command, "cached_tables", lambda _: None)
    return scenes


@pytest.mark.slow  # the renderer of paint compiles for half a minute
def test_an_eye_is_drawn(done, tmp_path, monkeypatch):
    """Black on white paper covers; the picture's top is the eye's."""
    monkeypatch.setattr(command, "_SMALL", (120, 90))
    scan = np.full((32, 32), 255, np.uint8)
    scan[:16] = 0
    Image.fromarray(scan).save(tmp_path / "scan.png")
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(
        '[[coat]]\ncomponent = "base"\npaints = "titanium white"\n[[coat]]\ncomponent = "scan"\n'
        'parameters = { file = "scan.png" }\npaints = ["cadmium red", "ultramarine"]\n'
    )
    done("paint", recipe, *SMALL, "-o", tmp_path / "eye")
    eye = _pixels(tmp_path / "eye" / "eye.png")
    assert eye.shape == (90, 120, 3)
    assert eye[45, 60].max() == 0  # the pupil
    upper, lower = eye[20, 55:65].mean(0), eye[70, 55:65].mean(0)
    assert upper[0] > 2 * upper[1] and lower[1] > 0.9 * lower[0]
    assert _pixels(tmp_path / "eye" / "progression.png").shape == (90, 240, 3)
    # The recipe as used lies elsewhere and finds the scan all the same.
    again = tmp_path / "deeper" / "again"
    done("paint", tmp_path / "eye" / "recipe.toml", *SMALL, "-o", again)
    assert (again / "eye.png").read_bytes() == (tmp_path / "eye" / "eye.png").read_bytes()


def test_the_progress_has_twelve_pictures_at_most():
    for count, shown in ((1, [1]), (3, [1, 2, 3]), (12, list(range(1, 13)))):
        assert command._progress_counts(count) == shown
    many = command._progress_counts(50)
    assert len(many) == 12 and (many[0], many[-1]) == (1, 50)


def test_options_reach_the_scene(irisjax, tmp_path, undrawn, one_coat):
    """An environment takes the lamps' place, or lights beside those of --light."""
    said = ("--environment", "uniform", "--camera", "20,0,11", "--shadow", "as-printed")
    for lights in ((), ("--light", "30,0")):
        folder = tmp_path / f"eye{len(lights)}"
        assert irisjax("paint", one_coat, *SMALL, *said, *lights, "-o", folder)[0] == 0
        whole, step = undrawn
        assert (whole.camera.size, step.camera.size) == ((120, 90), (320, 240))
        assert _pixels(folder / "eye.png").shape == (90, 120, 3)
        assert float(whole.camera.width) == 11 and whole.integrator.as_printed
        assert whole.environment is not None and (whole.lights is None) == (not lights)
        undrawn.clear()


def test_a_recipe_becomes_an_eye_its_coats_and_the_recipe_as_used(
    irisjax, done, tmp_path, undrawn, one_coat
):
    folder = tmp_path / "new" / "green"
    out, _ = done("paint", RECIPE, *SMALL, "-o", folder)
    assert out.startswith("6 coats")
    made = {"eye.png", "progression.png", "recipe.toml", "coats"}
    assert {p.name for p in folder.iterdir()} == made
    coats = sorted((folder / "coats").iterdir())
    assert len(coats) == 6
    used = read_recipe(folder / "recipe.toml")
    assert used.coats == read_recipe(RECIPE).coats and used.palette == {"moss": "#5a6b2c"}
    one_line(irisjax("paint", RECIPE, "-o", folder), str(folder), "--overwrite")
    # Other paints, another eye; a file in the folder is replaced when asked.
    before = _pixels(coats[0])
    again = (*SMALL, "-o", folder, "--overwrite")
    done("paint", RECIPE, "--mixing", "kubelka-munk", *again)
    assert np.abs(_pixels(coats[0]) - before).max() > 5
    assert read_recipe(folder / "recipe.toml").mixing == "kubelka-munk"
    # Of fewer coats none of the former are left, and nothing of a match, of tissue and meshes; what
    # the command would not write stays.
    made = ("match.png", "match.json", "retouch-1.png", "tissue/maps.exr", "tissue/scene.toml")
    made += ("meshes/09_base.obj", "meshes/09_base.mtl", "meshes/09_base.png", "meshes/white.ply")
    kept = ("notes.txt", "retouch-idea.png", "coats/01_mine.png")
    for name in (*made, *kept):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("of before")
    done("paint", one_coat, *again)
    assert {p.relative_to(folder).as_posix() for p in folder.rglob("*.*")} == {
        *("eye.png", "progression.png", "recipe.toml", "coats/01_base.png", *kept)
    }
    assert not (folder / "tissue").exists() and not (folder / "meshes").exists()


def test_pictures_that_a_recipe_paints_with_are_spared(irisjax, tmp_path, bloodless, monkeypatch):
    """An artist goes on with a coat that the command wrote; it must be there the next time."""
    monkeypatch.setattr(command, "painting_files", lambda *_, **__: {"01_scan.png": b""})
    (tmp_path / "recipe.toml").touch()  # a painted eye
    recipe = tmp_path / "new.toml"
    for name in ("coats/01_scan.png", "eye.png", "meshes/01_scan.png"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        Image.fromarray(np.zeros((16, 16), np.uint8)).save(tmp_path / name)
        before = (tmp_path / name).read_bytes()
        recipe.write_text(f'{SCAN}{{ file = "{name}" }}\n')
        meshes = ("--meshes", "obj") if "meshes" in name else ()
        options = (*meshes, *SMALL, "-o", tmp_path, "--overwrite")
        one_line(irisjax("paint", recipe, *options), name, "another folder")
        assert (tmp_path / name).read_bytes() == before


def test_a_former_coat_that_is_a_scan_now_stays(irisjax, tmp_path, undrawn):
    (tmp_path / "coats").mkdir()
    (tmp_path / "recipe.toml").touch()
    scan, stale = tmp_path / "coats" / "07_sphincter.png", tmp_path / "coats" / "08_limbus.png"
    for path in (scan, stale):
        Image.fromarray(np.zeros((16, 16), np.uint8)).save(path)
    recipe = tmp_path / "new.toml"
    recipe.write_text(SCAN + '{ file = "coats/07_sphincter.png" }\n')
    assert irisjax("paint", recipe, *SMALL, "-o", tmp_path, "--overwrite")[0] == 0
    assert scan.exists() and not stale.exists()
    assert read_recipe(tmp_path / "recipe.toml").scans()


def test_a_type_of_eye_has_the_papers_number_of_coats(done, tmp_path, undrawn, monkeypatch):
    """The tissue is one of uniform maps: what is nearest to paint is the library's business."""
    maps = {name: np.full((12, 6), 0.3) for name in ("eumelanin", "pheomelanin", "stroma_depth")}
    found = Tissue(ij.Iris(), IrisMaps(**maps), 8.0, Difference(9.0, 20.0))
    monkeypatch.setattr(command, "nearest_tissue", lambda *_: found)
    options = ("--type", "smeared", "--colour", "brown", *SMALL, "-o", tmp_path / "eye")
    out, _ = done("paint", *options, "--tissue", "--meshes", "ply")
    assert "12 coats" in out and "of the nearest tissue: 9.0 (20.0)" in out
    # As tissue it is a scene like any other, with the painted eye's pupil.
    file = read_scene(tmp_path / "eye" / "tissue" / "scene.toml")
    scene = file.with_entries("eye", sclera=False).scene()  # veins of the white grow for a second
    assert file.exposure == 8
    assert float(scene.eye.pupil_radius) == pytest.approx(1.9)
    assert float(scene.eye.iris_radius) == pytest.approx(5.77)
    assert set(scene.maps.present()) == {"eumelanin", "pheomelanin", "stroma_depth"}
    meshes = {p.name for p in (tmp_path / "eye" / "meshes").glob("*.ply")}
    assert len(meshes) == 14 and {"01_base.ply", "cornea.ply", "white.ply"} < meshes


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["no coats"]),
        ('[[coat]]\ncomponent = "base"\n', ["line 1", "needs paints"]),
        (BASE.replace("base", "blobs"), ["line 2", "one of base"]),
        (BASE.replace("ultramarine", "blue"), ["coat 1", "unknown paint 'blue'"]),
        (BASE.replace('"ultramarine"', "3"), ["line 3", "names of paints"]),
        (BASE.replace("base", "scan"), ["coat 1", "file"]),
        (SCAN + '{ file = ["a.png"] }', ["coat 1 (scan)", 'file = "coat.png"', "['a.png']"]),
        (SCAN + '{ flie = "a.png" }', ["coat 1 (scan)", "flie", "did you mean 'file'"]),
        (
            SCAN + '{ file = "none.png" }',
            ["recipe.toml: coat 1 (scan): ", "none.png: No such file"],
        ),
        (BASE + "height = 2\n", ["line 4", "coat.height = 2", "[0, 1] mm"]),
        (f'[painting]\nmixing = "oil"\n{BASE}', ["line 2", "mixing", "kubelka-munk"]),
        (OWN_PAINTS + BASE, ["line 3", "a file of paints", "kubelka-munk"]),
        ("[coat]\n", ["line 1", "[[coat]]"]),
        (
            PALETTE + BASE.replace("ultramarine", "sky"),
            ["palette.sky = 'blue' is no colour; need '#rrggbb'"],
        ),
        (REECH, ["coat 1", "reech", "did you mean 'reach'"]),
    ],
)
def test_wrong_recipes_are_one_line(irisjax, tmp_path, text, words):
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(text)
    file = "none.png" if "none.png" in text else "recipe.toml"
    one_line(irisjax("paint", recipe, "-o", tmp_path / "eye"), file, *words)
    assert not (tmp_path / "eye").exists()


@pytest.mark.parametrize(
    ("name", "options"), [("coats", ()), ("meshes", ("--meshes", "obj")), ("tissue", ("--tissue",))]
)
def test_a_file_where_a_folder_should_be_is_told_before_the_work(irisjax, tmp_path, name, options):
    folder = tmp_path / "eye"
    folder.mkdir()
    (folder / name).write_text("mine")
    result = irisjax("paint", RECIPE, *SMALL, *options, "-o", folder)
    one_line(result, name, "is a file, not a folder")
    assert [p.name for p in folder.iterdir()] == [name]


def test_a_folder_without_permission_is_told_before_the_work(irisjax, tmp_path, monkeypatch):
    """`os.access` says no, as it never does to root."""
    monkeypatch.setattr(os, "access", lambda path, mode, **options: not mode & os.W_OK)
    result = irisjax("paint", RECIPE, *SMALL, "-o", tmp_path / "new" / "eye")
    one_line(result, f"{tmp_path}: no permission to write in this folder")
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ((), ["a recipe or --type"]),
        ((RECIPE, "--type", "detail", "--colour", "blue"), ["one of them"]),
        (("--type", "detail"), ["--colour"]),
        (("--type", "spotted", "--colour", "blue"), ["spotted", "dit-dot"]),
        ((RECIPE, "--pupil-radius", "9"), ["9", "4.75"]),
        ((RECIPE, "--seed", "3"), ["--seed", "--type", "each of its coats"]),
        ((RECIPE, "--match", ""), ["--match", "no file or folder"]),
        ((RECIPE, "--size", "0x0"), ["--size 0x0", "from 1 to 16384"]),
        ((RECIPE, "--camera", "200,0"), ["--camera", "200,0"]),
        ((RECIPE, "--environment", "garden"), ["garden", "studio"]),
        ((RECIPE, "--environment", "none.exr"), ["none.exr", "No such file"]),
    ],
)
def test_wrong_options_are_refused_before_the_work(irisjax, tmp_path, monkeypatch, options, words):
    monkeypatch.setattr(command, "_prepare", None)
    one_line(irisjax("paint", *options, "-o", tmp_path / "eye"), *words)
    assert not (tmp_path / "eye").exists()
