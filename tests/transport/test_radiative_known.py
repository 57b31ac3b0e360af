"""Radiative transfer of known scattering: against the exact solver, its refusals, its derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from irisjax.tissue.layers import Layers
from irisjax.transport.pointwise import Pointwise
from irisjax.transport.radiative import shipped
from irisjax.transport.radiative.known import of_known_scattering
from irisjax.transport.solution import RESULTS

SCATTERING = np.array([0.008, 0.03, 0.12, 0.3, 0.6])
EXACT = ij.RadiativeExact(32, 8, 1)


def layers_of(abl, absorption, scattering=SCATTERING):
    indices = ij.Iris().indices()
    depths = (jnp.broadcast_to(jnp.asarray(x), SCATTERING.shape) for x in (abl, absorption))
    return Layers(*depths, jnp.asarray(scattering), indices, indices.order())


def solver_at(cosine):
    return of_known_scattering(shipped.table(ij.Iris().indices()), SCATTERING, cosine)


@jax.jit
def solved(solver, layers, cosine):
    return solver.solve(layers, ij.Light(cosine))


@pytest.mark.parametrize("cosine", [1.0, 0.4, 0.02])
def test_agrees_with_the_exact_solver_at_every_absorption(cosine):
    solver = solver_at(cosine)
    rng = np.random.default_rng(0)
    depths = np.exp(rng.uniform(np.log(1e-4), np.log(8.0), (12, 2, SCATTERING.size)))
    depths[:4] = [[[0.0], [0.0]], [[0.0], [1.0]], [[1.0], [0.0]], [[18.0], [14.0]]]
    for abl, absorption in depths:
        layers = layers_of(abl, absorption)
        found, table, exact = (solved(s, layers, cosine) for s in (solver, solver.table, EXACT))
        assert found.status == RESULTS.successful
        np.testing.assert_allclose(found.reflectance, table.reflectance, rtol=2e-5, atol=1e-11)
        # Relative where something comes back: of a hundred thousandth of the light, 1e-7 of it.
        np.testing.assert_allclose(found.reflectance, exact.reflectance, rtol=2.5e-5, atol=1e-7)
        for layer in ("abl", "stroma", "ipe"):
            np.testing.assert_allclose(
                getattr(found.absorbed, layer), getattr(exact.absorbed, layer), atol=5e-5
            )


@pytest.mark.parametrize("depth", [20.0, 100.0, 1e6])
def test_a_stroma_deeper_than_the_table(depth):
    layers = layers_of(0.1, depth)
    found, exact = (solved(s, layers, 1.0) for s in (solver_at(1.0), ij.AddingDoubling()))
    np.testing.assert_allclose(found.reflectance, exact.reflectance, rtol=2e-4)


def test_other_scattering_incidence_or_media_are_outside():
    solver, layers = solver_at(1.0), layers_of(0.1, 0.1)
    assert solved(solver, layers_of(0.1, 0.1, SCATTERING * 1.001), 1.0).status == (
        RESULTS.outside_table
    )
    assert solved(solver, layers, 0.9).status == RESULTS.outside_table
    other = ij.Iris(ipe_index=1.45).indices()
    moved = Layers(*(jnp.full(5, 0.1),) * 2, jnp.asarray(SCATTERING), other, other.order())
    assert solved(solver, moved, 1.0).status != RESULTS.successful


def test_what_it_does_not_do_is_refused():
    solver, layers = solver_at(1.0), layers_of(0.1, 0.1)
    with pytest.raises(ValueError, match="one direction"):
        solver.solve(layers, ij.Light(None))
    with pytest.raises(ValueError, match="one direction"):
        solver.solve(layers, ij.Light(1.0, ij.Directions(1.0)))
    with pytest.raises(ValueError, match="5 wavelengths"):
        solver.solve(jax.tree.map(lambda x: x[:2] if x.ndim else x, layers), ij.Light(1.0))
    for factor in (0.1, 1.1):
        with pytest.raises(ValueError, match="not between"):
            of_known_scattering(shipped.table(ij.Iris().indices()), SCATTERING * factor, 1.0)


def test_derivatives_are_those_of_the_exact_solver_and_none_by_scattering():
    quick, exact = Pointwise(solver_at(1.0)), Pointwise(EXACT)

    def slopes(solver):
        def of(x):
            return solver.solve(layers_of(x[0], x[1]), ij.Light(1.0)).reflectance

        return jax.jit(jax.jacfwd(of))(jnp.asarray([0.3, 0.2]))

    np.testing.assert_allclose(slopes(quick), slopes(exact), rtol=1e-4, atol=1e-8)

    def by_scattering(factor):
        layers = layers_of(0.3, 0.2, jnp.asarray(SCATTERING) * factor)
        return quick.solve(layers, ij.Light(1.0)).reflectance

    with pytest.raises(NotImplementedError, match="scattering that is known"):
        jax.jvp(by_scattering, (1.0,), (1.0,))


def test_single_precision(float32):
    solver = solver_at(1.0)
    assert solver.weights.dtype == jnp.float32
    found = solved(solver, layers_of(0.2, 0.3), 1.0).reflectance
    with jax.enable_x64(True):
        exact = solved(EXACT, layers_of(0.2, 0.3), 1.0).reflectance
    np.testing.assert_allclose(found, exact, rtol=5e-5)
