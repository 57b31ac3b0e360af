"""Analysers and polarimeters along the normal, and what they refuse. Other directions are seen in
tests/transport/test_polarised.py, by the program there.
"""

from functools import partial

import numpy as np
import pytest

import irisjax as ij

GRID = [450.0, 620.0]
IRIS = ij.Iris.of_level("low")
SOLVER = ij.RadiativeExact(24, 8, 1, process=ij.POLARISED)


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
