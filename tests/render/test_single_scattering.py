"""F09's marching against closed forms, radiative transfer and a brute-force march in NumPy."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import quick_jit, solve
from irisjax.anatomy.eye import Eye
from irisjax.render.bands import Bands
from irisjax.render.camera import Camera
from irisjax.render.integrator import solve_response
from irisjax.render.lights import Lights
from irisjax.render.picture import illuminate, shade, texture
from irisjax.render.project import project
from irisjax.render.scene import Scene
from irisjax.render.single_scattering import SingleScattering, TabulatedSingleScattering
from irisjax.tissue.maps import IrisMaps, Scales
from render.small_scenes import rays_of

pytestmark = pytest.mark.peer

WAVES = (450.0, 550.0, 650.0)


def bare():
    return Eye(cornea=None, sclera=None, iris_depth=3.6, pupil_radius=1.9)


def lamps():
    return Lights.distant([0.5, 1.1], [2.2, -0.4], [2.0, 1.0])


def camera():
    return Camera(polar=0.7, azimuth=0.3, distance=400.0, width=10.0, size=(24, 24))


def scene(iris, maps=None, lights=None, n_steps=12):
    lights = lamps() if lights is None else lights
    parts = {"camera": camera(), "integrator": SingleScattering(n_steps)}
    return Scene(iris, maps, bare(), lights, **parts)


def spectral(made):
    """The picture of an iris in the scene, with a channel for each of `WAVES`."""
    bands = Bands(WAVES, jnp.eye(3), jnp.ones(3), tuple(map(str, WAVES)))
    view, index = project(made.eye, made.camera), made.eye.aqueous_index
    texels = texture(view, made)
    light = illuminate(view, texels, made)

    def picture(iris):
        response = solve_response(made.integrator, iris, index, bands, Scales())
        return shade(view, texels, light, response)

    return picture


def rays():
    """Points on the iris plane, unit directions, and pixels well inside the iris, in NumPy."""
    origin, direction = (np.asarray(x, np.float64) for x in rays_of(camera(), bare()))
    direction = direction.reshape(-1, 3)
    point = origin + ((3.6 - origin[2]) / direction[:, 2])[:, None] * direction
    r = np.hypot(point[:, 0], point[:, 1])
    return point, direction, (r > 2.1) & (r < 5.4)


def slab(layers, towards, direction):
    """Single scattering of two plane layers, radiance per irradiance across the light.

    ∫₀^τ ω p e^(−(τ_A + t) m) dt/μ_o with m = 1/μ_i + 1/μ_o.
    """
    mu_i, mu_o = -towards[2], direction[:, 2]
    phase = 3 / (16 * np.pi) * (1 + (direction @ towards) ** 2)
    m = (1 / mu_i + 1 / mu_o)[:, None]
    abl, tau, albedo = (
        np.asarray(x) for x in (layers.abl_absorption, layers.extinction, layers.albedo)
    )
    return phase[:, None] * albedo * np.exp(-abl * m) * (1 - np.exp(-tau * m)) / (m * mu_o[:, None])


def expected(layers):
    _, direction, inside = rays()
    pairs = zip(np.asarray(lamps().towards), np.asarray(lamps().irradiance), strict=True)
    return sum(e * slab(layers, t, direction) for t, e in pairs)[inside], inside


def layers_of(iris):
    return iris.layers(ij.extinction(np.asarray(WAVES)))


def shown(made):
    """Channels of every pixel, (pixels, 3)."""
    return np.asarray(spectral(made)(made.iris)).reshape(-1, 3)


def maps_of(abl=0.0, stroma=0.0, freckles=0.0):
    """All maps, of one shape; their modulation in three shares."""
    angle, radius = np.meshgrid(np.arange(48) * (2 * np.pi / 48), np.arange(16) / 16, indexing="ij")
    wave, other = np.sin(9 * angle + 8 * radius), np.cos(9 * angle - 11 * radius)
    one = np.ones_like(wave)
    return IrisMaps(abl_depth=0.06 + abl * wave, stroma_depth=0.35 + stroma * other,
                    freckles=0.2 + freckles * wave, eumelanin=0.5 * one, pheomelanin=3 * one)  # fmt: skip


def test_uniform_iris_is_the_closed_form():
    iris = ij.Iris.of_level("high")
    true, inside = expected(layers_of(iris))
    assert inside.sum() > 100
    np.testing.assert_allclose(shown(scene(iris))[inside], true, rtol=1e-10)


def mapped_layers(iris):
    """Those of `maps_of()`: concentrations stay as thicknesses change."""
    made = layers_of(iris.replace(eumelanin=0.5 * iris.eumelanin, pheomelanin=3 * iris.pheomelanin))
    abl = 0.06 / float(iris.abl_thickness) * (1 + 11 * 0.2)
    stroma = 0.35 / float(iris.stroma_thickness)
    of_stroma = made.stroma_absorption * stroma, made.stroma_scattering * stroma
    depths = made.abl_absorption * abl, *of_stroma
    return ij.Layers(*depths, indices=made.indices, order=made.order)


def test_marching_through_uniform_maps_is_the_closed_form(bits):
    iris = ij.Iris.of_level("low")
    found = shown(scene(iris, maps_of()))
    assert found.dtype == {32: np.float32, 64: np.float64}[bits]
    true, inside = expected(mapped_layers(iris))
    np.testing.assert_allclose(found[inside], true, rtol={32: 1e-4, 64: 1e-10}[bits])


def test_the_table_is_what_is_marched():
    """Uniform irides, seen from 40° aside in light at 29° and 63°; the bound is the table's own."""
    iris = ij.Iris.of_level("low").replace(fibril_radius=60.0)
    marched, tabulated = (
        spectral(dataclasses.replace(scene(iris), integrator=integrator))(iris)
        for integrator in (SingleScattering(), TabulatedSingleScattering())
    )
    assert marched.max() > 0.01
    np.testing.assert_allclose(tabulated, marched, atol=2e-3 * float(marched.max()))


