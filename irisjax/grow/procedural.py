"""Procedural irides: maps grown from a seed.

The stroma follows the ultrasound profile of [F09 Section 3] and has two layers. Fine radial fibres
run from pupil to root; outside the collarette an upper leaf of thicker cords lies over them, with
Fuchs's crypts as openings. Pigment lies in rings, patches and veils.
Features are drawn from what textbooks show, not fitted to anything.
"""

import math
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.random import bits, fold_in
from jaxtyping import Array

from irisjax._types import PRNGKey, Scalar
from irisjax.anatomy.eye import Eye
from irisjax.grow.noise import NoiseField, Seed, Whole, drawn, noise, noises, split_seed
from irisjax.numerics.checks import Range, check_range
from irisjax.numerics.interpolation import smoothstep
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, cell_centres

IPE_THICKNESS = 0.07
"""Iris pigment epithelium, mm, part of what ultrasound measures  [F09 Section 3]."""
COLLARETTE = 0.30  # mean place of the collarette between the pupil's edge (0) and the root (1)
STROMA, ABL, MELANIN = (0.15, 2.5), (0.5, 1.6), (0.4, 2.5)
"""Least and most of a map relative to its mean: wider ones cost the renderer's tables accuracy."""
FOLD = 0.025  # height of a contraction furrow's crest, mm
REST = 1.9
"""Radius of the pupil, mm, at which an iris has its mean thicknesses."""
FINEST = 0.045  # mm between neighbouring fibres, below which they are not drawn
_Radius = TypeVar("_Radius", Array, np.ndarray)


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
    amber: float = 0.0,
    patches: float = 0.0,
    ruff: float = 1.0,
    relief: float = 0.3,
    key: PRNGKey,
) -> IrisMaps:
    """Grow the maps of an invented iris; a map that no feature needs is absent.

    Args:
        iris: Gives mean thicknesses: area means over the ring from pupil to root at a pupil of
            `REST`.
        eye: Gives that ring (default: `Eye()`). Equal keys give the same tissue at any pupil: a
            wider one presses it together along the radius, so that every ring keeps its volume and
            thickens; furrows deepen, crypts close, cords bend, and the seam at the pupil keeps its
            width.
        shape: Numbers of angles and radii; fewer than 768 angles coarsen the finest fibres.
        profile: Whether the stroma thins towards the root as in ultrasound.
        fibres: Contrast of the radial fibres, 1 as in a light iris.
        collarette: Height of the wreath between pupillary and ciliary zone.
        crypts: Number of groups of openings near the collarette; each has a small one nearer the
            root.
        furrows: Number of concentric contraction furrows, partial arcs in the ciliary zone.
        freckles: Number of spots.
        abl: How far the anterior border layer is thinned over crypts, gathered on the crests of
            furrows and mottled, 1 as in a brown iris.
        heterochromia: Eumelanin added round the pupil, in rays, relative to the rest's.
        amber: Pheomelanin added round the pupil, in a wide and cloudy ring, relative to the rest's.
        patches: Contrast of patches and sectors of eumelanin, and of its ring at the root.
        ruff: How far the stroma ends before the pupil's edge, where the scalloped, dark seam of the
            pigment epithelium shows, 1 as usual.
        relief: Share of the unevenness that rises towards the cornea; the rest lies within. 0: no
            relief, nor furrows.
        key: Random key; equal keys give equal maps.

    Returns:
        Maps with `stroma_depth` unless the stroma is uniform, and at need `relief`, `abl_depth`,
        `freckles`, `eumelanin` and `pheomelanin`, the last two with area means of 1.

    Raises:
        ValueError: A feature is negative, or the shape is below (16, 8).
    """
    given, general = locals(), ("iris", "eye", "shape", "profile", "key")
    wanted = {name: value for name, value in given.items() if name not in general}
    for name, value in wanted.items():
        check_range(name, value, Range(0, math.inf))
    if shape[0] < 16 or shape[1] < 8:
        raise ValueError(f"shape {shape} is below (16, 8)")
    eye = Eye() if eye is None else eye
    # Fibres cost most and are left out where there are none. How much there is of any feature is no
    # new program: an eye of another colour grows by the program of the first.
    counts = "crypts", "furrows", "freckles"
    amounts = {k: jnp.asarray(v, None if k in counts else float) for k, v in wanted.items()}
    maps = _grow(iris, eye, shape, profile, bool(fibres), amounts, key)
    rough = fibres or collarette or crypts or ruff
    absent = {
        "stroma_depth": not (profile or rough),
        "relief": not (relief and (rough or furrows or abl)),
        "abl_depth": not abl,
        "freckles": not freckles,
        "eumelanin": not (heterochromia or patches),
        "pheomelanin": not amber,
    }
    return IrisMaps(**{name: None if absent[name] else value for name, value in maps.items()})


