"""The weighted estimator of radiative transfer against the exact solver, and what it promises."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import common
import irisjax as ij
from common import any_order, heavily, layers, quick_jit

IRIS = (1.336, 1.4733333333, 1.4727930095, 1.5)
MEDIA = {
    "iris": IRIS,
    "matched": (1.4, 1.4, 1.4, 1.4),
    "reversed": (1.5, 1.45, 1.4, 1.336),
    "guided": (1.336, 1.4, 1.6, 1.3),
}
EXITS = np.array([1.0, 0.9, 0.6, 0.6, 0.3, 0.05])
AZIMUTH = np.array([0.0, 0.4, np.pi, 2.0, 1.0, 0.0])
FEW = ij.RadiativeWeighted(1024)
KEY = jax.random.key(2)


def shares(s):
    return np.stack([s.reflectance, s.mirrored, s.absorbed.abl, s.absorbed.stroma, s.absorbed.ipe])


@quick_jit
def _sampled(made, cosine, key):
    exits = {"cos_exit": jnp.asarray(EXITS), "azimuth": jnp.asarray(AZIMUTH)}
    return FEW.solve(made, ij.DEPTH_RESOLVED, cosine, key=key, **exits)


def sampled(made, cosine, key=KEY):
    """One program for all of this file's nine depths."""
    assert made.extinction.size == 9
    return _sampled(any_order(made), jnp.asarray(cosine), key)


def exactly(made, cosine, solver=None):
    """By the exact solver, one program for every order of media."""
    made = any_order(made)
    return common.solve(ij.DEPTH_RESOLVED, made, cosine, solver, EXITS, AZIMUTH)


def of_levels():
    """Three levels at three wavelengths, as one set of layers."""
    grid = ij.extinction(np.array([420.0, 550.0, 700.0]))
    each = [ij.Iris.of_level(v).layers(grid) for v in ("low", "moderate", "high")]
    names = ("abl_absorption", "stroma_absorption", "stroma_scattering")
    abl, absorption, scattering = (
        np.concatenate([getattr(made, n) for made in each]) for n in names
    )
    return layers(abl, absorption, scattering, [float(n) for n in jax.tree.leaves(each[0].indices)])


def nine(abl, absorption, scattering, media):
    """Of three depths nine, three times the same."""
    return layers(np.tile(abl, 3), np.tile(absorption, 3), np.tile(scattering, 3), media)