def test_radiative_transfer_where_little_is_scattered_twice():
    """Light scattered again is a share of about the albedo, or the depth,
    of that scattered once.
    """
    matched = dict.fromkeys(("abl_index", "stroma_index", "ipe_index"), 1.0)
    base = ij.Iris.of_level("low").replace(abl_fraction=0.1, **matched)
    lights = Lights.distant([0.5, 1.1], 2.2, [1.0, 0.0])
    _, direction, inside = rays()
    towards = np.asarray(lights.towards)[0]
    pick = np.flatnonzero(inside)[::17]
    # Both directions of travel: the light's, and that of the light sent back.
    azimuth = np.arctan2(-direction[pick, 1], -direction[pick, 0]) - np.arctan2(
        -towards[1], -towards[0]
    )
    off = {"albedo": [], "depth": []}
    for what, factor in itertools.product(off, (1e2, 1e3)):
        if what == "albedo":  # fibrils nearly of the base's index hardly scatter
            iris = base.replace(collagen_index=1.5 - 0.03 / np.sqrt(factor))
        else:
            thin = {"stroma_thickness": base.stroma_thickness / factor}
            iris = base.replace(
                eumelanin=0.0, pheomelanin=0.0, oxyhemoglobin=0.0, deoxyhemoglobin=0.0, **thin
            )
        made = iris.layers(ij.extinction(np.asarray(WAVES)), 1.0)
        solved = solve(ij.RadiativeExact(24), made, -towards[2], direction[pick, 2], azimuth)
        true = np.asarray(solved.brdf).T * -towards[2]
        air = bare().replace(aqueous_index=1.0)
        found = shown(scene(iris, lights=lights).replace(eye=air))[pick]
        small = np.asarray(made.albedo if what == "albedo" else made.extinction)
        # In a thin layer a ray's mean way is of order τ (1 + ln 1/τ): grazing rays go furthest.
        bound = small if what == "albedo" else small * (2 + np.log(1 / small))
        gap = true / found - 1
        off[what].append(np.abs(gap).max())
        assert (gap < bound).all(), (what, factor, gap, bound)
        assert (gap > -1e-7).all(), (what, factor, gap)  # the solver's own error
    assert all(b < a / 5 for a, b in off.values()), off


