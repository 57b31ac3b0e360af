"""Counter-based random numbers for photon lanes: JAX's own threefry stream, laid out to fuse."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Integer, UInt32

from irisjax._types import PRNGKey, Scalar

Word = UInt32[Array, "..."]

_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))


def key_of(seed: int) -> PRNGKey:
    """Return a seed's key; its kind is fixed, whatever the environment prefers."""
    return jax.random.key(seed, impl="threefry2x32")


def one_key(key: Any) -> PRNGKey:
    """Return `key`; raise `ValueError` unless it is one as `jax.random.key` makes."""
    of_keys = isinstance(key, jax.Array) and jnp.issubdtype(key.dtype, jax.dtypes.prng_key)
    if not of_keys or key.ndim:
        raise ValueError("key must be one new-style key, as made by jax.random.key(seed)")
    return key


def check_key(key: Any) -> PRNGKey:
    """Return `key`; raise `ValueError` unless it is one threefry key as `jax.random.key` makes."""
    if key is None:
        raise ValueError("MonteCarlo needs a key: pass key=jax.random.key(seed)")
    if "threefry" not in str(jax.random.key_impl(one_key(key))):
        raise ValueError(f"key must be of the threefry2x32 kind, got {jax.random.key_impl(key)}")
    return key


def words_of(key: PRNGKey) -> list[int]:
    """Return the numbers of a key, which seed NumPy's generators."""
    return [int(word) for word in np.ravel(jax.random.key_data(one_key(key)))]


def fold_in_words(k0: Word, k1: Word, count: Word) -> tuple[Word, Word]:
    """Compute `jax.random.key_data(jax.random.fold_in(key, count))` from the words of `key`.

    The bits are those of the public call. It is written out because JAX lowers threefry on CPU to a
    loop over arrays in memory: 11 ns a block against 2.8 here, where it fuses with what uses it.
    [Salmon et al. 2011]
    """
    schedule = (k0, k1, k0 ^ k1 ^ jnp.uint32(0x1BD11BDA))
    x0, x1 = k0, count + k1  # fold_in hashes (0, count)
    for block in range(5):
        for r in _ROTATIONS[block % 2]:
            x0 = x0 + x1
            x1 = x0 ^ ((x1 << r) | (x1 >> (32 - r)))
        x0 = x0 + schedule[(block + 1) % 3]
        x1 = x1 + schedule[(block + 2) % 3] + jnp.uint32(block + 1)
    return x0, x1


def uniform(integers: Integer[Array, "..."], count: Scalar) -> Float[Array, "..."]:
    """Compute centred uniform numbers (integer + ½)/count, never 0 or 1 and exact in float32.

    `count` is a *traced* power of two on purpose: XLA on CPU copies cheap producers into every
    fusion that uses them (all of threefry, twenty times over) but never a division. A literal costs
    a factor of three.
    """
    return (integers.astype(jnp.int32).astype(jnp.float32) + 0.5) / count


def scales() -> tuple[Scalar, ...]:
    """Return the counts that `uniform` divides by, arguments of jitted functions: 2²³, 2¹⁸, 1."""
    return tuple(jnp.float32(v) for v in (2**23, 2**18, 1))