@eqx.filter_jit
def _grow(
    iris: Iris, eye: Eye, shape, profile: bool, fibrous: bool, much, key
) -> dict[str, NoiseField]:
    """All maps, with those of features of which there is nothing."""
    angles, radii = cell_centres(shape)
    turns, radius = jnp.broadcast_arrays(angles[:, None] / (2 * jnp.pi), radii)
    place = eye.from_axis(radius)
    seeds = jax.vmap(lambda i: bits(fold_in(key, i), dtype=jnp.uint32))(jnp.arange(6))
    fibres, wreath, crypts, furrows, freckles, slow = seeds
    # One program for all slow fields: a bend of the cords, and clouds of pigment and of tissue.
    kinds = [(9, 2, 3), (3, 1, 2), (7, 3, 4), (22, 9, 4), (90, 4, 2), (36, 13, 2), (48, 24, 3)]
    bend, wide, cloud, mist, streak, arc, wool = noises(slow, turns, radius, kinds)
    slack = (eye.iris_radius - REST) / (eye.iris_radius - eye.pupil_radius)  # of cords and folds
    # Tissue over the area that is left to it, relative to that at rest; by rings and in the mean.
    rest = eye.replace(pupil_radius=jnp.asarray(REST, place.dtype))
    pressed = rest.ring_area(radius) / eye.ring_area(radius)
    total = (eye.iris_radius**2 - REST**2) / (eye.iris_radius**2 - eye.pupil_radius**2)
    bent = turns + 0.006 * slack * bend
    ring = COLLARETTE + _wander(wreath, turns)
    outside = smoothstep((radius - ring) / 0.05 + 0.5)
    region, parted = _crypts(crypts, turns, radius, mist, streak, much["crypts"])
    bent += parted
    crest = _furrows(furrows, turns, radius, much["furrows"])
    within, surface = 0.0, jnp.zeros_like(radius)
    cords, gap = 0.45, 1.0
    if fibrous:
        pitch = 2 * jnp.pi * place / FINEST  # fibres that find room round this ring
        mesh, cords, spokes = _fibres(fibres, bent, radius, slack, pitch, shape[0])
        gap = smoothstep((0.95 - cords) / 0.5)  # cords bridge an opening
        # Near the root the cords bend into arcs.
        root = jnp.exp(-((3 * arc) ** 2)) * smoothstep((radius - 0.6) / 0.3)
        within = much["fibres"] * (0.8 * mesh + 0.35 * wool + 0.6 * root)
        upper = outside * 1.8 * (cords - 0.55) + (1 - outside) * 1.3 * (spokes - 0.6)
        surface += much["fibres"] * ((1 + 0.5 * cloud) * upper + (mist + cloud + wide) / 4)
    surface += much["collarette"] * _wreath(wreath, turns, radius, ring)
    hole = region * gap * jnp.minimum(1.0, 1.3 / slack)  # a wide pupil closes them
    surface -= 2.2 * hole
    rim = jnp.where(much["ruff"] > 0, _ruff(wreath, turns, radius / slack), 0.0)
    within -= 2.5 * much["ruff"] * rim
    stroma = stroma_profile(radius) if profile else jnp.ones_like(radius)
    stroma *= pressed * jnp.exp(surface + within)
    mottled = 0.35 * streak + 0.3 * cloud + 0.3 * crest - 0.6 * hole + 0.5 * (cords - 0.45)
    thickness = pressed * jnp.maximum(1 + much["abl"] * mottled, 0.0)
    thickness = _bounded(thickness, place, total * iris.abl_thickness, ABL)
    uneven = total * iris.stroma_thickness * _softened(jnp.tanh(surface))
    uneven += jnp.where(much["abl"] > 0, thickness - total * iris.abl_thickness, 0.0)
    reach = ring + 0.14 + 0.15 * cloud + 0.25 * streak
    inner = smoothstep((reach - radius) / 0.25 + 0.5)
    brown = 1 + much["heterochromia"] * inner * (1 + 0.7 * mist)
    root = smoothstep((radius - 0.86 + 0.12 * cloud) / 0.16)
    dark = cloud + 0.7 * wide + 0.5 * mist + 0.5 * streak + 0.9 * root
    dark += 2.0 * rim - 0.8 * (cords - 0.45)
    brown *= jnp.exp(much["patches"] * dark)
    reach = ring + 0.3 + 0.2 * wide - 0.2 * cloud + 0.2 * streak
    inner = smoothstep((reach - radius) / 0.5 + 0.5)
    yellow = 1 + much["amber"] * inner * (1 + 0.5 * mist)
    spots = freckles, turns, rest.from_axis(radius), rest, mist + wool
    return {
        "stroma_depth": _bounded(stroma, place, total * iris.stroma_thickness, STROMA),
        "abl_depth": thickness,
        "relief": much["relief"] * uneven + FOLD * jnp.minimum(slack, 2.0) * crest,
        "freckles": _freckles(*spots, much["freckles"]),
        "eumelanin": _bounded(brown, place, 1.0, MELANIN),
        "pheomelanin": _bounded(yellow, place, 1.0, MELANIN),
    }


