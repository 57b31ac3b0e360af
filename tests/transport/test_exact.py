"""The exact solver against reference tables, multiprecision, and itself with more nodes."""

import functools

import jax
import numpy as np
import pytest

import common
import irisjax as ij
from common import GRID, ILIT, all_irides, quick_jit, reference
from multiprecision import ilit_rayleigh

ROWS = reference("ilit_reflectance.csv")
VARIANTS = sorted({(r["phase"], r["rescatter"], r["perturb_on_reflection"] == "1") for r in ROWS})
N = ij.IlitExact().n_angles


@functools.cache
def spectra(process, n_angles=N, bits=64):
    """The nine irides of the table, first surface left out of the values (it is in `.mirrored`)."""
    assert jax.config.jax_enable_x64 == (bits == 64)
    _, irides = all_irides()

    def spectrum(iris):
        return ij.reflectance(
            iris, GRID, solver=common.exact(process, n_angles), first_surface=False, throw=False
        )

    # As NumPy: what is kept outlives a change of precision.
    return jax.tree.map(np.asarray, quick_jit(jax.vmap(spectrum))(irides))


@pytest.mark.parametrize(("phase", "rescatter", "redrawn"), VARIANTS)
def test_reference_table(phase, rescatter, redrawn):
    names, _ = all_irides()
    wanted = {
        (r["level"], float(r["abl_fraction"]), float(r["wavelength_nm"])): float(r["reflectance"])
        for r in ROWS
        if (r["phase"], r["rescatter"], r["perturb_on_reflection"])
        == (phase, rescatter, "1" if redrawn else "0")
    }
    assert len(wanted) == 279
    found = spectra(ij.Ilit(phase=phase, rescatter=rescatter, perturb_on_reflection=redrawn))
    check_energy(found, np.float64, 1e-12)
    expected = np.array([[wanted[(*name, float(w))] for w in GRID] for name in names])
    # The issue asks for 1e-7 with phase="rayleigh". The file itself is off by up to 1.34e-7 where
    # the ABL is thin: test_multiprecision settles one such point with 25 digits, and this solver is
    # right there.
    near = 1e-6 if phase == "lb06" else 1.5e-7
    np.testing.assert_allclose(found.values, expected, rtol=near)


@pytest.mark.parametrize(
    ("level", "fraction", "wavelength"), [("low", 0.2, 690.0), ("high", 0.8, 400.0)]
)
def test_multiprecision(level, fraction, wavelength):
    iris = ij.Iris.of_level(level).replace(abl_fraction=fraction)
    depths = quick_jit(ij.Iris.layers)(iris, ij.extinction(np.array([wavelength])))
    names = "abl_absorption", "stroma_absorption", "stroma_scattering"
    expected = ilit_rayleigh(*(float(getattr(depths, n)[0]) for n in names))
    row = all_irides()[0].index((level, fraction))
    found = spectra(ij.ILIT_CORRECTED).values[row, list(GRID).index(wavelength)]
    assert found == pytest.approx(expected, rel=1e-10)


def check_energy(result, dtype, error):
    parts = jax.tree.leaves((result.values, result.mirrored, result.absorbed))
    assert all(part.dtype == dtype for part in parts)
    np.testing.assert_allclose(sum(x.astype(float) for x in parts), 1, rtol=0, atol=error)


@pytest.mark.parametrize("name", ["lb06", "rayleigh-retest"])
def test_single_precision(name):
    double = spectra(ILIT[name])
    with jax.enable_x64(False):
        single = spectra(ILIT[name], bits=32)
    check_energy(single, np.float32, 1e-6)
    for mirrored in (0, 1):
        a, b = (r.values + mirrored * r.mirrored for r in (single, double))
        bright = b > 1e-3
        assert bright.mean() > 0.5
        np.testing.assert_allclose(a[bright], b[bright], rtol=2e-5)


# The printed kernel is singular, which product integration takes in its stride.
@pytest.mark.parametrize("name", ["rayleigh-redrawn", "lb06"])
def test_default_size_against_more_nodes(name):
    found, fine = (spectra(ILIT[name], n).values for n in (N, N + 24))
    np.testing.assert_allclose(found, fine, rtol=1e-10)


@pytest.mark.parametrize(("field", "value"), [("n_angles", 3), ("n_depths", 1), ("n_panels", 0)])
def test_bad_solver(field, value):
    with pytest.raises(ValueError, match=rf"^{field} = {value} is outside"):
        ij.RadiativeExact(**{field: value})
