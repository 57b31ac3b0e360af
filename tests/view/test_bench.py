"""A painted eye in the viewer: coats switched, recoloured, faded, moved and saved."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from common import counting
from irisjax.io.recipes import Recipe, read_recipe
from irisjax.measure.colour import srgb_decode
from irisjax.ocularist import integrator
from irisjax.ocularist.coats import over, through
from irisjax.ocularist.recipes import CoatRecipe
from irisjax.view import Bench
from irisjax.view.bench import Layer, edited, moved

COATS = (
    CoatRecipe("base", {}, "burnt umber", "burnt sienna", 0.4, 1.0, 0, 0.0),
    CoatRecipe("stroma-smears", {"count": 20}, "yellow ochre", "titanium white", 0.3, 0.8, 1, 0.1),
    CoatRecipe("limbus", {}, "ivory black", "burnt umber", 0.2, 0.6, 2, 0.2),
)
RECIPE = Recipe(COATS)
BASE, SMEARS, LIMBUS = "01 base", "02 stroma-smears", "03 limbus"
TEXELS = 32


def small(scene):
    """A picture of few pixels, of an iris in one lamp's light."""
    camera = dataclasses.replace(scene.camera, size=(16, 12))
    return scene.replace(camera=camera, eye=scene.eye.replace(cornea=None, sclera=None), veins=None)


def bench(recipe=RECIPE):
    return Bench(recipe, small, texels=TEXELS)


def all_off(layers):
    for name in (BASE, SMEARS, LIMBUS):
        layers = edited(layers, name, on=False)
    return layers


def layers(*heights):
    return tuple(Layer(name, True, None, 0.5, h) for name, h in zip("abc", heights, strict=True))


def anew(*coats, **fields) -> np.ndarray:
    """The picture of other coats, painted from the start."""
    return bench(RECIPE._replace(coats=coats, **fields)).update()


def near(picture, expected, levels=1):
    """To a level of 255: rounding of halves."""
    assert np.abs(picture.astype(float) - expected).max() <= levels


def test_a_coat_moves_with_its_neighbours_height():
    before = layers(0.0, 0.1, 0.3)
    up = moved(before, "a", True)
    assert [(x.name, x.height) for x in up] == [("b", 0.0), ("a", 0.1), ("c", 0.3)]
    assert moved(up, "a", False) == before
    assert moved(before, "c", True) == moved(before, "a", False) == before


def test_refuses_unknown_coats_and_what_is_no_colour_and_no_opacity():
    stack = layers(0.0, 0.1, 0.2)
    for change in (lambda: edited(stack, "d", on=False), lambda: moved(stack, "d", True)):
        with pytest.raises(ValueError, match=r"^no coat 'd'; there are a, b, c$"):
            change()
    with pytest.raises(ValueError, match="#12345"):
        edited(stack, "a", colour="#12345")
    with pytest.raises(ValueError, match=r"1\.5"):
        edited(stack, "a", opacity=1.5)
    with pytest.raises(ValueError, match="no such setting: eumelanin"):
        bench().update(eumelanin=1.0)


def test_every_change_is_the_picture_of_a_painting_made_anew():
    found, (base, smears, limbus) = bench(), COATS
    first = found.settings.layers

    without = found.update(layers=edited(first, SMEARS, on=False))
    near(without, anew(base, limbus))

    thin = found.update(layers=edited(first, LIMBUS, opacity=0.25))
    near(thin, anew(base, smears, limbus._replace(opacity=0.25)))

    up = found.update(layers=moved(first, SMEARS, True))
    near(up, anew(base, limbus._replace(height=0.1), smears._replace(height=0.2)))

    hand = found.update(layers=edited(first, BASE, colour="#3060c0"))
    blue = base._replace(first="picked", second="picked", share=0.0)
    near(hand, anew(blue, smears, limbus, palette={"picked": "#3060c0"}))
    assert found.colour(BASE) == (0x30, 0x60, 0xC0)
    pictures = [without, thin, up, hand, found.update(layers=first)]
    for i, a in enumerate(pictures):
        for b in pictures[i + 1 :]:
            assert np.abs(a.astype(int) - b).max() > 5
    assert not found.update(layers=all_off(first)).any()


