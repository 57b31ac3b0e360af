"""Noise and the likelihood: against scipy, limits, and each other."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import irisjax as ij
from common import quick_jit
from experiments.closed_formulas import BeerLambert
from irisjax.infer.fit import fit
from irisjax.infer.noise import Noise
from irisjax.infer.parameters import PARAMETERS
from irisjax.infer.priors import LogNormal, Uniform
from irisjax.infer.problem import pointwise
from irisjax.numerics import chunks
from irisjax.tissue.scattering import POWER_LAW_LIMITS
from irisjax.transport.solution import RESULTS

GRID = ij.wavelengths(400, 700, 20)


CLOSED = BeerLambert()


def stated(noise=None, solver=CLOSED, **options):
    """A problem by a closed formula, which is enough for noise, or by transport."""
    seen = ij.spectrum(GRID, np.linspace(0.02, 0.01, GRID.size))
    return ij.problem(seen, noise=noise, solver=solver, **options)


@eqx.filter_jit
def evaluated(problem, z):
    """The spectrum, the factor of the noise, log likelihood and log prior."""
    rest = problem.values(z)["noise"], problem.log_likelihood(z), problem.log_prior(z)
    return problem.predict(z)[0], *rest


@pytest.mark.peer
def test_prediction_is_the_spectrophotometer():
    """At the values of an iris it is `reflectance` times the gain; a radiance is `radiance`."""
    iris, how = ij.Iris.of_level("high"), {"solver": ij.IlitExact(16)}
    known = {"fixed": {"abl_fraction": 0.3}, "base": iris}
    problem = stated(free=["melanin_load", "gain"], **known, **how)
    z = problem.standard({"melanin_load": 0.2, "gain": 1.02})
    wanted = ij.reflectance(iris.replace(melanin_load=0.2, abl_fraction=0.3), GRID, **how)
    np.testing.assert_allclose(problem.predict(z)[0], 1.02 * wanted.values, rtol=1e-12)
    options = {"illuminant": "A", "cos_incidence": 0.8}
    seen = ij.spectrum(GRID, np.ones(GRID.size), quantity="radiance", **options)
    problem = ij.problem(seen, free=["gain"], base=iris, **how)
    wanted = ij.radiance(iris, GRID, **how, **options)
    np.testing.assert_allclose(problem.predict(jnp.zeros(1))[0], wanted.values, rtol=1e-12)


@pytest.mark.peer
@pytest.mark.parametrize("quantity", ["XYZ", "Lab", "linear sRGB"])
def test_colours_are_those_of_the_colorimeter(quantity):
    iris = ij.Iris.of_level("low")
    seen = ij.colour_data([0.1, 0.1, 0.1], np.eye(3) * 1e-4, quantity=quantity)
    problem = ij.problem(seen, free=["melanin_load"], base=iris, solver=ij.IlitExact(16))
    colour = ij.colour(iris, seen.wavelengths, solver=ij.IlitExact(16))
    wanted = {"XYZ": colour.xyz, "Lab": colour.lab, "linear sRGB": colour.srgb_linear}[quantity]
    found = problem.predict(problem.standard({"melanin_load": float(iris.melanin_load)}))[0]
    np.testing.assert_allclose(found, wanted, rtol=1e-9)


@pytest.mark.parametrize(
    ("degrees_of_freedom", "distribution"), [(None, stats.norm), (4.0, partial(stats.t, 4))]
)
def test_likelihood_is_scipys(degrees_of_freedom, distribution):
    noise = Noise(0.03, 1e-3, degrees_of_freedom=degrees_of_freedom)
    problem, z = stated(noise), np.random.default_rng(1).normal(size=7) * 0.3
    m, factor, likelihood, prior = evaluated(problem, z)
    sd = float(factor) * np.hypot(0.03 * np.asarray(m), 1e-3)
    wanted = distribution(m, sd).logpdf(problem.observations[0].values).sum()
    assert float(likelihood) == pytest.approx(wanted, rel=1e-10)
    assert float(prior) == pytest.approx(stats.norm.logpdf(z).sum())


def test_correlated_residuals_are_whitened():
    """More wavelengths than a block of the matrix's root: densities and squares are those of
    scipy.
    """
    count, rng = 41, np.random.default_rng(0)
    grid = np.linspace(400, 700, count)
    model, noise = 0.02 + 0.01 * rng.random(count), Noise(0.03, 1e-3, 0.05, 60.0)
    seen = ij.spectrum(grid, model * (1 + 0.03 * rng.normal(size=count)))

    def covariance(m, factor=1.0):
        smooth = 0.05**2 * np.outer(m, m) * np.exp(-0.5 * ((grid[:, None] - grid) / 60) ** 2)
        return np.diag(factor**2 * ((0.03 * m) ** 2 + 1e-6)) + smooth

    values = np.asarray(seen.values)
    both = quick_jit(lambda m: (noise.pointwise(seen, m, 1.3).sum(), noise.whiten(seen, m)))
    density, white = both(model)
    wanted = stats.multivariate_normal(model, covariance(model, 1.3)).logpdf(values)
    assert float(density) == pytest.approx(wanted, rel=1e-10)
    square = (values - model) @ np.linalg.solve(covariance(values), values - model)
    assert (np.asarray(white) ** 2).sum() == pytest.approx(square, rel=1e-10)


def test_colour_likelihood_is_scipys():
    c = np.array([[2.0, 0.5, 0.1], [0.5, 1.0, -0.2], [0.1, -0.2, 0.5]]) * 1e-4
    seen = ij.colour_data([0.02, 0.02, 0.03], c)
    problem = ij.problem(seen, free=["melanin_load"], solver=BeerLambert())
    model, _, found, _ = evaluated(problem, np.zeros(1))
    wanted = stats.multivariate_normal(np.asarray(model), c).logpdf([0.02, 0.02, 0.03])
    assert float(found) == pytest.approx(wanted, rel=1e-10)


def test_a_stated_covariance_is_the_likelihoods():
    """In the file's order of wavelengths, and times the free factor of the noise."""
    rng = np.random.default_rng(2)
    order, root = rng.permutation(GRID.size), rng.normal(size=(GRID.size, 2 * GRID.size))
    c = 1e-8 * root @ root.T
    y = 0.02 + 1e-3 * rng.normal(size=GRID.size)
    seen = ij.spectrum(GRID[order], y[order], covariance=c[np.ix_(order, order)])
    problem = ij.problem(seen, free=["gain", "noise"], solver=BeerLambert())
    z = problem.standard({"gain": 1.01, "noise": 1.3})
    model, _, found, _ = evaluated(problem, z)
    wanted = stats.multivariate_normal(np.asarray(model), 1.3**2 * c).logpdf(y)
    assert float(found) == pytest.approx(wanted, rel=1e-9)
    np.testing.assert_allclose(seen.sd, np.sqrt(np.diag(c)))


