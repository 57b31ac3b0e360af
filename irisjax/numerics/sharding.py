"""Arrays within a caller's sharding: what loops and inner functions must be told there.

In the body of `jax.shard_map` an array's type says over which axes of the mesh it varies. A loop's
carry and what an inner function closes over keep one such type, so it is given to them beforehand.
"""

from typing import Any

import jax
from jax import lax
from jax.sharding import AxisType, PartitionSpec


def vary_alike(tree, *others):
    """The arrays of `tree`, typed to vary over every mesh axis over which any array here varies.

    Outside `jax.shard_map` it is `tree` itself.
    """
    axes = frozenset().union(*(_axes(x) for x in jax.tree.leaves((tree, others))))
    if not axes:
        return tree

    def widened(x):
        missing = tuple(sorted(axes - _axes(x)))
        return _widened(x, missing) if missing else x

    return jax.tree.map(widened, tree)


def laid_out_as(like, ranks, function, *arguments) -> Any:
    """`function(*arguments)` where a mesh of explicit axes has the layouts inside left to the
    compiler.

    Look-ups, and reshapes of several axes at once, have no layout that follows from their inputs'.
    What is returned has arrays of these `ranks` (a tree of numbers), their first axis laid out as
    that of `like`. All traced arrays must be among `arguments`. Without such a mesh it is a call.
    """
    if AxisType.Explicit not in jax.sharding.get_abstract_mesh().axis_types:
        return function(*arguments)
    first = tuple(jax.typeof(like).sharding.spec)[:1]
    specs = jax.tree.map(lambda rank: PartitionSpec(*first, *(None,) * (rank - 1)), ranks)
    return jax.sharding.auto_axes(function, out_sharding=specs)(*arguments)


def compiler_laid_out(function, like, *arguments) -> Any:
    """`function(*arguments)` where a mesh of explicit axes has the layouts inside left to the
    compiler, for a function of whatever it returns.

    What has the length of the vector `like` along its first axis is laid out as that. All traced
    arrays must be among `arguments`. Without such a mesh it is a call.
    """
    if AxisType.Explicit not in jax.sharding.get_abstract_mesh().axis_types:
        return function(*arguments)
    specs, first = PartitionSpec(), tuple(jax.typeof(like).sharding.spec)[:1]
    if first not in ((), (None,)):
        whole = jax.sharding.auto_axes(function, out_sharding=specs)
        specs = jax.tree.map(
            lambda x: PartitionSpec(*first) if x.shape[:1] == like.shape else PartitionSpec(),
            jax.eval_shape(whole, *arguments),
        )
    return jax.sharding.auto_axes(function, out_sharding=specs)(*arguments)


def _axes(x) -> frozenset:
    kind = jax.typeof(x)
    # Since JAX 0.10 in a field of its own.
    return frozenset(kind.vma if hasattr(kind, "vma") else kind.mat.varying)


def _widened(x, axes: tuple):
    # JAX 0.8 gave `pvary` this name.
    return lax.pcast(x, axes, to="varying") if hasattr(lax, "pcast") else lax.pvary(x, axes)  # pyright: ignore[reportAttributeAccessIssue]
