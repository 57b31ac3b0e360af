"""Paint on texels: where it lies, how much there is, how it covers."""

import numpy as np
import pytest

from irisjax.ocularist.strokes import Annulus, Dots, Paint, Strokes, angles_round, smooth_noise

RNG = np.random.default_rng(5)
FAINT = 1e-7  # optical depth × area: opacity is proportional to it


def drops(x, y, amount):
    return Paint(*(np.asarray(v, np.float32) for v in (x, y, np.full(np.shape(x), amount))))


def moments(opacity):
    """Amount, middle and variance along x and y."""
    at = (2 * np.arange(len(opacity)) + 1) / len(opacity) - 1
    total = opacity.sum(dtype=float)
    x, y = opacity.sum(0) @ at / total, -opacity.sum(1) @ at / total
    variance = opacity.sum(0) @ (at - x) ** 2 / total, opacity.sum(1) @ (at + y) ** 2 / total
    return total * (2 / len(opacity)) ** 2, (x, y), variance


@pytest.mark.parametrize(
    ("size", "softness"),
    [(256, 0.02), (100, 0.06), (256, 0.08), (64, 0.008)],
    ids=["texels", "odd", "coarse", "averaged"],
)
def test_paint_lies_where_it_is_put(size, softness):
    cloud = np.array([[0.4], [0.3]]) + 0.01 * RNG.normal(size=(2, 500))
    amount, middle, variance = moments(drops(*cloud, FAINT / 500).opacity(size, softness))
    np.testing.assert_allclose(amount, FAINT, rtol=2e-3)
    np.testing.assert_allclose(middle, cloud.mean(1), atol=1e-3)
    # Of the brush and of where the drops are; of a texel's mean, which depends on where that is.
    texel = (2 / size) ** 2 / 12
    expected = softness**2 + cloud.var(1) + texel
    np.testing.assert_allclose(variance, expected, rtol=0.02, atol=texel)


def test_paint_over_paint_covers_as_coat_over_coat():
    one = drops([0.0, 0.1], [0.0, 0.0], 0.01)
    other = drops([0.05], [0.02], 0.02)
    a, b, both = (p.opacity(128, 0.05) for p in (one, other, one | other))
    assert b.max() > 0.5
    np.testing.assert_allclose(both, 1 - (1 - a) * (1 - b), atol=2e-5)


def test_paint_beyond_the_square_does_not_come_back():
    assert drops([1.5, 0.0], [0.0, -3.0], 1.0).opacity(64, 0.05).max() == 0


def test_a_dot_is_as_wide_and_as_thick_as_it_says():
    ring, n = Annulus(0.3), 40
    angle = 2 * np.pi * np.arange(n) / n
    dots = Dots(angle, np.full(n, 0.5), np.full(n, 0.06), np.full(n, 1.5))
    opacity = dots.paint(RNG, ring, 0.004).opacity(1024, 0.004)
    x, y = ring.place(0.5) * np.cos(angle), ring.place(0.5) * np.sin(angle)
    depth = -np.log1p(-opacity.astype(float))
    middles = depth[((1 - y) * 512).astype(int), ((1 + x) * 512).astype(int)]
    assert np.median(middles) == pytest.approx(1.5, rel=0.1)
    half = (depth > 0.75).mean() * 4
    assert half == pytest.approx(n * np.pi * 0.03**2, rel=0.1)


def test_strokes_run_where_they_are_put():
    ring, n = Annulus(0.3), 60
    values = np.pi / 2, 0.2, 0.5, 0.02, 0.0, 0.01
    path = Strokes(*(np.full(n, v) for v in values), 0.5)
    opacity = path.paint(RNG, ring, 0.005).opacity(512, 0.005)
    rows, columns = np.nonzero(opacity > 0.05 * opacity.max())
    y, x = 1 - (2 * rows + 1) / 512, (2 * columns + 1) / 512 - 1
    assert np.abs(x).max() < 0.04
    assert ring.place(0.2) - 0.02 < y.min() < y.max() < ring.place(0.7) + 0.02
    assert np.ptp(y) > 0.8 * 0.5 * 0.7


def test_angles_are_even_or_not_as_asked():
    def gaps(irregularity):
        angle = np.sort(angles_round(np.random.default_rng(3), 200, irregularity) % (2 * np.pi))
        return np.diff(np.append(angle, angle[0] + 2 * np.pi)) * 200 / (2 * np.pi)

    np.testing.assert_allclose(gaps(0.0), 1, atol=1e-9)
    assert gaps(0.5).std() > 0.25
    assert gaps(1.0).max() > 2.5


def test_a_wandering_edge_closes():
    at = smooth_noise(np.random.default_rng(1), 14)
    angle = np.linspace(0, 2 * np.pi, 4097)
    values = at(angle)
    np.testing.assert_allclose(values[0], values[-1], atol=1e-9)
    np.testing.assert_allclose([values[:-1].mean(), values[:-1].var()], [0, 1], atol=1e-9)
