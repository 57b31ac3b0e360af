"""Pixels in portions whose intermediates stay in the processor's cache, and in shares, one for each
thread that a caller hands over.

Portions are two to three times as fast as everything at once. XLA runs a loop of them on one core
and lets the others steal its small operations, which costs more than it brings; threads with a
share of the portions each do not.
"""

import functools
from collections.abc import Callable
from concurrent.futures import Executor
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


def in_portions(f: Callable[[Any], Any], pixels: Any) -> Any:
    """`f` of a tree of arrays, one portion of their last axis after the other; it is that of the
    results too.

    An accelerator gets all at once: a loop of small portions would leave it idle. Which it is the
    program learns where it is compiled for.
    """
    if _count(pixels) <= _SIZE:
        return f(pixels)
    return jax.lax.platform_dependent(
        pixels, cpu=lambda some: share_of(f, some), default=lambda some: f(some)
    )


def share_of(f: Callable[[Any], Any], pixels: Any, share: Any = 0, shares: int = 1) -> Any:
    """`f` of the portions that belong to number `share` of several; of all pixels where there is
    one.
    """
    count = _count(pixels)
    size = min(_SIZE, count)
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


class Pixelwise:
    """A function `f(pixels, *others)` in portions; use as a decorator.

    The last axis of all arrays in `pixels` and in what `f` gives is that of pixels; of `others`
    each portion has all. `jit` compiles.
    """

    def __init__(self, f: Callable[..., Any], jit: Callable[..., Any] = eqx.filter_jit):
        functools.update_wrapper(self, f)

        def whole(pixels, others):
            return in_portions(lambda some: f(some, *others), pixels)

        def shared(pixels, others, share, shares: int):
            return share_of(lambda some: f(some, *others), pixels, share, shares)

        self._whole, self._shared = jit(whole), jit(shared)

    def __call__(self, pixels, *others):
        """One program for all pixels."""
        return self._whole(pixels, others)

    def on_threads(self, executor: Executor, threads: int, pixels, *others):
        """As a call, with an equal share of the pixels for each thread of an executor.

        One program where threads bring nothing: for few pixels, while something is traced, and
        under settings (float64, say) that a `with` made for the caller's thread alone.
        """
        count = _count(pixels)
        traced = any(isinstance(x, Tracer) for x in jax.tree.leaves((pixels, others)))
        if threads == 1 or count < _FEW or traced:
            return self(pixels, *others)
        if executor.submit(_settings).result() != _settings():
            return self(pixels, *others)

        def part(i):
            return jax.block_until_ready(self._shared(pixels, others, jnp.asarray(i), threads))

        work = [executor.submit(part, i) for i in range(threads)]
        return _joined([w.result() for w in work], count)


def pixelwise(f: Callable[..., Any]) -> Pixelwise:
    """`Pixelwise`, as a decorator."""
    return Pixelwise(f)


def _count(pixels) -> int:
    return jax.tree.leaves(pixels)[0].shape[-1]


@eqx.filter_jit
def _joined(done, count: int):
    return jax.tree.map(lambda *x: jnp.concatenate(x, axis=-1)[..., :count], *done)


def _settings() -> list[Any]:
    return [getattr(jax.config, name) for name in _SETTINGS]


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
