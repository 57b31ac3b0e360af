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
        how = self.solver, layers.indices, light, key
        depths = eqx.tree_at(lambda each: each.indices, layers, None)
        found, brdf = _by_wavelength(_solution, how, depths)
        return found if brdf is None else dataclasses.replace(found, brdf=brdf.T)


def _solution(how, depths: Layers) -> tuple[Solution, Array | None]:
    solver, indices, light, key = how
    layers = eqx.tree_at(lambda each: each.indices, depths, indices, is_leaf=lambda x: x is None)
    found = solver.solve(layers, light, key=key)
    brdf = None if found.brdf is None else found.brdf.T
    return dataclasses.replace(found, brdf=None), brdf


@eqx.filter_custom_jvp
def _by_wavelength(run, how, depths):
    """`run(how, depths)`, with derivatives from one forward pass for each array of `depths`.

    The arrays have shape (wavelengths,), and a value depends on those of its own wavelength only.
    The last axis of what `run` returns is that of wavelengths. Derivatives with respect to `how`
    are refused. Reverse mode works whatever loops there are inside.
    """
    return run(how, depths)


@_by_wavelength.def_jvp
def _by_wavelength_jvp(primals, tangents):
    run, how, depths = primals
    _, moved, slopes = tangents
    if any(t is not None for t in jax.tree.leaves(moved)):
        raise NotImplementedError(
            "derivatives by indices or incidence are not part of an inversion"
        )
    each, structure = jax.tree.flatten(depths)
    slopes = structure.flatten_up_to(slopes)
    active = [i for i, slope in enumerate(slopes) if slope is not None]
    # One program for all: compiling is what takes long here.
    directions = jnp.eye(len(each), dtype=each[0].dtype)[np.array(active)]

    def along(direction):
        ones = (jnp.full_like(x, d) for x, d in zip(each, direction, strict=True))
        return eqx.filter_jvp(partial(run, how), (depths,), (structure.unflatten(ones),))

    values, derivatives = eqx.filter_vmap(along)(directions)
    # Alike along every direction; a status comes out of a batched loop as many times.
    values = jax.tree.map(lambda v: v[0], values)

    def total(derivative):
        if derivative is None:
            return None
        rows = (1,) * (derivative.ndim - 2) + (-1,)
        return sum(derivative[k] * jnp.reshape(slopes[i], rows) for k, i in enumerate(active))

    return values, jax.tree.map(total, derivatives, is_leaf=lambda x: x is None)
