"""Slits, filters and moving averages: their means against quadrature and against numpy."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

import irisjax as ij
from experiments.closed_formulas import KubelkaMunk
from irisjax import io

GRID = ij.wavelengths(440, 680, 40)
SHAPES = {
    "gaussian": lambda x: np.exp(-4 * np.log(2) * x**2),
    "boxcar": lambda x: float(abs(x) <= 0.5),
}
CLOSED = KubelkaMunk()
LOW = ij.Iris.of_level("low")


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("width", [1.5, 20.0])
def test_means_are_those_of_quadrature(shape, width):
    """For a spectrum that is linear between the values of the pigment tables."""
    nodes = np.arange(350.0, 801, 2)
    values = np.random.default_rng(0).uniform(0.01, 0.1, nodes.size)
    bands = ij.Passbands.slit(GRID[:2], width, shape)
    found = bands.mean(np.interp(bands.wavelengths, nodes, values))
    np.testing.assert_allclose(bands.weights.sum(1), 1, rtol=1e-12)
    for centre, mean in zip(GRID[:2], found, strict=True):
        x = np.linspace(centre - 2.2 * width, centre + 2.2 * width, 20_001)
        passed = np.array([SHAPES[shape]((v - centre) / width) for v in x])
        by_hand = scipy.integrate.trapezoid(passed * np.interp(x, nodes, values), x)
        by_hand /= scipy.integrate.trapezoid(passed, x)
        assert mean == pytest.approx(by_hand, rel=1e-3 if shape == "boxcar" else 1e-5)


def test_readings_are_means_of_fine_readings():
    bands = ij.Passbands.slit(GRID, 15.0)
    x = np.asarray(bands.wavelengths)
    each = ij.reflectance(LOW, x, solver=CLOSED)
    found = ij.reflectance(LOW, GRID, solver=CLOSED, bands=15.0)
    np.testing.assert_allclose(found.wavelengths, GRID)
    fine = ij.wavelengths(400, 720, 1)
    weights = np.exp(-4 * np.log(2) * ((fine - GRID[:, None]) / 15) ** 2)
    wanted = weights @ np.interp(fine, x, each.values) / weights.sum(1)
    np.testing.assert_allclose(found.values, wanted, rtol=1.5e-3)
    # Energy closes in each band.
    closed = found.values + found.absorbed.total()
    np.testing.assert_allclose(closed, 1, rtol=1e-9)
    seen = ij.Spectrophotometer(GRID, bands=15.0)

    def total(load):
        return ij.observe(LOW.replace(melanin_load=load), seen, CLOSED).values.sum()

    slope, off = jax.jit(jax.grad(total))(0.1), 1e-4
    difference = (total(0.1 + off) - total(0.1 - off)) / (2 * off)
    assert float(slope) == pytest.approx(float(difference), rel=1e-5)
    # A radiance is the mean of products with the illuminant.
    light = ij.measure.illuminant_power("A", x) * float(ij.Media().inward(1.0)[0]) / np.pi
    found = ij.radiance(LOW, GRID, solver=CLOSED, illuminant="A", bands=15.0)
    np.testing.assert_allclose(found.values, bands.weights @ (light * each.values), rtol=1e-12)


def test_an_illuminant_weighs_what_filters_pass():
    grid = ij.wavelengths(400, 700, 10)
    flat = np.ones((grid.size, 1))
    reddish = ij.Passbands.of(grid, flat, illuminant="A")
    assert float(ij.Passbands.of(grid, flat).centres[0]) == pytest.approx(550)
    power = np.asarray(ij.measure.illuminant_power("A", grid))
    assert float(reddish.centres[0]) == pytest.approx((power * grid).sum() / power.sum())


def test_errors_average_as_independent_ones():
    bands = ij.Passbands.slit(np.array([550.0]), 12.0)
    x = np.asarray(bands.wavelengths)
    errors = np.linspace(1e-3, 2e-3, x.size)

    @jax.jit
    def read(errors):
        light = CLOSED.solve(LOW.layers(ij.extinction(x), 1.336), ij.Light(1.0))
        light = dataclasses.replace(light, standard_error=errors, total_error=errors)
        seen = ij.Spectrophotometer(x), ij.Spectrophotometer(bands.centres, bands=bands)
        return [instrument.reading(light, jnp.ones(())).standard_error for instrument in seen]

    each, mean = read(errors)
    np.testing.assert_array_equal(each, errors)
    weights = np.asarray(bands.weights)
    np.testing.assert_allclose(mean, np.sqrt(weights**2 @ errors**2), rtol=1e-9)


NARROW = functools.partial(ij.Passbands.slit, GRID, 5.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: ij.Colorimeter(bands=10.0), "a Colorimeter has no bands"),
        (lambda: ij.Goniophotometer(GRID, cos_exit=1.0, bands=10.0), "has no bands"),
        (lambda: ij.Spectrophotometer(GRID, bands=0.0), "bandwidth = 0"),
        (lambda: ij.Spectrophotometer(GRID[:2], bands=NARROW()), "2 values for 7"),
        (
            lambda: ij.Spectrophotometer(GRID + 30, bands=NARROW()),
            "no band is centred near 470 nm: the next is at 440 nm",
        ),
        (lambda: NARROW("square"), "unknown shape 'square'; known: gaussian"),
        (lambda: ij.Passbands.of(GRID, -np.ones((7, 1))), "must be zero or more"),
        (lambda: ij.Passbands.of(GRID, np.ones((6, 1))), "sensitivities of shape"),
    ],
)
def test_wrong_bands_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_bands_from_files(tmp_path):
    path = tmp_path / "bands.csv"

    def bands(text):
        path.write_text(text)
        return io.read_passbands(path)

    found = bands("centre (nm),FWHM (nm)\n600,40\n450,20\n")
    wanted = ij.Passbands.slit(np.array([450.0, 600]), np.array([20.0, 40]))
    np.testing.assert_allclose(found.weights, wanted.weights)
    found = bands("nm,red,green\n500,0,1\n550,0,3\n600,2,1\n650,1,0\n")
    np.testing.assert_allclose(found.centres, [550, 616 + 2 / 3])
    assert bands("nm,R,G,B\n500,0,0,1\n550,0,1,0\n600,1,0,0\n").centres.size == 3
    for text, said in (
        ("nm,red,green\n500,0,1\n550,,3\n600,2,1\n", "line 3: no finite number for 'red'"),
        (
            "nm,R %,sd\n500,2,1\n550,2,1\n",
            r"column 'R %' \(reflectance\) is of a spectrum, not of bands",
        ),
        (
            "centre,sensitivity\n500,1\n550,1\n",
            "the file has centres of bands and no widths; need rows",
        ),
        ("nm,fwhm\n500,10\n550,10\n", "widths of bands and no centres"),
        ("nm,infrared\n700,1\n900,1\n", "50 % of the band 'infrared' is outside 350 to 800 nm"),
    ):
        with pytest.raises(ValueError, match=said):
            bands(text)
