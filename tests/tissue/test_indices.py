import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from irisjax.tissue.indices import (
    COLLAGEN_FRACTION,
    gladstone_dale,
    scatterer_density,
    scattering_lb06,
    scattering_rayleigh_spheres,
)


def test_indices_of_the_paper():
    n = ij.Iris().indices()
    assert n.abl == pytest.approx(1.473333, abs=5e-7)
    assert n.stroma == pytest.approx(1.472793, abs=5e-7)
    assert (float(n.aqueous), float(n.ipe)) == (1.336, 1.5)
    assert pytest.approx(0.906900, abs=5e-7) == COLLAGEN_FRACTION
    assert [gladstone_dale(1.42, f, 1.5) for f in (0.0, 1.0)] == [1.5, 1.42]


def test_scattering_as_printed(bits):
    fibrils = jnp.asarray(30.0), jnp.asarray(COLLAGEN_FRACTION), 1.47, 1.5
    mu = scattering_lb06(jnp.asarray([400.0, 500.0, 600.0]), *fibrils)
    # rel: half a unit of the sixth place printed in ilit.md.
    np.testing.assert_allclose(mu, [0.631629, 0.258715, 0.124766], rtol=4.1e-6)


def test_scattering_of_spheres_by_hand():
    """24π³ n⁴ f V λ⁻⁴ ((m²−1)/(m²+2))² at 500 nm, worked in mm."""
    m, volume, wavelength = 1.47 / 1.5, 4 / 3 * np.pi * (30e-6) ** 3, 500e-6
    contrast = (m * m - 1) / (m * m + 2)
    expected = 24 * np.pi**3 * 1.5**4 * 0.9069 * volume / wavelength**4 * contrast**2
    fibrils = jnp.asarray(30.0), jnp.asarray(0.9069), 1.47, 1.5
    found = scattering_rayleigh_spheres(jnp.asarray([500.0]), *fibrils)
    assert found[0] == pytest.approx(expected, rel=1e-12)
    density = scatterer_density(30e-6, 0.9069)
    assert density == pytest.approx(0.9069 / 1.1309733552923255e-13, rel=1e-12)


def test_order_is_static_unless_an_index_is_traced():
    """Else every critical angle would be compiled for, and gradients of pigments would be slow."""
    order, orders = ij.Iris().order, []
    assert list(vars(order).values()) == [True, False, False]
    assert ij.Iris().indices().agree(order)
    assert not ij.Iris(ipe_index=1.45).indices().agree(order)

    @jax.jit
    def f(eumelanin, index):
        orders.append(ij.Iris().replace(eumelanin=eumelanin).order)
        orders.append(ij.Iris(ipe_index=index).order)
        return index

    f(1.0, 1.5)
    assert orders[0] == order
    assert all(vars(orders[1]).values())
