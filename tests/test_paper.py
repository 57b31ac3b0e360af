"""What LB06 says comes out. Aqueous side, first surface left out."""

import itertools

import numpy as np
import pytest

import irisjax as ij
from common import exact

GRID = ij.wavelengths(400, 700, 1)
SOLVER = exact(ij.ILIT_2006)


def spectrum(level, **fields):
    iris = ij.Iris.of_level(level).replace(**fields)
    return np.asarray(ij.reflectance(iris, GRID, solver=SOLVER, first_surface=False).values)


def at(values, wavelength):
    return values[int(wavelength - 400)]


def hump(values):
    """How far the hump near 560 nm stands above the mean of the dips near 542 and 577 nm, each
    sought within 4 nm.
    """

    def near(wavelength):
        return values[wavelength - 404 : wavelength - 395]

    return near(560).max() - (near(542).min() + near(577).min()) / 2


@pytest.mark.parametrize(("level", "expected"), [("low", 0.00124), ("high", 0.00034)])
def test_blood_w(level, expected):
    assert hump(spectrum(level)) == pytest.approx(expected, abs=5e-6)


def test_blood_w_comes_from_blood():
    """Without blood the spectrum bends the other way: no hump above the chord of 542 and 577 nm."""

    def bend(level, **fields):
        values = spectrum(level, **fields)
        return at(values, 560) - (at(values, 542) * 17 + at(values, 577) * 18) / 35

    for level in ("low", "high"):
        bloodless = bend(level, oxyhemoglobin=0.0, deoxyhemoglobin=0.0)
        assert bend(level) > max(0.0002, 3 * bloodless)


def test_range_between_levels():
    gap = spectrum("low") - spectrum("high")
    assert 400 + 10 * int(np.argmax(gap[::10])) == 460
    assert at(gap, 460) == pytest.approx(0.0356, abs=5e-5)
    assert at(gap, 700) == pytest.approx(0.0066, abs=5e-5)
    # Shrinks from 600 nm on.
    assert (np.diff(gap[200:]) < 0).all()


@pytest.mark.parametrize("level", ["moderate", "high"])
def test_more_of_it_in_the_abl_is_darker(level):
    """[LB06 Fig. 7] for the moderate level; low irides turn round beyond 640 nm, where so little
    absorbs.
    """
    spectra = [spectrum(level, abl_fraction=fraction) for fraction in (0.2, 0.35, 0.5, 0.65, 0.8)]
    for brighter, darker in itertools.pairwise(spectra):
        assert (brighter > darker).all()


@pytest.mark.parametrize("level", ["low", "high"])
@pytest.mark.parametrize("angle", [0, 60])
def test_brdf_is_near_lambertian(level, angle):
    """At 550 nm the factor π f / R stays within 1/8 of one out to 60 degrees, and is the same for
    both incidences.
    """
    at = ij.Iris.of_level(level), np.array([550.0])
    exits, cosine = np.cos(np.radians(np.arange(0, 61, 5))), float(np.cos(np.radians(angle)))
    seen = {"cos_incidence": cosine, "solver": ij.IlitExact(12)}
    f = np.asarray(ij.brdf(*at, cos_exit=exits, **seen).values[0])
    whole = ij.reflectance(*at, first_surface=False, **seen).values[0]
    assert np.abs(np.pi * f / float(whole) - 1).max() <= 0.126
    # Falls off monotonically towards grazing.
    assert (np.diff(f) < 0).all()
