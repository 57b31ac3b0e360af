"""Pixels in chunks whose intermediates stay in the processor's cache, shared among its cores.

Chunks are two to three times as fast as all pixels at once. XLA runs a loop of them on one core
and lets the others steal its small operations, which costs more than it saves. Pictures are
therefore shared among threads, each of which runs a loop over its own chunks.
"""

import functools
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Generic, TypeVar, TypeVarTuple, Unpack

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from irisjax.numerics.checks import is_known
from irisjax.numerics.precision import full_precision

P = TypeVar("P")
Rest = TypeVarTuple("Rest")
T = TypeVar("T")

# On a processor: from 512 on XLA shares small operations among threads, which takes longer.
_SIZE = 256
_FEW = 1 << 14  # pixels for which a second thread is not worth its start
# Half a megabyte an array. With 10,000 wavelengths and 64 walkers twice as fast as everything at
# once, with a hundredth of the memory; up to 1,000 wavelengths they are one piece.
_ELEMENTS = 1 << 16
_SETTINGS = (
    "jax_enable_x64",
    "jax_default_device",
    "jax_default_matmul_precision",
    "jax_numpy_dtype_promotion",
    "jax_disable_jit",
    "jax_debug_nans",
    "jax_debug_infs",
)


def map_chunks(f: Callable[[P], T], pixels: P) -> T:
    """Apply `f` to a tree of arrays, one chunk of their last axis after the other.

    The last axis of the results is that of the pixels too. An accelerator gets all pixels at once:
    a loop of small chunks would leave it idle.
    """
    if _count(pixels) <= _SIZE:
        return f(pixels)
    return jax.lax.platform_dependent(
        pixels,
        cpu=lambda p: _map_share(f, p, 0, 1),
        default=lambda p: f(p),
    )


class Pixelwise(Generic[P, *Rest, T]):
    """A compiled function `f(pixels, *others)` that is applied in chunks, each with all `others`.

    The last axis of all arrays in `pixels` and in the results is that of the pixels. The chunks of
    a large picture are shared among the processor's cores; the threads end with the call.

    Attributes:
        compiled: The program, of pixels, others, the number of a share and the count of shares.
    """

    def __init__(self, f: Callable[[P, Unpack[Rest]], T]):
        functools.update_wrapper(self, f)

        @full_precision
        def chunked(pixels: P, others: tuple[*Rest], share: Any, shares: int) -> T:
            def apply(chunk: P) -> T:
                return f(chunk, *others)

            if shares == 1:
                return map_chunks(apply, pixels)
            return _map_share(apply, pixels, share, shares)

        chunked.__module__, chunked.__qualname__ = f.__module__, f.__qualname__
        chunked.__name__ = f.__name__
        self.compiled: Callable[..., T] = eqx.filter_jit(chunked)

    def __call__(self, pixels: P, *others: *Rest) -> T:
        """Apply the function to all pixels."""
        # One thread in a trace.
        shares = share_count(_count(pixels)) if is_known(pixels, others) else 1
        if shares > 1:

            def run_share(i: int) -> T:
                return self.compiled(pixels, others, jnp.asarray(i), shares)

            return _concatenate(on_cores(run_share, range(shares)), _count(pixels))
        return self.compiled(pixels, others, None, 1)


pixelwise = Pixelwise
"""`Pixelwise` as a decorator."""


def on_cores(f: Callable[..., T], *arguments: Sequence[Any]) -> list[T]:
    """Apply `f` to the first of each sequence, to the second and so on, each on a thread of its own
    in which `Pixelwise` functions use no others; the threads end with the call. A single one, and
    all where a `with` has changed JAX's settings for this thread alone, are done on this thread.
    """
    with ThreadPoolExecutor(len(arguments[0]), initializer=_use_one_thread) as pool:
        # A thread lacks the settings, float64 say, that a `with` made for its caller.
        if len(arguments[0]) == 1 or pool.submit(_settings).result() != _settings():
            return [f(*each) for each in zip(*arguments, strict=True)]
        return list(pool.map(lambda *each: jax.block_until_ready(f(*each)), *arguments))


