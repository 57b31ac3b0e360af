"""Mixtures by absorption and scattering, the paints that come with it, and users' files."""

import colorsys
import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from irisjax.io.recipes import read_paints
from irisjax.measure.colour import XYZ_TO_SRGB, colour_of, srgb_encode
from irisjax.ocularist.kubelka_munk import (
    KubelkaMunkMixer,
    constructed_absorption,
    smoothest_reflectance,
)
from irisjax.ocularist.mixing import FURTHER_PAINTS, PAINTS, HslMixer, linear_colour

EVERY = {**PAINTS, **FURTHER_PAINTS}


def hue(linear):
    """Degrees."""
    return 360 * colorsys.rgb_to_hls(*np.asarray(srgb_encode(linear)))[0]


def luminance(linear):
    return float(np.linalg.inv(XYZ_TO_SRGB)[1] @ np.asarray(linear))


def test_masstones_have_the_palettes_colours(bits):
    mixer, palette = KubelkaMunkMixer.default(), HslMixer.of(EVERY)
    assert mixer.paints == palette.paints
    assert mixer.paints[: len(PAINTS)] == HslMixer.default().paints
    found = mixer.mix(mixer.paints, mixer.paints, 0.3)
    np.testing.assert_allclose(found, palette.colours, atol=2e-5)


def test_the_table_is_what_the_construction_gives():
    """To its six digits; see `experiments.paint_table`."""
    mixer = KubelkaMunkMixer.default()
    for i, (name, srgb) in enumerate(EVERY.items()):
        assert float(jnp.ptp(mixer.scattering[i])) == 0
        scattering = np.asarray(mixer.scattering[i])
        k = constructed_absorption(linear_colour(name, srgb), mixer.wavelengths, scattering)
        np.testing.assert_allclose(mixer.absorption[i], k, rtol=1e-5)


def test_the_bands_are_narrow_enough():
    """K and S read off a grid four times as fine change no mixture by a step of 8 bits."""
    coarse, x = KubelkaMunkMixer.default(), np.arange(400.0, 700.1, 2.5)
    fine = KubelkaMunkMixer(coarse.paints, tuple(x.tolist()), *(
        jnp.asarray([np.interp(x, coarse.wavelengths, row) for row in table])
        for table in (coarse.absorption, coarse.scattering)
    ))  # fmt: skip
    for first, second in (("ultramarine", "cadmium yellow"), ("cadmium red", "titanium white")):
        steps = [255 * srgb_encode(m.mix(first, second, 0.5)) for m in (coarse, fine)]
        np.testing.assert_allclose(*steps, atol=1.0)


@pytest.mark.parametrize("blue", ["ultramarine", "phthalo blue"])
def test_a_blue_and_a_yellow_make_a_green(blue):
    """Darker than both the average of the light and the mixture in HSL."""
    mixed = KubelkaMunkMixer.default().mix(blue, "cadmium yellow", 0.5)
    assert 80 < hue(mixed) < 170
    palette = HslMixer.of(EVERY)
    average = palette.colours[palette.indices([blue, "cadmium yellow"])].mean(0)
    assert not 80 < hue(average) < 170
    assert luminance(mixed) < luminance(average)
    in_hsl = palette.mix(blue, "cadmium yellow", 0.5)
    assert luminance(mixed) < luminance(in_hsl)
    assert 300 < hue(in_hsl) < 345 or blue == "phthalo blue"  # ultramarine makes a pink


def test_ultramarine_and_burnt_sienna_make_a_neutral_dark():
    """What painters use for a black."""
    mixed = KubelkaMunkMixer.default().mix("ultramarine", "burnt sienna", 0.5)
    encoded = np.asarray(srgb_encode(mixed))
    assert np.ptp(encoded) < 0.06 and encoded.max() < 0.3


def test_a_mixture_by_hand():
    """K and S of two grey paints add: (0.2, 1) and (1, 0.5) at a quarter make 0.4 and 0.875."""
    x = np.arange(400.0, 701.0, 20.0)
    k, s = (np.outer(column, np.ones(x.size)) for column in ([0.2, 1.0], [1.0, 0.5]))
    mixer = KubelkaMunkMixer(("light", "dark"), tuple(x.tolist()), jnp.asarray(k), jnp.asarray(s))
    q = 0.4 / 0.875
    by_hand = 1 + q - np.sqrt(q * q + 2 * q)
    np.testing.assert_allclose(mixer.mix("light", "dark", 0.25), np.full(3, by_hand), atol=1e-4)