def test_a_moving_average_correlates_what_it_averages():
    grid = np.arange(500.0, 520, 1)
    seen = ij.spectrum(grid, np.full(20, 0.02), boxcar=5.0)
    white = np.random.default_rng(0).normal(size=(20_000, 24))
    means = np.stack([white[:, i : i + 5].mean(1) for i in range(20)], 1)
    root = np.asarray(seen.correlation_root)
    np.testing.assert_allclose(root @ root.T, np.corrcoef(means.T), atol=0.04)
    assert seen.instrument.bands is not None
    with pytest.raises(ValueError, match="correlated errors and Student's t"):
        ij.problem(seen, noise=Noise(degrees_of_freedom=4.0), solver=BeerLambert())


def test_a_slit_averages_the_light():
    """The expected values are integrals over the slit, from which light of single wavelengths is up
    to 18 % off.
    """
    fine, blank = np.arange(350.0, 801, 1), ij.spectrum(GRID, np.ones(GRID.size), bands=20.0)
    problem = ij.problem(blank, free=["hemoglobin"], solver=CLOSED)
    found, *_ = evaluated(problem, problem.standard({"hemoglobin": 0.2}))
    iris = ij.Iris().replace(oxyhemoglobin=0.1, deoxyhemoglobin=0.1)
    spectrum = np.asarray(ij.reflectance(iris, fine, solver=CLOSED).values)
    passed = np.exp(-4 * np.log(2) * ((fine - GRID[:, None]) / 20) ** 2)
    np.testing.assert_allclose(found, (passed @ spectrum) / passed.sum(1), rtol=4e-3)


