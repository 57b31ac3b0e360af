"""What is multiplied in single precision on a graphics processor."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import export

import irisjax as ij
from irisjax.transport.defaults import table_for

pytestmark = pytest.mark.peer

SOLVERS = {
    "ILIT, exact": lambda: ij.IlitExact(4),
    "ILIT, tabulated": lambda: table_for(ij.Iris().indices(), ij.ILIT_2006),
    "radiative transfer, exact": lambda: ij.RadiativeExact(4, 4, 1),
    "radiative transfer, tabulated": lambda: table_for(ij.Iris().indices(), ij.DEPTH_RESOLVED),
    "radiative transfer, by doubling": lambda: ij.AddingDoubling(4, 4),
}


def reflectance_by(name):
    """A function of the load of melanin, its solver made in the precision of the moment."""
    grid, solver = np.array([450.0, 550.0]), SOLVERS[name]()

    def reflectance(load):
        iris = ij.Iris(eumelanin=load)
        return ij.reflectance(iris, grid, solver=solver, throw=False).values.sum()

    return reflectance


@pytest.mark.parametrize("name", SOLVERS)
def test_products_keep_all_bits(name):
    """Lowered for a GPU, which need not be there: no product may round its factors to TF32."""
    with jax.enable_x64(False):
        run = jax.jit(jax.value_and_grad(reflectance_by(name)))
        text = export.export(run, platforms=["cuda"])(jnp.float32(1.0)).mlir_module()
    products = re.findall(r"stablehlo\.dot_general.*", text)
    assert products
    assert not [p for p in products if "HIGHEST" not in p]


@pytest.mark.parametrize("name", SOLVERS)
def test_constants_follow_the_precision(name):
    """JAX keeps a NumPy array in the precision in which it met it first, while that lives in a
    program. What is computed in double precision afterwards must hold no single one.
    """

    def program():
        return jax.jit(reflectance_by(name)).trace(jnp.ones((), jnp.result_type(float)))

    with jax.enable_x64(False):
        single = program()
    double = program().lower().as_text()
    assert "f32>" in single.lower().as_text()
    assert "f64>" in double
    assert "f32>" not in double
