"""Value noise on hashed lattices round a circle, by one compiled program for all uses."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int, UInt32

from irisjax.numerics.interpolation import smoothstep

NoiseField = Float[Array, "..."]
Seed = UInt32[Array, ""]
Count = int | Int[Array, ""]


def noise(
    seed: Seed,
    turns: NoiseField,
    radius: NoiseField,
    cells: tuple[Count, Count],
    octaves: Count = 1,
) -> NoiseField:
    """Draw fractal value noise, −1 to 1, on `cells` over `turns` (period 1) and `radius`, 0 to 1.

    Every octave halves cells and height. The noise is the same in both precisions.
    """

    def layer(octave, total):
        scale = 2 ** jnp.asarray(octave, radius.dtype)
        n, m = cells[0] * scale, cells[1] * scale
        octave_seed = seed + jnp.asarray(octave, jnp.uint32)
        x, y = turns * n, jnp.clip(radius, 0.0, 1.0) * m
        i, j = jnp.floor(x), jnp.floor(y)
        u, v = smoothstep(x - i), smoothstep(y - j)

        def along_radius(i):
            below, above = (hash_uniform(octave_seed, i, row) for row in (j, j + 1))
            return below * (1 - v) + above * v

        return total + (along_radius(i % n) * (1 - u) + along_radius((i + 1) % n) * u) / scale

    total = jnp.zeros(jnp.broadcast_shapes(turns.shape, radius.shape), radius.dtype)
    # Rolled, so that one program serves every number of octaves.
    return jax.lax.fori_loop(0, octaves, layer, total) / (2 - jnp.exp2(1.0 - octaves))


def noise_fields(
    seed: Seed, turns: NoiseField, radius: NoiseField, kinds: Sequence[tuple[int, int, int]]
) -> Float[Array, "kinds ..."]:
    """Draw one `noise` for each of `kinds`, its two numbers of cells and its number of octaves."""
    table = jnp.stack(split_seed(seed, len(kinds))), *jnp.asarray(kinds).T
    return jax.lax.map(lambda k: noise(k[0], turns, radius, (k[1], k[2]), k[3]), table)


def _mix_bits(x: UInt32[Array, "..."]) -> UInt32[Array, "..."]:
    """Mix the bits of 32-bit integers, so that equal steps give unrelated numbers."""
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B)):
        x = (x ^ (x >> shift)) * jnp.uint32(factor)
    return x ^ (x >> 16)


def split_seed(seed: Seed, n: int) -> list[Seed]:
    """Derive n seeds from one."""
    return [_mix_bits(seed + jnp.uint32(0x632BE5AB * (i + 1) % 2**32)) for i in range(n)]


def hash_uniform(seed: Seed, i: NoiseField, j: NoiseField) -> NoiseField:
    """Draw a number, uniform on −1 to 1, for each pair of whole i, j ≥ 0, by hashing.

    XLA takes 30 s to compile as many draws of `jax.random`.
    """
    x, y = i.astype(jnp.uint32), j.astype(jnp.uint32)
    x = x * jnp.uint32(0x9E3779B1) + y * jnp.uint32(0x85EBCA77)
    return _mix_bits(x + seed).astype(i.dtype) * 2.0**-31 - 1


def draw_uniform(seed: Seed, n: int, k: Count, dtype: DTypeLike) -> NoiseField:
    """Draw the k-th tuple of n numbers uniform on 0 to 1, shape (n,)."""
    return 0.5 + 0.5 * hash_uniform(seed, jnp.arange(n).astype(dtype), jnp.full(n, k, dtype))
