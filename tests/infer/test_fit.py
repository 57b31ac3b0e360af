"""Least squares: truths come back, covariances are those of the Jacobian, and failures are said."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

import irisjax as ij
from irisjax.infer.analytic import BeerLambert, KubelkaMunk, SingleScattering
from irisjax.infer.fit import METHODS, Normal, fit
from irisjax.infer.identifiability import in_words, information
from irisjax.infer.observation import with_values

GRID = ij.wavelengths(400, 700, 10)


def measured(level, process=ij.ILIT_2006):
    return ij.spectrum(GRID, ij.reflectance(ij.Iris.of_level(level), GRID, process=process).values)


@pytest.mark.parametrize("level", ["low", "moderate", "high"])
def test_noiseless_data_give_the_truth_back(level):
    """Maximum likelihood, no priors: every parameter the noiseless spectrum determines, to 1e-6."""
    problem = ij.problem(measured(level))
    found = fit(problem, use_priors=False)
    assert bool(found.ok)
    truth = ij.infer.parameters.of_iris(ij.Iris.of_level(level))
    for name in problem.free:
        if name != "noise":
            assert float(found.values[name]) == pytest.approx(float(truth[name]), rel=1e-6), name
    assert float(found.chi_square) < 1e-10


@pytest.mark.parametrize("method", METHODS)
def test_most_probable_point_is_scipys(method):
    rng = np.random.default_rng(0)
    clean = measured("moderate")
    noisy = with_values(clean, clean.values * (1 + 0.02 * jnp.asarray(rng.normal(size=31))))
    problem = ij.problem(noisy)
    found = fit(problem, method=method)
    moving = [i for i, n in enumerate(problem.free) if n != "noise"]
    residuals = jax.jit(
        lambda x: jnp.concatenate(
            [problem.residuals(jnp.zeros(7).at[jnp.asarray(moving)].set(x)), x]
        )
    )
    other = least_squares(
        lambda x: np.asarray(residuals(x)), np.zeros(6), xtol=1e-12, ftol=1e-14, gtol=1e-12
    )
    assert float(found.cost) == pytest.approx(other.cost, rel=1e-8)
    np.testing.assert_allclose(found.z[jnp.asarray(moving)], other.x, atol=2e-4)
    wanted = np.linalg.inv(other.jac.T @ other.jac)
    np.testing.assert_allclose(
        found.covariance[np.ix_(moving, moving)], wanted, rtol=2e-3, atol=2e-4
    )
    assert int(found.agreeing) >= 3


def test_batches_are_single_fits():
    clean = measured("low")
    problem = ij.problem(clean)
    noise = np.random.default_rng(1).normal(size=(5, 31))
    many = clean.values * (1 + 0.02 * jnp.asarray(noise))
    run = eqx.filter_jit(
        eqx.filter_vmap(
            lambda p, v: fit(p.with_observations(with_values(clean, v)), starts=1),
            in_axes=(None, 0),
        )
    )
    together = run(problem, many)
    assert bool(together.ok.all())
    for i in (0, 4):
        alone = fit(problem.with_observations(with_values(clean, many[i])), starts=1)
        np.testing.assert_allclose(together.z[i], alone.z, atol=1e-4)


def test_normal_equations_solve_least_squares():
    import lineax as lx

    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(9, 4)), rng.normal(size=9)
    found = lx.linear_solve(lx.MatrixLinearOperator(jnp.asarray(a)), jnp.asarray(b), Normal()).value
    np.testing.assert_allclose(found, np.linalg.lstsq(a, b, rcond=None)[0], rtol=1e-10)


def test_ridge_is_found_and_said():
    """Load and fraction correlate at −0.9 or worse; their product is known better than either."""
    problem = ij.problem(measured("moderate"))
    found = information(problem, fit(problem))
    assert found.correlation < -0.9
    values = [d.relative for d in found.directions]
    assert values == sorted(values)
    assert any("load × fraction" in line for line in in_words(found))


@pytest.mark.parametrize(
    ("values", "sd"),
    [
        (np.zeros(31), None),
        (np.full(31, 0.03), None),
        (np.full(31, -0.01), None),
        (np.full(31, 3.0), None),
        (np.linspace(0.05, 0.01, 31), 1e-8),
        (np.linspace(0.05, 0.01, 31), 10.0),
    ],
    ids=["zeros", "constant", "negative", "above one", "noise 1e-8", "noise 10"],
)
def test_odd_data_end_in_numbers_or_a_status(values, sd):
    found = fit(ij.problem(ij.spectrum(GRID, values, sd)))
    assert np.isfinite(found.z).all()
    if bool(found.ok):
        assert np.isfinite(found.covariance).all()
        assert all(np.isfinite(v) for v in found.values.values())
    if sd == 10.0:
        # Nothing learnt: the priors' medians and widths.
        np.testing.assert_allclose(found.z, 0, atol=1e-3)
        np.testing.assert_allclose(np.diag(found.covariance)[:-1], 1, atol=1e-3)


@pytest.mark.parametrize(
    "edge", [{"abl_fraction": 0.0}, {"abl_fraction": 1.0}, {"eumelanin": 0.0, "pheomelanin": 1e-6}]
)
def test_truth_at_an_edge(edge):
    iris = ij.Iris.of_level("low").replace(**edge)
    problem = ij.problem(ij.spectrum(GRID, ij.reflectance(iris, GRID).values))
    found = fit(problem)
    assert bool(found.ok)
    assert float(found.chi_square) < 31
    if "abl_fraction" in edge:
        assert abs(float(found.values["abl_fraction"]) - edge["abl_fraction"]) < 0.5


def test_unknown_method():
    with pytest.raises(ValueError, match="levenberg-marquardt"):
        fit(ij.problem(measured("low")), method="simplex")


ANALYTIC = [BeerLambert(), KubelkaMunk(), SingleScattering()]


@pytest.mark.parametrize("solver", ANALYTIC, ids=lambda s: type(s).__name__)
def test_analytic_models_have_their_limits(solver):
    iris = ij.Iris.of_level("low")
    clear = {
        "eumelanin": 0.0,
        "pheomelanin": 0.0,
        "oxyhemoglobin": 0.0,
        "deoxyhemoglobin": 0.0,
        "lutein": 0.0,
        "zeaxanthin": 0.0,
    }
    for fields in (
        {},
        clear,
        {"eumelanin": 1e3},
        {"stroma_thickness": 0.0},
        {"collagen_index": 1.5},
    ):
        r = ij.reflectance(iris.replace(**fields), GRID, solver=solver)
        values = np.asarray(r.values - r.mirrored)
        assert np.isfinite(values).all()
        assert (values >= 0).all()
        assert (values <= 1).all()
        if fields.get("eumelanin") == 1e3:
            assert values.max() < 1e-6
        if "collagen_index" in fields and not isinstance(solver, BeerLambert):
            assert values.max() < 1e-12  # nothing scatters
    slope = jax.grad(
        lambda c: ij.reflectance(iris.replace(eumelanin=c), GRID, solver=solver).values.sum()
    )(0.1)
    assert float(slope) < 0


def test_kubelka_munk_is_the_two_stream_equations():
    """dI/dx = −(S+K)I + SJ, −dJ/dx = −(S+K)J + SI on black, integrated by scipy."""
    from scipy.integrate import solve_bvp

    k, s = 0.7, 0.4
    layers = ij.Layers.from_coefficients(
        0.0,
        [k / 2],
        [s / 0.75],
        abl_thickness=0.0,
        stroma_thickness=1.0,
        indices=ij.Iris().indices(),
    )
    ode = solve_bvp(
        lambda x, y: np.stack([-(s + k) * y[0] + s * y[1], (s + k) * y[1] - s * y[0]]),
        lambda a, b: np.array([a[0] - 1, b[1]]), np.linspace(0, 1, 21), np.ones((2, 21)), tol=1e-10,
    )  # fmt: skip
    assert float(KubelkaMunk().inner(layers)[0]) == pytest.approx(ode.y[1, 0], rel=1e-8)


def test_single_scattering_of_a_thin_layer():
    """Half of what a thin layer scatters goes up."""
    layers = ij.Layers.from_coefficients(
        0.0, [0.0], [1e-6], abl_thickness=0.0, stroma_thickness=1.0, indices=ij.Iris().indices()
    )
    assert float(SingleScattering().inner(layers)[0]) == pytest.approx(0.5e-6, rel=1e-5)
    assert float(KubelkaMunk().inner(layers)[0]) == pytest.approx(0.75e-6, rel=1e-5)
