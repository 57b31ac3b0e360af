"""Pixels in portions whose intermediates stay in the processor's cache: two to three times as fast."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

_SIZE = 256  # from 512 on XLA shares out small operations among threads, which takes longer than doing them


def in_chunks(f: Callable[[Any], Any], pixels: Any, axis: int = 0) -> Any:
    """`f` of a tree of arrays, one portion of their `axis` (0 or -1) after the other; it is that of the results too."""
    count = jax.tree.leaves(pixels)[0].shape[axis]
    size = min(_SIZE, count)
    pad = -count % size

    def cut(x):
        # Copies of the last pixel: whatever is finite there has finite derivatives.
        widths = [(0, 0)] * x.ndim
        widths[axis] = (0, pad)
        x = jnp.pad(x, widths, mode="edge")
        return x.reshape((-1, size, *x.shape[1:]) if axis == 0 else (*x.shape[:-1], -1, size))

    portions = jax.tree.map(cut, pixels)
    at = 0 if axis == 0 else -2

    def part(k):
        return f(jax.tree.map(lambda x: jax.lax.dynamic_index_in_dim(x, k, x.ndim + at if at else 0, False), portions))

    done = jax.lax.map(part, jnp.arange((count + pad) // size))

    def joined(x):
        x = jnp.moveaxis(x, 0, at) if at else x
        x = x.reshape((-1, *x.shape[2:]) if axis == 0 else (*x.shape[:-2], -1))
        return jax.lax.slice_in_dim(x, 0, count, axis=axis)

    return jax.tree.map(joined, done)
