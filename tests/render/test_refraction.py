"""Refraction at the cornea against numpy's rays: entry points, laws, power,
the textbook's pupil.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from irisjax.anatomy.eye import Cornea, Eye
from irisjax.cli.render import missing_light_warning
from irisjax.optics.conicoid import Conicoid
from irisjax.render import refraction
from irisjax.render.illumination import Illumination, reflects_inside
from irisjax.render.lights import Lights
from irisjax.render.refraction import UNIQUE_POLAR, RefractionFunction, find_arrival
from irisjax.render.scene import Scene
from irisjax.tissue.iris import Iris
from render.tracing import disc, soft_edge, towards, trace

DEFAULT, F09 = Eye(), Eye(cornea=Cornea.f09(), aqueous_index=1.376)

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(160)
_R, _ANGLE = 2.75 * (_NODES[:, None] + 1), np.arange(200) * (np.pi / 100)
_POINTS = np.stack([_R * np.cos(_ANGLE), _R * np.sin(_ANGLE)], -1)
_AREAS = 2.75 * _WEIGHTS[:, None] * _R * (np.pi / 100)


@jax.jit
def _search(eye, targets, light):
    """Arrivals by Newton's search; always of 40 targets, so that it is compiled once for each kind
    of eye.
    """
    return jax.vmap(lambda t: find_arrival(eye, t, light, 0.9 * t, 20))(targets)


_look_up, _at = eqx.filter_jit(RefractionFunction.at), eqx.filter_jit(Illumination.at)


@jax.jit
def _entered(eye, k, light):
    """Where rays that enter at points (rays, 2) of the cornea land."""
    rays = refraction.cornea_point(eye.cornea, k), jnp.broadcast_to(-light, (len(k), 3))
    return refraction.refract_to_iris(eye, *rays)


@pytest.fixture(scope="module")
def tables():
    return RefractionFunction.build(DEFAULT)


def test_table_finds_the_entry_points(tables):
    """0.008 mm, a tenth of F09's, wherever light enters through the cornea and lands on the
    iris.
    """
    assert tables.entry.shape == (50, 50, 100, 2)
    rng = np.random.default_rng(1)
    k, _ = disc(5.5, 2000)
    for polar in [*rng.uniform(0, UNIQUE_POLAR, 7), UNIQUE_POLAR]:
        light = towards(polar)
        found = trace(DEFAULT, k, light)
        seen = (found.share > 0) & (np.linalg.norm(found.point[:, :2], axis=1) <= 5.5)
        entry = np.asarray(_look_up(tables, found.point[:, :2], light).entry)
        assert np.linalg.norm(entry - k, axis=1)[seen].max() < 0.008, polar


@pytest.mark.parametrize("eye", [DEFAULT, F09], ids=["default", "f09"])
@pytest.mark.parametrize("polar", [0.0, 0.9, 1.7])
def test_rays_and_shares_are_numpys(eye, polar):
    light = towards(polar)
    k, _ = disc(5.5, 40)
    rays = trace(eye, k, light)
    found = _entered(eye, k, light)
    lit = rays.share > 0
    np.testing.assert_allclose(np.asarray(found.point)[lit], rays.point[lit], atol=1e-10)
    np.testing.assert_allclose(np.asarray(found.direction)[lit], rays.met[-1][2][lit], atol=1e-10)
    np.testing.assert_allclose(np.asarray(found.share), rays.share, atol=1e-12)
    # Every ray let in meets the posterior cornea and then the iris.
    assert rays.inside[lit].all()


def test_rays_from_the_entries_found_land_on_their_targets():
    targets, light = disc(4.5, 40)[0], towards(0.9)
    entry = np.asarray(_search(F09, jnp.asarray(targets), jnp.asarray(light)).entry)
    np.testing.assert_allclose(trace(F09, entry, light).point[:, :2], targets, atol=1e-9)


@pytest.mark.parametrize(("depth", "textbook"), [(3.6, 1.131), (3.0, 1.107)])
def test_paraxial_magnification_of_the_pupil(depth, textbook):
    """One surface of index 1.336 magnifies what lies behind it by 1 / (1 − depth (n − 1) / (n
    R)).
    """
    eye = F09.replace(iris_depth=depth, aqueous_index=1.336)
    light = jnp.asarray([0.0, 0.0, -1.0])
    # A camera far away on the axis sees the pupil's edge where a ray parallel to the axis enters.
    targets = jnp.asarray(np.linspace(1e-3, 2e-3, 40)[:, None] * [1.0, 0.0])
    entry = _search(eye, targets, light).entry
    exact = 1 / (1 - depth * 0.336 / (1.336 * 7.8))
    assert exact == pytest.approx(textbook, abs=5e-4)
    found = np.asarray(entry)[:, 0] / np.asarray(targets)[:, 0]
    np.testing.assert_allclose(found, exact, rtol=1e-6)


def let_in(polar, count=50_000):
    """Where rays over the cornea and its soft edge land, and the power of each, by numpy alone."""
    k, area = disc(5.65, count)
    rays = trace(DEFAULT, k, towards(polar))
    assert np.isfinite(rays.power).all()
    power = rays.power * soft_edge(np.linalg.norm(k, axis=1), 5.5) * area
    return rays.point[:, :2], power


@pytest.fixture(scope="module")
def illumination(tables):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RefractionFunction, "build", lambda eye, *size: tables)  # made once for both
        return Illumination.build(DEFAULT, n_rays=32_768)


@pytest.mark.parametrize("polar", [0.0, UNIQUE_POLAR, 1.7])
def test_power_is_kept_and_lands_where_numpys_rays_do(illumination, polar):
    """Of searched rays, and of counted ones beyond `UNIQUE_POLAR`."""
    landed, power = let_in(polar)
    on_iris = np.linalg.norm(landed, axis=1) < 5.5
    found = np.asarray(_at(illumination, _POINTS, towards(polar))[..., 2]) * _AREAS
    assert found.sum() == pytest.approx(power[on_iris].sum(), abs=1e-3 * power.sum())
    middle = np.einsum("ra,rak->k", found, _POINTS) / found.sum()
    np.testing.assert_allclose(middle, np.average(landed[on_iris], 0, power[on_iris]), atol=0.01)


def test_shadow_of_the_limbus_has_its_edge(illumination):
    """Irradiance in patches of 0.75 mm on the iris, 2 % r.m.s. of each that has a twentieth of the
    mean, from rays traced by numpy; between tabulated angles a shadow would be smeared.
    """
    polar, count, side = np.radians(75), 14, 0.75
    landed, power = let_in(polar, 200_000)
    edges = (np.arange(count + 1) - count / 2) * side
    landed = np.histogram2d(*landed.T, bins=edges, weights=power)[0] / side**2
    fine = np.arange(count * 10) / 10 + 0.05
    points = (np.stack(np.meshgrid(fine, fine, indexing="ij"), -1) - count / 2) * side
    found = np.asarray(_at(illumination, points, towards(polar))[..., 2])
    found = found.reshape(count, 10, count, 10).mean((1, 3))
    far = np.maximum(np.abs(edges[1:]), np.abs(edges[:-1]))
    on_iris = np.hypot(far[:, None], far) < 5.5
    lit = on_iris & (landed > 0.05 * landed[on_iris].mean())
    off = found[lit] / landed[lit] - 1
    assert lit.sum() > 80 and np.sqrt((off**2).mean()) < 0.02


def test_the_rim_is_as_bright_as_its_surroundings(illumination, tables):
    """Of searched rays."""
    light = towards(0.7)
    points = np.stack([-np.linspace(5.3, 5.495, 2000), np.zeros(2000)], -1)
    found = _look_up(tables, points, light)
    window = soft_edge(np.linalg.norm(found.entry, axis=1), 5.5)
    exact = window[:, None] * np.asarray(found.flux)
    np.testing.assert_allclose(_at(illumination, points, light), exact, rtol=0.02, atol=1e-3)


def test_counted_rays_light_the_rim_to_its_edge(illumination):
    """By light from 109°: the edge cells, which reach beyond the iris, must hold all of it."""
    landed, power = let_in(1.9, 200_000)
    inner, outer, half = -5.41, -5.49, 0.8
    x, y = landed.T
    met = (x < inner) & (x > outer) & (np.abs(y) < half)
    true = power[met].sum() / (2 * half * (inner - outer))
    line = np.linspace(-1, 1, 41)
    points = np.stack(np.meshgrid((inner + outer + 0.08 * line) / 2, half * line), -1)
    found = np.asarray(_at(illumination, points, towards(1.9))[..., 2]).mean()
    assert found == pytest.approx(true, rel=0.05)


def test_light_has_its_derivative_by_the_angle_at_tabulated_angles_too():
    """Between those of both sides: flux of a table whose layers rise by more and more."""
    rows = jnp.broadcast_to(jnp.arange(60.0)[:, None, None, None] ** 2, (60, 3, 3, 3))
    table, middle = Illumination(rows, jnp.asarray(5.5), 2.0), jnp.zeros(2)

    def flux(polar):
        light = jnp.stack([jnp.sin(polar), jnp.zeros_like(polar), -jnp.cos(polar)])
        return table.at(middle, light)[2]

    polar, step = 0.05 * np.arange(4, 20), 1e-4
    values = jax.jit(jax.vmap(jax.value_and_grad(flux)))
    (now, slope), (later, _), (earlier, _) = (values(polar + s) for s in (0, step, -step))
    before, after = (now - earlier) / step, (later - now) / step
    assert ((0.999 * before < slope) & (slope < 1.001 * after)).all()


def test_light_from_behind_fades_out(illumination):
    without = Illumination(illumination.flux[:53], illumination.extent, UNIQUE_POLAR)
    for tables, largest in ((without, 1.40), (illumination, 2.25)):
        lights = map(towards, (largest, largest + 0.025, largest + 0.051, 3.1))
        at = [np.abs(_at(tables, np.zeros(2), d)).max() for d in lights]
        assert at[0] >= at[1] >= at[2] == at[3] == 0


@pytest.mark.peer
def test_single_precision(float32):
    k, _ = disc(5.4, 40)
    eye = Eye()
    for polar in (0.5, 1.3):
        rays = trace(DEFAULT, k, towards(polar))
        seen = (rays.share > 0) & (np.linalg.norm(rays.point[:, :2], axis=1) < 5.4)
        found = _search(eye, jnp.asarray(rays.point[:, :2]), jnp.asarray(towards(polar)))
        assert found.flux.dtype == jnp.float32
        assert np.linalg.norm(np.asarray(found.entry) - k, axis=1)[seen].max() < 1e-4


@pytest.mark.parametrize(
    ("cornea", "limbus", "said"),
    [
        (Cornea.f09(), 5.5, False),  # none of 2.2 million rays traced apart from this package
        (Cornea(), 5.5, False),
        (Cornea.f09(), 6.5, True),
        (Cornea(Conicoid(7.8, 1.0), posterior=None), 5.5, True),  # L03's
    ],
)
def test_light_reflected_inside_the_cornea_is_noticed(cornea, limbus, said):
    eye = Eye(cornea=cornea, aqueous_index=1.376, limbus_radius=limbus, sclera=None)
    assert reflects_inside(eye) == said
    for polar in (0.5, 2.0):
        scene = Scene(Iris(), eye=eye, lights=Lights.distant(polar, 0.0))
        assert (missing_light_warning(scene) is not None) == (said and polar > UNIQUE_POLAR)
