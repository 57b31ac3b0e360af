"""Default coats of the types of eye."""

import functools
import itertools

import numpy as np
import pytest

from irisjax.ocularist import components, recipes
from irisjax.ocularist.recipes import EYE_COLOURS, EYE_TYPES, HEIGHT_STEP

coats = functools.cache(recipes.coats)
COUNTS = {"brown": 12, "blue": 50, "green": 30}  # [L03 Fig. 10] and our own for green
EYES = [(kind, colour) for kind in EYE_TYPES for colour in EYE_COLOURS]


@pytest.mark.parametrize(("kind", "colour"), EYES)
def test_coats_are_as_a_recipe_needs_them(kind, colour):
    painted = coats(kind, colour, seed=0)
    assert len(painted) == COUNTS[colour]
    assert painted[0].component == "base"
    assert (painted[0].opacity, painted[0].height) == (1, 0)
    assert "base" not in [c.component for c in painted[1:]]
    np.testing.assert_allclose(np.diff([c.height for c in painted]), HEIGHT_STEP)
    assert len({c.seed for c in painted}) == len(painted)
    for coat in painted:
        components.component(coat.component, coat.parameters)
        assert 0 < coat.opacity <= 1
        assert 0 <= coat.share <= 1
        assert {type(v) for v in coat.parameters.values()} <= {int, float}
        assert [type(v) for v in coat[2:]] == [str, str, float, float, int, float]
    # Back and forth between all parts.
    parts = [c.component.split("-")[0] for c in painted]
    assert set(parts) == {"base", "stroma", "collarette", "sphincter", "limbus", "pupil"}
    runs = 1 + sum(a != b for a, b in itertools.pairwise(parts))
    assert runs > 0.7 * len(parts)


def test_fewer_than_ten_paints():
    """[L03 Section 3.2], of the paper's types of eye."""
    assert EYE_TYPES == ("smeared", "dit-dot", "detail")
    assert set(EYE_COLOURS) == set(COUNTS)
    used = {p for eye in EYES for c in coats(*eye, seed=0) for p in (c.first, c.second)}
    assert len(used) < 10


def test_smeared_eyes_have_the_softest_brushes_and_dit_dot_ones_the_most_dots():
    for colour in EYE_COLOURS:
        soft, dots = {}, {}
        for kind in EYE_TYPES:
            stroma = [c for c in coats(kind, colour, seed=0) if "stroma" in c.component]
            soft[kind] = np.median([c.parameters["softness"] for c in stroma])
            dots[kind] = np.mean([c.component.endswith("dots") for c in stroma])
        assert soft["smeared"] > 2 * max(soft["dit-dot"], soft["detail"])
        assert dots["dit-dot"] > max(dots["smeared"], dots["detail"])


def test_equal_seeds_give_equal_coats_and_others_do_not():
    assert recipes.coats("detail", "blue", seed=1) == coats("detail", "blue", seed=1)
    assert coats("detail", "blue", seed=1) != coats("detail", "blue", seed=0)


@pytest.mark.parametrize(
    ("kind", "colour", "seed", "line"),
    [
        ("dotted", "blue", 0, "unknown type of eye 'dotted'; known: smeared, dit-dot, detail"),
        ("detail", "grey", 0, r"colour of eye 'grey'; did you mean 'green'\? known: brown, blue"),
        ("detail", "blue", -1, r"seed = -1 is outside \[0, inf\)"),
    ],
)
def test_eyes_that_there_are_none_of(kind, colour, seed, line):
    with pytest.raises(ValueError, match=line):
        coats(kind, colour, seed=seed)
