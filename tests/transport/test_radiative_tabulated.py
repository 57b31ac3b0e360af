"""Radiative transfer by table: against the exact solver, at the ends of its axes, and beyond."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import filled, quick_jit
from experiments.radiative_table import build
from irisjax.tissue.layers import Layers
from irisjax.transport.defaults import quickest, table_for

pytestmark = pytest.mark.peer

GRID = np.array([400.0, 480.0, 560.0, 640.0, 700.0])
EXACT = ij.RadiativeExact(24, 8, 5)
IRIDES = {
    "low": {"eumelanin": 0.12, "pheomelanin": 0.02},
    "high": {"eumelanin": 1.0, "pheomelanin": 0.27},
    "no-abl": {"abl_thickness": 0.0},
    "all-in-abl": {"abl_fraction": 1.0},
    "none-in-abl": {"abl_fraction": 0.0},
    "no-pigment": {"eumelanin": 0.0, "pheomelanin": 0.0, "oxyhemoglobin": 0.0},
    "much-scattering": {"scattering_scale": 3.0},
    "bundles-of-fibrils": {"scattering_scale": 40.0, "stroma_thickness": 0.5},
    "bundles-without-pigment": {"scattering_scale": 40.0, "melanin_load": 0.0},
    "next-to-none": {"scattering_scale": 0.01},
}


@pytest.fixture(scope="module")
def table():
    with jax.enable_x64(True):
        return table_for(ij.Iris().indices(), ij.DEPTH_RESOLVED)


@jax.jit
def both(iris, cosine, table):
    with_table, exact = (
        ij.reflectance(iris, GRID, solver=s, cos_incidence=cosine, throw=False)
        for s in (table, EXACT)
    )
    return (with_table.values, with_table.absorbed), (exact.values, exact.absorbed)


@pytest.mark.parametrize("name", IRIDES)
def test_agrees_with_the_exact_solver(table, name):
    iris = ij.Iris.of_level("low").replace(**IRIDES[name])
    for cosine in (1.0, 0.4, 0.02):
        (found, absorbed), (exact, expected) = both(iris, cosine, table)
        # The error that the table measured of itself, where it was looked for.
        np.testing.assert_allclose(found, exact, rtol=3 * table.error)
        for layer in ("abl", "stroma", "ipe"):
            np.testing.assert_allclose(
                getattr(absorbed, layer), getattr(expected, layer), rtol=0, atol=5e-5
            )


def test_diffuse_light_and_energy(table):
    iris = ij.Iris.of_level("low")

    @quick_jit
    def diffuse(iris, solver):
        return ij.reflectance(iris, GRID, solver=solver, cos_incidence=ij.DIFFUSE)

    found, exact = (diffuse(iris, s) for s in (table, EXACT))
    np.testing.assert_allclose(found.values, exact.values, rtol=3 * table.error)
    np.testing.assert_allclose(found.values + found.absorbed.total(), 1, rtol=1e-12)


def test_slopes_are_those_of_the_exact_solver(table):
    def brightness(values, solver):
        load, fraction, scale, cosine = values
        iris = ij.Iris.of_level("low").replace(
            melanin_load=load, abl_fraction=fraction, scattering_scale=scale
        )
        return ij.reflectance(
            iris, GRID, solver=solver, cos_incidence=cosine, throw=False
        ).values.sum()

    at, step = np.array([0.1, 0.3, 1.1, 0.8]), 1e-3
    found = jax.jit(jax.grad(brightness))(jnp.asarray(at), table)
    value = quick_jit(lambda values: brightness(values, EXACT))
    ends = np.array([[value(at + h * unit) for h in (step, -step)] for unit in np.eye(4)])
    np.testing.assert_allclose(found, (ends[:, 0] - ends[:, 1]) / (2 * step), rtol=2e-4)


@jax.jit
def solve(table, layers):
    return table.solve(layers, ij.Light(0.9))


def solved(table, abl, absorption, scattering, indices=None):
    depths = (
        jnp.atleast_1d(jnp.asarray(x, jnp.result_type(float)))
        for x in (abl, absorption, scattering)
    )
    indices = table.indices if indices is None else indices
    depths = (filled(x, 4) for x in jnp.broadcast_arrays(*depths))
    return solve(table, Layers(*depths, indices, indices.order()))


def test_what_is_deeper_than_the_table_is_alike(table):
    depth = np.array([20.0, 30.0, 1e3, 1e6])
    for albedo in (0.02, 0.89):
        found = solved(table, 0.05, (1 - albedo) * depth, albedo * depth)
        assert bool(found.status == ij.RESULTS.successful)
        np.testing.assert_allclose(found.reflectance, found.reflectance[-1], rtol=2e-5)
    dark = solved(table, np.array([19.0, 50.0, 1e6]), 0.5, 0.1)
    assert np.isfinite(dark.reflectance).all() and (np.diff(dark.reflectance) <= 0).all()
    np.testing.assert_allclose(dark.energy, 1, rtol=1e-12)


def test_empty_layers_are_the_interfaces_alone(table):
    found = solved(table, [0.0, 0.0, 0.3], [0.0, 0.5, 0.0], 0.0)
    assert np.isfinite(found.reflectance).all()
    np.testing.assert_allclose(found.absorbed.abl[:2], 0, atol=1e-15)
    np.testing.assert_allclose(found.absorbed.stroma[::2], 0, atol=1e-15)
    np.testing.assert_allclose(found.energy, 1, rtol=1e-12)
    thin = solved(table, 0.01, 0.01, [1e-12, 1e-9]).reflectance
    without = solved(table, 0.01, 0.01, 0.0).reflectance
    np.testing.assert_allclose(
        (thin[1] - without) / 1e-9, (thin[1] - thin[0]) / (1e-9 - 1e-12), rtol=1e-4
    )


def test_what_the_table_does_not_hold_is_said(table):
    inside, outside = (solved(table, 0.1, 0.0, s).status for s in (25.0, 25.1))
    assert bool(inside == ij.RESULTS.successful)
    assert bool(outside == ij.RESULTS.outside_table)
    other = ij.Iris(ipe_index=1.51).indices()
    assert bool(solved(table, 0.1, 0.1, 0.1, other).status == ij.RESULTS.outside_table)


@pytest.mark.parametrize("cosine", [1.0, 0.5, 0.2])
def test_brdf_agrees_with_the_exact_solver(table, cosine):
    exits = np.cos(np.radians([0.0, 30.0, 60.0, 75.0, 80.0, 80.0]))
    azimuth = np.array([0.0, 1.0, np.pi, 0.0, 2.0, np.pi])
    for level, scale in (("low", 1.0), ("high", 1.0), ("low", 40.0)):
        iris = ij.Iris.of_level(level).replace(scattering_scale=scale)
        found, exact = (angular(iris, cosine, exits, azimuth, s) for s in (table, EXACT))
        np.testing.assert_allclose(found, exact, rtol=1e-3)


@quick_jit
def angular(iris, cosine, exits, azimuth, solver):
    seen = {"cos_incidence": cosine, "cos_exit": exits, "azimuth": azimuth}
    return ij.brdf(iris, GRID, solver=solver, **seen).values


def test_brdf_of_empty_layers_is_none(table):
    iris, exits = ij.Iris.of_level("low").replace(stroma_thickness=0.0), np.linspace(0.3, 1.0, 6)
    np.testing.assert_array_equal(angular(iris, 1.0, exits, np.zeros(6), table), 0)


def test_single_precision(table):
    with jax.enable_x64(False):
        narrow = table_for(ij.Iris().indices(), ij.DEPTH_RESOLVED)
        iris = ij.Iris.of_level("low")
        found = ij.reflectance(iris, GRID, solver=narrow).values
        assert found.dtype == jnp.float32
    exact = both(ij.Iris.of_level("low"), 1.0, table)[1][0]
    np.testing.assert_allclose(found, exact, rtol=3 * narrow.error)


@pytest.mark.slow  # makes a table
def test_the_table_that_is_shipped_is_the_one_that_is_built(table):
    built = build(ij.Iris().indices())
    assert built.error == pytest.approx(table.error, rel=0.01)
    assert built.error < 1.2e-5
    by_both = (solved(t, 0.07, [0.3, 3.0], 0.2).reflectance for t in (built, table))
    np.testing.assert_allclose(*by_both, rtol=1e-6)  # stored in single precision


def test_other_media_are_solved_exactly():
    iris = ij.Iris(ipe_index=1.3)
    with pytest.raises(ValueError, match="has LB06's indices; use RadiativeExact"):
        table_for(iris.indices(), ij.DEPTH_RESOLVED)
    assert isinstance(quickest(iris, 1.336, ij.DEPTH_RESOLVED), ij.RadiativeExact)
