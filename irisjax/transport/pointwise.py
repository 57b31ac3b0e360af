"""Derivatives at the price of three: a value depends on its own wavelength's depths only."""

import dataclasses
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from irisjax._types import PRNGKey
from irisjax.tissue.layers import Layers
from irisjax.transport.light import Light
from irisjax.transport.process import AbstractProcess
from irisjax.transport.solution import Solution
from irisjax.transport.solver import AbstractSolver


class Pointwise(AbstractSolver):
    """A solver whose derivatives by any number of parameters cost three, by the layers' depths, one
    more where the epithelium lets light through, and two where a phase function has parameters.

    For inversions: derivatives by indices or incidence are refused, and so are polarised BRDFs.
    """

    solver: AbstractSolver
    process: AbstractProcess

    def __init__(self, solver: AbstractSolver):
        self.solver, self.process = solver, solver.process

    def prepare(self, layers: Layers, light: Light) -> "Pointwise":
        return Pointwise(self.solver.prepare(layers, light))

    @property
    def numbers_per_wavelength(self) -> int:
        return self.solver.numbers_per_wavelength

    def solve(self, layers: Layers, light: Light, *, key: PRNGKey | None = None) -> Solution:
        if light.exits is not None and self.process.polarised:
            raise ValueError("Pointwise has no polarised BRDF; it needs the solver itself")
        context = self.solver, layers.indices, light, key
        depths = eqx.tree_at(lambda tree: tree.indices, layers, None)
        solution, brdf = _by_wavelength(_solution, context, depths)
        return solution if brdf is None else dataclasses.replace(solution, brdf=brdf.T)


def _solution(context, depths: Layers) -> tuple[Solution, Array | None]:
    solver, indices, light, key = context
    layers = eqx.tree_at(lambda tree: tree.indices, depths, indices, is_leaf=lambda x: x is None)
    solution = solver.solve(layers, light, key=key)
    brdf = None if solution.brdf is None else solution.brdf.T
    return dataclasses.replace(solution, brdf=None), brdf


@eqx.filter_custom_jvp
def _by_wavelength(run, context, depths):
    """`run(context, depths)`, with derivatives from one forward pass for each array of `depths`.

    The arrays have shape (wavelengths,), and a value depends on those of its own wavelength only.
    The last axis of what `run` returns is that of wavelengths. Derivatives by the `context` are
    refused. Reverse mode works whatever loops there are inside.
    """
    return run(context, depths)


@_by_wavelength.def_jvp
def _by_wavelength_jvp(primals, tangents):
    run, context, depths = primals
    _, context_slopes, slopes = tangents
    if any(t is not None for t in jax.tree.leaves(context_slopes)):
        raise NotImplementedError(
            "derivatives by indices or incidence are not part of an inversion"
        )
    arrays, structure = jax.tree.flatten(depths)
    slopes = structure.flatten_up_to(slopes)
    active = [i for i, slope in enumerate(slopes) if slope is not None]
    # One program for all: compiling is what takes long here.
    directions = jnp.eye(len(arrays), dtype=arrays[0].dtype)[np.array(active)]

    def derivative_along(direction):
        ones = (jnp.full_like(x, d) for x, d in zip(arrays, direction, strict=True))
        return eqx.filter_jvp(partial(run, context), (depths,), (structure.unflatten(ones),))

    values, derivatives = eqx.filter_vmap(derivative_along)(directions)
    # Alike along every direction; a status comes out of a batched loop as many times.
    values = jax.tree.map(lambda v: v[0], values)

    def total(derivative):
        if derivative is None:
            return None
        rows = (1,) * (derivative.ndim - 2) + (-1,)
        return sum(derivative[k] * jnp.reshape(slopes[i], rows) for k, i in enumerate(active))

    return values, jax.tree.map(total, derivatives, is_leaf=lambda x: x is None)