def vmap_in_pieces(function: Callable[[P], T], arguments: P, elements: int) -> T:
    """Apply `jax.vmap(function)`, to as many arguments at a time as make arrays of `_ELEMENTS`
    numbers, where each takes `elements`.
    """
    count = jax.tree.leaves(arguments)[0].shape[0]
    pieces = -(-count // max(1, _ELEMENTS // elements))
    batched = jax.vmap(lambda x: function(x))  # JAX cannot hash bound methods of modules
    if pieces == 1:
        return batched(arguments)
    # All of one size, so that one program serves them; the last argument fills the last piece.
    indices = np.arange(pieces * -(-count // pieces)).reshape(pieces, -1)
    padded = jax.tree.map(lambda x: x[np.minimum(indices, count - 1)], arguments)
    results = jax.lax.map(batched, padded)
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:])[:count], results)


def map_rows(
    function: Callable[[Any], Any], arguments: Any, rows: int, map_fn: Callable[..., Any] = map
) -> Any:
    """Apply a compiled function of `rows` rows of each array to any number of them; a program for
    each number would take longer to compile than all to run. `map_fn` is a `map`, such as a pool's.
    """
    count = jax.tree.leaves(arguments)[0].shape[0]

    def run_rows(first: int) -> Any:
        # Copies of the last row: whatever is finite there has finite copies.
        indices = np.minimum(np.arange(first, first + rows), count - 1)
        return jax.tree.map(np.asarray, function(jax.tree.map(lambda x: x[indices], arguments)))

    results = map_fn(run_rows, range(0, count, rows))
    return jax.tree.map(lambda *x: np.concatenate(x)[:count], *results)


def cores() -> int:
    """Return the number of processor cores that this process may use."""
    of_process = getattr(os, "sched_getaffinity", None)  # not on every system
    return len(of_process(0)) if of_process else os.cpu_count() or 1


def share_count(pixels: int) -> int:
    """Return the number of threads among which so many pixels are shared: a power of two, so that
    no share is padded; one on an accelerator.
    """
    if pixels < _FEW or jax.default_backend() != "cpu" or getattr(_THREAD, "alone", False):
        return 1
    return 1 << (min(cores(), 8).bit_length() - 1)


_THREAD = threading.local()


def _use_one_thread() -> None:
    _THREAD.alone = True


def _map_share(f: Callable[[P], T], pixels: P, share: Array | int, shares: int) -> T:
    """Apply `f` to the chunks that belong to number `share` of several."""
    count = _count(pixels)
    size = min(_SIZE, count)
    pad = -count % (size * shares)

    def cut(x: Array) -> Array:
        # Copies of the last pixel: what is finite there has finite derivatives.
        x = jnp.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, pad)], mode="edge") if pad else x
        return x.reshape(*x.shape[:-1], -1, size)

    chunks = jax.tree.map(cut, pixels)

    def run_chunk(k: Array) -> T:
        return f(jax.tree.map(lambda x: x[..., k, :], chunks))

    chunks_per_share = (count + pad) // size // shares
    results = jax.lax.map(run_chunk, share * chunks_per_share + jnp.arange(chunks_per_share))

    def join_chunks(x: Array) -> Array:
        x = jnp.moveaxis(x, 0, -2)
        x = x.reshape(*x.shape[:-2], -1)
        return x[..., :count] if shares == 1 else x

    return jax.tree.map(join_chunks, results)


def _count(pixels: object) -> int:
    return jax.tree.leaves(pixels)[0].shape[-1]


@eqx.filter_jit
def _concatenate(shares: list[T], count: int) -> T:
    return jax.tree.map(lambda *x: jnp.concatenate(x, axis=-1)[..., :count], *shares)


def _settings() -> list[object]:
    return [getattr(jax.config, name) for name in _SETTINGS]