@pytest.mark.peer
def test_draws_have_the_stated_moments():
    keys, z = jax.random.split(jax.random.key(0), 20_000), jnp.zeros(1)
    for more in ({"discrepancy": 0.05, "length": 60.0}, {}, {"degrees_of_freedom": 6.0}):
        noise = Noise(0.03, 1e-3, **more)
        problem = stated(noise, free=["gain"])
        draws = quick_jit(jax.vmap(lambda k, p=problem: p.simulate(z, k)[0]))(keys)
        m = np.asarray(problem.predict(z)[0])
        variance = (0.03 * m) ** 2 + 1e-6
        if noise.discrepancy is not None:
            variance = variance + (0.05 * m) ** 2
        if noise.degrees_of_freedom is not None:
            variance = variance * 6 / 4
        error = np.sqrt(variance / 20_000)
        assert np.abs((np.asarray(draws).mean(0) - m) / error).max() < 4.5
        np.testing.assert_allclose(np.asarray(draws).var(0), variance, rtol=0.1)


def test_slopes_agree_with_differences():
    """The rule that wavelengths do not mix: forward, reverse, and a difference of the model."""
    free = [name for name in PARAMETERS if name not in POWER_LAW_LIMITS]
    problem = ij.problem(ij.spectrum(GRID, np.linspace(0.02, 0.01, GRID.size)), free=free)
    z = jnp.asarray(np.random.default_rng(3).normal(size=10) * 0.3)

    def residuals(x):
        found = problem.evaluated(x)[0]
        return found, found

    forward = quick_jit(jax.jacfwd(residuals, has_aux=True))
    h, steps = 1e-4, 1e-4 * np.eye(10)
    slopes = forward(z)[0]
    reverse = quick_jit(jax.jacrev(lambda x: residuals(x)[0]))(z)
    np.testing.assert_allclose(slopes, reverse, rtol=1e-9, atol=1e-10)
    difference = [np.asarray(forward(z + s)[1] - forward(z - s)[1]) / (2 * h) for s in steps]
    bound = 1e-5 * np.abs(slopes).max()
    np.testing.assert_allclose(slopes, np.transpose(difference), rtol=1e-4, atol=bound)


SCALE = "scattering_scale"
FEW = ij.wavelengths(410, 690, 40)


def by_transfer(seen, iris, *free, **how):
    """A problem by radiative transfer."""
    free = "melanin_load", "hemoglobin", *free
    return ij.problem(seen, base=iris, free=free, process=ij.DEPTH_RESOLVED, **how)


def predicted(problem, values):
    return _predicted(problem.unnamed(), {n: np.asarray(v) for n, v in values.items()})


@eqx.filter_jit
def _predicted(problem, values):
    _, (reading,), status = problem.evaluated(problem.standard(values))
    return reading, status


def test_what_scatters_less_or_more_than_usual_is_read_too():
    """The table serves priors within its range. A prior that reaches beyond it is computed without
    it, since the table would extrapolate and a chain would not know.
    """
    low, seen = ij.Iris.of_level("low"), ij.spectrum(FEW, np.ones(FEW.size))
    wide = {SCALE: ij.infer.LogUniform(0.005, 400.0)}
    beyond = by_transfer(seen, low, SCALE, priors=wide)
    assert isinstance(beyond.solvers[0].solver, ij.RadiativeExact)
    assert isinstance(by_transfer(seen, low, SCALE).solvers[0].solver, ij.RadiativeTabulated)

    def by_table(iris, load, scale):
        problem = by_transfer(seen, iris.replace(scattering_scale=scale))
        assert isinstance(problem.solvers[0].solver, ij.RadiativeTabulated)
        return np.asarray(predicted(problem, {"melanin_load": load, "hemoglobin": 0.084})[0])

    for scale in (0.01, 30.0, 200.0):
        values = {"melanin_load": 0.1, "hemoglobin": 0.084, SCALE: scale}
        expected, status = predicted(beyond, values)
        assert status == RESULTS.successful
        if scale < 200:
            np.testing.assert_allclose(by_table(low, 0.1, scale), expected, rtol=3e-5)
    # These values were made by RadiativeExact(40, 8, 5), with a noise of 2 %.
    values = [0.06345, 0.12487, 0.16804, 0.13968, 0.12198, 0.14416, 0.13176, 0.11241]
    off = (values / by_table(ij.Iris().replace(abl_fraction=0.5), 0.2, 20.0) - 1) / 0.02
    assert (off**2).sum() < stats.chi2(8).ppf(0.999)


