"""A painted eye in the viewer: coats switched, recoloured, faded, moved and saved."""

import dataclasses
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from common import counting
from irisjax.io.recipes import Recipe, read_recipe
from irisjax.measure.colour import srgb_decode, srgb_encode
from irisjax.ocularist import composite
from irisjax.ocularist.coats import over, through
from irisjax.ocularist.integrator import Painted
from irisjax.ocularist.painting import painted
from irisjax.ocularist.recipes import CoatRecipe
from irisjax.render.picture import draw
from irisjax.view import Bench
from irisjax.view.layers import Layer, covering, moved, recoloured, switched

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
    camera = dataclasses.replace(scene.camera, size=(40, 30))
    return scene.replace(camera=camera, eye=scene.eye.replace(cornea=None, sclera=None), veins=None)


def bench(recipe=RECIPE):
    return Bench(recipe, small, texels=TEXELS)


def layers(*heights):
    return tuple(Layer(name, True, None, 0.5, h) for name, h in zip("abc", heights, strict=True))


def as_painted(found: Bench, coats) -> np.ndarray:
    """The picture of other recipes in the same scene, painted from the start."""
    painting = painted(coats, RECIPE.mixer(), RECIPE.eye(), size=TEXELS)
    return shown(found.scene().replace(integrator=Painted(painting=painting)))


def shown(scene) -> np.ndarray:
    return np.rint(255 * np.clip(np.asarray(srgb_encode(draw(scene))), 0, 1))


def near(picture, expected, levels=1):
    """To a level of 255: rounding of halves."""
    assert np.abs(picture.astype(float) - expected).max() <= levels


def test_a_coat_moves_with_its_neighbours_height():
    before = layers(0.0, 0.1, 0.3)
    up = moved(before, "a", True)
    assert [(x.name, x.height) for x in up] == [("b", 0.0), ("a", 0.1), ("c", 0.3)]
    assert moved(up, "a", False) == before
    assert moved(before, "c", True) == moved(before, "a", False) == before


@pytest.mark.parametrize(
    "change",
    [
        lambda x: switched(x, "d", False),
        lambda x: recoloured(x, "d", "#102030"),
        lambda x: covering(x, "d", 0.5),
        lambda x: moved(x, "d", True),
    ],
)
def test_an_unknown_coat_is_named_among_those_there_are(change):
    with pytest.raises(ValueError, match=r"^no coat 'd'; there are a, b, c$"):
        change(layers(0.0, 0.1, 0.2))


def test_refuses_what_is_no_colour_and_no_opacity():
    with pytest.raises(ValueError, match="#12345"):
        recoloured(layers(0.0, 0.1, 0.2), "a", "#12345")
    with pytest.raises(ValueError, match=r"1\.5"):
        covering(layers(0.0, 0.1, 0.2), "a", 1.5)
    with pytest.raises(ValueError, match="no such setting: eumelanin"):
        bench().update(eumelanin=1.0)


def test_every_change_is_the_picture_of_a_painting_made_anew():
    found = bench()
    near(found.update(), as_painted(found, COATS))
    first = found.settings.layers

    off = switched(first, SMEARS, False)
    without = found.update(layers=off)
    near(without, as_painted(found, (COATS[0], COATS[2])))
    assert [coat.name for coat in found.painting().coats] == [BASE, LIMBUS]

    thin = found.update(layers=covering(first, LIMBUS, 0.25))
    near(thin, as_painted(found, (*COATS[:2], COATS[2]._replace(opacity=0.25))))

    up = found.update(layers=moved(first, SMEARS, True))
    lower, higher = COATS[2]._replace(height=0.1), COATS[1]._replace(height=0.2)
    near(up, as_painted(found, (COATS[0], lower, higher)))

    hand = found.update(layers=recoloured(first, BASE, "#3060c0"))
    painting = found.painting().replace(BASE, colour=jnp.asarray(linear("#3060c0"), float))
    near(hand, shown(found.scene().replace(integrator=Painted(painting=painting))))
    assert found.colour(BASE) == (0x30, 0x60, 0xC0)
    pictures = [without, thin, up, hand, found.update(layers=first)]
    for i, a in enumerate(pictures):
        for b in pictures[i + 1 :]:
            assert np.abs(a.astype(int) - b).max() > 5


def linear(colour):
    return srgb_decode(np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255)


def test_coats_that_change_places_follow_the_equation():
    """Two glazes all over on a white base: their light by hand, whichever is upper."""
    glaze = CoatRecipe("base", {}, "cadmium red", "cadmium red", 0.0, 0.5, 0, 0.0)
    other = glaze._replace(first="cadmium yellow", second="cadmium yellow", opacity=0.3)
    white = glaze._replace(first="titanium white", second="titanium white", opacity=1.0)
    found = bench(Recipe((white, glaze, other)))

    def by_hand(bottom, *above):
        light = {}
        tint = np.ones(3)
        for coat in reversed(above):
            light[coat.name] = tint
            tint = through(tint, float(coat.opacity.max()), np.asarray(coat.colour))
        shown = np.asarray(bottom.colour) * tint
        for coat in above:
            shown = over(
                shown, float(coat.opacity.max()), np.asarray(coat.colour), light[coat.name]
            )
        return shown

    ratios = []
    for order in (found.settings.layers, moved(found.settings.layers, "02 base", True)):
        picture = found.update(layers=order, exposure=0.25)
        lit = linear_of(picture[15, 29])
        expected = by_hand(*found.painting().coats)
        ratios.append(lit / expected)
        # One factor in all channels: the lamps', and the exposure.
        np.testing.assert_allclose(lit / lit[0], expected / expected[0], atol=0.03)
    np.testing.assert_allclose(ratios[0], ratios[1], rtol=0.03)


def linear_of(pixel):
    return np.asarray(srgb_decode(pixel / 255.0))


@pytest.mark.parametrize("mixing", ["hsl", "kubelka-munk"])
def test_the_saved_recipe_makes_the_same_picture(tmp_path, mixing):
    taken = {"picked 02": "#5a6b2c"}
    coats = (COATS[0]._replace(first="picked 02"), *COATS[1:])
    found = bench(Recipe(coats, mixing=mixing, palette=taken, folder=tmp_path))
    change = recoloured(found.settings.layers, SMEARS, "#20a060")
    change = moved(covering(switched(change, LIMBUS, False), SMEARS, 0.35), SMEARS, True)
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
    every = found.settings.layers
    for name in (BASE, SMEARS, LIMBUS):
        every = switched(every, name, False)
    with pytest.raises(ValueError, match="no coat is on"):
        found.save(every)


def test_a_coat_that_changes_is_done_with_those_below_it(monkeypatch):
    found = bench()
    found.update()
    steps = "opacity_at", "crossed", "paint_over"
    done = counting(monkeypatch, **dict.fromkeys(steps, composite))
    found.update(layers=recoloured(found.settings.layers, SMEARS, "#20a060"))
    # Each of the three coats is a group by itself, the uppermost the first.
    assert tuple(done.values()) == (0, 0, 2)


def test_without_coats_there_is_a_picture_still():
    found = bench()
    every = found.settings.layers
    for name in (BASE, SMEARS, LIMBUS):
        every = switched(every, name, False)
    assert not found.update(layers=every).any()


def test_the_example_recipe_in_the_viewer():
    path = Path(__file__).parent.parent.parent / "data" / "recipes" / "green.toml"
    found = Bench(read_recipe(path), small, texels=TEXELS)
    assert next(layer.name for layer in found.settings.layers) == BASE
    assert found.recipe().coats == read_recipe(path).coats
