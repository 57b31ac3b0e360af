"""Least squares: truths come back, covariances are those of the Jacobian, and failures are said."""

import inspect

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from scipy import stats
from scipy.optimize import least_squares

import irisjax as ij
from irisjax.cli.sentences import information_lines
from irisjax.infer import least_squares as search
from irisjax.infer.fit import FitStatus, _status, fit, words_for
from irisjax.infer.identifiability import information
from irisjax.infer.least_squares import NORMAL_EQUATIONS, levenberg_marquardt
from irisjax.infer.noise import Noise
from irisjax.infer.observation import with_values
from irisjax.infer.parameters import of_iris
from irisjax.transport.solution import raise_failure

GRID = ij.wavelengths(400, 700, 10)
KEY = jax.random.key(0, impl="threefry2x32")


@pytest.fixture(scope="module")
def problem(tabulated):
    """One form of problem, so that two programs serve most tests; the values follow."""
    return ij.problem(ij.spectrum(GRID, np.ones(GRID.size)), solver=tabulated)


@pytest.fixture(scope="module")
def predict(problem):
    """The noiseless spectrum of a vector z."""
    return jax.jit(lambda z: problem.predict(z)[0])


@pytest.fixture(scope="module")
def measured(problem, predict):
    """The problem with the noiseless spectrum of a preset, or of another iris."""

    def of(iris):
        iris = ij.Iris.of_level(iris) if isinstance(iris, str) else iris
        # Just inside the open intervals that the coordinates cover.
        values = {n: np.clip(v, 1e-12, None) for n, v in of_iris(iris).items()}
        for name in ("abl_fraction", "pheomelanin_share"):
            values[name] = np.clip(values[name], 1e-9, 1 - 1e-9)
        return seen(problem, predict(problem.standard(values)))

    return of


def seen(problem, values, noise=None):
    values = jnp.asarray(values, float)
    problem = problem.with_observations(with_values(problem.observations[0], values))
    return problem if noise is None else eqx.tree_at(lambda p: p.noise, problem, noise)


@pytest.mark.parametrize("level", ["low", "moderate", "high"])
def test_noiseless_data_give_the_truth_back(measured, level):
    """Maximum likelihood, no priors: every parameter the noiseless spectrum determines, to 1e-6."""
    problem = measured(level)
    found = fit(problem, use_priors=False, key=KEY)
    assert bool(found.ok)
    truth = of_iris(ij.Iris.of_level(level))
    for name in problem.free:
        if name != "noise":
            assert float(found.values[name]) == pytest.approx(float(truth[name]), rel=1e-6), name
    assert float(found.chi_square) < 1e-10
    assert float(found.p_value) == 1
    assert found.degrees == 25


def test_thirty_irides_of_the_priors_are_all_found(problem, predict):
    """Precise noiseless data: two of these ended at chi-squares of 828 and 105 with status ok, and
    of twelve one start in four had found the truth.
    """
    z = np.zeros((300, 7))
    z[:, :5] = jax.random.normal(jax.random.key(77, impl="threefry2x32"), (300, 5))
    for each in z[105:135]:
        precise = seen(problem, predict(each), Noise(1e-3, 1e-5))
        found = fit(precise, use_priors=False, key=KEY)
        assert bool(found.ok), words_for(found.status)
        assert float(found.chi_square) < 1e-6
        assert int(found.agreeing) >= 2


