"""Paintings in plan, matched to a target, retouched, and taken to maps of pigments."""

import contextlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from common import lab_of_linear
from irisjax.ocularist.coats import Coat, Painting, profile_of, prosthesis
from irisjax.ocularist.matching import match, retouch
from irisjax.ocularist.mixing import PAINTS, HslMixer
from irisjax.ocularist.painting import painted
from irisjax.ocularist.plan import difference, plan_view, rolled, texture_of, unrolled
from irisjax.ocularist.recipes import CoatRecipe
from irisjax.ocularist.tissue import EUMELANIN, PHEOMELANIN, STROMA, nearest_tissue, reflectance_of
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps

SHAPE = (48, 16)
SIZE = 64
EYE = prosthesis()
RECIPES = (
    CoatRecipe("base", {}, "burnt umber", "burnt sienna", 0.4, 1.0, 0, 0.0),
    CoatRecipe("stroma-smears", {"count": 60}, "burnt sienna", "yellow ochre", 0.7, 0.6, 1, 0.01),
    CoatRecipe("limbus", {}, "ivory black", "burnt umber", 0.3, 0.7, 2, 0.02),
)
OTHERS = tuple(
    recipe._replace(share=share, opacity=opacity)
    for recipe, share, opacity in zip(RECIPES, (0.8, 0.3, 0.6), (1.0, 0.3, 0.4), strict=True)
)


@pytest.fixture(scope="module")
def target():
    return texture_of(painted(RECIPES, HslMixer.default(), EYE, size=SIZE), EYE, SHAPE)


@contextlib.contextmanager
def promoting():
    """Searches and pictures of tissue promote as NumPy does."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


def matched(target, known=None, recipes=OTHERS, **more):
    few = {"size": SIZE, "texels": 200, "key": jax.random.key(0)} | more
    with promoting():
        return match(recipes, HslMixer.default(), EYE, target, known, **few)


def test_two_coats_over_a_base_by_hand():
    """Light reaches the middle coat through the upper one's paint, the base through both."""
    opacity = jnp.asarray([[1.0], [0.5], [0.25]])
    colour = jnp.asarray([[0.8] * 3, [0.4] * 3, [0.2] * 3])
    middle = 0.75 + 0.25 * 0.2
    base = middle * (0.5 + 0.5 * 0.4)
    expected = 0.75 * (0.5 * 0.8 * base + 0.5 * 0.4 * middle) + 0.25 * 0.2
    np.testing.assert_allclose(plan_view(opacity, colour), np.full((1, 3), expected), atol=1e-15)


def test_a_painting_shows_at_each_place_what_is_painted_there():
    """Left and right, above and below, near the pupil and near the root."""
    along = (2 * np.arange(SIZE) + 1) / SIZE - 1
    x, y = np.meshgrid(along, -along)
    shades = 0.5 + 0.3 * x + 0.2 * y
    coat = Coat("one", jnp.asarray(shades), jnp.ones(3), jnp.asarray(0.0))
    seen = texture_of(Painting((coat,), profile_of(EYE)), EYE, SHAPE)
    angle = (np.arange(48) + 0.5) * 2 * np.pi / 48
    away = np.asarray(EYE.from_axis((np.arange(16) + 0.5) / 16) / EYE.iris_radius)
    expected = 0.5 + 0.3 * np.cos(angle)[:, None] * away + 0.2 * np.sin(angle)[:, None] * away
    # Within half a texel of the sides, where maps are held, the plane is flat.
    inner = away < 1 - 1 / SIZE
    np.testing.assert_allclose(seen[:, inner, 0], expected[:, inner], atol=1e-12)
    row, column, on = rolled(SHAPE, EYE, SIZE)
    back = np.asarray(seen)[row, column, 0]
    assert np.abs(back - shades)[on].max() < 0.03  # of a texel of the coarser texture
    assert np.hypot(x, y)[on].min() > EYE.pupil_radius / EYE.iris_radius


def test_differences_are_of_lab():
    one, other = np.array([0.2, 0.1, 0.05]), np.array([0.25, 0.1, 0.02])
    by_hand = np.linalg.norm(lab_of_linear(one) - lab_of_linear(other))
    found = difference(jnp.tile(one, (4, 1)), jnp.tile(other, (4, 1)))
    np.testing.assert_allclose(found, by_hand, rtol=1e-9)