def test_coats_that_change_places_follow_the_equation():
    """Two glazes all over on a white base: their light by hand, whichever is upper."""
    glaze = CoatRecipe("base", {}, "cadmium red", "cadmium red", 0.0, 0.5, 0, 0.0)
    other = glaze._replace(first="cadmium yellow", second="cadmium yellow", opacity=0.3)
    white = glaze._replace(first="titanium white", second="titanium white", opacity=1.0)
    found = bench(Recipe((white, glaze, other)))

    def by_hand(bottom, *above):
        light, tint = {}, np.ones(3)
        for coat in reversed(above):
            light[coat.name] = tint
            tint = through(tint, float(coat.opacity.max()), np.asarray(coat.colour))
        seen = np.asarray(bottom.colour) * tint
        for coat in above:
            seen = over(seen, float(coat.opacity.max()), np.asarray(coat.colour), light[coat.name])
        return seen

    ratios = []
    for order in (found.settings.layers, moved(found.settings.layers, "02 base", True)):
        pixel = found.update(layers=order, exposure=0.25)[6, 12]
        lit = np.asarray(srgb_decode(pixel / 255.0))
        expected = by_hand(*found.scene().integrator.painting.coats)
        ratios.append(lit / expected)
        # One factor in all channels: the lamps', and the exposure.
        np.testing.assert_allclose(lit / lit[0], expected / expected[0], atol=0.03)
    np.testing.assert_allclose(ratios[0], ratios[1], rtol=0.03)


def test_the_saved_recipe_makes_the_same_picture(tmp_path):
    taken = {"picked 02": "#5a6b2c"}
    coats = (COATS[0]._replace(first="picked 02"), *COATS[1:])
    found = bench(Recipe(coats, mixing="kubelka-munk", palette=taken, folder=tmp_path))
    change = edited(found.settings.layers, SMEARS, colour="#20a060", opacity=0.35)
    change = moved(edited(change, LIMBUS, on=False), SMEARS, True)
    picture = found.update(layers=change)
    path = found.save()
    assert path == tmp_path / "recipe.toml"
    saved = read_recipe(path)
    assert saved.palette == taken | {"picked 02 (2)": "#20a060"}
    assert saved.coats[-1][2:6] == ("picked 02 (2)", "picked 02 (2)", 0.0, 0.35)
    assert [coat.component for coat in saved.coats] == ["base", "stroma-smears"]
    near(bench(saved).update(), picture)


def test_saves_over_its_own_file_and_no_other(tmp_path):
    (tmp_path / "recipe.toml").write_text("another's")
    found = bench(Recipe(COATS, folder=tmp_path))
    assert found.save() == found.save() == tmp_path / "recipe_2.toml"
    assert read_recipe(tmp_path / "recipe_2.toml").coats == COATS
    assert (tmp_path / "recipe.toml").read_text() == "another's"
    with pytest.raises(ValueError, match="no coat is on"):
        found.save(all_off(found.settings.layers))


def test_a_coat_that_changes_is_done_with_those_below_it(monkeypatch):
    found = bench()
    steps = "_opacity_at", "_crossed", "_paint_over"
    done = counting(monkeypatch, **dict.fromkeys(steps, integrator))
    found.update()
    done.update(dict.fromkeys(steps, 0))
    found.update(layers=edited(found.settings.layers, SMEARS, colour="#20a060"))
    # Each of the three coats is a group by itself, the uppermost the first.
    assert tuple(done.values()) == (0, 0, 2)


def test_the_example_recipe_in_the_viewer():
    path = Path(__file__).parent.parent.parent / "data" / "recipes" / "green.toml"
    found = Bench(read_recipe(path), small, texels=TEXELS)
    assert next(layer.name for layer in found.settings.layers) == BASE
    assert found.recipe().coats == read_recipe(path).coats
