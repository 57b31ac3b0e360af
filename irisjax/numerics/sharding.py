"""Types and layouts of arrays that loops and inner functions need under a caller's sharding.

In the body of `jax.shard_map` an array's type says over which axes of the mesh it varies. A loop's
carry and what an inner function closes over keep one such type, so it is given to them beforehand.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
from jax import Array, lax
from jax.sharding import AxisType, PartitionSpec

_T = TypeVar("_T")


def vary_alike(tree: _T, *others: object) -> _T:
    """Type the arrays of `tree` to vary over each mesh axis that any array given here varies over.

    Outside `jax.shard_map` this is `tree` itself.
    """
    axes = frozenset().union(*(_axes(x) for x in jax.tree.leaves((tree, others))))
    if not axes:
        return tree

    def widen_missing(x):
        missing = tuple(sorted(axes - _axes(x)))
        return _widen(x, missing) if missing else x

    return jax.tree.map(widen_missing, tree)


def call_with_layout(function: Callable[..., Any], like: Array, *arguments: object) -> Any:
    """Return `function(*arguments)`, layouts inside left to the compiler on explicit meshes.

    Look-ups, and reshapes of several axes at once, have no layout that follows from their inputs'.
    Results whose first axis is as long as that of `like` are laid out as `like` along it. All
    traced arrays must be among `arguments`. Without such a mesh it is a call.
    """
    if AxisType.Explicit not in jax.sharding.get_abstract_mesh().axis_types:
        return function(*arguments)
    replicated = jax.sharding.auto_axes(function, out_sharding=PartitionSpec())
    first = tuple(jax.typeof(like).sharding.spec)[:1]
    if first in ((), (None,)):
        return replicated(*arguments)
    specs = jax.tree.map(
        lambda x: PartitionSpec(*first) if x.shape[:1] == like.shape[:1] else PartitionSpec(),
        jax.eval_shape(replicated, *arguments),
    )
    return jax.sharding.auto_axes(function, out_sharding=specs)(*arguments)


def _axes(x) -> frozenset[str]:
    kind = jax.typeof(x)
    # Since JAX 0.10 in a field of its own.
    return frozenset(kind.vma if hasattr(kind, "vma") else kind.mat.varying)


def _widen(x, axes: tuple[str, ...]):
    # JAX before 0.8 has `pvary` only.
    return lax.pcast(x, axes, to="varying") if hasattr(lax, "pcast") else lax.pvary(x, axes)  # pyright: ignore[reportAttributeAccessIssue]
