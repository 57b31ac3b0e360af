"""Paints by name, and their mixtures in HSL, against Python's colorsys and by hand."""

import colorsys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from irisjax.measure.colour import srgb_decode, srgb_encode
from irisjax.ocularist.mixing import PAINTS, HslMixer, hsl_of, linear_colour, mixed_in_hsl, srgb_of

GRID = np.stack(np.meshgrid(*[np.linspace(0, 1, 6)] * 3), -1).reshape(-1, 3)
TONES = {
    "red": "#ff0000", "yellow": "#ffff00", "green": "#00ff00", "cyan": "#00ffff", "blue": "#0000ff",
    "magenta": "#ff00ff", "black": "#000000", "white": "#ffffff", "grey": "#808080",
}  # fmt: skip


def encoded(linear):
    return np.asarray(srgb_encode(linear))


def test_hsl_is_that_of_colorsys():
    expected = np.array([colorsys.rgb_to_hls(*colour) for colour in GRID])[:, [0, 2, 1]]
    np.testing.assert_allclose(np.stack(jax.jit(hsl_of)(GRID), -1), expected, atol=1e-14)
    found = jax.jit(srgb_of)(*GRID.T)
    expected = [colorsys.hls_to_rgb(hue, light, saturation) for hue, saturation, light in GRID]
    np.testing.assert_allclose(found, expected, atol=1e-14)


@pytest.mark.parametrize(
    ("first", "second", "share", "hand"),
    [
        ("red", "yellow", 0.5, (1, 0.5, 0)),
        ("yellow", "green", 0.5, (0.5, 1, 0)),
        ("red", "blue", 0.5, (1, 0, 1)),  # through magenta, not through green
        ("magenta", "yellow", 0.5, (1, 0, 0)),  # across hue 0
        ("red", "white", 0.5, (0.875, 0.625, 0.625)),  # S 1/2, L 3/4
        ("blue", "black", 0.5, (0.125, 0.125, 0.375)),
        ("black", "white", 0.25, (0.25, 0.25, 0.25)),
        ("grey", "white", 0.0, (128 / 255,) * 3),
    ],
)
def test_mixtures_by_hand(first, second, share, hand):
    found = HslMixer.of(TONES).mix(first, second, share)
    np.testing.assert_allclose(encoded(found), hand, atol=1e-12)


@pytest.mark.parametrize(
    ("first", "second", "middle"),
    [
        ("red", "cyan", (0.5, 1, 0)),
        ("yellow", "blue", (0, 1, 0.5)),
        ("green", "magenta", (0, 0.5, 1)),
    ],
)
def test_between_opposite_hues_red_is_not_passed(first, second, middle, bits):
    """Whichever is first, and in either precision."""
    m = HslMixer.of(TONES)
    for a, b in ((first, second), (second, first)):
        np.testing.assert_allclose(encoded(m.mix(a, b, 0.5)), middle, atol=1e-5)


def pairs(names):
    """Every paint with every other, one pair a coat."""
    return [a for a in names for _ in names], list(names) * len(names)


def test_the_ends_are_the_paints(bits):
    m = HslMixer.default()
    first, second = pairs(m.paints)
    for share, paints in ((0.0, first), (1.0, second)):
        found = m.mix(first, second, share)
        np.testing.assert_allclose(found, m.colours[m.indices(paints)], atol=1e-5)
        assert found.dtype == m.colours.dtype
    there, back = m.mix(first, second, 0.2), m.mix(second, first, 0.8)
    np.testing.assert_allclose(there, back, atol=1e-5 if bits == 32 else 1e-12)


def test_many_coats_at_once():
    m = HslMixer.default()
    first, second = ["ultramarine", "burnt umber", "cadmium red"], "titanium white"
    shares = jnp.asarray([0.1, 0.5, 0.9])
    found = jax.jit(lambda m, s: m.mix(first, second, s))(m, shares)
    assert found.shape == (3, 3)
    for i, name in enumerate(first):
        np.testing.assert_allclose(found[i], m.mix(name, second, float(shares[i])), atol=1e-14)
    assert m.mix("ultramarine", second, jnp.zeros((2, 5))).shape == (2, 5, 3)


