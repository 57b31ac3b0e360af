"""The tables: their certified error, and what happens outside of what they were made for; the one that
comes with the package.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import irisjax as ij
from common import GRID
from edges import OF_DEPTHS
from irisjax.transport.defaults import table_for

pytestmark = pytest.mark.peer

FINE = ij.IlitExact(n_angles=64)


@jax.jit
def both(iris, tables):
    def values(solver):
        r = ij.reflectance(iris, GRID, solver=solver, throw=False)
        return r.values, r.absorbed, r.status

    return values(tables), values(FINE)


def test_error_is_certified(tabulated):
    assert 0 < tabulated.error < 1e-11


positive = st.floats(0, 3)


@settings(max_examples=40)
@given(positive, positive, st.floats(0, 1), positive, positive, st.floats(0, 0.3), st.floats(0, 2))
def test_matches_exact(tabulated, eumelanin, pheomelanin, fraction, blood, lutein, abl, stroma):
    values = (eumelanin, pheomelanin, fraction, blood, lutein, abl, stroma)
    iris = ij.Iris.of_level("low").replace(
        **{n: jnp.asarray(v) for n, v in zip(OF_DEPTHS, values, strict=True)}
    )
    (found, absorbed, status), (exact, exact_absorbed, _) = both(iris, tabulated)
    # A reflectance joins four layer functions, each with a partial derivative of at most one here,
    # twice over.
    tolerance = 8 * tabulated.error
    np.testing.assert_allclose(found, exact, rtol=0, atol=tolerance)
    for name in ("abl", "stroma", "ipe"):
        np.testing.assert_allclose(
            getattr(absorbed, name), getattr(exact_absorbed, name), rtol=0, atol=2 * tolerance
        )
    assert bool(status == ij.RESULTS.successful)


def test_depth_resolved_cannot_be_tabulated():
    message = "IlitTabulated treats Ilit processes, not RadiativeTransfer"
    with pytest.raises(ValueError, match=message):
        ij.IlitTabulated.build(process=ij.DEPTH_RESOLVED)


def test_too_small_tables_are_refused():
    with pytest.raises(ValueError, match=r"are tabulated to .* only, not to 1.0e-11"):
        ij.IlitTabulated.build(n_intervals=8)


def test_other_indices(tabulated):
    other = ij.Iris(ipe_index=1.51)
    found = ij.reflectance(other, GRID, solver=tabulated, throw=False)
    assert bool(found.status == ij.RESULTS.outside_table)
    with pytest.raises(ValueError, match="outside the range the table was built for"):
        ij.reflectance(other, GRID, solver=tabulated)


def test_gradients_match_exact(tabulated):
    iris = ij.Iris.of_level("low")

    def slopes(solver):
        def f(x):
            changed = iris.replace(**dict(zip(OF_DEPTHS, x, strict=True)))
            return ij.reflectance(changed, GRID, solver=solver).values

        return jax.jit(jax.jacfwd(f))(jnp.stack([getattr(iris, n) for n in OF_DEPTHS]))

    exact = np.asarray(slopes(FINE))
    scale = np.abs(exact).max(0)
    # Differentiating polynomials of degree 5 costs about the inverse of an interval's relative
    # width, 1/0.05, a few times.
    np.testing.assert_allclose(
        np.asarray(slopes(tabulated)) / scale, exact / scale, rtol=0, atol=1e-8
    )


def test_incidence_and_brdf(tabulated):
    iris, exits = ij.Iris.of_level("moderate"), np.array([0.2, 0.6, 1.0])
    for cosine in (1.0, 0.2):
        found = ij.brdf(iris, GRID, cos_incidence=cosine, cos_exit=exits, solver=tabulated).values
        exact = ij.brdf(iris, GRID, cos_incidence=cosine, cos_exit=exits, solver=FINE).values
        np.testing.assert_allclose(found, exact, rtol=0, atol=8 * tabulated.error)


def test_the_table_that_is_shipped_is_the_one_that_is_built():
    read, built = (
        table_for(ij.Iris().indices(), ij.ILIT_2006),
        ij.IlitTabulated.build(ij.Iris().indices()),
    )
    np.testing.assert_allclose(read.abl, built.abl, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(read.stroma, built.stroma, rtol=1e-12, atol=1e-14)
    assert read.error == pytest.approx(built.error, rel=0.1)
    assert jax.tree.structure(read.process) == jax.tree.structure(built.process)


def test_another_iris_gets_its_own_table(monkeypatch):
    build = ij.IlitTabulated.build
    small = functools.partial(build, n_intervals=8, tolerance=1.0)
    monkeypatch.setattr(ij.IlitTabulated, "build", small)
    indices = ij.Iris().indices(jnp.asarray(1.34))
    assert float(table_for(indices, ij.ILIT_2006).indices.aqueous) == 1.34


def test_single_precision(float32):
    tables = ij.IlitTabulated.build(process=ij.ILIT_CORRECTED)
    iris = ij.Iris.of_level("low")
    found = ij.reflectance(iris, GRID, solver=tables).values
    exact = ij.reflectance(iris, GRID, solver=ij.IlitExact(process=ij.ILIT_CORRECTED)).values
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, exact, rtol=2e-5)
