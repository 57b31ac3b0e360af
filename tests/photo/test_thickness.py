"""Freckles and thickness from a texture."""

import numpy as np
import pytest
from scipy import ndimage

from irisjax.photo.texture import Unrefracted, texels_of
from irisjax.photo.thickness import (
    ARC_LIGHT,
    SHADE_SHARE,
    THINNEST,
    deconvolve,
    encoded_intensity,
    f09_thickness,
    generic_thickness,
    local_contrast,
    local_normalisation,
    relative_luminance,
    relative_thickness,
    remove_arcs,
    shape_maps,
)

TEXEL = 12 / 128
Y, X = (np.mgrid[:128, :128] - 63.5) * TEXEL
R = np.hypot(X, Y).astype(np.float32)
RING = (R > 2) & (R < 5.5)


def _pattern(width=4.0, seed=0):
    """Smooth noise of unit variance."""
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(R.shape), width)
    return (noise / noise.std()).astype(np.float32)


def test_generic_iris_has_the_measured_thicknesses_and_is_constant_beyond():
    whole = generic_thickness(np.array([2.25, 3.5, 5.0])) + 0.07 + 0.05675
    np.testing.assert_allclose(whole, [0.645, 0.457, 0.372], atol=1e-6)
    r = np.linspace(0.25, 7, 200)
    t = generic_thickness(r)
    assert t.min() > 0.2 and (np.diff(t) <= 0).all()
    assert np.ptp(t[r < 2.25]) == 0 and np.ptp(t[r > 5]) == 0


def test_exposure_and_slow_shadows_do_not_tell():
    light = 0.1 * (1 + 0.2 * _pattern(1.5)).clip(0.1)
    shadow = np.exp(-X / 12).astype(np.float32)
    both = (
        encoded_intensity(relative_luminance(p, RING, 0.5, TEXEL))
        for p in (light, 7 * shadow * light)
    )
    plain, shaded = (local_normalisation(p, RING, 0.5, TEXEL) for p in both)
    assert (plain - shaded)[RING].std() < 0.1 * plain[RING].std()


def test_normalised_picture_has_no_mean_round_about_and_ignores_what_is_hidden():
    values = 0.4 + 0.3 * X / 6 + 0.05 * _pattern(1.0)
    hidden = np.where(RING, values, 50.0)
    found = local_normalisation(hidden, RING, 0.8, TEXEL)
    np.testing.assert_array_equal(found, local_normalisation(values, RING, 0.8, TEXEL))
    assert abs(found[RING].mean()) < 0.01
    assert (found[~RING] == 0).all()


def test_deconvolution_sharpens_what_a_gaussian_has_blurred():
    sharp = 0.1 * _pattern(3.0)
    blurred = ndimage.gaussian_filter(sharp, 0.3 / TEXEL)
    found = deconvolve(blurred, RING, 0.3, TEXEL)
    more = deconvolve(blurred, RING, 0.3, TEXEL, iterations=100)
    inner = ndimage.binary_erosion(RING, iterations=6)
    errors = [np.sqrt(np.mean((x - sharp)[inner] ** 2)) for x in (blurred, found, more)]
    assert errors[2] < errors[1] < 0.6 * errors[0]


def test_deconvolution_keeps_the_mean_and_does_nothing_at_no_width():
    picture = 0.1 * _pattern(2.0) + 0.03
    found, narrow, none = (deconvolve(picture, RING, mm, TEXEL)[RING] for mm in (0.5, 0.001, 0.0))
    assert found.mean() == pytest.approx(picture[RING].mean(), abs=1e-6)
    np.testing.assert_allclose(narrow, picture[RING], atol=1e-3)
    np.testing.assert_array_equal(none, picture[RING])


def test_a_flat_picture_does_not_ring_at_its_holes():
    flat = np.full(R.shape, 0.1, np.float32)
    holes = RING & ~(np.hypot(X - 3.5, Y) < 0.6)
    found = deconvolve(np.where(holes, flat, -0.9), holes, 0.5, TEXEL)
    assert np.abs(found - flat)[holes].max() < 1e-3


def test_thickness_is_clamped_and_says_where():
    wide = np.where(X > 0, 0.4, -5.0).astype(np.float32)
    found, clamped = f09_thickness(R, wide)
    np.testing.assert_array_equal(clamped, X <= 0)
    assert found[clamped].min() == found[clamped].max() == np.float32(THINNEST)
    np.testing.assert_allclose((found - generic_thickness(R))[X > 0], 0.35 * 0.4, rtol=1e-4)