def test_spots_share_blood_but_not_melanin():
    """Each on its own wavelengths and in its own light."""
    low, y = ij.Iris.of_level("low"), np.linspace(0.02, 0.01, FEW.size)
    two = [
        ij.spectrum(FEW, y, name="a"),
        ij.spectrum(FEW - 10, 0.5 * y, name="b", cos_incidence=0.6),
    ]
    problem = by_transfer(two, low, separate=["melanin_load"])
    assert problem.free == ("melanin_load@1", "melanin_load@2", "hemoglobin")
    loads, blood = (0.05, 0.2), {"hemoglobin": 0.1}
    z = problem.standard({f"melanin_load@{i}": x for i, x in enumerate(loads, 1)} | blood)
    _, readings, status = quick_jit(lambda z: problem.evaluated(z))(z)
    assert status == RESULTS.successful
    for seen, load, found in zip(two, loads, readings, strict=True):
        expected, _ = predicted(by_transfer(seen, low), blood | {"melanin_load": load})
        np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert set(problem.reported(z)) >= {"melanin_load@1", "eumelanin@2"}


ONES, MANY = ij.spectrum(GRID, np.ones(GRID.size)), np.linspace(400, 700, 1001)
SMOOTH, TWO = {"discrepancy": 0.1, "length": 50.0}, [400.0, 410.0]
READ, LAW = ij.Measured(GRID, GRID, None, (), {}), ij.Iris(power_law=ij.PowerLaw())
by_ilit = partial(ij.problem, ONES)


@pytest.mark.parametrize(
    ("state", "message"),
    [
        (lambda: by_ilit(free=["melanin"]), "unknown parameter 'melanin'"),
        (lambda: by_ilit(fixed={"abl_fraction": 1.2}), r"abl_fraction = 1.2 is outside \[0, 1\]"),
        (lambda: by_ilit(free=["gain"], fixed={"gain": 1.0}), "both free and fixed"),
        (lambda: by_ilit(free=[]), "nothing is free"),
        (lambda: by_ilit(free=["gain"], priors={"noise": LogNormal(1.0, 1.0)}), "is not free"),
        (lambda: by_ilit(priors={"gain": LogNormal(-1.0, 0.5)}), "make no distribution"),
        (lambda: by_ilit(priors={"abl_fraction": Uniform(0.5, 0.2)}), "make no distribution"),
        (lambda: ij.problem(ij.spectrum(MANY, MANY), noise=Noise(**SMOOTH)), "1001 by 1001"),
        (lambda: Noise(**SMOOTH, degrees_of_freedom=4.0), "do not go together"),
        (lambda: Noise(discrepancy=0.1), "needs its length"),
        (lambda: ij.colour_data([0.1, 0.1, 0.1], np.zeros((3, 3))), "positive definite"),
        (lambda: by_ilit(free=["anisotropy"]), "anisotropy is of radiative transfer"),
        (lambda: by_ilit(fixed={"rayleigh_share": 0.1}), "rayleigh_share is of radiative transfer"),
        (lambda: by_ilit(base=LAW), "power_law is of radiative transfer"),
        (lambda: by_transfer(ONES, None, "reduced_scattering", SCALE), "one factor"),
        (lambda: ij.spectrum(TWO, [0.1, np.nan]), "the value at 410 nm is not a finite number"),
        (lambda: ij.spectrum([300.0, 410.0], [0.1, 0.1]), "300 nm is outside the pigment tables"),
        (lambda: ij.spectrum([400.0, 400.0], [0.1, 0.1]), "must increase"),
        (lambda: ij.spectrum([400.0, 410.0, 400.0], [0.1] * 3), "400 nm is twice: average the two"),
        (lambda: ij.spectrum(TWO, [0.1]), "need one for each"),
        (lambda: ij.spectrum(TWO, [[0.1, 0.2]] * 3), r"\(3, 2\) values for \(2,\) wavelengths"),
        (lambda: ij.spectrum(TWO, np.ones((2, 0))), r"\(2, 0\) values for \(2,\) wavelengths"),
        (lambda: ij.spectrum([TWO], [TWO]), r"\(1, 2\) values for \(1, 2\) wavelengths"),
        (lambda: ij.spectrum(TWO, np.ma.masked_less([0.1, 0.2], 0.15)), "some values are masked"),
        (lambda: ij.spectrum(TWO, [0.1, 0.1], [0.1, 0.0]), "standard deviation at 410 nm is 0"),
        (lambda: ij.spectrum(TWO), "wavelengths and values, or one object"),
        (lambda: ij.spectrum(READ, 0.01), "wavelengths and values, or one object"),
    ],
)
def test_wrong_problems_and_data_are_named(state, message):
    with pytest.raises(ValueError, match=message):
        state()