def test_a_painting_is_found_again_from_its_plan_view(target):
    found = matched(target)
    assert found.converged and found.after.mean < 0.5 < 3 < found.before.mean
    for recipe, true, start in zip(found.recipes, RECIPES, OTHERS, strict=True):
        assert recipe.opacity == pytest.approx(true.opacity, abs=0.05)
        assert recipe._replace(share=0, opacity=0) == start._replace(share=0, opacity=0)


def test_what_is_not_known_has_no_say(target):
    known = np.broadcast_to(np.arange(SHAPE[0])[:, None] >= 12, SHAPE)
    spoilt = np.where(known[..., None], target, np.nan)
    found = matched(spoilt, known)
    assert found == matched(np.where(known[..., None], target, 1.0), known)
    assert found.after.mean < 0.5


def test_retouching_paints_what_strokes_cannot():
    few = ("burnt umber", "burnt sienna", "titanium white")
    mixer = HslMixer.of({name: PAINTS[name] for name in few})
    angle = (np.arange(SHAPE[0]) + 0.5) * 2 * np.pi / SHAPE[0]
    spot = np.exp(-((angle[:, None] - 2) ** 2) / 0.1) * np.ones(SHAPE[1])
    base = RECIPES[:1]
    plain = texture_of(painted(base, mixer, EYE, size=SIZE), EYE, SHAPE)
    white = plain + 0.4 * spot[..., None] * (0.9 - plain)
    known = np.ones(SHAPE, bool)
    known[30:] = False
    more = retouch(base, mixer, EYE, white, known, count=2, size=SIZE)
    assert [recipe.component for recipe in more.recipes] == ["scan", "scan"]
    both = base + more.recipes
    seen = texture_of(painted(both, mixer, EYE, size=SIZE, scans=more.scans), EYE, SHAPE)
    before, after = (difference(v, white, known) for v in (plain, seen))
    assert after.mean < 0.3 * before.mean
    far = np.zeros(SHAPE, bool)
    far[33:45] = True  # beyond the brush and a map's texel
    assert difference(seen, plain, far).mean < 1e-6


def test_a_painting_as_tissue():
    """The maps' own reflectance is as far off as they say."""
    painting = painted(RECIPES, HslMixer.default(), EYE, size=SIZE)
    with promoting():
        found = nearest_tissue(painting, EYE, shape=(12, 6))
        shown = found.exposure * reflectance_of(found.iris, found.maps, EYE)
    assert difference(shown, texture_of(painting, EYE, (12, 6))) == pytest.approx(found.left)
    assert 4 < found.exposure < 16  # tissue is darker than paint
    maps = found.maps.present()
    assert set(maps) == {"eumelanin", "pheomelanin", "stroma_depth"}
    depth = maps["stroma_depth"] / found.iris.stroma_thickness
    tried = (maps["eumelanin"], EUMELANIN), (maps["pheomelanin"], PHEOMELANIN), (depth, STROMA)
    for values, table in tried:
        assert table[0] - 1e-9 <= values.min() <= values.max() <= table[-1] + 1e-9


def test_paint_of_a_tissues_colour_is_found_among_tissues():
    one, iris = jnp.ones((12, 6)), Iris()
    maps = IrisMaps(eumelanin=1.9 * one, pheomelanin=one, stroma_depth=iris.stroma_thickness * one)
    with promoting():
        colour = 10 * reflectance_of(iris, maps, EYE)[0, 0]
        coat = Coat("flat", jnp.ones((4, 4)), colour, jnp.asarray(0.0))
        flat = nearest_tissue(Painting((coat,), profile_of(EYE)), EYE, shape=(12, 6))
    assert flat.left.q95 < 1


@pytest.mark.parametrize(
    ("run", "line"),
    [
        (lambda: matched(np.zeros((8, 3))), r"a target has shape \(8, 3\); need \(angles, radii, 3\)"),
        (lambda: matched(np.full((8, 4, 3), np.nan)), r"target = nan is outside \[0, 100\]"),
        (lambda: matched(np.zeros((8, 4, 3)), np.ones((4, 8), bool)),
         "mask of a target of 8 angles and 4 radii"),
        (lambda: matched(np.zeros((8, 4, 3)), np.zeros((8, 4), bool)),
         "the mask of a target leaves no texel"),
        (lambda: matched(np.zeros((8, 4, 3)), recipes=()), "a match needs at least one coat"),
        (lambda: unrolled(jnp.zeros((4, 8)), EYE), r"has shape \(4, 8\); it must be square"),
        (lambda: texture_of(Painting((), profile_of(EYE)), EYE),
         "a painting without coats has no colours"),
    ],
)  # fmt: skip
def test_refusals(run, line):
    with pytest.raises(ValueError, match=line):
        run()
