"""A problem at many places at once, in pieces: all arrays of all walkers together would fall out of
the cache.
"""

import equinox as eqx
import jax
import numpy as np

from irisjax.infer.problem import Problem
from irisjax.numerics.portions import in_pieces

_ROWS = 64
"""The sampler's default walkers: what a call costs beside its rows is as much as twenty of them."""


def elements(problem: Problem) -> int:
    """Numbers in the largest array that one evaluation makes."""
    sizes = [max(o.wavelengths.size, o.values.shape[-1]) for o in problem.observations]
    each = max(solver.numbers_per_wavelength for solver in problem.solvers)
    # A correlated error takes a matrix.
    noise = max(sizes) ** 2 if problem.noise.discrepancy is not None else 0
    return max(noise, sum(sizes) * each)


def density(problem: Problem):
    """The function z (n, free) → log posterior densities (n,), compiled once for all problems of
    the same form.
    """
    both = in_rows(_densities, problem.unnamed())
    return lambda z: both(z)[0]


def pointwise(problem: Problem, z):
    """Log likelihoods of every value, shape (n, all data)."""
    return in_rows(_densities, problem.unnamed())(z)[1]


def in_rows(function, problem: Problem, rows: int = _ROWS):
    """`function(problem, z)` of any number of vectors z, so many at a time: a program for each
    number would take longer to compile than all of them to run.
    """

    def each(z):
        z = np.asarray(z)
        count = len(z)
        # Copies of the last: whatever is finite there has finite copies.
        z = np.pad(z, [(0, -count % rows), (0, 0)], mode="edge")
        done = [function(problem, z[i : i + rows]) for i in range(0, len(z), rows)]
        return jax.tree.map(lambda *x: np.concatenate([np.asarray(p) for p in x])[:count], *done)

    return each


@eqx.filter_jit
def _densities(problem: Problem, z):
    """Log posterior densities (n,), and log likelihoods of every value (n, all data)."""

    def one(x):
        each = problem.pointwise(x)
        return problem.with_prior(each.sum(), x), each

    return in_pieces(one, z, elements(problem))


@eqx.filter_jit
def predicted(problem: Problem, z, key):
    """Noisy measurements, the models without noise and the standard deviations stated there: three
    tuples of arrays (n, data), one an observation.
    """

    def one(each):
        simulated, models = problem.simulated_and_models(*each)
        return simulated, models, problem.stated_sds(each[0], models)

    return in_pieces(one, (z, jax.random.split(key, len(z))), elements(problem))
