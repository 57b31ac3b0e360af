"""The power law of scattering: its formula, what an iris does with it, what it refuses."""

import jax
import numpy as np
import pytest

import irisjax as ij


def test_is_jacques_formula():
    law = ij.PowerLaw(2.0, 0.4, 1.3, 0.8)
    x = np.array([400.0, 500.0, 650.0])
    wanted = 2.0 * (0.4 * (x / 500) ** -4 + 0.6 * (x / 500) ** -1.3)
    made = jax.jit(lambda x: (law.reduced(x), law.coefficient(x), law.phase(x)))
    reduced, coefficient, phase = made(x)
    np.testing.assert_allclose(reduced, wanted, rtol=1e-14)
    mean = (1 - np.asarray(phase.rayleigh)) * np.asarray(phase.anisotropy)
    np.testing.assert_allclose(coefficient * (1 - mean), wanted, rtol=1e-13)


def test_iris_takes_its_numbers_by_name():
    iris = ij.Iris().replace(anisotropy=0.7).replace(reduced_scattering=3.0)
    assert iris.power_law is not None
    assert float(iris.power_law.anisotropy) == 0.7
    assert float(iris.power_law.reduced_scattering) == 3.0
    assert "anisotropy = 0.7" in repr(iris)
    assert iris.replace(power_law=None).power_law is None
    table = ij.extinction(np.array([500.0]))
    made = iris.layers(table)
    h = iris.stroma_thickness
    np.testing.assert_allclose(
        made.stroma_scattering, h * iris.power_law.coefficient(table.wavelengths), rtol=1e-14
    )
    assert ij.Iris().layers(table).phase is None


def test_out_of_range_is_named():
    bad = {"anisotropy": 1.0, "rayleigh_share": -0.1, "scattering_power": 9}
    for name, value in (bad | {"reduced_scattering": -1}).items():
        with pytest.raises(ValueError, match=f"{name} = .* is outside"):
            ij.PowerLaw(**{name: value})
