"""Contrast of fibres is kept, that of light along arcs and of noise is taken off."""

import numpy as np
import pytest

from irisjax.photo.texture import Unrefracted
from irisjax.photo.thickness import ARC_LIGHT, along_fibres

SIZE = 600


def ring(hidden=False) -> Unrefracted:
    """Of an eye without lids, or with its upper third hidden."""
    empty = Unrefracted(
        np.zeros((SIZE, SIZE, 3), np.float32), np.zeros((SIZE, SIZE), bool), 2.0, 5.5
    )
    radius, y = empty.radius(), empty.radius() * np.sin(empty.angle())
    return empty._replace(valid=(radius > 2) & (radius < 5.5) & ~(hidden & (y > 2)))


def away_from_edges(texture: Unrefracted):
    """Texels at which no neighbourhood reaches an edge."""
    radius, y = texture.radius(), texture.radius() * np.sin(texture.angle())
    return texture.valid & (radius > 2.3) & (radius < 5.2) & (y < 0)


@pytest.mark.parametrize("hidden", [False, True])
@pytest.mark.parametrize("response", [0.2, 0.6])
def test_fibres_and_rings_stay(response, hidden):
    """What varies with the angle alone, or with the distance alone, is tissue."""
    texture = ring(hidden)
    where, angle, radius = away_from_edges(texture), texture.angle(), texture.radius()
    for tissue in (0.1 * np.cos(40 * angle), 0.1 * np.sin(2 * np.pi * radius / 1.0)):
        seen = np.where(texture.valid, tissue, np.nan).astype(np.float32)
        found = along_fibres(seen, texture.valid, texture, response)
        # A wave 1 mm long loses 1 − exp(−2π²·0.05²) = 0.048 of its height to the smoothing.
        np.testing.assert_allclose(found[where], tissue[where], atol=0.008)
        assert not found[~texture.valid].any()


@pytest.mark.parametrize("response", [0.2, 0.6])
def test_light_along_an_arc_is_taken_off(response):
    """A shadow along the limbus on one side: the share of it that the estimate believes."""
    texture = ring()
    middle = np.exp(-0.5 * (np.angle(np.exp(1j * (texture.angle() + np.pi / 2))) / 0.5) ** 2)
    shadow = -0.2 * middle / (1 + np.exp(-(texture.radius() - 4.5) / 0.15))
    found = along_fibres(shadow.astype(np.float32), texture.valid, texture, response)
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
    noise = np.random.default_rng(1).normal(size=(SIZE, SIZE)).astype(np.float32)
    found = along_fibres(noise, texture.valid, texture, 0.6)
    left = found[away_from_edges(texture)].var()
    expected = 1 / (2 * np.sqrt(np.pi) * 0.05 / texture.millimetres_per_texel)
    assert 0.3 * expected < left < 1.05 * expected