@jax.jit
def weighted(x):
    """One number a mixture of rows (first colour, second colour, share)."""
    return (mixed_in_hsl(x[:, :3], x[:, 3:6], x[:, 6]) * jnp.asarray([[1.0, 2.0, 3.0]])).sum(-1)


SLOPES = jax.jit(jax.grad(lambda x: weighted(x).sum()))


def test_gradients_are_those_of_differences():
    """In a number of each mixture at a time: the others do not see it."""
    x = np.random.default_rng(3).uniform(0.1, 0.9, (len(GRID), 7))
    slopes, step = SLOPES(x), 1e-6
    for j, way in enumerate(step * np.eye(7)):
        difference = np.asarray(weighted(x + way) - weighted(x - way)) / (2 * step)
        np.testing.assert_allclose(slopes[:, j], difference, rtol=1e-5, atol=1e-7)


def test_no_gradient_is_lost_at_greys_and_ends():
    colours = np.asarray(srgb_decode(jnp.asarray(GRID)))
    for second in (np.roll(colours, 7, 0), colours, np.full_like(colours, 0.2), 0 * colours):
        for share in (0.0, 0.4, 1.0):
            x = np.concatenate([colours, second, np.full((len(colours), 1), share)], 1)
            assert np.isfinite(SLOPES(x)).all()


def test_fewer_than_ten_paints_with_their_sources():
    """[L03 Section 3.2]"""
    assert len(PAINTS) == 9
    m = HslMixer.default()
    assert m.paints == tuple(PAINTS)
    steps = np.rint(255 * encoded(m.colours)).astype(int)
    assert ["#" + bytes(s.tolist()).hex() for s in steps] == [*PAINTS.values()]


@pytest.mark.parametrize(
    "same", ["#322B26", (50, 43, 38), [50.0, 43.0, 38.0], np.array([50, 43, 38])]
)
def test_paints_are_added_and_replaced(same):
    default = HslMixer.default()
    edited = default.with_paints({"raw umber": same, "burnt umber": "#402010"})
    assert edited.paints == (*default.paints, "raw umber")
    for name, steps in (("raw umber", (50, 43, 38)), ("burnt umber", (64, 32, 16))):
        np.testing.assert_allclose(255 * encoded(edited.mix(name, name, 0.0)), steps, atol=1e-9)
    others = [name for name in default.paints if name != "burnt umber"]
    kept = (m.colours[m.indices(others)] for m in (edited, default))
    np.testing.assert_array_equal(*kept)


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
        linear_colour("moss", colour)


@pytest.mark.parametrize(
    ("make", "line"),
    [
        (lambda m: m.mix("burnt umber", "ultramarine", 1.2), r"^share = 1\.2 is outside \[0, 1\]$"),
        (lambda m: m.mix("burnt umber", "ultramarine", np.nan), "share = nan is outside"),
        (lambda m: m.mix(["burnt umber"] * 2, "ultramarine", jnp.zeros(3)),
         r"paints of shapes \(2,\) and \(\) and shares of \(3,\)"),
        (lambda m: m.indices("ultramarin"),
         r"^unknown paint 'ultramarin'; did you mean 'ultramarine'\? known: ivory black, .*, cadmium red$"),
        (lambda m: m.indices(["burnt umber", "xyz"]), r"^unknown paint 'xyz'; known: ivory black, "),
        (lambda _: HslMixer.of({}), "at least one paint"),
        (lambda m: HslMixer(("a", "a"), m.colours[:2]), "one name a colour, each once; got 2 names for 2"),
        (lambda m: HslMixer(("a",), m.colours[:2]), "got 1 names for 2"),
        (lambda m: HslMixer(("a",), m.colours[1:2] * 2),
         r"reflectance of paint 'a' = 1\.9\d* is outside \[0, 1\]"),
    ],
)  # fmt: skip
def test_refusals(make, line):
    with pytest.raises(ValueError, match=line):
        make(HslMixer.default())