def stroma_profile(radius: _Radius) -> _Radius:
    """Thickness of a generic stroma, mm, at relative radii from 0 (2 mm) to 1 (5.5 mm).

    Quadratic through 0.645, 0.457 and 0.372 mm at 2.25, 3.5 and 5 mm, less IPE and ABL  [F09
    Section 3].
    """
    r = 2.0 + 3.5 * radius
    inner, outer = (0.457 - 0.645) / 1.25, (0.372 - 0.457) / 1.5
    whole = 0.645 + (r - 2.25) * (inner + (r - 3.5) * (outer - inner) / 2.75)
    return whole - IPE_THICKNESS - 0.05675


def _softened(height: NoiseField) -> NoiseField:
    """Without the angular frequencies that a map's texels hold no slope of: twice (1, 2, 1) / 4."""
    for _ in range(2):
        height = (jnp.roll(height, 1, 0) + 2 * height + jnp.roll(height, -1, 0)) / 4
    return height


def _scaled(thickness, place, mean) -> NoiseField:
    """Scaled to an area mean: texels cover areas in proportion to their distance from the axis."""
    return thickness * (mean * jnp.sum(place) / jnp.sum(thickness * place))


def _bounded(thickness, place, mean, within: tuple[float, float]) -> NoiseField:
    """The same within a range, but for what the clipped tails shift the mean."""
    low, high = within
    return _scaled(jnp.clip(_scaled(thickness, place, mean), low * mean, high * mean), place, mean)


def _strands(seed: Seed, turns, radius, count: int, width: float, sway: Scalar) -> NoiseField:
    """Height, 0 to 1, of `count` wavy strands that join and branch: the higher one lies on top."""
    where, wave, high = split_seed(seed, 3)
    x = turns * count

    def over(top, offset):
        strand = jnp.floor(x) + offset
        at = strand / count
        shift = noise(wave, at, radius, (count, 3), 2)
        centre = strand + 0.5 + 0.6 * noise(where, at, 0 * radius, (count, 1)) + sway * shift
        height = noise(high, at, radius, (count, 3))
        off = (x - centre) / (width * (1 + 0.5 * height))
        return jnp.maximum(top, (0.7 + 0.3 * height) * jnp.exp(-off * off)), None

    return jax.lax.scan(over, jnp.zeros_like(x), jnp.arange(-2, 3).astype(x.dtype))[0]


