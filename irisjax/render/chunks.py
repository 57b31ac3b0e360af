"""Pixels in portions whose intermediates stay in the processor's cache, and in shares, one for each core.

Portions are two to three times as fast as everything at once. XLA runs a loop of them on one core and lets the others
steal its small operations, which costs more than it brings; threads with a share of the portions each do not.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import Tracer

_SIZE = 256  # from 512 on XLA shares out small operations among threads, which takes longer than doing them
_SETTINGS = (
    "jax_enable_x64", "jax_default_device", "jax_default_matmul_precision", "jax_numpy_dtype_promotion",
    "jax_disable_jit", "jax_debug_nans", "jax_debug_infs",
)  # fmt: skip
_FEW = 1 << 14  # pixels for which a second thread is not worth its start


def in_chunks(f: Callable[[Any], Any], pixels: Any, axis: int = 0, share: Any = 0, shares: int = 1) -> Any:
    """`f` of a tree of arrays, one portion of their `axis` (0 or -1) after the other; it is that of the results too.

    With several `shares`, only those portions that belong to number `share`; see `side_by_side`.
    """
    count = jax.tree.leaves(pixels)[0].shape[axis]
    size = min(_SIZE, count)
    pad = -count % (size * shares)

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

    each = (count + pad) // size // shares
    done = jax.lax.map(part, share * each + jnp.arange(each))

    def joined(x):
        x = jnp.moveaxis(x, 0, at) if at else x
        x = x.reshape((-1, *x.shape[2:]) if axis == 0 else (*x.shape[:-2], -1))
        return jax.lax.slice_in_dim(x, 0, count if shares == 1 else x.shape[axis], axis=axis)

    return jax.tree.map(joined, done)


def side_by_side(f: Callable[[Any, int], Any], count: int, *inputs: Any) -> list[Any]:
    """`f(share, shares)` of every share of `count` pixels, on a thread each; one share where that brings nothing.

    `inputs` are what `f` depends on: while they are traced there is one share, as on an accelerator. Joined, results
    may be longer than `count`; what is too much repeats the last pixel.
    """
    traced = any(isinstance(x, Tracer) for x in jax.tree.leaves(inputs))
    shares = _threads() if count >= _FEW and not traced else 1
    # What a `with` set for this thread alone, float64 say, does not reach others.
    if shares == 1 or _pool(shares).submit(_settings).result() != _settings():
        return [f(jnp.asarray(0), 1)]
    work = [_pool(shares).submit(lambda i=i: jax.block_until_ready(f(jnp.asarray(i), shares))) for i in range(shares)]
    return [w.result() for w in work]


def _settings() -> list[Any]:
    return [getattr(jax.config, name) for name in _SETTINGS]


@cache
def _threads() -> int:
    cores = min(os.cpu_count() or 1, 8) if jax.default_backend() == "cpu" else 1
    return 1 << (cores.bit_length() - 1)  # lengths are multiples of large powers of two: no share is padded


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="irisjax-pixels")
