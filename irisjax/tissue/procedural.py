"""Procedural irides: maps grown from a seed, and eye colours, so that nobody needs a photograph to start.

The stroma follows the ultrasound profile of [F09 Section 3] and is a meshwork of radial strands: bundled, wavy, fine
between pupil and collarette, coarse outside, parting round Fuchs's crypts. Features are drawn from what textbooks
show, not fitted to anything.
"""

import math
from functools import partial

import jax
import jax.numpy as jnp
from jax.random import bits, fold_in
from jaxtyping import Array, Float, UInt32

from irisjax._types import PRNGKey
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, cell_centres

Field = Float[Array, "..."]
Seed = UInt32[Array, ""]

IPE_THICKNESS = 0.07
"""Iris pigment epithelium, mm, part of what ultrasound measures  [F09 Section 3]."""
COLLARETTE = 0.32
"""Mean place of the collarette between the pupil's edge (0) and the root (1)."""
RANGE = (0.38, 2.0)
"""Thinnest and thickest place of a layer relative to its mean."""
FOLD = 0.03
"""Height of a contraction furrow's crest, mm."""


def procedural(
    iris: Iris,
    *,
    shape: tuple[int, int] = (768, 256),
    profile: bool = True,
    fibres: float = 1.0,
    collarette: float = 1.0,
    crypts: int = 14,
    furrows: int = 4,
    freckles: int = 0,
    abl: float = 0.0,
    heterochromia: float = 0.0,
    relief: float = 0.4,
    key: PRNGKey,
) -> IrisMaps:
    """Maps of a made-up iris; a map that no feature needs is absent.

    **Arguments:**

    - `iris`: gives mean thicknesses (kept: area means over its ring of `pupil_radius` to `iris_radius`) and sizes.
    - `shape`: (angles, radii); fewer than 768 angles coarsen the finest fibres.
    - `profile`: whether the stroma thins towards the root as in ultrasound.
    - `fibres`: contrast of the radial strands, 1 as in a light iris; `collarette`: height of the zig-zag ring.
    - `crypts`: number of lens-shaped holes near the collarette, each 2 small ones nearer the root besides.
    - `furrows`: number of concentric contraction furrows, partial arcs in the ciliary zone; `freckles`: of spots.
    - `abl`: how far the anterior border layer is thinned over crypts, gathered on the crests of furrows and
        mottled, 1 as in a brown iris; `heterochromia`: eumelanin added round the pupil, relative to the rest's.
    - `relief`: share of the unevenness that stands out towards the cornea; the rest lies within.

    **Returns:** `IrisMaps` with `stroma_thickness` unless the stroma is uniform, and at need `relief`,
    `abl_thickness`, `freckles` and `eumelanin`. Equal keys give equal maps. **Raises:** `ValueError` for negative
    features and shapes below (16, 8).
    """
    wanted = {k: v for k, v in locals().items() if k not in ("iris", "shape", "profile", "key")}
    for name, value in wanted.items():
        if not (math.isfinite(value) and value >= 0):
            raise ValueError(f"{name} = {value:g} must be finite and not negative")
    if shape[0] < 16 or shape[1] < 8:
        raise ValueError(f"shape {shape} is below (16, 8)")
    return IrisMaps(**_grow(iris, shape, profile, tuple(wanted.items()), key))


