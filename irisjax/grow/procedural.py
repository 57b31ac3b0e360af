"""Procedural irides: maps grown from a seed.

The stroma follows the ultrasound profile of [F09 Section 3] and has two layers. A meshwork of fine
fibres that lean to either side and cross lies below; above it cords of uneven thickness are
gathered in bundles, which part and join; slits part them in the pupillary zone. Fuchs's crypts are
gaps between bundles, open in a wreath outside the collarette. Density, sharpness and pigment vary
in clouds, sectors and rings. Features are drawn from what photographs show, not fitted to anything.
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
from irisjax.grow.noise import NoiseField, Seed, Whole, drawn, hashed, noise, noises, split_seed
from irisjax.numerics.checks import Range, check_range
from irisjax.numerics.interpolation import smoothstep
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, cell_centres

IPE_THICKNESS = 0.07
"""Iris pigment epithelium, mm, part of what ultrasound measures  [F09 Section 3]."""
COLLARETTE = 0.30  # mean place of the collarette between the pupil's edge (0) and the root (1)
STROMA, ABL, MELANIN = (0.1, 1.7), (0.5, 1.6), (0.4, 2.5)
"""Least and most of a map relative to its mean: wider ones cost the renderer's tables accuracy."""
FOLD = 0.025  # height of a contraction furrow's crest, mm
REST = 1.9
"""Radius of the pupil, mm, at which an iris has its mean thicknesses."""
CELLS = (67, 5, 1.0), (139, 4, 0.0)
"""Cells between bundles of fibres, wide ones and slits: how many round the iris and along the
radius, and whether they are wide."""
WREATH = 67  # crypts, at which all wide cells near the collarette are open
FINEST = 0.045  # mm between neighbouring fibres, below which they are not drawn
_Radius = TypeVar("_Radius", Array, np.ndarray)


