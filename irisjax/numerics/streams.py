"""Counter-based random numbers for photon lanes: JAX's own threefry stream, laid out to fuse."""

import jax
import jax.numpy as jnp

_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))


def check_key(key) -> None:
    """Raise `ValueError` unless `key` is a single new-style threefry key,
    `jax.random.key(seed)`.
    """
    if key is None:
        raise ValueError("MonteCarlo needs a key: pass key=jax.random.key(seed)")
    if (
        not (isinstance(key, jax.Array) and jnp.issubdtype(key.dtype, jax.dtypes.prng_key))
        or key.ndim
    ):
        raise ValueError("key must be one new-style key, as made by jax.random.key(seed)")
    if "threefry" not in str(jax.random.key_impl(key)):
        raise ValueError(f"key must be of the threefry2x32 kind, got {jax.random.key_impl(key)}")


def checked_key(key) -> jax.Array:
    """The key, or what `check_key` raises."""
    check_key(key)
    return key


def fold_in_words(k0, k1, count):
    """The two words of `jax.random.key_data(jax.random.fold_in(key, count))` for the words of
    `key`.

    The same bits as the public call (a test holds them equal), written out because JAX lowers
    threefry on CPU to a loop over arrays in memory: 11 ns a block against 2.8 here, where it fuses
    with what uses it. [Salmon et al. 2011]
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


def uniform(integers, count):
    """Centred uniform (integer + ½)/count: never 0 or 1, every point exact in float32.

    `count` is a *traced* power of two on purpose: XLA on CPU copies cheap producers into every
    fusion that uses them (all of threefry, twenty times over) but never a division. A literal costs
    a factor of three.
    """
    return (integers.astype(jnp.int32).astype(jnp.float32) + 0.5) / count


def scales():
    """The counts `uniform` divides by, to be handed to a jitted function as arguments: 2²³, 2¹⁸ and
    1.
    """
    return tuple(jnp.float32(v) for v in (2**23, 2**18, 1))
