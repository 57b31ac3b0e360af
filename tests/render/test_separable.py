"""The table of texels against the exact solver itself: it errs by no more than it says."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from irisjax.render.bands import spectral_bands
from irisjax.render.integrator import solve_response
from irisjax.render.separable import Separable
from irisjax.tissue.maps import IrisMaps, Scales

X = np.array([430.0, 550.0, 650.0])
LIGHT = ij.Iris.of_level("low")
EXITS = np.array([0.02, 0.3, 0.7, 1.0])


def tabulated(integrator=None, iris=LIGHT, ranges=None, x=X):
    """Channels of their own, by default of the solver that is the truth below."""
    integrator = Separable(solver=ij.IlitExact(12)) if integrator is None else integrator
    ranges = Scales() if ranges is None else ranges
    index, bands = ij.Eye().aqueous_index, spectral_bands(x, "E")
    return solve_response(integrator, iris, index, bands, ranges)


def brdf(iris, wavelengths, exits):
    return np.asarray(ij.brdf(iris, wavelengths, cos_exit=exits, solver=ij.IlitExact(12)).values)


@eqx.filter_jit
def shown(response, *scales):
    """The BRDF at normal incidence and `EXITS`."""
    exits, one = jnp.asarray(EXITS), jnp.ones(4)
    return response.brdf(Scales(*(s if s is None else s * one for s in scales)), one, exits, one)


@pytest.mark.parametrize("level", ["low", "high"])
def test_uniform_iris(level):
    iris = ij.Iris.of_level(level)
    response = tabulated(iris=iris)
    found, true = shown(response), brdf(iris, X, EXITS)
    assert float(response.error) < 1e-3
    # The error is measured at a few exits; these are others.
    np.testing.assert_allclose(found, true, atol=2 * float(response.error) * true.max())


@pytest.mark.peer
def test_texels_with_scaled_layers_are_irides_of_their_own():
    """An ABL three times as thick, with three times the pigment, and so on."""
    ranges = Scales(abl=jnp.array([0.2, 6.0]), stroma=jnp.array([0.3, 2.0]))
    response = tabulated(ranges=ranges)
    assert float(response.error) < 2e-3
    for abl, stroma in ((3.0, 1.0), (0.25, 1.9), (5.5, 0.4), (1.0, 1.0)):
        found = shown(response, abl, stroma)
        # Concentrations of the layers are kept: m·f/h_A and m·(1 − f)/h_S with m the melanin's
        # mass.
        whole = float(LIGHT.abl_thickness + LIGHT.stroma_thickness)
        h_a, h_s = abl * float(LIGHT.abl_thickness), stroma * float(LIGHT.stroma_thickness)
        in_abl, in_stroma = 0.5 * whole * abl, 0.5 * whole * stroma
        more = (in_abl + in_stroma) / (h_a + h_s)
        iris = LIGHT.replace(
            abl_thickness=h_a,
            stroma_thickness=h_s,
            abl_fraction=in_abl / (in_abl + in_stroma),
            eumelanin=float(LIGHT.eumelanin) * more,
            pheomelanin=float(LIGHT.pheomelanin) * more,
        )
        true = brdf(iris, X, EXITS)
        np.testing.assert_allclose(found, true, atol=2e-3 * 0.1, rtol=5e-3)


@pytest.mark.peer
def test_pigment_maps_are_irides_of_their_own():
    ranges = Scales(eumelanin=jnp.array([0.0, 3.0]), pheomelanin=jnp.array([0.5, 4.0]))
    response = tabulated(ranges=ranges)
    for eu, pheo in ((0.0, 1.0), (2.9, 0.6), (1.0, 3.9)):
        found = shown(response, None, None, eu, pheo)
        iris = LIGHT.replace(
            eumelanin=eu * float(LIGHT.eumelanin), pheomelanin=pheo * float(LIGHT.pheomelanin)
        )
        true = brdf(iris, X, EXITS)
        np.testing.assert_allclose(found, true, atol=2 * float(response.error) * true.max() + 1e-12)


@pytest.mark.peer
def test_error_tells_a_table_too_coarse():
    wide = Scales(abl=jnp.array([0.0, 30.0]))

    def error(degree):
        integrator = Separable(degrees=(degree, 5, 4, 4, 3), solver=ij.IlitExact(8))
        return float(tabulated(integrator, ranges=wide, x=X[:1]).error)

    assert error(2) > 0.02 > 2e-3 > error(12)


def test_maps_become_scales():
    even = {"abl_depth": 0.1135, "stroma_depth": 0.571, "eumelanin": 1.5}
    even = {name: np.full((4, 3), value) for name, value in even.items()}
    maps = IrisMaps(**even, freckles=np.eye(4, 3))
    scales = Scales.of(maps, LIGHT)
    # Twice the ABL, and twelve times its melanin where there is a freckle.
    np.testing.assert_allclose(scales.abl, 2 * (1 + 11 * np.eye(4, 3)))
    np.testing.assert_allclose(scales.stroma, 2.0)
    assert scales.pheomelanin is None
    for found, (low, high) in ((scales.abl, (2, 24)), (scales.eumelanin, (1.5, 1.5))):
        span = scales._replace(abl=found).ranges().abl
        assert span[0] < low <= high < span[1]
    assert Scales.of(None, LIGHT) == Scales()


def test_depth_resolved_transport_is_no_separable_one():
    with pytest.raises(ValueError, match="needs ILIT"):
        Separable(solver=ij.RadiativeExact())
