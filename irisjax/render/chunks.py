"""Pixels in portions whose intermediates stay in the processor's cache: two to three times as fast."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

_SIZE = 256


def in_chunks(f: Callable[[Any], Any], pixels: Any, axis: int = 0) -> Any:
    """`f` of a tree of arrays, one portion of their first axis after the other; results have it as their `axis`."""
    count = jax.tree.leaves(pixels)[0].shape[0]
    size = min(_SIZE, count)
    pad = -count % size

    def cut(x):
        # Copies of the last pixel: whatever is finite there has finite derivatives.
        return jnp.pad(x, [(0, pad)] + [(0, 0)] * (x.ndim - 1), mode="edge").reshape(-1, size, *x.shape[1:])

    done = jax.lax.map(f, jax.tree.map(cut, pixels))

    def joined(x):
        x = jnp.moveaxis(x, 0, axis)
        x = x.reshape(*x.shape[:axis], -1, *x.shape[axis + 2 :])
        return jax.lax.slice_in_dim(x, 0, count, axis=axis)

    return jax.tree.map(joined, done)
