"""The weighted estimator of radiative transfer against the exact solver, and what it promises."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import any_order, heavily, layers, quick_jit, solve

IRIS = (1.336, 1.4733333333, 1.4727930095, 1.5)
MEDIA = {
    "iris": IRIS,
    "matched": (1.4, 1.4, 1.4, 1.4),
    "reversed": (1.5, 1.45, 1.4, 1.336),
    "guided": (1.336, 1.4, 1.6, 1.3),
}
EXITS = np.array([1.0, 0.9, 0.6, 0.6, 0.3, 0.05])
AZIMUTH = np.array([0.0, 0.4, np.pi, 2.0, 1.0, 0.0])
GRID = (420.0, 550.0, 700.0)
FEW = ij.RadiativeWeighted(16_384)


def shares(s):
    return np.stack([s.reflectance, s.mirrored, s.absorbed.abl, s.absorbed.stroma, s.absorbed.ipe])


def sampler(solver, where=None):
    """Of layers, incidence, exits and a key; compiled once."""

    def run(made, cosine, exits, azimuth, key):
        options = {} if exits is None else {"cos_exit": exits, "azimuth": azimuth}
        return solver.solve(
            made, ij.DEPTH_RESOLVED, cosine if where is None else where, key=key, **options
        )

    return quick_jit(run)


@pytest.fixture(scope="module")
def at_exits():
    return sampler(FEW)


def of_levels():
    """Three levels at three wavelengths, as one set of layers."""
    each = [ij.Iris.of_level(v).layers(ij.extinction(np.array(GRID))) for v in ("low", "high")]
    each.append(ij.Iris.of_level("moderate").layers(ij.extinction(np.array(GRID))))
    names = ("abl_absorption", "stroma_absorption", "stroma_scattering")
    depths = [np.concatenate([getattr(made, n) for made in each]) for n in names]
    return layers(*depths, [float(n) for n in jax.tree.leaves(each[0].indices)])


def z_scores(found, exact, error):
    return np.asarray((found - exact) / np.where(error > 0, error, 1e-6))


@pytest.mark.parametrize("cosine", [1.0, 0.6, heavily(0.1)])
def test_agrees_with_exact(at_exits, cosine):
    made = of_levels()
    exact = solve(ij.DEPTH_RESOLVED, made, cosine, exits=EXITS, azimuth=AZIMUTH)
    where = jnp.asarray(cosine), jnp.asarray(EXITS), jnp.asarray(AZIMUTH)
    found = at_exits(any_order(made), *where, jax.random.key(3))
    # 9 and 54 comparisons: |z| < 4 fails by chance once in 250 runs of other seeds.
    assert np.abs(z_scores(found.reflectance, exact.reflectance, found.standard_error)).max() < 4
    z = z_scores(found.brdf, exact.brdf, found.brdf_error)
    assert np.abs(z).max() < 4
    np.testing.assert_allclose(found.mirrored, exact.mirrored, rtol=1e-6)
    np.testing.assert_allclose(found.energy, 1, atol=2e-6)
    # Light absorbed is what is left of the rest: errors of the same size.
    assert np.abs(shares(found) - shares(exact)).max() < 8 * found.standard_error.max()
    assert (found.brdf_error < 0.02 * exact.brdf).all()


@pytest.mark.parametrize("media", [pytest.param(v, id=k) for k, v in MEDIA.items()])
@pytest.mark.parametrize("cosine", [0.7, heavily(1e-3)])
def test_any_indices(at_exits, media, cosine):
    made = layers([0.02, 0.3, 0.0], [0.05, 0.0, 1.5], [0.2, 2.5, 0.3], media)
    exact = solve(ij.DEPTH_RESOLVED, made, cosine, exits=EXITS, azimuth=AZIMUTH)
    where = jnp.asarray(cosine), jnp.asarray(EXITS), jnp.asarray(AZIMUTH)
    found = at_exits(any_order(made), *where, jax.random.key(0))
    assert np.abs(z_scores(found.reflectance, exact.reflectance, found.standard_error)).max() < 4
    assert np.abs(z_scores(found.brdf, exact.brdf, found.brdf_error)).max() < 4
    np.testing.assert_allclose(found.energy, 1, atol=2e-6)
