"""The table that comes with the package."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from irisjax.transport.ilit import shipped


def test_the_table_that_is_shipped_is_the_one_that_is_built():
    read, built = shipped.table(ij.Iris().indices()), ij.IlitTabulated.build(ij.Iris().indices())
    np.testing.assert_allclose(read.abl, built.abl, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(read.stroma, built.stroma, rtol=1e-12, atol=1e-14)
    assert read.error == pytest.approx(built.error, rel=0.1)
    assert jax.tree.structure(read.process) == jax.tree.structure(built.process)


def test_the_table_that_is_shipped_agrees_with_the_exact_solver():
    iris = ij.Iris.of_level("low")
    grid = np.array([400.0, 550.0, 700.0])
    by_table = ij.reflectance(iris, grid, solver=shipped.table(iris.indices()))
    exact = ij.reflectance(iris, grid, solver=ij.IlitExact(40))
    np.testing.assert_allclose(by_table.values, exact.values, rtol=1e-9)


def test_another_iris_gets_its_own_table():
    indices = ij.Iris().indices(jnp.asarray(1.34))
    assert float(shipped.table(indices).indices.aqueous) == 1.34