def _grow(iris: Iris, shape: tuple[int, int], profile: bool, wanted: tuple, key: PRNGKey) -> dict[str, Field]:
    has = dict(wanted)
    angles, radii = cell_centres(shape)
    turns, radius = jnp.broadcast_arrays(angles[:, None] / (2 * jnp.pi), radii)
    place = iris.pupil_radius + (iris.iris_radius - iris.pupil_radius) * radius
    fibres, zigzag, crypts, furrows, freckles, mottles = jax.vmap(lambda i: bits(fold_in(key, i)))(jnp.arange(6))
    ring = COLLARETTE + _zigzag(zigzag, turns)
    holes, parted = _crypts(crypts, turns, radius, has["crypts"])
    crest = _furrows(furrows, turns, radius, has["furrows"])
    maps = {}

    uneven = 1.0
    if has["fibres"]:
        uneven += has["fibres"] * _fibres(fibres, parted, radius, ring, shape[0] // 4)
    if has["collarette"]:
        uneven += has["collarette"] * _ring(zigzag, turns, radius, ring)
    uneven *= 1 - 0.7 * holes
    stroma = stroma_profile(radius) if profile else jnp.ones_like(radius)
    smooth = _scaled(stroma, place, iris.stroma_thickness)
    stroma = _bounded(stroma * uneven, place, iris.stroma_thickness)
    if profile or has["fibres"] or has["collarette"] or has["crypts"]:
        maps["stroma_thickness"] = stroma
    height = has["relief"] * (stroma - smooth)
    if has["abl"]:
        mottled = 0.3 * noise(mottles, parted, radius, (30, 4), 4) + 0.35 * crest - 0.85 * holes
        maps["abl_thickness"] = _bounded(1 + has["abl"] * mottled, place, iris.abl_thickness)
        height += has["relief"] * (maps["abl_thickness"] - iris.abl_thickness)
    if has["relief"] and any(has[n] for n in ("fibres", "collarette", "crypts", "furrows", "abl")):
        maps["relief"] = height + FOLD * crest
    if has["freckles"]:
        maps["freckles"] = _freckles(freckles, turns, place, iris, has["freckles"])
    if has["heterochromia"]:
        maps["eumelanin"] = 1 + has["heterochromia"] * _rays(zigzag, parted, radius, ring)
    return maps


def stroma_profile(radius: Field) -> Field:
    """Thickness of a generic stroma (mm) at relative radii from 0, 2 mm from the axis, to 1, the root at 5.5 mm.

    Quadratic through 0.645, 0.457 and 0.372 mm at 2.25, 3.5 and 5 mm, less IPE and ABL  [F09 Section 3].
    """
    r = 2.0 + 3.5 * radius
    inner, outer = (0.457 - 0.645) / 1.25, (0.372 - 0.457) / 1.5
    whole = 0.645 + (r - 2.25) * (inner + (r - 3.5) * (outer - inner) / 2.75)
    return whole - IPE_THICKNESS - 0.05675


@jax.jit
def noise(seed: Seed, turns: Field, radius: Field, cells: tuple[int, int], octaves: int = 1) -> Field:
    """Fractal value noise, −1 to 1, of period 1 in `turns`, on `cells` over the period and over `radius` 0 to 1.

    Every octave halves cells and height; both precisions see the same one.
    """

    def layer(octave, total):
        scale = 2 ** jnp.asarray(octave, radius.dtype)
        n, m = cells[0] * scale, cells[1] * scale
        own = seed + jnp.asarray(octave, jnp.uint32)
        x, y = turns * n, jnp.clip(radius, 0.0, 1.0) * m
        i, j = jnp.floor(x), jnp.floor(y)
        u, v = _step(x - i), _step(y - j)
        left, right = i % n, (i + 1) % n
        below = _hashed(own, left, j) * (1 - v) + _hashed(own, left, j + 1) * v
        above = _hashed(own, right, j) * (1 - v) + _hashed(own, right, j + 1) * v
        return total + (below * (1 - u) + above * u) / scale

    total = jnp.zeros(jnp.broadcast_shapes(turns.shape, radius.shape), radius.dtype)
    # Rolled, so that one program serves every number of octaves.
    return jax.lax.fori_loop(0, octaves, layer, total) / (2 - jnp.exp2(1.0 - octaves))


def _mixed(x: Seed) -> Seed:
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B)):
        x = (x ^ (x >> shift)) * jnp.uint32(factor)
    return x ^ (x >> 16)


def _split(seed: Seed, n: int) -> list[Seed]:
    return [_mixed(seed + jnp.uint32(0x632BE5AB * (i + 1) % 2**32)) for i in range(n)]


def _hashed(seed: Seed, i: Field, j: Field) -> Field:
    """Uniform on −1 to 1 at whole numbers i, j ≥ 0. XLA takes half a minute to compile as many draws of its own."""
    x = i.astype(jnp.uint32) * jnp.uint32(0x9E3779B1) + j.astype(jnp.uint32) * jnp.uint32(0x85EBCA77)
    return _mixed(x + seed).astype(i.dtype) * 2.0**-31 - 1


def _drawn(seed: Seed, rows: int, n: int, dtype) -> Field:
    """Uniform on 0 to 1, shape (rows, n)."""
    return 0.5 + 0.5 * _hashed(
        seed, *jnp.meshgrid(jnp.arange(rows, dtype=dtype), jnp.arange(n, dtype=dtype), indexing="ij")
    )


def _scaled(thickness: Field, place: Field, mean) -> Field:
    """Scaled to an area mean: texels cover areas in proportion to their distance from the axis."""
    return thickness * (mean * jnp.sum(place) / jnp.sum(thickness * place))