@pytest.mark.peer
def test_most_probable_point_is_scipys(problem, measured):
    rng = np.random.default_rng(0)
    clean = measured("moderate").observations[0].values
    problem = seen(problem, clean * (1 + 0.02 * jnp.asarray(rng.normal(size=31))))
    found = fit(problem, key=KEY)
    moving = jnp.asarray([i for i, n in enumerate(problem.free) if n != "noise"])

    @jax.jit
    def residuals(x):
        return jnp.concatenate([problem.evaluated(jnp.zeros(7).at[moving].set(x))[0], x])

    tolerances = {"xtol": 1e-12, "ftol": 1e-14, "gtol": 1e-12}
    other = least_squares(lambda x: np.asarray(residuals(x)), np.zeros(6), **tolerances)
    assert bool(found.ok)
    assert int(found.agreeing) >= 3
    assert float(found.cost) == pytest.approx(other.cost, rel=1e-8)
    np.testing.assert_allclose(found.z[moving], other.x, atol=2e-4)
    wanted, fitted = np.linalg.inv(other.jac.T @ other.jac), np.ix_(moving, moving)
    np.testing.assert_allclose(found.covariance[fitted], wanted, rtol=2e-3, atol=2e-4)
    assert found.degrees == 31
    assert float(found.p_value) == pytest.approx(stats.chi2(31).sf(float(found.chi_square)))
    # Another solver, and with it another search.
    gauss_newton = optx.GaussNewton(1e-8, 1e-8, linear_solver=NORMAL_EQUATIONS)
    again = fit(problem, solver=gauss_newton, starts=1)
    assert bool(again.ok)
    np.testing.assert_allclose(again.z, found.z, atol=1e-5)


@pytest.mark.peer
def test_batches_are_single_fits(problem, measured):
    """Several starts, and rounds that some of the batch need and others do not."""
    clean = measured("low").observations[0].values
    noise = np.random.default_rng(1).normal(size=(5, 31))
    many = clean * (1 + 0.02 * jnp.asarray(noise))
    solver = levenberg_marquardt(1e-5, 1e-5)

    def one(problem, values):
        return fit(seen(problem, values), solver=solver, starts=2, key=KEY)

    together = eqx.filter_jit(eqx.filter_vmap(one, in_axes=(None, 0)))(problem, many)
    assert bool(together.ok.all())
    assert together.p_value.shape == (5,)
    for i in (0, 4):
        np.testing.assert_allclose(together.z[i], fit(seen(problem, many[i]), key=KEY).z, atol=1e-3)


def test_normal_equations_solve_least_squares():
    import lineax as lx

    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(9, 4)), rng.normal(size=9)
    operator = lx.MatrixLinearOperator(jnp.asarray(a))
    found = lx.linear_solve(operator, jnp.asarray(b), NORMAL_EQUATIONS).value
    np.testing.assert_allclose(found, np.linalg.lstsq(a, b, rcond=None)[0], rtol=1e-10)


@pytest.mark.peer
def test_ridge_is_found_and_said(measured):
    """Load and fraction correlate at −0.9 or worse; their product is known better than either."""
    problem = measured("moderate")
    best = fit(problem, key=KEY)
    (a, c), (_, b) = best.covariance[:2, :2]
    assert c / np.sqrt(a * b) < -0.9
    found = information(problem, best)
    values = [d.relative for d in found.directions]
    assert values == sorted(values)
    assert any("load × fraction" in line for line in information_lines(found))


@pytest.mark.parametrize("values", [0.0, 0.03, -0.01, 3.0, (1e-8,), (10.0,)], ids=str)
def test_odd_data_end_in_numbers_or_a_status(problem, values):
    """Constants, and a slope with noise that is far too small or too large."""
    noise, useless = Noise(), values == (10.0,)
    if isinstance(values, tuple):
        noise, values = Noise(0.0, *values), np.linspace(0.05, 0.01, 31)
    found = fit(seen(problem, np.broadcast_to(values, 31), noise), key=KEY)
    assert np.isfinite(found.z).all()
    # What no iris makes is said, whatever the search came to.
    assert bool(found.ok) == useless
    if bool(found.converged):
        assert np.isfinite(found.covariance).all()
        assert all(np.isfinite(v) for v in found.values.values())
    if useless:
        # Nothing learnt: the priors' medians and widths.
        np.testing.assert_allclose(found.z, 0, atol=1e-3)
        np.testing.assert_allclose(np.diag(found.covariance)[:-1], 1, atol=1e-3)


@pytest.mark.parametrize(
    "edge", [{"abl_fraction": 0.0}, {"abl_fraction": 1.0}, {"eumelanin": 0.0, "pheomelanin": 1e-6}]
)
def test_truth_at_an_edge(measured, edge):
    found = fit(measured(ij.Iris.of_level("low").replace(**edge)), key=KEY)
    assert bool(found.ok)
    assert float(found.chi_square) < 31
    if "abl_fraction" in edge:
        assert abs(float(found.values["abl_fraction"]) - edge["abl_fraction"]) < 0.5