def test_mixtures_lie_in_srgb_and_have_gradients():
    mixer, step = KubelkaMunkMixer.default(), 1e-6
    first = [name for name in mixer.paints for _ in mixer.paints]
    second = list(mixer.paints) * len(mixer.paints)
    mix = jax.jit(lambda mixer, share: mixer.mix(first, second, share))
    half = np.full(len(first), 0.5)
    for share in (0 * half, half, 2 * half):
        found = mix(mixer, share)
        assert found.shape == (len(first), 3)
        assert float(found.min()) >= 0 and float(found.max()) <= 1
    of_mixer, of_share = jax.jit(jax.grad(lambda m, s: mix(m, s).sum(), (0, 1)))(mixer, half)
    for slopes in (of_mixer.absorption, of_mixer.scattering):
        assert np.isfinite(slopes).all() and np.abs(slopes).max() > 0
    difference = (mix(mixer, half + step) - mix(mixer, half - step)).sum(-1) / (2 * step)
    np.testing.assert_allclose(of_share, difference, rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("surface", [None, (0.04, 0.6)])
def test_paints_are_added_and_replaced_by_colour(surface):
    default = KubelkaMunkMixer.default()
    mixer = dataclasses.replace(default, surface=surface)
    edited = mixer.with_paints({"moss": "#506030", "ultramarine": (40, 60, 170)})
    assert edited.paints == (*default.paints, "moss")
    for name, steps in (("moss", (80, 96, 48)), ("ultramarine", (40, 60, 170))):
        found = 255 * np.asarray(srgb_encode(edited.mix(name, name, 0.0)))
        np.testing.assert_allclose(found, steps, atol=1e-3)
    place = default.paints.index("ultramarine")
    np.testing.assert_array_equal(edited.scattering[place], default.scattering[place])
    with pytest.raises(ValueError, match="paint 'moss': '#50603' is no colour"):
        mixer.with_paints({"moss": "#50603"})


@pytest.mark.parametrize("srgb", ["#000000", "#ffffff", "#0000ff", "#00ffff", "#0300fa", "#7f807f"])
def test_smoothest_reflectances(srgb):
    even, colour = np.arange(400.0, 701.0, 10.0), linear_colour("any", srgb)
    for x in (even, np.concatenate([even[:10], even[10::2]])):
        found = smoothest_reflectance(colour, x)
        assert found.min() > 0 and found.max() < 1
        np.testing.assert_allclose(colour_of(x, found).srgb_linear, colour, atol=1.1e-5)


def test_the_smoothest_reflectance_is_the_smoothest():
    """Any small change that keeps the colour is rougher in z = artanh(2R − 1)."""
    from scipy.linalg import null_space

    from irisjax.measure.colour import tristimulus_matrix

    x = np.arange(400.0, 701.0, 10.0)
    best = smoothest_reflectance(linear_colour("any", (90, 60, 150)), x)

    def roughness(r):
        return float(np.sum(np.diff(np.arctanh(2 * r - 1)) ** 2))

    for direction in null_space(tristimulus_matrix(x, "linear sRGB")[0]).T:
        for step in (1e-3, -1e-3):
            assert roughness(best + step * direction) > roughness(best)


def written(tmp_path, text):
    path = tmp_path / "mine.csv"
    path.write_text(text, encoding="utf-8")
    return path


def rows(*columns, x=range(400, 701, 20)):
    return "".join(",".join(str(v) for v in (w, *columns)) + "\n" for w in x)


def test_a_users_file(tmp_path):
    """The package's own table, written by hand with semicolons, and two blues in it."""
    default = KubelkaMunkMixer.default()
    wanted = ("ultramarine", "phthalo blue", "cadmium yellow")
    lines = ["wavelength_nm;" + ";".join(f"{n}_K;{n}_S" for n in wanted)]
    for i, w in enumerate(default.wavelengths):
        cells = [w]
        for name in wanted:
            place = default.paints.index(name)
            cells += [float(default.absorption[place, i]), float(default.scattering[place, i])]
        lines.append(";".join(f"{c:.9g}".replace(".", ",") for c in cells))
    mixer = read_paints(written(tmp_path, "# my paints\n" + "\n".join(lines) + "\n"))
    assert mixer.paints == wanted and mixer.surface is None
    for blue in wanted[:2]:
        found = mixer.mix(blue, "cadmium yellow", 0.5)
        np.testing.assert_allclose(found, default.mix(blue, "cadmium yellow", 0.5), atol=1e-7)


def test_a_file_with_a_surface(tmp_path):
    head = "# saunderson: 0.04, 0.6 [outside, inside]\nwavelength_nm,grey_K,grey_S\n"
    mixer = read_paints(written(tmp_path, head + rows(0.5, 1)))
    assert mixer.surface == (0.04, 0.6)
    by_hand = 0.96 * 0.4 * 0.381966 / (1 - 0.6 * 0.381966)
    np.testing.assert_allclose(mixer.mix("grey", "grey", 0.0), np.full(3, by_hand), atol=1e-4)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no rows of numbers"),
        ("nm,a_K,a_S\n" + rows(1, 1), "the first column must be wavelength_nm, not 'nm'"),
        ("wavelength_nm,a_K,a_S\n" + rows(1, 1) + "720,x,1\n", "line 18: 'x' is not a number"),
        ("wavelength_nm,a_K,a_S\n" + rows(-1, 1), r"line 2: a_K = -1 is outside \[0, inf\)"),
        ("wavelength_nm,a_K,a_S\n" + rows(1, 1) + "720,,1\n", "line 18: a_K = nan is outside"),
        ("wavelength_nm,a_K,a_S\n" + rows(0, 0), "line 2: K and S of a are both 0"),
        ("wavelength_nm,a_K,b_S\n" + rows(1, 1), "column a_K has no a_S beside it"),
        ("wavelength_nm,a_K,a_S,a_K\n" + rows(1, 1, 1), "column 'a_K' appears twice"),
        ("wavelength_nm,a,a_S\n" + rows(1, 1), "column 'a' is neither PAINT_K nor PAINT_S"),
        ("wavelength_nm,a_K,a_S\n" + rows(1, 1, x=range(500, 701, 20)), "wavelengths from 500 to 700 nm make no colour"),
        ("wavelength_nm,a_K,a_S\n" + rows(1, 1, x=range(400, 701, 50)), "steps of at most 25 nm"),
        ("wavelength_nm,a_K,a_S\n" + rows(1, 1, x=range(700, 399, -20)), "wavelengths must increase"),
        ("# saunderson: 0.04\n" + "wavelength_nm,a_K,a_S\n" + rows(1, 1), "saunderson: '0.04' is not two numbers"),
        ("# saunderson: 0.04 1\n" + "wavelength_nm,a_K,a_S\n" + rows(1, 1), r"surface = 1 is outside \[0, 0.99\]"),
    ],
)  # fmt: skip
def test_broken_files(tmp_path, text, said):
    path = written(tmp_path, text)
    with pytest.raises(ValueError, match=said) as caught:
        read_paints(path)
    assert str(caught.value).startswith(f"{path}") and "\n" not in str(caught.value)


def test_broken_mixers():
    default = KubelkaMunkMixer.default()
    k, s = default.absorption, default.scattering
    for paints in (default.paints[:-1], ("a", *default.paints[:-2], "a")):
        with pytest.raises(ValueError, match="one row a paint, each paint once"):
            KubelkaMunkMixer(paints, default.wavelengths, k, s)
    with pytest.raises(ValueError, match="S of paint 'ivory black' = -1 is outside"):
        KubelkaMunkMixer(default.paints, default.wavelengths, k, s.at[0, 3].set(-1.0))
    with pytest.raises(ValueError, match=r"K \+ S of paint 'ivory black' = 0 is outside \(0"):
        KubelkaMunkMixer(default.paints, default.wavelengths, 0 * k, 0 * s)
