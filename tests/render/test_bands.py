"""Ten wavelengths for 81: colours of irides that the bands were not made from."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import lab_of_linear, quick_jit, stack
from irisjax.anatomy.eye import Cornea
from irisjax.measure.colour import illuminant_power
from irisjax.render.bands import BAND_GRID, colour_bands, spectral_bands

# Not drawn as the bands' own irides were: corners, no pigment, no blood, other collagen, other
# shares.
IRIDES = {
    "low": ij.Iris.of_level("low"),
    "high": ij.Iris.of_level("high"),
    "no melanin": ij.Iris(eumelanin=0.0, pheomelanin=0.0),
    "red only": ij.Iris(eumelanin=0.0, pheomelanin=2.0, abl_fraction=0.3),
    "bloodless": ij.Iris.of_level("low").replace(oxyhemoglobin=0.0, deoxyhemoglobin=0.0),
    "thin": ij.Iris.of_level("low").replace(stroma_thickness=0.1, abl_fraction=0.9),
    "thick fibrils": ij.Iris.of_level("moderate").replace(fibril_radius=60.0),
}


@functools.cache
def spectra():
    """Reflectances of all irides at 81 wavelengths."""
    one = jax.vmap(lambda iris: ij.reflectance(iris, BAND_GRID, solver=ij.IlitExact(12)).values)
    return np.asarray(quick_jit(one)(stack(IRIDES.values())))


@pytest.mark.parametrize("illuminant", ["D65", "A"])
def test_colours_as_of_81_wavelengths(illuminant):
    from colour.difference import delta_E_CIE2000

    bands = colour_bands(illuminant)
    assert len(bands.wavelengths) == 10 and bands.channels == ("R", "G", "B")
    at = np.searchsorted(BAND_GRID, bands.wavelengths)
    np.testing.assert_array_equal(BAND_GRID[at], bands.wavelengths)
    for name, values in zip(IRIDES, spectra(), strict=True):
        true = ij.colour_of(BAND_GRID, values, illuminant=illuminant).srgb_linear
        found = np.asarray(bands.weights @ values[at])
        assert delta_E_CIE2000(lab_of_linear(np.asarray(true)), lab_of_linear(found)) < 0.5, name


def test_white_is_white():
    """A perfect white is no iris: the bands know it to 2 %."""
    for illuminant in ("D65", "A", "FL11"):
        np.testing.assert_allclose(colour_bands(illuminant).weights.sum(1), 1, atol=0.02)


def test_haze_of_the_cornea_counts_twice():
    cornea = Cornea(scatter=jnp.asarray(21e8))
    x = np.array([420.0, 560.0, 700.0])
    clear, hazy = (np.diag(spectral_bands(x, "A", c).weights) for c in (None, cornea))
    np.testing.assert_allclose(clear, illuminant_power("A", x))
    np.testing.assert_allclose(hazy / clear, 10.0 ** (-2 * (0.016 + 21e8 / x**4)))
    warm = np.asarray(colour_bands("D65", cornea=cornea).weights).sum(1)
    assert warm[2] < warm[1] < 1
    # A cornea that scatters nothing is no filter.
    np.testing.assert_array_equal(
        colour_bands(cornea=Cornea(scatter=None)).weights, colour_bands().weights
    )


def test_unknown_illuminants_are_named():
    with pytest.raises(ValueError, match="moon"):
        colour_bands("moon")