@pytest.mark.parametrize("response", [0.6, 0.2])
def test_relative_thickness_is_the_estimate_of_least_error(response):
    """Of deviations of 20 % under 5 % of other contrast: no other power comes nearer."""
    thicker, other = 0.2 * _pattern(), 0.05 * _pattern(seed=1)
    contrast = np.exp(response * thicker + other) - 1
    found, clamped = relative_thickness(R, contrast.astype(np.float32), response)
    assert not clamped.any()
    told = np.log(found / generic_thickness(R))

    def error(factor):
        return np.square(factor * told - thicker).mean()

    assert error(1.0) < min(error(0.8), error(1.25))
    # Nothing but thickness in a light iris: nearly all of it comes back.
    alone, _ = relative_thickness(R, np.expm1(0.6 * thicker), 0.6)
    back = np.log(alone / generic_thickness(R))
    np.testing.assert_allclose(back, thicker * 0.36 / (0.36 + 1 / 16), rtol=1e-3, atol=1e-5)
    # An opaque iris: no number is out of range, and nothing is told.
    average, clamped = relative_thickness(R, thicker, 0.0)
    np.testing.assert_allclose(average, generic_thickness(R), rtol=1e-6)
    assert not clamped.any()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda p: deconvolve(p, RING, -0.1, TEXEL), "sigma_mm = -0.1 mm is outside"),
        (lambda p: deconvolve(p - 2, RING, 0.5, TEXEL), "values to deconvolve"),
        (lambda p: deconvolve(p, np.zeros_like(RING), 0.5, TEXEL), "no texel is valid"),
        (lambda p: f09_thickness(R, p, np.nan), "beta = nan mm"),
        (lambda p: relative_thickness(R, p, 9.0), "response = 9"),
        (lambda p: shape_maps(_texture(), _texture().valid), "no texel that shows the iris"),
        (lambda p: shape_maps(_texture(), np.zeros((2, 2), bool)), "the freckle mask is"),
    ],
)
def test_what_cannot_be(call, message):
    with pytest.raises(ValueError, match=message):
        call(np.zeros(R.shape, np.float32))


def test_the_edge_of_a_shadow_is_no_thickness():
    """Light falls off to a fifth within 0.6 mm; what is beyond is told to be shade."""
    pattern = 0.15 * _pattern(1.5)
    light = (0.2 + 0.8 / (1 + np.exp(-(X + 3) / 0.15))).astype(np.float32)
    picture, shade = light * (1 + pattern), light < 0.7
    whole = local_contrast(picture, RING, None, TEXEL)
    told = local_contrast(picture, RING, shade, TEXEL)
    lit, beside = RING & ~shade, RING & ~shade & (X < -2)

    def error(found, where):
        return np.sqrt(np.mean((found - pattern)[where] ** 2))

    assert error(told, beside) < 0.75 * error(whole, beside)
    assert error(told, lit) <= error(whole, lit)
    assert told[RING & shade].std() < 0.7 * whole[RING & shade].std()
    assert (told[~RING] == 0).all()
    even = local_contrast(1 + pattern, RING, RING & (Y > 0), TEXEL)
    assert even[RING & (Y > 0)].std() < 1.2 * SHADE_SHARE * even[RING & (Y < 0)].std()


SIZE = 192


def _texture():
    radius, angle = texels_of(SIZE)
    pixels = np.array([0.1, 0.14, 0.2]) * (1 + 0.3 * np.sin(24 * angle))[..., None]
    return Unrefracted(pixels, (radius > 1.9) & (radius < 5.5), 1.9, 5.5)


def test_bright_streaks_are_thick_and_the_iris_thins_outwards():
    found = shape_maps(_texture(), shape=(192, 32))
    depth = np.asarray(found.maps.stroma_depth)
    assert depth.shape == (192, 32)
    angle = (np.arange(192) + 0.5) * 2 * np.pi / 192
    assert np.corrcoef(depth[:, 20], np.sin(24 * angle))[0, 1] > 0.95
    assert depth[:, 2].mean() > depth[:, 16].mean() > depth[:, 30].mean()
    assert found.maps.freckles is None and found.maps.abl_depth is None and found.clamped == 0


def test_freckles_of_the_user_are_filled_and_handed_on():
    texture, (radius, angle) = _texture(), texels_of(SIZE)
    spot = np.maximum(abs(radius * np.cos(angle) - 3.5), abs(radius * np.sin(angle))) < 0.3
    spoilt = texture._replace(pixels=np.where(spot[..., None], 1e-3, texture.pixels))
    found = shape_maps(spoilt, spot, shape=(192, 32))
    clean = shape_maps(texture, np.zeros_like(spot), shape=(192, 32))
    assert np.asarray(found.maps.freckles).max() > 0.9
    difference = np.abs(np.asarray(found.maps.stroma_depth) - clean.maps.stroma_depth)
    assert difference.max() < 0.05 and np.median(difference) < 1e-4


