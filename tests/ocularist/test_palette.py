"""Paints by name: their colours, adding and replacing them, and what is refused."""

import jax
import numpy as np
import pytest

from irisjax.measure.colour import srgb_decode
from irisjax.ocularist.palette import FURTHER_PAINTS, PAINTS, Palette, linear_colour


def test_fewer_than_ten_paints_with_their_sources():
    """[L03 Section 3.2]"""
    assert len(PAINTS) == 9
    assert all(paint.source for paint in {**PAINTS, **FURTHER_PAINTS}.values())
    assert Palette.default().srgb() == {name: paint.srgb for name, paint in PAINTS.items()}


def test_colours_are_linear():
    """#cd261e by hand: ((205/255 + 0.055)/1.055)^2.4 and so on [IEC 61966-2-1]."""
    by_hand = [((v / 255 + 0.055) / 1.055) ** 2.4 for v in (205, 38, 30)]
    np.testing.assert_allclose(Palette.default().colour("cadmium red"), by_hand, rtol=1e-12)


def test_one_colour_a_coat():
    palette = Palette.default()
    coats = palette.colour(["ultramarine", "burnt umber", "ultramarine"])
    assert coats.shape == (3, 3)
    np.testing.assert_array_equal(coats[0], palette.colour("ultramarine"))
    np.testing.assert_array_equal(coats[2], coats[0])


@pytest.mark.parametrize(
    "same", ["#322B26", (50, 43, 38), [50.0, 43.0, 38.0], np.array([50, 43, 38])]
)
def test_paints_are_added_and_replaced(same):
    default = Palette.default()
    edited = default.with_paints({"raw umber": same, "burnt umber": "#402010"})
    assert edited.names == (*default.names, "raw umber")
    assert edited.srgb() == {**default.srgb(), "raw umber": "#322b26", "burnt umber": "#402010"}
    assert "raw umber" not in default.names
    assert default.srgb()["burnt umber"] == PAINTS["burnt umber"].srgb


def test_gradients_reach_the_colours():
    slopes = jax.grad(lambda palette: palette.colour("ultramarine").sum())(Palette.default())
    assert float(slopes.colours.sum()) == 3.0


def test_a_palette_of_encoded_colours_is_read_back():
    wanted = {"a": "#000000", "b": "#ffffff", "c": "#0a0b0c"}
    assert Palette.of(wanted).srgb() == wanted
    np.testing.assert_allclose(
        linear_colour("c", "#0a0b0c"), srgb_decode(np.array([10, 11, 12]) / 255)
    )


@pytest.mark.parametrize(
    "colour",
    ["", "moss", "#12345", "#1234567", "#12345g", "123456", (1, 2), (1, 2, 3, 4), (0, 0, 256),
     (-1, 0, 0), (0, float("nan"), 0), (True, 0, 0), ("1", "2", "3"), 7, None, {"r": 1}],
)  # fmt: skip
def test_what_is_no_colour(colour):
    with pytest.raises(
        ValueError,
        match=r"^paint 'moss': .* is no colour; need '#rrggbb' or three numbers in \[0, 255\]$",
    ):
        Palette.default().with_paints({"moss": colour})


def test_unknown_paints_are_named_with_the_known():
    palette = Palette.default()
    with pytest.raises(
        ValueError,
        match=r"^unknown paint 'ultramarin'; did you mean 'ultramarine'\? known: ivory black, .*, cadmium red$",
    ):
        palette.colour("ultramarin")
    with pytest.raises(ValueError, match=r"^unknown paint 'xyz'; known: ivory black, "):
        palette.colour(["burnt umber", "xyz"])


def test_broken_palettes():
    palette = Palette.default()
    with pytest.raises(ValueError, match="at least one paint"):
        Palette.of({})
    with pytest.raises(ValueError, match="one name a colour, each once; got 2 names for 2"):
        Palette(("a", "a"), palette.colours[:2])
    with pytest.raises(ValueError, match="got 1 names for 2"):
        Palette(("a",), palette.colours[:2])
    with pytest.raises(ValueError, match=r"reflectance of paint 'a' = 1\.9\d* is outside \[0, 1\]"):
        Palette(("a",), palette.colours[1:2] * 2)