def bilinear(texture, point):
    """As the maps are read: round in angle, held in radius."""
    rows, columns = texture.shape
    row = np.arctan2(point[:, 1], point[:, 0]) * rows / (2 * np.pi) - 0.5
    column = np.clip(
        (np.hypot(point[:, 0], point[:, 1]) - 1.9) / (5.5 - 1.9) * columns - 0.5, 0, columns - 1
    )
    i, j = np.floor(row).astype(int), np.minimum(column.astype(int), columns - 2)
    u, v = row - i, column - j
    a, b = i % rows, (i + 1) % rows
    near, far = ((1 - v) * texture[k, j] + v * texture[k, j + 1] for k in (a, b))
    return (1 - u) * near + u * far


def brute(iris, maps, point, direction, n=20_000):
    """Radiance of one ray in thin slices, coefficients from each slice's own place."""
    layers = mapped_layers(iris)
    abl0, tau0, sca0 = (
        np.asarray(x) for x in (layers.abl_absorption, layers.extinction, layers.stroma_scattering)
    )
    dz = 0.9 / n
    z = (np.arange(n) + 0.5) * dz
    place = point + direction * (z / direction[2])[:, None]
    a, s = (bilinear(np.asarray(m), place) for m in (maps.abl_depth, maps.stroma_depth))
    last = np.argmax(z > a + s)  # the IPE
    z, place, a = z[:last, None], place[:last], a[:last, None]
    mu_abl = abl0 / 0.06 / 3.2 * (1 + 11 * bilinear(np.asarray(maps.freckles), place)[:, None])
    mu, mu_s = tau0 / 0.35, sca0 / 0.35
    here = np.where(z < a, mu_abl, mu) * dz / direction[2]
    seen = np.exp(-(np.cumsum(here, 0) - here / 2))
    total = 0.0
    for towards, power in zip(
        np.asarray(lamps().towards), np.asarray(lamps().irradiance), strict=True
    ):
        phase = 3 / (16 * np.pi) * (1 + (direction @ towards) ** 2)
        arriving = power * phase * np.exp(-(mu_abl * a + mu * (z - a)) / -towards[2])
        total = total + (np.where(z < a, 0.0, arriving * mu_s) * seen).sum(0) * dz / direction[2]
    return total


def test_marching_converges_to_thin_slices():
    maps = maps_of(abl=0.03, stroma=0.2, freckles=0.2)
    iris = ij.Iris.of_level("low")
    point, direction, inside = rays()
    pick = np.flatnonzero(inside)[5::23]
    true = np.stack([brute(iris, maps, point[i], direction[i]) for i in pick])

    def off(*given, **options):
        return np.sqrt(np.mean((shown(scene(iris, *given, **options))[pick] / true - 1) ** 2))

    # First order, for where a layer ends is known to a step; half of that, for the error of one ray
    # is erratic.
    assert off(maps, n_steps=384) < off(maps, n_steps=12) / 16
    # The uniform iris is not that: it takes the march to get there.
    assert off(maps_of()) > 0.05


def test_lights_add():
    """Each light keeps its own direction; tints colour what each sends."""
    iris = ij.Iris.of_level("low")
    tint = jnp.asarray([[1.0, 0.5, 0.2], [0.3, 1.0, 2.0]])
    both = shown(scene(iris, lights=dataclasses.replace(lamps(), tint=tint)))
    total = 0.0
    for i in range(2):
        one = dataclasses.replace(lamps(), irradiance=lamps().irradiance * (jnp.arange(2) == i))
        total = total + shown(scene(iris, lights=one)) * tint[i]
    np.testing.assert_allclose(both, total, rtol=1e-10)


def test_gradients():
    maps = maps_of(abl=0.06, stroma=0.35, freckles=0.2)  # down to nothing
    iris = ij.Iris.of_level("low")
    stage = spectral(scene(iris, maps))

    def total(eumelanin):
        return stage(iris.replace(eumelanin=eumelanin)).sum()

    slope = float(quick_jit(jax.grad(total))(iris.eumelanin))
    assert np.isfinite(slope)
    change = total(iris.eumelanin + 1e-5) - total(iris.eumelanin - 1e-5)
    assert slope == pytest.approx(float(change) / 2e-5, rel=1e-6)


def test_nothing_scatters_without_stroma():
    iris = ij.Iris.of_level("low").replace(stroma_thickness=0.0)
    assert (shown(scene(iris)) == 0).all()


def test_steps_are_checked():
    with pytest.raises(ValueError, match="n_steps = 0"):
        SingleScattering(0)