def _bounded(thickness: Field, place: Field, mean) -> Field:
    """The same within `RANGE`, but for what the clipped tails shift the mean."""
    low, high = RANGE
    return _scaled(jnp.clip(_scaled(thickness, place, mean), low * mean, high * mean), place, mean)


def _step(x: Field) -> Field:
    x = jnp.clip(x, 0.0, 1.0)
    return x * x * (3 - 2 * x)


@jax.jit
def _strands(seed: Seed, turns: Field, radius: Field, count: int, width: float, sway: float) -> Field:
    """Height, 0 to 1, of `count` wavy strands; where two meet, the higher one lies on top: they join and branch."""
    where, wave, high = _split(seed, 3)
    x = turns * count

    def over(top, offset):
        strand = jnp.floor(x) + offset
        at = strand / count
        centre = strand + 0.5 + 0.5 * noise(where, at, 0 * radius, (count, 1))
        centre += sway * noise(wave, at, radius, (count, 2), 2)
        height = 0.65 + 0.35 * noise(high, at, radius, (count, 3))
        return jnp.maximum(top, height * jnp.exp(-(((x - centre) / width) ** 2))), None

    return jax.lax.scan(over, jnp.zeros_like(x), jnp.arange(-2, 3).astype(x.dtype))[0]


def _fibres(seed: Seed, turns: Field, radius: Field, ring: Field, finest: int) -> Field:
    """Relative thickness of the meshwork about its mean, roughly ±0.6."""
    bent, bundles, coarse, middle, fine = _split(seed, 5)
    turns = turns + 0.008 * noise(bent, turns, radius, (10, 2), 2)
    bundle = 0.7 + 0.6 * noise(bundles, turns, radius, (40, 2), 2)
    outer = bundle * (
        1.0 * _strands(coarse, turns, radius, min(80, finest), 0.35, 0.7)
        + 0.8 * _strands(middle, turns, radius, min(160, finest), 0.35, 0.7)
    )
    inner = 0.6 * _strands(fine, turns, radius, min(192, finest), 0.4, 0.5)
    outside = _step((radius - ring) / 0.06 + 0.5)
    return inner - inner.mean() + outside * (outer - outer.mean() - (inner - inner.mean()))


def _zigzag(seed: Seed, turns: Field) -> Field:
    """Deviation of the collarette from its mean radius: teeth on a slow wander."""
    slow, teeth, *_ = _split(seed, 4)
    tooth = jnp.abs(noise(teeth, turns, 0 * turns, (44, 1)))
    return 0.035 * noise(slow, turns, 0 * turns, (5, 1), 2) + 0.07 * (tooth - 0.4)


def _ring(seed: Seed, turns: Field, radius: Field, ring: Field) -> Field:
    """Relative thickness that the collarette adds: steep towards the pupil, gentle outwards, uneven along."""
    along = 0.7 + 0.5 * noise(_split(seed, 4)[2], turns, 0 * turns, (30, 1), 2)
    off = radius - ring
    return 0.45 * along * jnp.exp(-((off / jnp.where(off < 0, 0.022, 0.05)) ** 2)) - 0.12 * _step(-off / 0.05)


@partial(jax.jit, static_argnums=3)
def _crypts(seed: Seed, turns: Field, radius: Field, count: int) -> tuple[Field, Field]:
    """Depth of crypts, 0 to 1, and `turns` as the strands see it that part round them."""
    holes, parted = jnp.zeros_like(radius), turns
    for peripheral, (own, n) in enumerate(zip(_split(seed, 2), (count, 2 * count), strict=True)):
        a, b, c, d, e = _drawn(own, 5, n, radius.dtype)
        angle = (jnp.arange(n) + 0.15 + 0.7 * a) / max(n, 1)
        if peripheral:
            middle, half_width, half_length = 0.62 + 0.3 * b, 0.002 + 0.003 * c, 0.025 + 0.04 * d
        else:
            middle, half_width, half_length = COLLARETTE + 0.1 + 0.12 * b, 0.003 + 0.010 * c**2, 0.06 + 0.10 * d

        def dig(carry, crypt):
            holes, parted = carry
            angle, middle, half_width, half_length, depth = crypt
            off = (turns - angle + 0.5) % 1.0 - 0.5
            lens = half_width * jnp.clip(1 - ((radius - middle) / half_length) ** 2, 0.0)
            hole = depth * _step((lens - jnp.abs(off)) / 0.0025 + 0.2) * (lens > 0)
            # Inside the lens `pushed` is `off`: one strand fills it, the others crowd at its rim.
            pushed = lens * jnp.tanh(off / jnp.maximum(lens, 1e-6)) * jnp.exp(-((off / (3 * half_width)) ** 2))
            return (jnp.maximum(holes, hole), parted - 0.9 * pushed), None

        drawn = angle, middle, half_width, half_length, 0.5 + 0.5 * e
        (holes, parted), _ = jax.lax.scan(dig, (holes, parted), drawn)
    return holes, parted


