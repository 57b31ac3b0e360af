import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from irisjax.tissue.pigments import PIGMENTS, common_range, table_range

LN10 = 2.302585092994046


@pytest.mark.parametrize(
    ("pigment", "wavelength", "expected"),
    [
        # OMLC rows, cm⁻¹/(mg/ml), Napierian: a tenth of them in mm⁻¹.
        ("eumelanin", 483.36, 0.8937),
        ("eumelanin", 550.7, 0.5758),
        ("pheomelanin", 481.61, 0.6054),
        ("pheomelanin", 403.2, 1.189),
        # Half-way between the rows (483.36, 8.937) and (523.76, 6.995).
        ("eumelanin", 503.56, 0.7966),
        ("pheomelanin", 491.72, 0.5521),
        # Prahl: cm⁻¹/M, decadic; × ln 10 × 0.1 × 1e-3 gives mm⁻¹/(mmol/l).
        ("oxyhemoglobin", 400, 61.3021834),
        ("oxyhemoglobin", 500, 4.81995532),
        ("deoxyhemoglobin", 560, 12.3851447),
        ("oxyhemoglobin", 700, 0.0667749677),
        # cm⁻¹/(mg/ml), decadic.
        ("lutein", 400, 21.5504004501),
        ("zeaxanthin", 500, 15.8348546587),
    ],
)
def test_rows_of_the_tables(pigment, wavelength, expected):
    found = getattr(ij.extinction(np.array([float(wavelength)])), pigment)[0]
    assert found == pytest.approx(expected, rel=2e-9)


def test_tables_cover_the_visible():
    found = ij.extinction(ij.wavelengths(380, 780, 1))
    for pigment in PIGMENTS:
        low, high = table_range(pigment)
        assert low <= 380 < 780 <= high
        assert (np.asarray(getattr(found, pigment)) > 0).all()


def test_out_of_range_names_table_and_range():
    """The first table that ends is named."""
    for pigment in PIGMENTS:
        low, high = table_range(pigment)
        for bad in (low - 1, high + 1, np.nan):
            with pytest.raises(ValueError, match=r"nm is outside the \w+ table \(.* to .* nm\)"):
                ij.extinction(np.array([bad]))
    wanted = r"^wavelength 345 nm is outside the lutein table \(350 to 800 nm\)$"
    with pytest.raises(ValueError, match=wanted):
        ij.extinction(np.array([400.0, 345.0]))
    assert np.isfinite(ij.extinction(np.array(common_range())).eumelanin).all()


def test_traced_wavelengths_agree_with_concrete_ones():
    """Beyond a table there is no extinction."""
    grid = jnp.asarray(ij.wavelengths(381, 779, 2.0))
    beyond = grid.at[0].set(345.0).at[-1].set(jnp.nan)
    concrete, run = ij.extinction(grid), jax.jit(ij.extinction)
    for a, b in zip(jax.tree.leaves(concrete), jax.tree.leaves(run(grid)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-14)
    assert np.flatnonzero(np.isnan(run(beyond).lutein)).tolist() == [0, grid.size - 1]


def test_precision(bits):
    dtype = np.float64 if bits == 64 else np.float32
    assert ij.extinction(np.array([500.0])).lutein.dtype == dtype
