"""Pixels in portions whose intermediates stay in the processor's cache, and in shares, one for each
core.

Portions are two to three times as fast as everything at once. XLA runs a loop of them on one core
and lets the others steal its small operations, which costs more than it brings; threads with a
share of the portions each do not.
"""

import functools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer

# On a processor: from 512 on XLA shares out small operations among threads, which takes longer.
_SIZE = 256
_SETTINGS = (
    "jax_enable_x64",
    "jax_default_device",
    "jax_default_matmul_precision",
    "jax_numpy_dtype_promotion",
    "jax_disable_jit",
    "jax_debug_nans",
    "jax_debug_infs",
)
_FEW = 1 << 14  # pixels for which a second thread is not worth its start


def in_chunks(f: Callable[[Any], Any], pixels: Any, share: Any = 0, shares: int = 1) -> Any:
    """`f` of a tree of arrays, one portion of their last axis after the other; it is that of the
    results too.

    With several `shares`, only those portions that belong to number `share`; see `side_by_side`.
    """
    count = jax.tree.leaves(pixels)[0].shape[-1]
    size = min(_portion(count), count)
    pad = -count % (size * shares)

    def cut(x):
        # Copies of the last pixel: whatever is finite there has finite derivatives.
        x = jnp.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, pad)], mode="edge") if pad else x
        return x.reshape(*x.shape[:-1], -1, size)

    portions = jax.tree.map(cut, pixels)

    def part(k):
        return f(
            jax.tree.map(lambda x: jax.lax.dynamic_index_in_dim(x, k, x.ndim - 2, False), portions)
        )

    each = (count + pad) // size // shares
    done = jax.lax.map(part, share * each + jnp.arange(each))

    def joined(x):
        x = jnp.moveaxis(x, 0, -2)
        x = x.reshape(*x.shape[:-2], -1)
        return x[..., :count] if shares == 1 else x

    return jax.tree.map(joined, done)


def _portion(count: int) -> int:
    # An accelerator wants all at once: a loop of small portions would leave it idle.
    return _SIZE if jax.default_backend() == "cpu" else count


def pixelwise(f: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator: `f(pixels, *others)` portion by portion, the cores side by side.

    The last axis of all arrays in `pixels` and in what `f` gives is that of pixels; of `others`
    each portion has all.
    """

    @eqx.filter_jit
    def program(pixels, others, share, shares: int):
        return in_chunks(lambda some: f(some, *others), pixels, share, shares)

    @functools.wraps(f)
    def all_pixels(pixels, *others):
        count = jax.tree.leaves(pixels)[0].shape[-1]
        done = side_by_side(lambda *share: program(pixels, others, *share), count, pixels, others)
        return done[0] if len(done) == 1 else _joined(done, count)

    return all_pixels


@functools.partial(jax.jit, static_argnums=1)
def _joined(done, count: int):
    return jax.tree.map(lambda *x: jnp.concatenate(x, axis=-1)[..., :count], *done)


def side_by_side(f: Callable[[Any, int], Any], count: int, *inputs: Any) -> list[Any]:
    """`f(share, shares)` of every share of `count` pixels, on a thread each; one share where that
    brings nothing.

    `inputs` are what `f` depends on: while they are traced there is one share, as on an
    accelerator. Joined, results may be longer than `count`; what is too much repeats the last
    pixel.
    """
    traced = any(isinstance(x, Tracer) for x in jax.tree.leaves(inputs))
    shares = _threads() if count >= _FEW and not traced else 1
    # What a `with` set for this thread alone, float64 say, does not reach others.
    if shares == 1 or _pool(shares).submit(_settings).result() != _settings():
        return [f(jnp.asarray(0), 1)]
    work = [
        _pool(shares).submit(lambda i=i: jax.block_until_ready(f(jnp.asarray(i), shares)))
        for i in range(shares)
    ]
    return [w.result() for w in work]


def _settings() -> list[Any]:
    return [getattr(jax.config, name) for name in _SETTINGS]


@functools.cache
def _threads() -> int:
    cores = min(os.cpu_count() or 1, 8) if jax.default_backend() == "cpu" else 1
    return 1 << (
        cores.bit_length() - 1
    )  # lengths are multiples of large powers of two: no share is padded


@functools.cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="irisjax-pixels")


def in_pieces(function, arguments, elements: int):
    """`jax.vmap(function)(arguments)`, so many at a time as make arrays of `_ELEMENTS` numbers."""
    count = jax.tree.leaves(arguments)[0].shape[0]
    size = max(1, _ELEMENTS // elements)
    if size >= count:
        return jax.vmap(lambda x: function(x))(
            arguments
        )  # JAX cannot hash bound methods of modules
    return jax.lax.map(function, arguments, batch_size=size)


# Half a megabyte an array. With 10,000 wavelengths and 64 walkers twice as fast as everything at
# once, with a hundredth of the memory; up to 1,000 wavelengths they are one piece.
_ELEMENTS = 1 << 16