def procedural(
    iris: Iris,
    eye: Eye | None = None,
    *,
    shape: tuple[int, int] = (768, 256),
    profile: bool = True,
    fibres: float = 1.0,
    looseness: float = 0.5,
    clouds: float = 1.0,
    collarette: float = 1.0,
    crypts: int = 14,
    furrows: int = 4,
    freckles: int = 0,
    abl: float = 0.0,
    heterochromia: float = 0.0,
    amber: float = 0.0,
    patches: float = 0.0,
    ruff: float = 1.0,
    relief: float = 0.1,
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
        looseness: How far bundles of fibres part, wave and cross, in patches: 0 straight and dense,
            1 a net.
        clouds: Contrast of denser and of clearer parts of the stroma, of several sizes.
        collarette: Height of the wreath between pupillary and ciliary zone.
        crypts: Number of openings expected near the collarette, at most `WREATH`: gaps between
            bundles of fibres. In proportion there are small ones nearer the root.
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
    # How much there is of any feature is no new program: an eye of another colour grows by the
    # program of the first.
    counts = "crypts", "furrows", "freckles"
    amounts = {k: jnp.asarray(v, None if k in counts else float) for k, v in wanted.items()}
    maps = _grow(iris, eye, shape, profile, amounts, key)
    rough = fibres or collarette or crypts or ruff or clouds
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
def _grow(iris: Iris, eye: Eye, shape, profile: bool, much, key) -> dict[str, NoiseField]:
    """All maps, with those of features of which there is nothing."""
    angles, radii = cell_centres(shape)
    turns, radius = jnp.broadcast_arrays(angles[:, None] / (2 * jnp.pi), radii)
    place = eye.from_axis(radius)
    seeds = jax.vmap(lambda i: bits(fold_in(key, i), dtype=jnp.uint32))(jnp.arange(6))
    fibres, wreath, crypts, furrows, freckles, slow = seeds
    # One program for all slow fields: bends of the cords, and clouds of pigment and of tissue.
    kinds = [
        (9, 2, 3),
        (3, 1, 2),
        (7, 3, 4),
        (22, 9, 4),
        (36, 13, 2),
        (48, 24, 3),
        (6, 2, 2),
        (5, 2, 2),
    ]
    bend, wide, cloud, mist, arc, wool, blur, open_ = noises(slow, turns, radius, kinds)
    slack = (eye.iris_radius - REST) / (eye.iris_radius - eye.pupil_radius)  # of cords and folds
    # Tissue over the area that is left to it, relative to that at rest; by rings and in the mean.
    rest = eye.replace(pupil_radius=jnp.asarray(REST, place.dtype))
    pressed = rest.ring_area(radius) / eye.ring_area(radius)
    total = (eye.iris_radius**2 - REST**2) / (eye.iris_radius**2 - eye.pupil_radius**2)
    loose = much["looseness"] * smoothstep(0.5 + 1.6 * open_)
    focus = 0.6 + 0.4 * smoothstep(0.55 + 1.4 * blur)
    bent = turns + slack * (0.006 * bend + (0.0015 + 0.003 * loose) * arc)
    ring = COLLARETTE + _wander(wreath, turns)
    pitch = 2 * jnp.pi * place / FINEST  # fibres that find room round this ring
    share = much["crypts"] / WREATH * jnp.exp(2 * open_)
    cells = crypts, bent, radius, ring, loose, mist, share, pitch, shape[0]
    bent, hole, seam, rough = _bundles(*cells)
    crest = _furrows(furrows, turns, radius, much["furrows"])
    lean = (0.02 + 0.05 * loose) * (radius + 0.1 * arc)
    cords, mesh, streak, gap = _fibres(fibres, bent, lean, radius, slack, pitch, shape[0])
    outside = smoothstep((rough - ring) / 0.06 + 0.5)
    # Between the cords of the pupillary zone lie slits, which narrow outwards.
    taper = jnp.maximum(1 - radius / (ring * (0.75 + 0.6 * mist)), 0.0)
    slit = jnp.exp(-((4 * gap) ** 2) / (taper + 1e-3)) * smoothstep(6 * taper)
    # Near the root the cords bend into arcs.
    root = jnp.exp(-((3 * arc) ** 2)) * smoothstep((radius - 0.6) / 0.3)
    hole = hole * smoothstep((1.1 - cords) / 0.5)  # cords bridge an opening
    hole *= jnp.minimum(1.0, 1.3 / slack)  # a wide pupil closes them
    clear = much["fibres"] * focus
    within = clear * ((0.5 + 0.7 * hole) * mesh + 0.2 * wool + 0.3 * streak + 0.4 * root)
    upper = (0.9 + 0.8 * outside) * (cords - 0.3) + 0.8 * outside * loose * (seam - 0.3)
    surface = clear * upper
    surface -= 0.6 * much["fibres"] * (1 - focus)  # as thick as between the cords
    surface += much["clouds"] * (0.45 * cloud + 0.35 * wide + 0.35 * mist) * (0.4 + 0.6 * outside)
    surface += much["collarette"] * _wreath(wreath, turns, rough, ring)
    surface -= 0.5 * hole + 0.4 * clear * slit
    rim = jnp.where(much["ruff"] > 0, _ruff(wreath, turns, radius / slack), 0.0)
    within -= 2.5 * much["ruff"] * rim + 0.6 * hole + 0.8 * clear * slit
    stroma = stroma_profile(radius) if profile else jnp.ones_like(radius)
    stroma *= pressed * jnp.exp(surface + within)
    mottled = 0.35 * streak + 0.5 * cloud + 0.3 * crest - 0.6 * (cords - 0.3)
    thickness = pressed * jnp.maximum(1 + much["abl"] * mottled, 0.0)
    thickness = _bounded(thickness, place, total * iris.abl_thickness, ABL)
    uneven = total * iris.stroma_thickness * _softened(jnp.tanh(surface))
    uneven += jnp.where(much["abl"] > 0, thickness - total * iris.abl_thickness, 0.0)
    reach = ring + 0.14 + 0.15 * cloud + 0.25 * streak
    inner = smoothstep((reach - rough) / 0.25 + 0.5)
    brown = 1 + much["heterochromia"] * inner * (1 + 0.7 * mist)
    root = smoothstep((radius - 0.86 + 0.12 * cloud) / 0.16)
    dark = 0.8 * cloud + 0.6 * jnp.tanh(4 * wide) + 0.6 * mist + 0.5 * streak + 0.9 * root
    dark += 2.0 * rim + 3.0 * (hole + slit) - clear * (1.5 * (cords - 0.3) + 0.4 * mesh)
    brown *= jnp.exp(much["patches"] * dark)
    reach = ring + 0.3 + 0.2 * wide - 0.2 * cloud + 0.2 * streak
    inner = smoothstep((reach - rough) / 0.5 + 0.5)
    yellow = 1 + much["amber"] * inner * (1 + 0.8 * mist + 0.4 * cloud)
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
    """The same within a range, but for what the clipped tails shift the mean.

    It flattens towards the upper end, so that what is thick keeps its fibres.
    """
    low, high = within
    relative = _scaled(thickness, place, 1.0)
    relative = _scaled(relative / jnp.sqrt(1 + (relative / high) ** 2), place, 1.0)
    return _scaled(jnp.clip(relative, low, high) * mean, place, mean)


def _strands(seed: Seed, turns, radius, count: int, sway: Scalar) -> NoiseField:
    """Height, 0 to 1, of `count` wavy cords, most of them low and thin and a few high and thick,
    each of which ends somewhere.
    """
    wave, *own = split_seed(seed, 5)
    x = turns * count

    def over(top, offset):
        strand = jnp.floor(x) + offset
        where, size, middle, length = (hashed(s, strand % count, 0 * x) for s in own)
        size = ((1 + size) / 2) ** 3
        shift = 0.8 * where + sway * noise(wave, strand / count, radius, (count, 4), 2)
        off = (x - strand - 0.5 - shift) / (0.14 + 0.4 * size)
        ends = jnp.abs(radius - 0.55 - 0.4 * middle) / (0.45 + 0.25 * length)
        height = (0.25 + 0.75 * size) * smoothstep(3 - 3 * ends)
        return jnp.maximum(top, height * jnp.exp(-off * off)), None

    return jax.lax.scan(over, jnp.zeros_like(x), jnp.arange(-2, 3).astype(x.dtype))[0]


def _fibres(
    seed: Seed, turns, lean, radius, slack, room, angles: int
) -> tuple[NoiseField, NoiseField, NoiseField, NoiseField]:
    """Cords of the upper leaf, from 0; the finer meshwork below, about 0; and streaks along both.

    Ridges at the zeros of noise lie at uneven distances, join and end. Of the upper ones the finer
    lie along the coarser, so that they are gathered in bundles and brightness is heavy-tailed. The
    lower ones lean to either side and cross.
    """
    few, many = split_seed(seed, 2)
    around, along = (19, 41, 89, 167, 61, 71, 139, 157, 90, 90), (1, 1, 2, 2, 3, 3, 4, 4, 2, 1)
    kinds = [(min(n, angles // 4), m) for n, m in zip(around, along, strict=True)]
    leaning = jnp.asarray([0.0, 0.2, -0.2, 0.0, 1.0, -1.0, 1.0, -1.0, 0.0, 0.0], radius.dtype)
    table = jnp.stack(split_seed(many, len(kinds))), *jnp.asarray(kinds).T, leaning

    def field(kind):
        seed, around, along, by = kind
        return noise(seed, turns + by * lean, radius, (around, along))

    *fields, streak, gap = jax.lax.map(field, table)
    ridges = []
    for f, (n, _) in zip(fields, kinds, strict=False):
        # About its zeros the noise over its slope is a distance: ridges are as wide everywhere.
        slope = (jnp.roll(f, -1, 0) - jnp.roll(f, 1, 0)) * (angles / (2 * n))
        away = f / jnp.hypot(0.7, slope)
        # No ridge is narrower than two texels, nor drawn where many share a picture's pixel.
        ridge = jnp.exp(-((min(7.0, angles / (1.7 * n)) * away) ** 2))
        mean = ridge.mean()
        ridges.append(mean + smoothstep(room / n - 0.5) * (ridge - mean))
    upper, gathered = 0.0, 1.0
    for ridge, height in zip(ridges[:4], (0.3, 0.4, 0.5, 0.4), strict=True):
        upper += height * gathered * ridge
        gathered = 0.35 + ridge
    cords = jnp.maximum(upper, _strands(few, turns, radius, min(59, angles // 5), 0.8 * slack))
    lower = sum(ridges[4:])
    return cords, lower - jnp.mean(lower), streak, gap


def _bundles(
    seed: Seed, turns, radius, ring, loose, ragged, share, room, angles: int
) -> tuple[NoiseField, NoiseField, NoiseField, NoiseField]:
    """Gaps between bundles of fibres, which part and join round cells of two sizes.

    Returns:
        Turns along the fibres, depth of the open cells and height of the bundles, 0 to 1, and the
        radius, ragged by the cells.
    """

    def layer(carry, kind):
        turns, hole, seam, _ = carry
        own_seed, across, along, wide = kind
        border, off, chance, middle = _cells(own_seed, turns, radius, across, along)
        # Wide ones are open in a wreath, slits about it, and a few of both out to the root.
        wreath = jnp.exp(-(((middle - ring - 0.12) / 0.16) ** 2))
        slits = 0.6 * smoothstep((ring + 0.25 - middle) / 0.3) + 0.1
        odds = share * (wide * wreath + (1 - wide) * slits)
        odds *= smoothstep(room / across - 0.3)  # none where many share a picture's pixel
        deep = smoothstep(1.5 - chance / jnp.maximum(odds, 1e-6))
        hole = jnp.maximum(hole, deep * smoothstep((border - 0.1 + 0.3 * ragged) / 0.5))
        height = jnp.exp(-((border / (0.2 + 0.1 * ragged)) ** 2))
        turns -= (0.35 * loose + 0.4 * deep) * off
        return (turns, hole, jnp.maximum(seam, height), middle), middle

    cells = [(min(n, angles // 4), *others) for n, *others in CELLS]
    kinds = jnp.asarray(split_seed(seed, 2)), *jnp.asarray(cells, radius.dtype).T
    start = turns, 0 * radius, 0 * radius, 0 * radius
    (turns, hole, seam, _), middles = jax.lax.scan(layer, start, kinds)
    return turns, hole, seam, radius + 0.5 * (middles[0] - radius)


def _cells(seed: Seed, turns, radius, across, along) -> tuple[NoiseField, ...]:
    """Cells about scattered points: by how much the second point is farther than the nearest, in
    cells, and of the nearest, blended at borders: its offset in turns, a number of its own from 0
    to 1, and its radius.

    Rows are staggered and distances between those of a circle and a rhomb, so that cells end in
    points.
    """
    draws = split_seed(seed, 4)
    y = radius * along + 1

    def nearer(carry, offset):
        first, second, *sums = carry
        row = jnp.floor(y) + offset[1]
        x = turns * across - 0.5 * (row % 2)
        at = jnp.floor(x) + offset[0]
        a, b, size, own = (hashed(s, at % across, row) for s in draws)
        dx, dy = x - at - 0.5 - 0.4 * a, y - row - 0.5 - 0.4 * b
        away = (jnp.abs(dx) + jnp.abs(dy) + jnp.hypot(dx, dy)) / 2 + 0.25 * size
        second = jnp.minimum(second, jnp.maximum(first, away))
        of_it = 1.0, dx / across, 0.5 + 0.5 * own, radius - dy / along
        weight = jnp.exp(-15 * away)
        sums = (total + weight * value for total, value in zip(sums, of_it, strict=True))
        return (jnp.minimum(first, away), second, *sums), None

    far, none = jnp.full_like(y, 9.0), jnp.zeros_like(y)
    offsets = jnp.asarray([(i, j) for j in (-1, 0, 1) for i in (-1, 0, 1)], y.dtype)
    start = far, far, none, none, none, none
    first, second, weight, *sums = jax.lax.scan(nearer, start, offsets)[0]
    return second - first, *(total / weight for total in sums)


def _wander(seed: Seed, turns) -> NoiseField:
    """Deviation of the collarette from its mean radius, (angles, 1): teeth on a slow wander."""
    slow, teeth, *_ = split_seed(seed, 5)
    at, none = turns[:, :1], 0 * turns[:, :1]
    tooth = jnp.abs(noise(teeth, at, none, (31, 1), 2))
    return 0.05 * noise(slow, at, none, (4, 1), 3) + 0.14 * (tooth - 0.3)


def _wreath(seed: Seed, turns, radius, ring) -> NoiseField:
    """Relative thickness that the collarette adds: two cords that wind about each other."""
    *_, one, two, along = split_seed(seed, 5)
    at, none = turns[:, :1], 0 * turns[:, :1]
    height = 0.6 + 0.5 * noise(along, at, none, (24, 1), 3)

    def cord(seed, spread, width):
        off = radius - ring - spread * noise(seed, at, none, (23, 1), 3)
        return jnp.exp(-((off / jnp.where(off < 0, 0.05, width)) ** 2))

    crests = jnp.maximum(cord(one, 0.05, 0.12), 0.8 * cord(two, 0.08, 0.05))
    return 0.8 * height * crests - 0.35 * smoothstep((ring - radius) / 0.08)


def _ruff(seed: Seed, turns, radius) -> NoiseField:
    """Share of the seam of pigment epithelium at the pupil's edge, scalloped."""
    at, none = turns[:, :1], 0 * turns[:, :1]
    width = 0.024 + 0.016 * noise(split_seed(seed, 6)[5], at, none, (70, 1), 3)
    return smoothstep((width - radius) / 0.014 + 0.5)


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