def test_misfit_is_no_failed_search(problem, measured):
    """A step that no pigment makes: all starts agree, and the data do not fit."""
    clean = measured("low").observations[0].values
    stepped = seen(problem, clean * np.where(GRID < 550, 1.0, 1.6))
    found = fit(stepped, key=KEY)
    assert bool(found.status == FitStatus.misfit)
    assert not bool(found.ok)
    assert bool(found.converged)
    assert float(found.p_value) < 1e-6
    with pytest.raises(ValueError, match="does not produce these data"):
        fit(stepped, key=KEY, throw=True)
    # `throw` raises the same error through this function in a compiled program.
    with pytest.raises(RuntimeError, match="does not produce these data"):
        eqx.filter_jit(raise_failure)(found.z, found.status)


def ended(result=optx.RESULTS.successful, **numbers):
    numbers = {"cost": 0.0, "steps": 5, "searches": 4, "agreeing": 4, "elsewhere": 0} | numbers
    numbers = {name: jnp.asarray(n) for name, n in numbers.items()}
    return search.Minimum(
        jnp.zeros(1), jacobian=jnp.ones((1, 1)), aux=None, result=result, **numbers
    )


LONE = {"agreeing": 1, "elsewhere": 3}
EXHAUSTED = {"result": optx.RESULTS.nonlinear_max_steps_reached, "agreeing": 0, "elsewhere": 3}


@pytest.mark.parametrize(
    ("best", "chi_square", "solved", "wanted"),
    [
        (ended(), 30.0, True, "successful"),
        (ended(agreeing=1), 30.0, True, "successful"),  # nothing else converged: one start, say
        (ended(), 90.0, True, "misfit"),
        (ended(**LONE), 90.0, True, "disagreement"),
        (ended(**EXHAUSTED), 90.0, True, "not_converged"),
        (ended(result=optx.RESULTS.nonlinear_divergence), 30.0, True, "solver_failed"),
        (ended(cost=jnp.inf), 30.0, True, "solver_failed"),
        (ended(), 30.0, False, "solver_failed"),
    ],
)
def test_statuses(best, chi_square, solved, wanted):
    status = _status(best, jnp.asarray(chi_square), 80.0, jnp.asarray(solved))
    assert bool(status == getattr(FitStatus, wanted))
    assert words_for(status) == FitStatus[getattr(FitStatus, wanted)]


def test_rounds_follow_while_starts_disagree():
    """A pit beside a wide basin: where one start of three falls into it, three more follow."""

    def residuals(x, weight, width):
        pit = jnp.exp(-0.5 * ((x - 1.5) / width) ** 2)
        return jnp.concatenate([0.3 * (x + 4), 3 * (1 - pit), weight * x]), None

    @jax.jit
    def run(width):
        return search.least_squares(
            residuals, width, jnp.asarray([-1.0]), weights=jnp.zeros(1), starts=3, rounds=5, max_steps=100, key=KEY,
        )._replace(result=None)  # fmt: skip

    wide, narrow = run(1.0), run(0.5)
    assert (int(wide.searches), int(wide.agreeing)) == (3, 3)
    assert (int(narrow.searches), int(narrow.agreeing), int(narrow.elsewhere)) == (6, 3, 3)
    assert float(narrow.x[0]) == pytest.approx(1.305, abs=1e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "starts=4 draws all but the first at random: give key="),
        ({"solver": "levenberg-marquardt"}, "'levenberg-marquardt': give one of optimistix's"),
        ({"starts": 0}, r"starts = 0 is outside \[1, inf\)"),
        ({"max_steps": 0, "starts": 1}, r"max_steps = 0 is outside \[1, inf\)"),
    ],
)
def test_wrong_searches_are_named(problem, options, message):
    # Unchecked: users run the package without the tests' type checks.
    with pytest.raises(ValueError, match=message):
        inspect.unwrap(fit)(problem, **options)


def test_several_searches_need_a_key():
    with pytest.raises(ValueError, match="starts=4, rounds=1 draw all but the first at random"):
        search.least_squares(lambda x, weight, args: (x, None), None, jnp.zeros(2), starts=4)
