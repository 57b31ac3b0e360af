"""Intermediate results that a compiled program computes once."""

from typing import TypeVar

import jax
import jax.numpy as jnp

_Tree = TypeVar("_Tree")


def materialise(values: _Tree) -> _Tree:
    """Return a tree of arrays of real numbers that XLA computes once and stores.

    On a processor, XLA copies cheap operations into everything that uses their result, without
    bound: a chain of vector operations is worked out anew for every component of every later
    vector. A barrier (`jax.lax.optimization_barrier`) is removed before that. Sums along an axis
    are never copied, so that each number is summed with a zero.
    """
    return jax.tree.map(lambda x: jnp.stack([x, jnp.zeros_like(x)]).sum(0), values)