def compare(found, exact):
    """9 and 54 comparisons: |z| < 4 fails by chance once in 250 runs of other seeds."""

    def z(value, expected, error):
        # Where nothing is drawn there is no error but single precision's.
        return np.abs(value - expected) / (error + 1e-6 * np.abs(expected) + 1e-30)

    assert z(found.reflectance, exact.reflectance, found.standard_error).max() < 4
    assert z(found.brdf, exact.brdf, found.brdf_error).max() < 4
    np.testing.assert_allclose(found.mirrored, exact.mirrored, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(found.energy, 1, rtol=0, atol=3e-6)


@pytest.mark.parametrize("cosine", [1.0, 0.6, 0.1])
def test_agrees_with_exact(cosine):
    made = of_levels()
    exact = exactly(made, cosine)
    found = sampled(made, cosine)
    compare(found, exact)
    assert np.abs(shares(found) - shares(exact)).max() < 0.01
    assert (found.brdf_error < 0.03 * exact.brdf).all()
    # An analogue photon has p(1 − p).
    assert (found.standard_error**2 < 0.1 * exact.reflectance / 1024).all()


@pytest.mark.parametrize("media", [pytest.param(v, id=k) for k, v in MEDIA.items()])
@pytest.mark.parametrize("cosine", [0.7, heavily(1e-3)])
def test_any_indices(media, cosine):
    made = nine([0.02, 0.3, 0.0], [0.05, 0.0, 1.5], [0.2, 2.5, 0.3], media=media)
    compare(
        sampled(made, cosine),
        exactly(made, cosine),
    )


@pytest.mark.parametrize("cosine", [1.0, heavily(1e-6), heavily(0.0)])
def test_limits(cosine):
    """Nothing at all, no scattering, no absorption, a film, next to no light left."""
    scattering = [0.0, 0.0, 1.0, 1e-12, 1e-12, 0.1, 0.5, 3.0, 1e-3]
    absorption = [0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 30.0, 1e-12]
    made = layers([0.0, 0.1, 0.0, 0.0, 0.0, 0.3, 50.0, 0.0, 0.0], absorption, scattering, IRIS)
    found = sampled(made, cosine)
    exact = ij.RadiativeExact(n_panels=3)
    compare(found, exactly(made, cosine, exact))
    assert bool(found.status == ij.RESULTS.successful)
    black = np.asarray(scattering) == 0
    assert (found.brdf[black] == 0).all()
    assert (found.standard_error[black] == 0).all()
    assert (found.absorbed.stroma[np.asarray(absorption) == 0] == 0).all()


@pytest.mark.heavy
def test_thick():
    """Depth 1e4: as bright as depth 30, and nothing reaches the floor."""
    albedo = np.linspace(0.1, 0.9, 9)
    found, exact = (
        run(layers(0.0, depth * (1 - albedo), depth * albedo, IRIS))
        for run, depth in (
            (lambda made: sampled(made, 0.8), 1e4),
            (lambda made: exactly(made, 0.8), 60.0),
        )
    )
    compare(found, exact)
    assert found.absorbed.ipe.max() < 1e-12


def test_errors_are_honest():
    """z-scores of independent runs have a variance of one."""
    made = of_levels()
    exact = exactly(made, 0.6)
    keys = jax.random.split(jax.random.key(7), 40)
    runs = [sampled(made, 0.6, key) for key in keys]
    for name, error in (("reflectance", "standard_error"), ("brdf", "brdf_error")):
        expected = getattr(exact, name)
        z = np.stack([(getattr(r, name) - expected) / getattr(r, error) for r in runs])
        # Wavelengths are independent; the exits of one are not.
        z = z.reshape(40, 9, -1)
        assert np.abs(z.mean((0, 1))).max() < 4 / np.sqrt(360)
        assert np.abs((z**2).mean((0, 1)) - 1).max() < 4 * np.sqrt(2 / 360)


def _diffuse(solver):
    return quick_jit(lambda made: solver.solve(made, ij.DEPTH_RESOLVED, ij.DIFFUSE, key=KEY))


@pytest.mark.heavy
def test_diffuse_light():
    made = of_levels()
    exact = _diffuse(ij.RadiativeExact())(any_order(made))
    found = _diffuse(FEW)(any_order(made))
    z = (found.reflectance - exact.reflectance) / found.standard_error
    assert np.abs(z).max() < 4
    np.testing.assert_allclose(found.energy, 1, rtol=0, atol=3e-6)


@pytest.mark.slow
def test_single_precision(float32):
    made = of_levels()
    found = sampled(made, 0.6)
    assert found.reflectance.dtype == found.brdf_error.dtype == jnp.float32
    compare(found, exactly(made, 0.6))


def _moved(solver, made, key, x):
    """Shares and BRDF as functions of depths, incidence and exits."""
    made = type(made)(*x[:3], indices=made.indices, order=made.order)
    exits = {"cos_exit": x[4][None], "azimuth": x[5][None]}
    s = solver.solve(made, ij.DEPTH_RESOLVED, x[3], key=key, **exits)
    return jnp.stack(
        [s.reflectance, s.absorbed.abl, s.absorbed.stroma, s.absorbed.ipe, s.brdf[:, 0]]
    )


@pytest.mark.slow
def test_derivatives_are_unbiased():
    made = any_order(layers([0.02, 0.3], [0.05, 0.4], [0.2, 1.5], IRIS))
    depths = made.abl_absorption, made.stroma_absorption, made.stroma_scattering
    x = (*depths, jnp.asarray(0.7), jnp.asarray(0.4), jnp.asarray(1.0))

    def slopes(solver, key):
        def along(i):
            d = tuple(jnp.where(i == k, jnp.ones_like(v), 0.0) for k, v in enumerate(x))
            return jax.jvp(lambda x: _moved(solver, made, key, x), (x,), (d,))[1]

        return jax.vmap(along)(jnp.arange(len(x)))

    exact = quick_jit(lambda: slopes(ij.RadiativeExact(), None))()
    run = quick_jit(lambda key: slopes(FEW, key))
    runs = np.stack([run(key) for key in jax.random.split(jax.random.key(3), 24)])
    error = runs.std(0, ddof=1) / np.sqrt(len(runs))
    # 60 derivatives, many of them zero by either: |z| < 5 by Student's law.
    assert (np.abs(runs.mean(0) - exact) < 5 * error + 1e-6).all()
    assert (error.max((1, 2)) < 0.02 * np.abs(exact).max((1, 2))).all()


@pytest.mark.slow
def test_reverse_mode_is_forward_mode():
    made = any_order(layers([0.02, 0.3], [0.05, 0.4], [0.2, 1.5], IRIS))
    few = ij.RadiativeWeighted(16)

    def value(x):
        n = ij.RefractiveIndices(*x[:4])
        moved = type(made)(*(x[4] * d for d in _depths(made)), indices=n, order=made.order)
        s = few.solve(moved, ij.DEPTH_RESOLVED, x[5], cos_exit=jnp.full(1, 0.5), key=KEY)
        assert s.brdf is not None
        return s.brdf.sum() + s.reflectance.sum()

    x = (*(jnp.asarray(n) for n in IRIS), jnp.asarray(1.0), jnp.asarray(0.7))
    reverse, forward = (quick_jit(f(value))(x) for f in (jax.grad, jax.jacfwd))
    np.testing.assert_allclose(reverse, forward, rtol=1e-5)


def _depths(made):
    return made.abl_absorption, made.stroma_absorption, made.stroma_scattering


def test_equal_keys_give_equal_bytes():
    made = of_levels()
    a, b, c = (sampled(made, 0.6, jax.random.key(s)) for s in (7, 7, 8))
    assert np.asarray(a.brdf).tobytes() == np.asarray(b.brdf).tobytes()
    assert (np.asarray(a.brdf) != np.asarray(c.brdf)).all()


@pytest.mark.slow
def test_batches_and_meshes_do_not_change_a_packet():
    made = any_order(layers(0.1, 0.1, np.array([0.5, 2.0]), IRIS))

    def run(made, mesh=None):
        solver = ij.RadiativeWeighted(200, mesh=mesh)
        return solver.solve(made, ij.DEPTH_RESOLVED, jnp.asarray(0.6), key=KEY).reflectance

    alone = quick_jit(run)(made)
    dealt = quick_jit(lambda made: run(made, ij.photon_mesh()))(made)
    batch = quick_jit(jax.vmap(run))(jax.tree.map(lambda x: jnp.stack([x, x]), made))
    # Other packets would be 1e-2 away; programs round sums of the same ones each in their way.
    for other in (dealt, batch[1]):
        np.testing.assert_allclose(alone, other, rtol=1e-6)


@pytest.mark.heavy
def test_packets_follow_the_illuminant():
    made, n = any_order(layers(0.0, 0.1, np.full(2, 0.5), IRIS)), 8192
    rays = jnp.asarray([1.0, 0.125])
    run = quick_jit(
        lambda: ij.RadiativeWeighted(n).solve(
            made, ij.DEPTH_RESOLVED, jnp.asarray(0.6), key=KEY, rays=rays
        )
    )
    error = run().standard_error
    assert error[1] / error[0] == pytest.approx(np.sqrt(8), rel=0.2)


def test_invalid_layers_end_at_once():
    made = of_levels()
    abl, absorption, scattering = (jnp.nan * d for d in _depths(made))
    broken = type(made)(abl, absorption, scattering, made.indices, made.order)
    assert bool(sampled(broken, 1.0).status == ij.RESULTS.invalid_input)


def test_what_is_not_offered_is_said():
    iris, grid, rt = ij.Iris(), [500.0], ij.DEPTH_RESOLVED
    with pytest.raises(ValueError, match="needs a key"):
        ij.reflectance(iris, grid, solver=FEW, process=rt)
    with pytest.raises(ValueError, match="treats RadiativeTransfer processes, not Ilit"):
        ij.reflectance(iris, grid, solver=FEW, key=KEY)
    with pytest.raises(ValueError, match="from one direction, not diffuse"):
        FEW.solve(of_levels(), rt, ij.DIFFUSE, cos_exit=jnp.ones(1), key=KEY)
    with pytest.raises(Exception, match="n_packets = 0 is outside"):
        ij.RadiativeWeighted(0)
