"""Noise round a circle: value noise on hashed lattices, one program for all its uses."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int, UInt32

from irisjax.numerics.interpolation import smoothstep

NoiseField = Float[Array, "..."]
Seed = UInt32[Array, ""]
Whole = int | Int[Array, ""]


def noise(
    seed: Seed,
    turns: NoiseField,
    radius: NoiseField,
    cells: tuple[Whole, Whole],
    octaves: Whole = 1,
) -> NoiseField:
    """Fractal value noise, −1 to 1, on `cells` over `turns` (of period 1) and `radius`, 0 to 1.

    Every octave halves cells and height; the noise is the same in both precisions.
    """

    def layer(octave, total):
        scale = 2 ** jnp.asarray(octave, radius.dtype)
        n, m = cells[0] * scale, cells[1] * scale
        own = seed + jnp.asarray(octave, jnp.uint32)
        x, y = turns * n, jnp.clip(radius, 0.0, 1.0) * m
        i, j = jnp.floor(x), jnp.floor(y)
        u, v = smoothstep(x - i), smoothstep(y - j)
        left, right = i % n, (i + 1) % n
        below = hashed(own, left, j) * (1 - v) + hashed(own, left, j + 1) * v
        above = hashed(own, right, j) * (1 - v) + hashed(own, right, j + 1) * v
        return total + (below * (1 - u) + above * u) / scale

    total = jnp.zeros(jnp.broadcast_shapes(turns.shape, radius.shape), radius.dtype)
    # Rolled, so that one program serves every number of octaves.
    return jax.lax.fori_loop(0, octaves, layer, total) / (2 - jnp.exp2(1.0 - octaves))


def noises(
    seed: Seed, turns: NoiseField, radius: NoiseField, kinds: Sequence[tuple[int, int, int]]
) -> Float[Array, "kinds ..."]:
    """One `noise` for each of `kinds`, its two numbers of cells and its octaves, by one program."""
    table = jnp.stack(split_seed(seed, len(kinds))), *jnp.asarray(kinds).T
    return jax.lax.map(lambda k: noise(k[0], turns, radius, (k[1], k[2]), k[3]), table)


def _mixed(x: UInt32[Array, "..."]) -> UInt32[Array, "..."]:
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B)):
        x = (x ^ (x >> shift)) * jnp.uint32(factor)
    return x ^ (x >> 16)


def split_seed(seed: Seed, n: int) -> list[Seed]:
    """Seeds of features from the seed of all."""
    return [_mixed(seed + jnp.uint32(0x632BE5AB * (i + 1) % 2**32)) for i in range(n)]


def hashed(seed: Seed, i: NoiseField, j: NoiseField) -> NoiseField:
    """Uniform on −1 to 1 at whole i, j ≥ 0; XLA compiles as many draws of its own for 30 s."""
    x, y = i.astype(jnp.uint32), j.astype(jnp.uint32)
    x = x * jnp.uint32(0x9E3779B1) + y * jnp.uint32(0x85EBCA77)
    return _mixed(x + seed).astype(i.dtype) * 2.0**-31 - 1


def drawn(seed: Seed, n: int, k: Whole, dtype: DTypeLike) -> NoiseField:
    """The k-th of n-tuples uniform on 0 to 1, shape (n,)."""
    return 0.5 + 0.5 * hashed(seed, jnp.arange(n).astype(dtype), jnp.full(n, k, dtype))
