"""Environments: lights that carry the map's power, and a map without seams."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from irisjax.render.environment import LUMINANCE, Environment
from irisjax.render.refraction import LARGEST_POLAR


def noisy(rows, columns=None, seed=3):
    shape = (rows, columns or 2 * rows, 3)
    return Environment(np.random.default_rng(seed).lognormal(0, 1.5, shape))


lookup = eqx.filter_jit(Environment.lookup)


def total(environment):
    """Power of the whole map by hand."""
    rows, columns = environment.radiance.shape[:2]
    edges = np.linspace(0, np.pi, rows + 1)
    solid = (np.cos(edges[:-1]) - np.cos(edges[1:])) * 2 * np.pi / columns
    return np.einsum("rck,r->k", np.asarray(environment.radiance, np.float64), solid)


def power_of(lights):
    power = np.asarray(lights.irradiance)[:, None] * np.asarray(lights.tint)
    return np.asarray(power, np.float64)


def on_a_facing_surface(lights):
    return (power_of(lights) * np.maximum(-np.asarray(lights.towards)[:, 2:], 0)).sum(0)


def spot(towards, rows=32, columns=64):
    """One bright texel in the dark: the one nearest to a direction."""
    polar, azimuth = np.arccos(towards[1]), np.arctan2(-towards[0], -towards[2])
    radiance = np.zeros((rows, columns, 3))
    i, j = int(polar / np.pi * rows), int((azimuth / (2 * np.pi) + 0.5) * columns) % columns
    radiance[i, j] = [100, 80, 60]
    return Environment(radiance), (i, j)


@pytest.mark.parametrize(("shape", "n"), [((15, 33), 1), ((15, 33), 300), ((1, 5), 7)])
def test_power_is_conserved(shape, n):
    environment = noisy(*shape)
    lights = environment.to_lights(n, largest_polar=None)
    assert len(lights) == min(n, np.prod(shape))
    np.testing.assert_allclose(power_of(lights).sum(0), total(environment), rtol=1e-12)
    np.testing.assert_allclose(np.asarray(lights.tint) @ LUMINANCE, 1, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(lights.towards, axis=-1), 1, rtol=1e-12)
    assert lights.illuminant == "D65" and lights.distance is None


def test_single_precision(float32):
    environment = noisy(40)
    lights = environment.to_lights(50)
    for leaf in jax.tree.leaves((lights, lookup(environment, lights.towards))):
        assert leaf.dtype == jnp.float32
    whole = environment.to_lights(50, largest_polar=None)
    np.testing.assert_allclose(power_of(whole).sum(0), total(environment), rtol=3e-6)


@pytest.mark.parametrize("towards", [(-1, 0.1, -0.2), (0.02, 1, 0.03)])
def test_one_bright_texel_gives_one_light_there(towards):
    """Columns right of the middle are to the right of who looks out of the eye, and left of who
    faces it.
    """
    towards = np.asarray(towards) / np.linalg.norm(towards)
    environment, (i, _) = spot(towards)
    lights = environment.to_lights(16)
    assert len(lights) == 1
    assert np.arccos(np.asarray(lights.towards)[0] @ towards) < 0.75 * np.pi / 32 * np.sqrt(2)
    np.testing.assert_allclose(lookup(environment, lights.towards)[0], [100, 80, 60], rtol=1e-10)
    solid = (np.cos(i * np.pi / 32) - np.cos((i + 1) * np.pi / 32)) * 2 * np.pi / 64
    found = 2 * np.pi * (1 - np.cos(np.asarray(lights.radius)[0]))
    np.testing.assert_allclose(found, solid, rtol=1e-9)


def test_even_hemisphere_lights_a_facing_surface_with_pi():
    """E = π L in front; the lights' own sum meets it as they grow in number."""
    radiance = np.full((64, 128, 3), 2.0)
    radiance[:, :32] = radiance[:, 96:] = 0  # behind the eye
    environment = Environment(radiance)
    errors = []
    for n in (16, 64, 256, 1024):
        lights = environment.to_lights(n)
        assert len(lights) == n
        errors.append(abs(on_a_facing_surface(lights)[0] / (2 * np.pi) - 1))
    assert errors[0] < 0.08 and errors[1] < 0.02 and errors[3] < 2e-3
    assert all(b < 0.5 * a for a, b in itertools.pairwise(errors))


def test_radius_is_that_of_the_region():
    lights = Environment(np.ones((32, 64, 3))).to_lights(100, largest_polar=None)
    solid = 2 * np.pi * (1 - np.cos(np.asarray(lights.radius)))
    np.testing.assert_allclose(solid, lights.irradiance, rtol=1e-9)  # L = 1
    np.testing.assert_allclose(solid.sum(), 4 * np.pi, rtol=1e-12)


def test_lights_behind_the_eye_are_left_out():
    environment = noisy(64)
    lights = environment.to_lights(200)
    assert len(lights) == 200 and float(lights.polar().max()) < LARGEST_POLAR
    behind, _ = spot((0.1, 0.0, 0.99))
    with pytest.raises(ValueError, match="no light of this environment reaches"):
        behind.to_lights(4)
    assert len(behind.to_lights(4, largest_polar=None)) == 1