def _fibres(seed: Seed, turns, radius, slack, room, angles: int) -> tuple[NoiseField, ...]:
    """Fine fibres everywhere, about 0; cords of the upper leaf and pupillary spokes, 0 to 1."""
    fine, coarse, middle, inner = split_seed(seed, 4)
    # Ridges at the zeros of noise: they join in long loops, which is a meshwork.
    counts = [(min(n, angles // 4), m, 1) for n, m in ((61, 2), (113, 3), (191, 5))]
    mesh = jnp.zeros_like(radius)
    for field, (n, *_) in zip(noises(fine, turns, radius, counts), counts, strict=True):
        # No ridge is narrower than two texels, nor drawn where many share a picture's pixel.
        ridge = jnp.exp(-((min(5.0, angles / (2.4 * n)) * field) ** 2))
        mesh += smoothstep(room / n - 0.5) * (ridge - ridge.mean())
    few, many = (min(n, angles // 5) for n in (59, 149))
    thick = _strands(coarse, turns, radius, few, 0.3, 0.55 * slack)
    thin = _strands(middle, turns, radius, many, 0.3, 0.9 * slack)
    cords = jnp.maximum(thick, 0.85 * thin)
    spokes = _strands(inner, turns, radius, min(110, angles // 4), 0.42, 0.5 * slack)
    spokes = 0.5 + smoothstep(room / 110 - 0.3) * (spokes - 0.5)
    return mesh, cords, spokes


def _wander(seed: Seed, turns) -> NoiseField:
    """Deviation of the collarette from its mean radius, (angles, 1): teeth on a slow wander."""
    slow, teeth, *_ = split_seed(seed, 5)
    at, none = turns[:, :1], 0 * turns[:, :1]
    tooth = jnp.abs(noise(teeth, at, none, (31, 1), 3))
    return 0.05 * noise(slow, at, none, (4, 1), 3) + 0.14 * (tooth - 0.3)


def _wreath(seed: Seed, turns, radius, ring) -> NoiseField:
    """Relative thickness that the collarette adds: two cords that wind about each other."""
    *_, one, two, along = split_seed(seed, 5)
    at, none = turns[:, :1], 0 * turns[:, :1]
    height = 0.6 + 0.5 * noise(along, at, none, (24, 1), 3)

    def cord(seed, spread, width):
        off = radius - ring - spread * noise(seed, at, none, (23, 1), 3)
        return jnp.exp(-((off / jnp.where(off < 0, 0.025, width)) ** 2))

    crests = jnp.maximum(cord(one, 0.05, 0.12), 0.8 * cord(two, 0.08, 0.05))
    return 0.8 * height * crests - 0.15 * smoothstep((ring - radius) / 0.05)


def _ruff(seed: Seed, turns, radius) -> NoiseField:
    """Share of the seam of pigment epithelium at the pupil's edge, scalloped."""
    at, none = turns[:, :1], 0 * turns[:, :1]
    width = 0.024 + 0.016 * noise(split_seed(seed, 6)[5], at, none, (70, 1), 3)
    return smoothstep((width - radius) / 0.014 + 0.5)


def _crypts(
    seed: Seed, turns, radius, ragged, streak, count: Whole
) -> tuple[NoiseField, NoiseField]:
    """Depth of openings, 0 to 1, and by how much of a turn strands part round them."""

    def dig(k, carry):
        holes, parted = carry
        a, b, c, d, e = drawn(seed, 5, k, radius.dtype)
        angle = (k + 0.9 * a) / count  # once round by the collarette, once nearer the root
        near = k < count
        middle = jnp.where(near, COLLARETTE + 0.08 + 0.16 * b, 0.55 + 0.35 * b)
        half_width = jnp.where(near, 0.006 + 0.014 * c**2, 0.002 + 0.003 * c)
        half_length = jnp.where(near, 0.07 + 0.10 * d, 0.04 + 0.06 * d)
        off = (turns - angle + 0.5) % 1.0 - 0.5
        along = (radius - middle) / half_length
        away = jnp.abs(off) / half_width + along**2  # a lens
        depth = (0.55 + 0.45 * e) * jnp.where(near, 1.0, 0.6)
        hole = depth * smoothstep(1.1 - 0.8 * away + 0.5 * ragged + 0.7 * streak)
        push = 0.4 * off * jnp.exp(-0.5 * away)
        return jnp.maximum(holes, hole), parted - push

    return jax.lax.fori_loop(0, 2 * count, dig, (jnp.zeros_like(radius), 0 * turns))


def _furrows(seed: Seed, turns, radius, count: Whole) -> NoiseField:
    """Crests (to about +0.5) and furrows (to −1) of the folds of contraction."""

    def fold(k, height):
        wander, extent = split_seed(seed + k.astype(jnp.uint32), 2)
        at, none = turns[:, :1], 0 * turns[:, :1]
        middle = 0.5 + 0.36 * (k + 0.5) / count + 0.04 * noise(wander, at, none, (5, 1), 4)
        depth = smoothstep(0.4 + 1.3 * noise(extent, at, none, (5, 1), 3))
        off = (radius - middle) / 0.03
        return height + depth * (0.45 * off**2 - 1) * jnp.exp(-0.5 * off**2)

    return jax.lax.fori_loop(0, count, fold, jnp.zeros_like(radius))


def _freckles(seed: Seed, turns, place, eye: Eye, ragged, count: Whole) -> NoiseField:
    """Soft irregular spots, 0 to 1, of 0.05 to 0.25 mm radius."""

    def spot(k, painted):
        a, b, c, d = drawn(seed, 4, k, place.dtype)
        where = eye.from_axis(0.15 + 0.75 * b)
        across = 2 * jnp.pi * ((turns - a + 0.5) % 1.0 - 0.5) * where
        away = jnp.sqrt(across**2 + (place - where) ** 2) / (0.05 * 5.0 ** (c**2))
        return jnp.maximum(painted, (0.3 + 0.7 * d) * smoothstep(1.4 - 0.9 * away + 0.8 * ragged))

    return jax.lax.fori_loop(0, count, spot, jnp.zeros_like(place))
