"""`irisjax paint --match`: eyes that paint comes close to."""

import json

import numpy as np
import pytest
from PIL import Image
from refusals import one_line

from irisjax.cli import paint as command
from irisjax.io.images import read_image
from irisjax.io.recipes import read_recipe
from irisjax.ocularist import painting
from irisjax.ocularist.matching import Match, Retouch
from irisjax.ocularist.plan import Difference
from irisjax.ocularist.recipes import CoatRecipe

RECIPE = (
    '[[coat]]\ncomponent = "base"\npaints = ["titanium white", "ivory black"]\nshare = 0.2\n'
    '[[coat]]\ncomponent = "limbus"\npaints = "ivory black"\nheight = 0.1\n'
)
SMALL = ("--size", "120x90", "--texels", "64")


@pytest.fixture
def recipe(tmp_path):
    path = tmp_path / "recipe.toml"
    path.write_text(RECIPE)
    return path


def _flat(path):
    """Red above and blue below, as a flat picture of an iris; nothing is known at its right."""
    pixels = np.zeros((96, 96, 4), np.uint8)
    pixels[..., 3] = 255
    pixels[:48, :, 0], pixels[48:, :, 2] = 150, 120
    pixels[:, 64:] = 255, 255, 255, 0
    Image.fromarray(pixels).save(path)
    return path


@pytest.fixture
def unsearched(monkeypatch):
    """No renderer, which compiles for long, and no search: coats as they are, and two scans."""
    grey = np.full((90, 120, 3), 0.2)
    monkeypatch.setattr(command, "_draw_pictures", lambda *_: (grey, grey))
    monkeypatch.setattr(painting, "veins", lambda *_, **__: None)
    off = Difference(40.0, 50.0)
    monkeypatch.setattr(command, "match", lambda r, *_, **__: Match(r, off, off, 300, False))

    def retouch(recipes, *_, count, prefix, size, **__):
        above = np.ones((size, size))
        above[: size // 2] = 0
        scans = {f"{prefix}1.png": above, f"{prefix}2.png": 1 - above}
        paints = ("cadmium red", "ultramarine")
        new = [
            CoatRecipe("scan", {"file": file}, paint, paint, 0.0, 1.0, 0, 0.2)
            for file, paint in zip(scans, paints, strict=True)
        ]
        return Retouch(tuple(new), scans)

    monkeypatch.setattr(command, "retouch", retouch)


@pytest.mark.usefixtures("unsearched")
def test_paint_is_matched_to_a_flat_picture_and_can_be_painted_again(done, tmp_path, recipe):
    target, folder = _flat(tmp_path / "flat.png"), tmp_path / "eye"
    out, err = done(*("paint", recipe, "--match", target, "--retouch", "2", *SMALL, "-o", folder))
    assert "the match was stopped after 300 steps" in err
    assert out.startswith("mean colour difference") and "4 coats" in out
    told = json.loads((folder / "match.json").read_text())
    assert told["target"] == "flat.png"
    before, matched, _ = (d["mean"] for d in told["colour_difference"].values())
    assert before == matched == 40
    # The target, the match and the match retouched, side by side.
    eye = read_image(folder / "match.png", decode=True).pixels[:, 128:]
    red, blue = (eye[rows, 28:36].mean((0, 1)) for rows in (slice(4, 12), slice(52, 60)))
    assert red[0] > 1.5 * red[2] and blue[2] > 1.5 * blue[0]
    # Retouching coats are files beside the recipe.
    used = read_recipe(folder / "recipe.toml")
    assert [c.component for c in used.coats] == ["base", "limbus", "scan", "scan"]
    assert [c.parameters["file"] for c in used.coats[2:]] == ["retouch-1.png", "retouch-2.png"]
    again = tmp_path / "other" / "eye"
    done("paint", folder / "recipe.toml", *SMALL, "-o", again)
    for coat in sorted((folder / "coats").iterdir()):
        there = read_image(again / "coats" / coat.name).pixels
        assert np.abs(there - read_image(coat).pixels).max() < 3 / 255  # scans have 8 bits


@pytest.mark.slow
def test_without_a_recipe_coats_of_the_nearest_colour_are_matched(done, tmp_path):
    """A scene of tissue, with the pupil that it has."""
    scene = tmp_path / "scene.toml"
    scene.write_text(
        '[iris]\npreset = "brown"\n[maps]\nuniform = true\n[eye]\npupil_radius = 2.4\n'
    )
    folder = tmp_path / "eye"
    out, _ = done(*("paint", "--match", scene, "--retouch", "0", *SMALL, "-o", folder))
    assert "12 coats" in out  # of brown eyes
    used = read_recipe(folder / "recipe.toml")
    assert used.pupil_radius / 5.77 == pytest.approx(2.4 / 6.0, rel=0.1)
    assert not list(folder.glob("retouch*"))


def test_wrong_targets_are_one_line(irisjax, tmp_path, recipe):
    def refused(*options, words):
        result = irisjax("paint", *options, "-o", tmp_path / "eye")
        one_line(result, *words)
        assert not (tmp_path / "eye").exists()

    flat = _flat(tmp_path / "flat.png")
    Image.fromarray(np.zeros((20, 30, 3), np.uint8)).save(tmp_path / "wide.png")
    Image.fromarray(np.zeros((20, 20, 4), np.uint8)).save(tmp_path / "clear.png")
    (tmp_path / "clone").mkdir()
    (tmp_path / "flat.toml").write_text(
        '[picture]\nintegrator = "single-scattering"\n[maps]\nuniform = true\n'
    )
    at = tmp_path
    refused(recipe, "--match", at / "none.png", words=["none.png", "No such file"])
    refused(recipe, "--match", at / "wide.png", words=["wide.png", "30 x 20", "square"])
    refused(recipe, "--match", at / "clear.png", words=["clear.png", "nothing of the iris"])
    refused(recipe, "--match", at / "clone", words=["clone", "clone.json"])
    refused(recipe, "--match", recipe.with_suffix(".txt"), words=["recipe.txt", ".png"])
    refused(recipe, "--match", at / "flat.toml", words=["single-scattering", "separable"])
    refused(recipe, "--match", recipe, words=["recipe.toml", "unknown section"])
    refused(recipe, "--retouch", "3", words=["--retouch means something only with --match"])
    refused(recipe, "--match", flat, "--retouch", "99", words=["--retouch", "[0, 30]"])
    refused("--match", flat, "--type", "detail", words=["--colour"])