def test_a_single_name_is_one_parameter():
    assert by_ilit(free="gain").free == by_ilit(free=iter(["gain"])).free == ("gain",)
    assert ij.problem([ONES, ONES], free="gain", separate="gain").free == ("gain@1", "gain@2")


def test_a_covariance_stands_for_the_scatter_of_scans():
    seen = ij.spectrum(TWO, [[0.1, 0.2], [0.1, 0.3]], covariance=np.diag([4e-4, 9e-4]))
    np.testing.assert_allclose(seen.sd, [0.02, 0.03])


def test_spectra_of_colour_science_and_read_ones_stand_for_wavelengths_and_values(tmp_path):
    import colour as cs

    grid = np.array([400.0, 500.0, 600.0])
    scans = np.array([[0.03, 0.032], [0.01, 0.012], [0.02, 0.019]])
    one = cs.SpectralDistribution(scans[:, 0], grid)
    np.testing.assert_array_equal(ij.spectrum(one).wavelengths, grid)
    np.testing.assert_array_equal(ij.spectrum(one).values, scans[:, 0])
    assert ij.spectrum(one).sd is None
    np.testing.assert_array_equal(ij.spectrum(one, sd=0.01).sd, [0.01] * 3)
    np.savetxt(tmp_path / "scans.csv", np.c_[grid, scans], delimiter=",")
    read = ij.read_measured(tmp_path / "scans.csv")
    for seen in (ij.spectrum(cs.MultiSpectralDistributions(scans, grid)), ij.spectrum(read)):
        np.testing.assert_allclose(seen.values, scans.mean(1))
        np.testing.assert_allclose(seen.sd, read.sd)
    assert ij.spectrum(cs.MultiSpectralDistributions(scans[:, [0, 0]], grid)).sd is None


@pytest.mark.peer
def test_densities_and_fits_do_not_depend_on_the_pieces(monkeypatch):
    """Large problems are evaluated in pieces: the same numbers, in bounded memory."""
    values = ij.reflectance(ij.Iris(), GRID, solver=BeerLambert()).values
    # Its name, a static field, keeps programs compiled for other tests away.
    seen = ij.spectrum(GRID, values, name="in pieces")
    problem = ij.problem(seen, free=["melanin_load", "hemoglobin"], solver=BeerLambert())
    monkeypatch.setattr(chunks, "_ELEMENTS", 2 * GRID.size)  # of seven walkers one remains
    z = jnp.asarray(np.random.default_rng(0).normal(size=(7, 2)))
    np.testing.assert_allclose(
        problem.log_density(z), [problem.log_posterior(x) for x in z], rtol=1e-12
    )
    np.testing.assert_allclose(pointwise(problem, z), [problem.pointwise(x) for x in z], rtol=1e-12)
    found = fit(problem, use_priors=False, key=jax.random.key(0))
    truth = ij.infer.of_iris(ij.Iris())
    assert int(found.agreeing) == 4
    for name in problem.free:
        assert float(found.values[name]) == pytest.approx(float(truth[name]), rel=1e-5)
