"""The table that comes with the package."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from irisjax.transport.defaults import table_for


@pytest.mark.slow  # makes a table; the quick form is below
def test_the_table_that_is_shipped_is_the_one_that_is_built():
    read, built = (
        table_for(ij.Iris().indices(), ij.ILIT_2006),
        ij.IlitTabulated.build(ij.Iris().indices()),
    )
    np.testing.assert_allclose(read.abl, built.abl, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(read.stroma, built.stroma, rtol=1e-12, atol=1e-14)
    assert read.error == pytest.approx(built.error, rel=0.1)
    assert jax.tree.structure(read.process) == jax.tree.structure(built.process)


def test_the_table_that_is_shipped_agrees_with_the_exact_solver():
    iris = ij.Iris.of_level("low")
    grid = np.array([400.0, 550.0, 700.0])
    by_table = ij.reflectance(iris, grid, solver=table_for(iris.indices(), ij.ILIT_2006))
    exact = ij.reflectance(iris, grid, solver=ij.IlitExact(40))
    np.testing.assert_allclose(by_table.values, exact.values, rtol=1e-9)


def test_another_iris_gets_its_own_table():
    indices = ij.Iris().indices(jnp.asarray(1.34))
    assert float(table_for(indices, ij.ILIT_2006).indices.aqueous) == 1.34
