"""Recipes written and read again."""

import pytest

from irisjax.io.recipes import Recipe, read_recipe, recipe_text
from irisjax.ocularist.kubelka_munk import KubelkaMunkMixer
from irisjax.ocularist.recipes import CoatRecipe

TABLE = "wavelength_nm,mud_K,mud_S\n" + "".join(
    f"{nm},{800 / nm},0.5\n" for nm in range(400, 701, 20)
)
SCAN = CoatRecipe("scan", {"file": 'my "scan".png'}, "mud", "mud", 1 / 3, 0.1 + 0.2, 7, 0.3)


def _written(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return read_recipe(path)


def test_a_written_recipe_is_the_same_to_the_last_digit(tmp_path):
    dots = CoatRecipe("stroma-dots", {"count": 40, "width": 1e-7 / 3}, "a", "b", 0.0, 1.0, 0, 0.0)
    palette = {"new moss": "#5a6b2c", "own.grey": (3, 4, 5)}
    recipe = Recipe((dots, SCAN), palette=palette, pupil_radius=2.123456789)
    read = _written(tmp_path / "recipe.toml", recipe_text(recipe))
    palette = {"new moss": "#5a6b2c", "own.grey": [3, 4, 5]}
    assert read._replace(folder=recipe.folder) == recipe._replace(palette=palette)


def test_a_coat_without_a_height_lies_on_the_one_before_it(tmp_path):
    """At the base it would be hidden by all that was painted before."""
    coat = '[[coat]]\ncomponent = "base"\npaints = "ultramarine"\n'
    text = f"{coat}{coat}height = 0.04\n{coat}{coat}height = 0.08\n{coat}"
    heights = [c.height for c in _written(tmp_path / "recipe.toml", text).coats]
    assert heights == [0.0, 0.04, 0.04, 0.08, 0.08]


def test_a_file_of_paints_is_mixed_by_kubelka_and_munk(tmp_path):
    (tmp_path / "own.csv").write_text(TABLE)
    text = '[painting]\npaints = "own.csv"\n[[coat]]\ncomponent = "base"\npaints = "mud"\n'
    recipe = _written(tmp_path / "recipe.toml", text)
    assert recipe.mixing == "kubelka-munk"
    assert isinstance(recipe.mixer(), KubelkaMunkMixer)
    with pytest.raises(ValueError, match="a file of paints is for mixing"):
        recipe._replace(mixing="hsl").mixer()


def test_a_recipe_in_another_folder_finds_its_files(tmp_path):
    home = tmp_path / "home"
    home.mkdir()
    (home / "own.csv").write_text(TABLE)
    fixed = SCAN._replace(parameters={"file": str(home / "far.png")})
    recipe = Recipe((SCAN, fixed), "kubelka-munk", "own.csv", folder=home)
    away = tmp_path / "a" / "b"
    moved = _written(away / "recipe.toml", recipe_text(recipe.moved(away)))
    assert moved.folder == away
    assert moved.mixer().paints == ("mud",)
    (home / 'my "scan".png').write_text("not a picture")
    near, far = (coat.parameters["file"] for coat in moved.coats)
    assert (away / near).resolve() == (home / 'my "scan".png').resolve()
    assert far == str(home / "far.png")