def test_a_freckle_is_as_dark_as_in_the_photograph():
    """Where the model's are darker; the darkest there is where they are not."""
    texture, (radius, angle) = _texture(), texels_of(SIZE)
    middle = np.hypot(radius * np.cos(angle) - 3.5, radius * np.sin(angle))[..., None]
    darkness = np.array([[0, 0.5, 1.0], [1, 0.5, 0.4]])
    known = {"response": 0.5, "darkness": darkness, "shape": (192, 32)}
    # About a spot as large the surroundings are filled in: the streaks are lost there.
    flat = np.where(middle < 1, [0.1, 0.14, 0.2], texture.pixels)
    for seen, share in ((0.75, 0.25), (0.45, 0.75), (0.2, 1.0)):
        dark = texture._replace(pixels=np.where(middle < 0.5, seen, 1.0) * flat)
        found = np.asarray(shape_maps(dark, middle[..., 0] < 0.5, **known).maps.freckles)
        assert found.max() == pytest.approx(share, abs=0.02)
        assert found.min() == 0


def test_hidden_texels_do_not_tell():
    texture = _texture()
    valid = texture.valid & ~(texture.radius() * np.sin(texture.angle()) > 4)
    spoilt = np.where(valid[..., None], texture.pixels, np.nan)
    found, again = (
        shape_maps(texture._replace(valid=valid, pixels=pixels)).thickness
        for pixels in (spoilt, texture.pixels)
    )
    np.testing.assert_array_equal(found, again)


RING_SIZE = 600


def ring(hidden=False) -> Unrefracted:
    """Of an eye without lids, or with its upper third hidden."""
    radius, angle = texels_of(RING_SIZE)
    valid = (radius > 2) & (radius < 5.5) & ~(hidden & (radius * np.sin(angle) > 2))
    return Unrefracted(np.zeros((*valid.shape, 3), np.float32), valid, 2.0, 5.5)


def away_from_edges(texture: Unrefracted):
    """Texels at which no neighbourhood reaches an edge."""
    radius, y = texture.radius(), texture.radius() * np.sin(texture.angle())
    return texture.valid & (radius > 2.3) & (radius < 5.2) & (y < 0)


@pytest.mark.parametrize(("response", "hidden"), [(0.2, False), (0.6, True)])
def test_fibres_and_rings_stay(response, hidden):
    """What varies with the angle alone, or with the distance alone, is tissue."""
    texture = ring(hidden)
    where, angle, radius = away_from_edges(texture), texture.angle(), texture.radius()
    for tissue in (0.1 * np.cos(40 * angle), 0.1 * np.sin(2 * np.pi * radius / 1.0)):
        seen = np.where(texture.valid, tissue, np.nan).astype(np.float32)
        found = remove_arcs(seen, texture.valid, texture, response)
        # A wave 1 mm long loses 1 − exp(−2π²·0.05²) = 0.048 of its height to the smoothing.
        np.testing.assert_allclose(found[where], tissue[where], atol=0.008)
        assert not found[~texture.valid].any()


@pytest.mark.parametrize("response", [0.2, 0.6])
def test_light_along_an_arc_is_taken_off(response):
    """A shadow along the limbus on one side: the share of it that the estimate believes."""
    texture = ring()
    middle = np.exp(-0.5 * (np.angle(np.exp(1j * (texture.angle() + np.pi / 2))) / 0.5) ** 2)
    shadow = -0.2 * middle / (1 + np.exp(-(texture.radius() - 4.5) / 0.15))
    found = remove_arcs(shadow.astype(np.float32), texture.valid, texture, response)
    where = away_from_edges(texture) & (middle > 0.9) & (texture.radius() > 4.8)
    left = found[where].mean() / shadow[where].mean()
    kept = response**2 / (ARC_LIGHT**2 + response**2)
    # The ring's mean, a fifth of the shadow, stays; the arc is blurred by 0.7 mm.
    share = 1.2533 * 0.5 / np.pi
    assert left == pytest.approx(kept + (1 - kept) * share, abs=0.08)


def test_noise_is_averaged_along_the_radius():
    """Of white noise a Gaussian of s texels along a line leaves 1 / (2 √π s) of the variance; two
    interpolations average some more.
    """
    texture = ring()
    noise = np.random.default_rng(1).normal(size=(RING_SIZE, RING_SIZE)).astype(np.float32)
    found = remove_arcs(noise, texture.valid, texture, 0.6)
    left = found[away_from_edges(texture)].var()
    expected = 1 / (2 * np.sqrt(np.pi) * 0.05 / texture.millimetres_per_texel)
    assert 0.3 * expected < left < 1.05 * expected