def test_lookup_between_texels():
    environment = noisy(6, 8)
    polar, azimuth = (np.arange(6) + 0.5) * np.pi / 6, ((np.arange(8) + 0.5) / 8 - 0.5) * 2 * np.pi

    def at(p, a):
        d = [-np.sin(p) * np.sin(a), np.cos(p) + 0 * a, -np.sin(p) * np.cos(a)]
        return lookup(environment, 3 * np.stack(d, axis=-1))

    np.testing.assert_allclose(
        at(*np.meshgrid(polar, azimuth, indexing="ij")), environment.radiance, rtol=1e-9
    )
    middle = at((polar[2] + polar[3]) / 2, (azimuth[4] + azimuth[5]) / 2)
    texels = np.asarray(environment.radiance)[2:4, 4:6]
    np.testing.assert_allclose(middle, texels.mean((0, 1)), rtol=1e-9)


def test_lookup_has_no_seam():
    environment = noisy(6, 7)
    tiny, y = 1e-9, np.linspace(-3, 3, 31)
    behind = np.stack([0 * y, y, 1 + 0 * y], axis=-1)
    aside = np.array([tiny, 0, 0])
    sides = (lookup(environment, behind + a) for a in (aside, -aside))
    np.testing.assert_allclose(*sides, rtol=1e-6)
    turn = np.linspace(0, 2 * np.pi, 17)
    for side in (1, -1):
        pole = np.array([0.0, side, 0.0])
        round_it = np.stack([tiny * np.cos(turn), side + 0 * turn, tiny * np.sin(turn)], axis=-1)
        there, at_pole = (lookup(environment, d) for d in (round_it, pole))
        np.testing.assert_allclose(there, np.broadcast_to(at_pole, (17, 3)), rtol=1e-6)
        row = np.asarray(environment.radiance)[0 if side > 0 else -1]
        np.testing.assert_allclose(at_pole, row.mean(0), rtol=1e-12)


def test_gradients_are_finite_and_true():
    environment = noisy(6, 8)
    special = [(0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1), (1, 0, 0)]
    ordinary = np.array([(0.3, 0.5, -0.8), (-0.7, -0.2, 0.4)])

    @jax.jit
    @jax.value_and_grad
    def brightness(arguments):
        radiance, d = arguments
        return (Environment(radiance).lookup(d) ** 2).sum()

    gradient = brightness((environment.radiance, np.concatenate([special, ordinary])))[1]
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))
    step = 1e-6 * np.random.default_rng(0).normal(size=ordinary.shape)
    ends = (np.concatenate([special, ordinary + sign * step]) for sign in (-1, 1))
    low, high = (brightness((environment.radiance, d))[0] for d in ends)
    slope = (gradient[1][len(special) :] * step).sum()
    np.testing.assert_allclose(slope, (high - low) / 2, rtol=1e-5)


def test_studio_and_sky():
    studio = Environment.studio(32)
    lights = studio.to_lights(32)
    radiance = np.asarray(lights.irradiance) / np.asarray(lights.radius) ** 2
    key = np.asarray(lights.towards)[np.argmax(radiance)]
    np.testing.assert_allclose(on_a_facing_surface(lights), np.pi, rtol=0.05)
    assert key[0] < 0 and key[1] > 0 and key[2] < 0
    for polar, azimuth in [(0.9, 2.0), (1.5, 0.3)]:
        bare, sunny = (Environment.sky(polar, azimuth, rows=48, **s) for s in ({"sun": 0.0}, {}))
        rise = total(sunny) - total(bare)
        np.testing.assert_allclose(rise @ np.asarray(LUMINANCE), 4.0, rtol=1e-9)
        sun = np.asarray(sunny.radiance) - np.asarray(bare.radiance)
        towards = np.asarray(Environment(sun).to_lights(1).towards)[0]
        sin = np.sin(polar)
        expected = sin * np.cos(azimuth), sin * np.sin(azimuth), -np.cos(polar)
        np.testing.assert_allclose(towards, expected, atol=0.01)


def test_window():
    window = Environment.window()
    np.testing.assert_allclose(on_a_facing_surface(window.to_lights(32)), np.pi, rtol=0.1)
    # Four panes, with the sky in the upper two and trees in the lower ones.
    right, up = np.meshgrid([-0.1, 0, 0.1], [0.13, 0.05, -0.17], indexing="ij")
    middle = np.array([-0.5, 0.62, -1.0]) / np.linalg.norm([-0.5, 0.62, -1.0])
    across = np.array([-middle[2], 0, middle[0]]) / np.hypot(middle[0], middle[2])
    rows = middle + right[..., None] * across + up[..., None] * np.cross(-middle, across)
    luminance = np.asarray(lookup(window, rows)) @ np.asarray(LUMINANCE)
    assert (luminance[[0, 2], 0] > 30).all()
    assert 2 < luminance[[0, 2], 2].min() < 10
    assert (luminance[1] < 10).all()  # on the bars
    assert (luminance[:, 1] < 10).all()


def test_errors():
    for radiance, said in (
        (np.zeros((2, 3)), r"shape \(rows, columns, 3\), got \(2, 3\)"),
        (np.array([[[1, np.nan, 0], [1, 2, 3]]]), "negative or not finite in 1 texels"),
        (np.full((1, 2, 3), -1.0), "negative or not finite in 2 texels"),
    ):
        with pytest.raises(ValueError, match=said):
            Environment(radiance)
    with pytest.raises(ValueError, match=r"^rows = 0 is outside \[1, inf\)$"):
        Environment.studio(0)
    with pytest.raises(ValueError, match="at least one light, got n = 0"):
        noisy(4).to_lights(0)
    with pytest.raises(ValueError, match="outside jit and grad"):
        jax.jit(lambda r: Environment(r).to_lights(2))(jnp.ones((2, 4, 3)))
