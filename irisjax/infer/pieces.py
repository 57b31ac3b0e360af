"""A problem at many places at once, in pieces: all arrays of all walkers together would fall out of
the cache.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from irisjax._types import PRNGKey
from irisjax.infer.problem import Problem
from irisjax.numerics.portions import in_pieces

_ROWS = 64
"""The sampler's default walkers: a call costs as much as twenty of them beside its rows."""


class Form:
    """What of a problem is no array, with its hash: an argument of jitted functions that is cheap
    to compare.
    """

    def __init__(self, problem: Problem):
        """Keep the problem with a mark in place of every array."""
        self._marked = jax.tree.map(lambda x: ... if eqx.is_array(x) else x, problem)
        leaves, structure = jax.tree.flatten(self._marked)
        self._parts = structure, *((type(leaf), leaf) for leaf in leaves)
        self._hash = hash(self._parts)

    def __hash__(self) -> int:
        """Return the hash that was computed once."""
        return self._hash

    def __eq__(self, other: object) -> bool:
        """Compare all that is no array."""
        return self is other or (isinstance(other, Form) and self._parts == other._parts)

    def __reduce__(self) -> Any:
        """Pickle the problem alone: structures of trees have no pickle."""
        return Form, (self._marked,)

    def filled(self, arrays: list[Array]) -> Problem:
        """Return the problem with these arrays."""
        places = iter(arrays)
        return jax.tree.map(lambda x: next(places) if x is ... else x, self._marked)


def elements(problem: Problem) -> int:
    """Return the size of the largest array that one evaluation makes."""
    sizes = [max(o.wavelengths.size, o.values.shape[-1]) for o in problem.observations]
    each = max(solver.numbers_per_wavelength for solver in problem.solvers)
    # A correlated error takes a matrix.
    noise = max(sizes) ** 2 if problem.noise.discrepancy is not None else 0
    return max(noise, sum(sizes) * each)


def density(problem: Problem) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function z (n, free) → log posterior densities (n,), which is compiled once for
    all problems of the same form.
    """
    both = in_rows(_densities, problem)
    return lambda z: both(z)[0]


def pointwise(problem: Problem, z: Float[np.ndarray, "n free"]) -> Float[np.ndarray, "n all_data"]:
    """Return the log likelihoods of every value."""
    return in_rows(_densities, problem)(z)[1]


def in_rows(
    function: Callable[[list[Array], Form, Any], Any], problem: Problem, rows: int = _ROWS
) -> Callable[[np.ndarray], Any]:
    """Return `function` of any number of vectors z, so many at a time.

    To compile a program for each number would take longer than to run all of them.

    Args:
        function: Jitted function of a problem's arrays, its `Form`, and vectors (rows, free).
        problem: The problem, which is taken apart once and not at every call.
        rows: Number of vectors at a time.
    """
    problem = problem.unnamed()
    arrays, form = [x for x in jax.tree.leaves(problem) if eqx.is_array(x)], Form(problem)

    def each(z: np.ndarray) -> Any:
        z = np.asarray(z)
        count = len(z)
        # Copies of the last: whatever is finite there has finite copies.
        z = np.pad(z, [(0, -count % rows), (0, 0)], mode="edge")
        done = [function(arrays, form, z[i : i + rows]) for i in range(0, len(z), rows)]
        return jax.tree.map(lambda *x: np.concatenate([np.asarray(p) for p in x])[:count], *done)

    return each


@eqx.filter_jit
def predicted(problem: Problem, z: Float[Array, "n free"], key: PRNGKey) -> Any:
    """Return noisy measurements, the models without noise and the standard deviations stated there:
    three tuples of arrays (n, data), one an observation.
    """

    def one(each):
        simulated, models = problem.simulated_and_models(*each)
        return simulated, models, problem.stated_sds(each[0], models)

    return in_pieces(one, (z, jax.random.split(key, len(z))), elements(problem))


@eqx.filter_jit
def _densities(arrays: list[Array], form: Form, z: Float[Array, "n free"]) -> Any:
    """Log posterior densities (n,), and log likelihoods of every value (n, all data)."""
    problem = form.filled(arrays)

    def one(x):
        each = problem.pointwise(x)
        return problem.with_prior(each.sum(), x), each

    return in_pieces(one, z, elements(problem))
