"""Derivatives that do not exist, and arrays where one number is meant: refused by name."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

import irisjax as ij
from common import quick_jit
from experiments.closed_formulas import KubelkaMunk

GRID = ij.wavelengths(400, 700, 10)
SHORT = (450.0, 550.0, 650.0)
KEY = jax.random.key(0)
CLOSED = KubelkaMunk()  # compiles soonest, where physics is not the point
MANY = np.linspace(0.5, 0.9, GRID.size)
REFUSED = (ValueError, jaxtyping.TypeCheckError)  # a wrong rank fails the tests' own checks first

DERIVATIVES = {
    "jit of grad": lambda f: jax.jit(jax.grad(f)),
    "jvp": lambda f: lambda x: jax.jvp(f, (x,), (jnp.ones(()),)),
    "vmap of grad": lambda f: lambda x: jax.vmap(jax.grad(f))(x[None]),
}


@pytest.mark.parametrize("derivative", DERIVATIVES)
def test_analogue_monte_carlo_has_no_derivatives(derivative):
    def value(x):
        iris, cosine = ij.Iris.of_level("low"), 1.0
        if derivative == "jvp":
            cosine = x
        else:
            iris = iris.replace(eumelanin=x)
        how = {"cos_incidence": cosine, "solver": ij.MonteCarlo(100, lanes=16), "key": KEY}
        return ij.reflectance(iris, SHORT, **how).values.sum()

    with pytest.raises(NotImplementedError, match="MonteCarlo has no derivatives"):
        DERIVATIVES[derivative](value)(jnp.asarray(0.5))


def test_monte_carlo_by_what_is_no_count():
    iris, solver = ij.Iris.of_level("low"), ij.MonteCarlo(2_000, lanes=64)

    def value(gain):
        instrument = ij.Spectrophotometer(SHORT, gain=gain)
        return ij.observe(iris, instrument, solver=solver, key=KEY).values.sum()

    whole, slope = jax.value_and_grad(value)(2.0)
    np.testing.assert_allclose(slope, whole / 2, rtol=1e-12)


@pytest.mark.parametrize("field", ["eumelanin", "fibril_radius"])
def test_an_iris_of_arrays_is_a_batch(field):
    def read(iris):
        return ij.reflectance(iris, GRID)

    for call in (read, jax.jit(read)):
        with pytest.raises(ValueError, match=rf"Iris\.{field} has shape \(31,\).*jax\.vmap"):
            call(ij.Iris().replace(**{field: MANY}))


def test_one_number_a_setting():
    gonio = partial(ij.Goniophotometer, cos_exit=0.5)
    for instrument in (ij.Spectrophotometer, ij.Radiometer, ij.Colorimeter, gonio):

        def make(cosine, instrument=instrument):
            return instrument(GRID, cos_incidence=cosine).wavelengths

        for call in (make, jax.jit(make)):
            with pytest.raises(ValueError, match=r"cos_incidence has shape \(31,\).*jax\.vmap"):
                call(MANY)
    with pytest.raises(ValueError, match=r"gain has shape \(31,\)"):
        ij.Spectrophotometer(GRID, gain=MANY)
    for none in (0.0, -1.0, np.inf):
        with pytest.raises(ValueError, match=r"gain = .* is outside \(0, 1000000\]|\(0, 1e\+06\]"):
            ij.Spectrophotometer(GRID, gain=none)
    with pytest.raises(REFUSED, match=r"aqueous"):
        ij.reflectance(ij.Iris(), GRID, media=ij.Media(aqueous=1 + MANY))


@pytest.mark.parametrize("measure", [ij.reflectance, ij.radiance, ij.colour])
def test_wavelengths_are_a_list(measure):
    def run(grid):
        return measure(ij.Iris(), grid).status == ij.RESULTS.successful

    for call in (run, jax.jit(run)):
        with pytest.raises(ValueError, match=r"wavelengths must be a list.*got shape \(1, 31\)"):
            call(GRID[None])
        with pytest.raises(ValueError, match=r"wavelengths must be a list.*got shape \(\)"):
            call(np.float64(500))


def test_exits_are_a_list_of_directions():
    def read(cosine, azimuth):
        return ij.brdf(ij.Iris(), SHORT, cos_exit=cosine, azimuth=azimuth).values

    for run in (read, jax.jit(read)):
        with pytest.raises(REFUSED, match=r"exits must be a list of directions|\(2, 2\)"):
            run(np.full((2, 2), 0.5), 0.0)
        with pytest.raises(ValueError, match=r"cos_exit and azimuth .*\(2,\).*\(3,\)"):
            run(np.full(2, 0.5), np.zeros(3))


# A transformation, a wrong value, and an iris and wavelengths that have it.
WRONG = {
    "pigment": (
        lambda f: lambda x: jax.vmap(f)(jnp.stack([x, x])),
        -1.0,
        lambda iris, x: (iris.replace(eumelanin=x), SHORT),
    ),
    "order of indices": (
        quick_jit,
        1.3,
        lambda iris, x: (eqx.tree_at(lambda i: i.ipe_index, iris, x), SHORT),
    ),
    "wavelength": (lambda f: quick_jit(jax.grad(f)), np.nan, lambda iris, x: (iris, 500 + x[None])),
}


@pytest.mark.parametrize("what", WRONG)
def test_wrong_values_raise_in_a_trace_too(what):
    transform, bad, made = WRONG[what]
    iris = ij.Iris.of_level("low")
    run = transform(lambda x: ij.reflectance(*made(iris, x), solver=CLOSED).values.sum())
    # An error of XLA or of Equinox: both are RuntimeErrors.
    with pytest.raises(RuntimeError, match="optical depth is negative or not finite"):
        jax.block_until_ready(run(jnp.asarray(bad)))


@pytest.mark.parametrize("measure", [ij.radiance, ij.colour], ids=["radiance", "colour"])
def test_traced_wavelengths_beyond_a_table_say_so(measure):
    how = {"illuminant": "FL2", "solver": CLOSED, "throw": False}
    run = quick_jit(lambda w: measure(ij.Iris(), w, **how).status._value)
    for first, status in ((400.0, ij.RESULTS.successful), (370.0, ij.RESULTS.invalid_input)):
        assert int(run(np.asarray([first, 500.0]))) == int(status._value)


def test_colour_of_whole_numbers():
    grid = np.arange(400, 701, 20)
    white = np.ones(grid.size, int)
    expected = ij.colour_of(grid.astype(float), white.astype(float))
    assert float(expected.xyz[1]) == pytest.approx(1)
    for values in (white, jnp.asarray(white), white.tolist()):
        found = ij.colour_of(grid, values)
        jax.tree.map(np.testing.assert_array_equal, found, expected)


def test_wavelengths_in_whole_numbers():
    whole = np.arange(400, 701, 20)
    how = {"solver": CLOSED}
    expected = ij.reflectance(ij.Iris(), whole.astype(float), **how)
    for grid in (whole, whole.tolist(), jnp.asarray(whole)):
        found = ij.reflectance(ij.Iris(), grid, **how)
        jax.tree.map(np.testing.assert_array_equal, found, expected)
    traced = quick_jit(lambda w: ij.reflectance(ij.Iris(), w, **how))(whole)
    jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-9, atol=1e-9), traced, expected)


def test_one_program_for_every_kind_of_number():
    seen = []

    class Counting(KubelkaMunk):
        def solve(self, *args, **settings):
            seen.append(1)
            return super().solve(*args, **settings)

    values = [
        ij.reflectance(ij.Iris(), SHORT, cos_incidence=c, solver=Counting()).values
        for c in (1, 1.0, np.float32(1), np.float64(1), np.ones(()), jnp.ones(()))
    ]
    assert len(seen) == 1
    for v in values:
        np.testing.assert_array_equal(v, values[0])


def test_failures_are_told_one_way():
    class Coarse(KubelkaMunk):
        def solve(self, *args, **settings):
            found = super().solve(*args, **settings)
            return eqx.tree_at(lambda x: x.status, found, ij.RESULTS.under_resolved)

    with pytest.raises(ValueError, match="for the number of depth panels"):
        ij.reflectance(ij.Iris(), SHORT, solver=Coarse())
    told = ij.reflectance(ij.Iris(), SHORT, solver=Coarse(), throw=False)
    assert told.status == ij.RESULTS.under_resolved


@pytest.mark.peer
def test_diffuse_light_by_monte_carlo():
    iris = ij.Iris.of_level("low")
    for solver in (ij.IlitExact(), ij.RadiativeExact()):
        photons = ij.MonteCarlo(2_000, lanes=64, process=solver.process)
        found, exact = (
            ij.reflectance(iris, SHORT, cos_incidence="diffuse", solver=s, key=KEY)
            for s in (photons, solver)
        )
        z = (found.values - exact.values) / found.standard_error
        assert np.abs(z).max() < 4
