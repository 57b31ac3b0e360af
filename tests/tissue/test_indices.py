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


def test_gladstone_dale_ends():
    assert gladstone_dale(1.42, 0.0, 1.5) == 1.5
    assert gladstone_dale(1.42, 1.0, 1.5) == 1.42


def test_scattering_as_printed(bits):
    mu = scattering_lb06(
        jnp.asarray([400.0, 500.0, 600.0]),
        jnp.asarray(30.0),
        jnp.asarray(COLLAGEN_FRACTION),
        1.47,
        1.5,
    )
    # rel: half a unit of the sixth place printed in ilit.md.
    np.testing.assert_allclose(mu, [0.631629, 0.258715, 0.124766], rtol=4.1e-6)


def test_scattering_of_spheres_by_hand():
    """24π³ n⁴ f V λ⁻⁴ ((m²−1)/(m²+2))² at 500 nm, worked in mm."""
    m, volume, wavelength = 1.47 / 1.5, 4 / 3 * np.pi * (30e-6) ** 3, 500e-6
    expected = (
        24 * np.pi**3 * 1.5**4 * 0.9069 * volume / wavelength**4 * ((m * m - 1) / (m * m + 2)) ** 2
    )
    found = scattering_rayleigh_spheres(
        jnp.asarray([500.0]), jnp.asarray(30.0), jnp.asarray(0.9069), 1.47, 1.5
    )
    assert found[0] == pytest.approx(expected, rel=1e-12)


def test_density():
    assert scatterer_density(30e-6, 0.9069) == pytest.approx(
        0.9069 / 1.1309733552923255e-13, rel=1e-12
    )


def test_order_is_static_for_concrete_indices():
    order = ij.Iris().order
    assert order.abl_over_stroma
    assert not order.stroma_over_abl
    assert not order.stroma_over_ipe


def test_order_survives_replacing_other_fields_inside_a_program():
    """Else every critical angle would be compiled for, and gradients of pigments would be many
    times slower.
    """
    orders = []

    @jax.jit
    def f(eumelanin):
        orders.append(ij.Iris().replace(eumelanin=eumelanin).order)
        return eumelanin

    f(1.0)
    assert orders == [ij.Iris().order]


def test_every_order_is_possible_for_traced_indices():
    orders = []

    @jax.jit
    def f(n):
        orders.append(ij.Iris(ipe_index=n).order)
        return n

    f(1.5)
    assert all(vars(orders[0]).values())


def test_agree():
    order = ij.Iris().order
    assert ij.Iris().indices().agree(order)
    assert not ij.Iris(ipe_index=1.45).indices().agree(order)
