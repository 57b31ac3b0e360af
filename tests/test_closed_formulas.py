"""Closed formulas: limits, slopes, and the equations they solve."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import quick_jit
from experiments.closed_formulas import BeerLambert, FirstOrder, KubelkaMunk

GRID = ij.wavelengths(400, 700, 10)
ANALYTIC = [BeerLambert(), KubelkaMunk(), FirstOrder()]


@pytest.mark.parametrize("solver", ANALYTIC, ids=lambda s: type(s).__name__)
def test_analytic_models_have_their_limits(solver):
    iris = ij.Iris.of_level("low")
    pigments = "eumelanin pheomelanin oxyhemoglobin deoxyhemoglobin lutein zeaxanthin"
    clear = dict.fromkeys(pigments.split(), 0.0)
    odd = {"eumelanin": 1e3}, {"stroma_thickness": 0.0}, {"collagen_index": 1.5}
    for fields in ({}, clear, *odd):
        r = ij.reflectance(iris.replace(**fields), GRID, solver=solver)
        values = np.asarray(r.values) - np.asarray(r.mirrored)
        assert ((values >= 0) & (values <= 1)).all()
        if fields.get("eumelanin") == 1e3:
            assert values.max() < 1e-6
        if "collagen_index" in fields and not isinstance(solver, BeerLambert):
            assert values.max() < 1e-12  # nothing scatters

    def total(eumelanin):
        return ij.reflectance(iris.replace(eumelanin=eumelanin), GRID, solver=solver).values.sum()

    assert float(quick_jit(jax.grad(total))(0.1)) < 0


def one_layer(absorption, scattering):
    """A stroma of 1 mm."""
    depths = (jnp.array([x]) for x in (0.0, absorption, scattering))
    indices = ij.Iris().indices()
    return ij.Layers(*depths, indices=indices, order=indices.order())


def test_kubelka_munk_is_the_two_stream_equations():
    """dI/dx = −(S+K)I + SJ, −dJ/dx = −(S+K)J + SI on black, integrated by scipy."""
    from scipy.integrate import solve_bvp

    k, s = 0.7, 0.4
    layers = one_layer(k / 2, s / 0.75)
    ode = solve_bvp(
        lambda x, y: np.stack([-(s + k) * y[0] + s * y[1], (s + k) * y[1] - s * y[0]]),
        lambda a, b: np.array([a[0] - 1, b[1]]), np.linspace(0, 1, 21), np.ones((2, 21)), tol=1e-10,
    )  # fmt: skip
    assert float(KubelkaMunk().inner(layers)[0]) == pytest.approx(ode.y[1, 0], rel=1e-8)


def test_single_scattering_of_a_thin_layer():
    """Half of what a thin layer scatters goes up."""
    layers = one_layer(0.0, 1e-6)
    assert float(FirstOrder().inner(layers)[0]) == pytest.approx(0.5e-6, rel=1e-5)
    assert float(KubelkaMunk().inner(layers)[0]) == pytest.approx(0.75e-6, rel=1e-5)
