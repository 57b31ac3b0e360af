"""Procedural irides: maps grown from a seed.

The stroma follows the ultrasound profile of [F09 Section 3] and is a meshwork of radial strands:
bundled, wavy, fine between pupil and collarette, coarse outside, parting round Fuchs's crypts.
Features are drawn from what textbooks show, not fitted to anything.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.random import bits, fold_in

from irisjax._types import PRNGKey
from irisjax.anatomy.eye import Eye
from irisjax.grow.noise import NoiseField, Seed, Whole, drawn, noise, split_seed
from irisjax.numerics.checks import Range, check_range
from irisjax.numerics.interpolation import smoothstep
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, cell_centres

IPE_THICKNESS = 0.07
"""Iris pigment epithelium, mm, part of what ultrasound measures  [F09 Section 3]."""
COLLARETTE = 0.32  # mean place of the collarette between the pupil's edge (0) and the root (1)
RANGE = (0.38, 2.0)  # thinnest and thickest place of a layer relative to its mean
FOLD = 0.03  # height of a contraction furrow's crest, mm


def procedural(
    iris: Iris,
    eye: Eye | None = None,
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
    relief: float = 0.3,
    key: PRNGKey,
) -> IrisMaps:
    """Grow the maps of an invented iris; a map that no feature needs is absent.

    Args:
        iris: Gives mean thicknesses, kept as area means over the ring from pupil to root.
        eye: Gives that ring (default: `Eye()`).
        shape: Numbers of angles and radii; fewer than 768 angles coarsen the finest fibres.
        profile: Whether the stroma thins towards the root as in ultrasound.
        fibres: Contrast of the radial strands, 1 as in a light iris.
        collarette: Height of the zig-zag ring.
        crypts: Number of lens-shaped holes near the collarette, each with a small one nearer the
            root.
        furrows: Number of concentric contraction furrows, partial arcs in the ciliary zone.
        freckles: Number of spots.
        abl: How far the anterior border layer is thinned over crypts, gathered on the crests of
            furrows and mottled, 1 as in a brown iris.
        heterochromia: Eumelanin added round the pupil, relative to the rest's.
        relief: Share of the unevenness that rises towards the cornea; the rest lies within. 0: no
            relief, nor furrows.
        key: Random key; equal keys give equal maps.

    Returns:
        Maps with `stroma_depth` unless the stroma is uniform, and at need `relief`, `abl_depth`,
        `freckles` and `eumelanin`.

    Raises:
        ValueError: A feature is negative, or the shape is below (16, 8).
    """
    given, general = locals(), ("iris", "eye", "shape", "profile", "key")
    wanted = {name: value for name, value in given.items() if name not in general}
    for name, value in wanted.items():
        check_range(name, value, Range(0, math.inf))
    # Absent features are not computed; how much there is of the others is no new program.
    has = {name: jnp.asarray(value) for name, value in wanted.items() if value}
    if shape[0] < 16 or shape[1] < 8:
        raise ValueError(f"shape {shape} is below (16, 8)")
    return IrisMaps(**_grow(iris, Eye() if eye is None else eye, shape, profile, has, key))


@eqx.filter_jit
def _grow(iris: Iris, eye: Eye, shape, profile: bool, has, key) -> dict[str, NoiseField]:
    angles, radii = cell_centres(shape)
    turns, radius = jnp.broadcast_arrays(angles[:, None] / (2 * jnp.pi), radii)
    place = eye.from_axis(radius)
    seeds = jax.vmap(lambda i: bits(fold_in(key, i), dtype=jnp.uint32))(jnp.arange(6))
    fibres, zigzag, crypts, furrows, freckles, mottles = seeds
    ring = COLLARETTE + _zigzag(zigzag, turns)
    holes = crest = jnp.zeros_like(radius)
    parted, uneven, maps = turns, 1.0, {}
    if "crypts" in has:
        holes, parted = _crypts(crypts, turns, radius, has["crypts"])
    if "furrows" in has:
        crest = _furrows(furrows, turns, radius, has["furrows"])
    if "fibres" in has:
        uneven += has["fibres"] * _fibres(fibres, parted, radius, ring, shape[0] // 4)
    if "collarette" in has:
        uneven += has["collarette"] * _ring(zigzag, turns, radius, ring)
    uneven *= 1 - 0.7 * holes
    stroma = stroma_profile(radius) if profile else jnp.ones_like(radius)
    smooth = _scaled(stroma, place, iris.stroma_thickness)
    stroma = _bounded(stroma * uneven, place, iris.stroma_thickness)
    rough = has.keys() & {"fibres", "collarette", "crypts"}
    if profile or rough:
        maps["stroma_depth"] = stroma
    share = has.get("relief", 0.0)
    height = share * (stroma - smooth)
    if "abl" in has:
        mottled = 0.3 * noise(mottles, parted, radius, (30, 4), 4) + 0.2 * crest - 0.3 * holes
        maps["abl_depth"] = _bounded(1 + has["abl"] * mottled, place, iris.abl_thickness)
        height += share * (maps["abl_depth"] - iris.abl_thickness)
    if "relief" in has and (rough or has.keys() & {"furrows", "abl"}):
        maps["relief"] = height + FOLD * crest
    if "freckles" in has:
        maps["freckles"] = _freckles(freckles, turns, place, eye, has["freckles"])
    if "heterochromia" in has:
        maps["eumelanin"] = 1 + has["heterochromia"] * _rays(zigzag, parted, radius, ring)
    return maps


def stroma_profile(radius: NoiseField) -> NoiseField:
    """Thickness of a generic stroma, mm, at relative radii from 0 (2 mm) to 1 (5.5 mm).

    Quadratic through 0.645, 0.457 and 0.372 mm at 2.25, 3.5 and 5 mm, less IPE and ABL  [F09
    Section 3].
    """
    r = 2.0 + 3.5 * radius
    inner, outer = (0.457 - 0.645) / 1.25, (0.372 - 0.457) / 1.5
    whole = 0.645 + (r - 2.25) * (inner + (r - 3.5) * (outer - inner) / 2.75)
    return whole - IPE_THICKNESS - 0.05675


def _scaled(thickness, place, mean) -> NoiseField:
    """Scaled to an area mean: texels cover areas in proportion to their distance from the axis."""
    return thickness * (mean * jnp.sum(place) / jnp.sum(thickness * place))


def _bounded(thickness, place, mean) -> NoiseField:
    """The same within `RANGE`, but for what the clipped tails shift the mean."""
    low, high = RANGE
    return _scaled(jnp.clip(_scaled(thickness, place, mean), low * mean, high * mean), place, mean)


def _strands(seed: Seed, turns, radius, count: int, width: float, sway: float) -> NoiseField:
    """Height, 0 to 1, of `count` wavy strands that join and branch: the higher one lies on top."""
    where, wave, high = split_seed(seed, 3)
    x = turns * count

    def over(top, offset):
        strand = jnp.floor(x) + offset
        at = strand / count
        centre = strand + 0.5 + 0.5 * noise(where, at, 0 * radius, (count, 1))
        centre += sway * noise(wave, at, radius, (count, 2), 2)
        height = 0.65 + 0.35 * noise(high, at, radius, (count, 3))
        return jnp.maximum(top, height * jnp.exp(-(((x - centre) / width) ** 2))), None

    return jax.lax.scan(over, jnp.zeros_like(x), jnp.arange(-2, 3).astype(x.dtype))[0]


def _fibres(seed: Seed, turns, radius, ring, finest: int) -> NoiseField:
    """Relative thickness of the meshwork about its mean, roughly ±0.6."""
    bent, bundles, coarse, middle, fine = split_seed(seed, 5)
    turns = turns + 0.008 * noise(bent, turns, radius, (10, 2), 2)
    bundle = 0.7 + 0.6 * noise(bundles, turns, radius, (40, 2), 2)
    wide = _strands(coarse, turns, radius, min(80, finest), 0.35, 0.7)
    outer = bundle * (wide + 0.8 * _strands(middle, turns, radius, min(160, finest), 0.35, 0.7))
    inner = 0.45 * _strands(fine, turns, radius, min(192, finest), 0.4, 0.5)
    outside = smoothstep((radius - ring) / 0.06 + 0.5)
    return inner - inner.mean() + outside * (outer - outer.mean() - (inner - inner.mean()))


def _zigzag(seed: Seed, turns) -> NoiseField:
    """Deviation of the collarette from its mean radius: teeth on a slow wander."""
    slow, teeth, *_ = split_seed(seed, 4)
    tooth = jnp.abs(noise(teeth, turns, 0 * turns, (44, 1)))
    return 0.035 * noise(slow, turns, 0 * turns, (5, 1), 2) + 0.07 * (tooth - 0.4)


def _ring(seed: Seed, turns, radius, ring) -> NoiseField:
    """Relative thickness that the collarette adds: steep towards the pupil, uneven along."""
    along = 0.7 + 0.5 * noise(split_seed(seed, 4)[2], turns, 0 * turns, (30, 1), 2)
    off = radius - ring
    crest = 0.45 * along * jnp.exp(-((off / jnp.where(off < 0, 0.022, 0.05)) ** 2))
    return crest - 0.12 * smoothstep(-off / 0.05)


def _crypts(seed: Seed, turns, radius, count: Whole) -> tuple[NoiseField, NoiseField]:
    """Depth of crypts, 0 to 1, and `turns` as the strands see it that part round them."""

    def dig(k, carry):
        holes, parted = carry
        a, b, c, d, e = drawn(seed, 5, k, radius.dtype)
        angle = (k + 0.15 + 0.7 * a) / count  # round once by the collarette, once nearer the root
        near = k < count
        middle = jnp.where(near, COLLARETTE + 0.10 + 0.12 * b, 0.62 + 0.30 * b)
        half_width = jnp.where(near, 0.003 + 0.010 * c**2, 0.002 + 0.003 * c)
        half_length = jnp.where(near, 0.06 + 0.10 * d, 0.025 + 0.04 * d)
        off = (turns - angle + 0.5) % 1.0 - 0.5
        lens = half_width * jnp.clip(1 - ((radius - middle) / half_length) ** 2, 0.0)
        hole = (0.5 + 0.5 * e) * smoothstep((lens - jnp.abs(off)) / 0.0025 + 0.2) * (lens > 0)
        # Inside the lens `pushed` is `off`: one strand fills it, the others crowd at its rim.
        pushed = lens * jnp.tanh(off / jnp.maximum(lens, 1e-6))
        pushed = pushed * jnp.exp(-((off / (3 * half_width)) ** 2))
        return jnp.maximum(holes, hole), parted - 0.9 * pushed

    return jax.lax.fori_loop(0, 2 * count, dig, (jnp.zeros_like(radius), turns))


def _furrows(seed: Seed, turns, radius, count: Whole) -> NoiseField:
    """Crests (to about +0.5) and furrows (to −1) of the folds of contraction."""

    def fold(k, height):
        wander, extent = split_seed(seed + k.astype(jnp.uint32), 2)
        middle = 0.55 + 0.38 * (k + 0.5) / count
        middle = middle + 0.025 * noise(wander, turns, 0 * turns, (6, 1), 3)
        depth = smoothstep(0.4 + 1.6 * noise(extent, turns, 0 * turns, (7, 1)))
        off = (radius - middle) / 0.016
        return height + depth * (0.45 * off**2 - 1) * jnp.exp(-0.5 * off**2)

    return jax.lax.fori_loop(0, count, fold, jnp.zeros_like(radius))


def _freckles(seed: Seed, turns, place, eye: Eye, count: Whole) -> NoiseField:
    """Soft irregular spots, 0 to 1, of 0.05 to 0.25 mm radius."""
    spots, edges = split_seed(seed, 2)
    ragged = 1 + 0.6 * noise(edges, turns, place / eye.iris_radius, (90, 24), 3)

    def spot(k, painted):
        a, b, c, d = drawn(spots, 4, k, place.dtype)
        where = eye.from_axis(0.15 + 0.75 * b)
        across = 2 * jnp.pi * ((turns - a + 0.5) % 1.0 - 0.5) * where
        away = jnp.sqrt(across**2 + (place - where) ** 2) * ragged / (0.05 * 5.0 ** (c**2))
        return jnp.maximum(painted, (0.5 + 0.5 * d) * smoothstep(1.6 - 1.1 * away))

    return jax.lax.fori_loop(0, count, spot, jnp.zeros_like(place))


def _rays(seed: Seed, turns, radius, ring) -> NoiseField:
    """Share of the pigment round the pupil, 1 at its edge, in rays beyond the collarette."""
    reach = ring + 0.12 + 0.22 * noise(split_seed(seed, 4)[3], turns, radius, (60, 2), 3)
    return 1 - smoothstep((radius - reach) / 0.4 + 0.5)