@jax.jit
def _furrows(seed: Seed, turns: Field, radius: Field, count: int) -> Field:
    """Crests (to about +0.5) and furrows (to −1) of the folds of contraction."""

    def fold(k, height):
        wander, extent = _split(seed + k.astype(jnp.uint32), 2)
        middle = 0.55 + 0.38 * (k + 0.5) / count + 0.025 * noise(wander, turns, 0 * turns, (6, 1), 3)
        depth = _step(0.4 + 1.6 * noise(extent, turns, 0 * turns, (7, 1)))
        off = (radius - middle) / 0.016
        return height + depth * (0.45 * off**2 - 1) * jnp.exp(-0.5 * off**2)

    return jax.lax.fori_loop(0, count, fold, jnp.zeros_like(radius))


@partial(jax.jit, static_argnums=4)
def _freckles(seed: Seed, turns: Field, place: Field, iris: Iris, count: int) -> Field:
    """Soft irregular spots, 0 to 1, of 0.05 to 0.25 mm radius."""
    where, edges = _split(seed, 2)
    a, b, c, d = _drawn(where, 4, count, place.dtype)
    where = iris.pupil_radius + (iris.iris_radius - iris.pupil_radius) * (0.15 + 0.75 * b)
    size = 0.05 * 5.0 ** (c**2)
    ragged = 1 + 0.6 * noise(edges, turns, place / iris.iris_radius, (90, 24), 3)

    def spot(spots, drawn):
        angle, where, size, dark = drawn
        across = 2 * jnp.pi * ((turns - angle + 0.5) % 1.0 - 0.5) * where
        away = jnp.sqrt(across**2 + (place - where) ** 2) * ragged / size
        return jnp.maximum(spots, dark * _step(1.6 - 1.1 * away)), None

    return jax.lax.scan(spot, jnp.zeros_like(place), (a, where, size, 0.5 + 0.5 * d))[0]


def _rays(seed: Seed, turns: Field, radius: Field, ring: Field) -> Field:
    """Share of the pigment round the pupil, 1 at its edge, frayed into rays beyond the collarette."""
    reach = ring + 0.16 + 0.14 * noise(_split(seed, 4)[3], turns, radius, (60, 2), 3)
    return 1 - _step((radius - reach) / 0.3 + 0.5)


# Pigments (eumelanin and pheomelanin, mg/ml), share in the ABL, fibril radius (nm); features.
_COLOURS: dict[str, tuple[tuple[float, float, float, float], dict[str, float]]] = {
    "brown": ((2.0, 0.3, 0.7, 72.0), {"abl": 1.0, "fibres": 0.8, "crypts": 10, "furrows": 6}),
    "hazel": ((0.5, 0.3, 0.5, 58.0), {"heterochromia": 4.0, "abl": 0.5, "freckles": 4}),
    "green": ((0.1, 0.8, 0.6, 51.5), {"heterochromia": 3.0, "freckles": 6}),
    "blue": ((0.015, 0.01, 0.5, 45.0), {}),
    "grey": ((0.4, 0.05, 0.3, 65.0), {}),
}


def preset(colour: str, *, shape: tuple[int, int] = (768, 256), key: PRNGKey) -> tuple[Iris, IrisMaps]:
    """An eye of a colour: `"brown"`, `"hazel"`, `"green"`, `"blue"` or `"grey"`."""
    if colour not in _COLOURS:
        raise ValueError(f"unknown eye colour {colour!r}; known: {', '.join(sorted(_COLOURS))}")
    (eumelanin, pheomelanin, share, radius), features = _COLOURS[colour]
    iris = Iris(
        eumelanin=jnp.asarray(eumelanin),
        pheomelanin=jnp.asarray(pheomelanin),
        abl_fraction=jnp.asarray(share),
        fibril_radius=jnp.asarray(radius),
    )
    return iris, procedural(iris, shape=shape, **features, key=key)


PRESETS = {colour: partial(preset, colour) for colour in _COLOURS}
"""Eye colours: functions of `shape` and `key` that make an iris and its maps."""
