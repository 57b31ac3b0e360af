"""Analysers and polarimeters: what every polariser must see, whatever the iris."""

from functools import partial

import numpy as np
import pytest

import irisjax as ij
from common import quick_jit

GRID = [450.0, 620.0]
IRIS = ij.Iris.of_level("low")
SOLVER = ij.RadiativeExact(24, 8, 1, process=ij.POLARISED)
COARSE = ij.RadiativeExact(12, 4, 1, process=ij.POLARISED)  # where resolution is not the point


@quick_jit
def _solved(meter):
    """One program for all that is read, into one direction or a hemisphere."""
    factor, light = meter.incident()
    return COARSE.solve(IRIS.layers(meter.pigments), light), factor


@pytest.fixture(scope="module")
def far():
    """A polarimeter that looks from the side, and what it reads."""
    meter = ij.Polarimeter(GRID, cos_exit=0.5)
    return meter, *_solved(meter)


@quick_jit
def _read(instrument, solution, factor):
    return instrument.reading(solution, factor)


@pytest.mark.usefixtures("far")  # compiles the program
@pytest.mark.parametrize("where", [1.0, 0.6, "hemisphere"])
def test_both_analysers_make_the_whole(where):
    """Of unpolarised light: the mean over two polarisers of the sum over both analysers."""
    towards = {"cos_incidence": 0.8, "azimuth": 0.7}
    cosine = 0.6 if where == "hemisphere" else where
    solution, factor = _solved(ij.Polarimeter(GRID, cos_exit=cosine, **towards))
    total = 0.0
    for setting in ("crossed", "parallel"):
        for polariser in (0.3, 0.3 + np.pi / 2):
            settings = {"polariser": polariser, "cos_exit": where, **towards}
            analyser = ij.Analyser(GRID, setting, **settings)
            values = np.asarray(_read(analyser, solution, factor).values)
            assert (values > 0).all()
            total = total + 0.5 * values
    if where == "hemisphere":
        wanted = np.asarray(solution.reflectance) + np.asarray(solution.mirrored)
    else:
        wanted = np.pi * np.asarray(solution.brdf)[:, 0]
    np.testing.assert_allclose(total, wanted, rtol=1e-10)


@pytest.mark.slow
def test_along_the_normal():
    """The spec's figures, alike for every polariser; unpolarised light stays so, by symmetry."""
    read = partial(ij.observe, IRIS, solver=SOLVER)
    crossed, parallel = (
        [read(ij.Analyser(GRID, s, polariser=a)).values for a in (0.0, 0.9)]
        for s in ("crossed", "parallel")
    )
    np.testing.assert_allclose(crossed[0], crossed[1], rtol=1e-9)
    share = crossed[0] / (crossed[0] + parallel[0])
    np.testing.assert_allclose(share, [0.0137, 0.0136], atol=1e-4)
    plain = read(ij.Polarimeter(GRID))
    np.testing.assert_allclose(plain.values, 0, atol=1e-9)
    lit = read(ij.Polarimeter(GRID, polariser=0.4))
    np.testing.assert_allclose(lit.values, 1 - 2 * share, rtol=1e-8)
    np.testing.assert_allclose(lit.angle, 0.4, atol=1e-9)


def test_far_from_the_normal_light_is_polarised_across_the_plane(far):
    seen = _read(*far)
    assert (np.asarray(seen.values) > 0.3).all()
    np.testing.assert_allclose(np.abs(seen.angle), np.pi / 2, atol=1e-6)
    assert seen.stokes.shape == (2, 4)


def test_refusals():
    analyser = ij.Analyser(GRID)
    with pytest.raises(ValueError, match="Analyser sees polarisation; give solver=Radiative"):
        ij.observe(IRIS, analyser, ij.RadiativeExact())
    for settings, said in (
        ({"polariser": None}, "give its angle"),
        ({"polariser": 30.0}, r"polariser = 30 rad is outside"),
        ({"cos_exit": 1.2}, "cos_exit = 1.2 is outside"),
        ({"cos_exit": "diffuse"}, "or 'hemisphere'"),
        ({"azimuth": [0.1]}, "azimuth has shape"),
        ({"cos_incidence": "diffuse"}, "comes from one direction"),
        ({"cornea": "inward"}, "bare iris: cornea = 'inward'"),
    ):
        with pytest.raises(ValueError, match=said):
            ij.Analyser(GRID, **settings)
