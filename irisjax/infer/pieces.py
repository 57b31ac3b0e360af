"""A problem at many places at once, in pieces: all arrays of all walkers together would fall out of
the cache.
"""

from functools import lru_cache, partial

import jax
import jax.numpy as jnp

from irisjax.infer.problem import Problem
from irisjax.numerics.portions import in_pieces


def elements(problem: Problem) -> int:
    """Numbers in the largest array that one evaluation makes."""
    sizes = [max(o.wavelengths.size, o.values.shape[-1]) for o in problem.observations]
    # A correlated error takes a matrix.
    return max(sizes) ** 2 if problem.noise.discrepancy is not None else sum(sizes)


def density(problem: Problem):
    """The function z (n, free) → log posterior densities (n,), compiled once for all problems of
    the same form.
    """
    leaves, structure = jax.tree.flatten(problem)
    return partial(_compiled_density(structure), [jnp.asarray(x) for x in leaves])


@lru_cache(maxsize=32)
def _compiled_density(structure):
    @jax.jit
    def run(leaves, z):
        stated = jax.tree.unflatten(structure, leaves)
        return in_pieces(lambda x: stated.log_posterior(x), z, elements(stated))

    return run


@jax.jit
def pointwise(problem: Problem, z):
    """Log likelihoods of every value, shape (n, all data)."""
    return in_pieces(lambda x: problem.pointwise(x), z, elements(problem))


@jax.jit
def predicted(problem: Problem, z, keys):
    """Noisy measurements and the models without noise: two tuples of arrays (n, data), one an
    observation.
    """
    return in_pieces(
        lambda a: (problem.simulate(*a), problem.predict(a[0])), (z, keys), elements(problem)
    )
