"""Procedural irides: maps grown from a seed.

The stroma follows the ultrasound profile of [F09 Section 3]. Its fibres are nets of lens-shaped
meshes, from coarse to fine: the lines on which noise is 0, straight inside the collarette and bent
outside; slits part them in the pupillary zone. Fuchs's crypts are gaps between bundles, open in a
wreath outside the collarette. Density, sharpness and pigment vary in clouds, tufts, sectors and
rings; where the stroma is thin, its pigment is denser. Features are drawn from what photographs
show, not fitted to anything. Relative to its mean over 17 degrees, luminance along a ring varies by
0.20 to 0.31 (r.m.s.) in the presets, and by 0.27 to 0.41 in six photographs.
"""

import math
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.random import bits, fold_in
from jaxtyping import Array

from irisjax._types import PRNGKey
from irisjax.anatomy.eye import Eye
from irisjax.grow.noise import (
    Count,
    NoiseField,
    Seed,
    draw_uniform,
    hash_uniform,
    noise,
    noise_fields,
    split_seed,
)
from irisjax.numerics.checks import Range, check_range, is_known
from irisjax.numerics.interpolation import smoothstep
from irisjax.numerics.streams import one_key
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, cell_centres

IPE_THICKNESS = 0.07
"""Thickness of the iris pigment epithelium, mm, which ultrasound includes  [F09 Section 3]."""
COLLARETTE = 0.30  # mean radius of the collarette between the pupil's edge (0) and the root (1)
STROMA, ABL, MELANIN = (0.12, 2.4), (0.5, 1.6), (0.2, 2.5)
"""Ranges of maps relative to their means: wider ones cost the renderer's tables accuracy."""
SMOOTH_STROMA = 0.2, 1.8
"""The range of a stroma without fibres."""
FURROW_HEIGHT = 0.025  # height of a contraction furrow's crest, mm
PUPIL_AT_REST = 1.9
"""Radius of the pupil, mm, at which an iris has its mean thicknesses."""
BUNDLE_CELLS = (53, 3, 1.0), (139, 4, 0.0)
"""Cells between bundles of fibres, wide ones and slits: their numbers round the iris and along the
radius, and whether they are wide.
"""
FIBRES = (
    (53, 1, 0.08, 1.6),
    (83, 2, 0.11, 1.6),
    (127, 2, 0.16, 1.6),
    (191, 4, 0.25, 1.4),
    (307, 6, 0.35, 1.2),
)
"""Nets of fibres, coarse ones first: numbers of meshes round the iris and along the radius, width
of the fibres relative to a mesh, and their height.
"""
NARROWEST = 0.1
"""Least distance of pupil and root, mm: in narrower rings the relief exceeds a millimetre."""
MOST_CRYPTS = 53  # crypts, at which all wide cells near the collarette are open
FIBRE_SPACING = 0.045  # mm between neighbouring fibres, below which they are not drawn
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
    margins: float = 0.0,
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
        iris: The iris, whose thicknesses are area means over the ring from pupil to root at a pupil
            of `PUPIL_AT_REST`.
        eye: The eye with that ring (default: `Eye()`). Equal keys give the same tissue at any
            pupil: a wider pupil compresses it along the radius, so that every ring keeps its volume
            and thickens; furrows deepen, crypts close, cords bend, and the seam at the pupil keeps
            its width.
        shape: Numbers of angles and radii; fewer than 768 angles coarsen the finest fibres.
        profile: Whether the stroma thins towards the root as in ultrasound.
        fibres: Contrast of the radial fibres, 1 as in a light iris.
        looseness: Degree to which bundles of fibres part, wave and cross, in patches: 0 is straight
            and dense, 1 a net.
        clouds: Contrast of denser and clearer parts of the stroma, of several sizes.
        margins: Degree to which the stroma is thinner at the pupil and the root than in ultrasound.
        collarette: Contrast of the collarette between pupillary and ciliary zone: it is thicker and
            paler, and the pupillary zone thinner and darker, than the ciliary zone.
        crypts: Expected number of openings near the collarette, at most `MOST_CRYPTS`: gaps between
            bundles of fibres. Small ones nearer the root are added in proportion.
        furrows: Number of concentric contraction furrows, partial arcs in the ciliary zone.
        freckles: Number of freckles.
        abl: Variation of the anterior border layer, which is thinner over crypts, thicker on the
            crests of furrows, and mottled; 1 as in a brown iris.
        heterochromia: Eumelanin added round the pupil, in rays, relative to the rest.
        amber: Pheomelanin added round the pupil, in a wide and cloudy ring, relative to the rest.
        patches: Contrast of patches and sectors of eumelanin, and of its ring at the root. Pigments
            with a map are also denser in thin tissue, nearly as if each area had as much of them.
        ruff: Width of the scalloped, dark seam of pigment epithelium at the pupil's edge, relative
            to a usual one; the stroma ends before it.
        relief: Share of the uneven thickness that rises towards the cornea; the rest lies below. 0
            is no relief and no furrows.
        key: Random key; equal keys give equal maps.

    Returns:
        Maps with `stroma_depth` unless the stroma is uniform, and as features need them `relief`,
        `abl_depth`, `freckles`, `eumelanin` and `pheomelanin`, the last two with area means of 1.

    Raises:
        ValueError: A feature is negative, the shape is below (16, 8), or the ring is narrower than
            `NARROWEST`.
    """
    one_key(key)
    arguments, others = locals(), ("iris", "eye", "shape", "profile", "key")
    features = {name: value for name, value in arguments.items() if name not in others}
    for name, value in features.items():
        check_range(name, value, Range(0, math.inf))
    if shape[0] < 16 or shape[1] < 8:
        raise ValueError(f"shape {shape} is below (16, 8)")
    eye = Eye() if eye is None else eye
    pupil, root = eye.pupil_radius, eye.iris_radius
    if is_known(pupil, root) and round(float(root - pupil), 5) < NARROWEST:
        raise ValueError(
            f"pupil_radius = {float(pupil):g} mm must be at least {NARROWEST:g} mm below "
            f"iris_radius = {float(root):g} mm where maps are grown"
        )
    # Amounts are arrays, so that irides of all colours grow by one compiled program.
    counts = "crypts", "furrows", "freckles"
    amounts = {k: jnp.asarray(v, None if k in counts else float) for k, v in features.items()}
    maps = _grow(iris, eye, shape, profile, amounts, key)
    rough = fibres or collarette or crypts or ruff or clouds
    absent = {
        "stroma_depth": not (profile or rough or margins),
        "relief": not (relief and (rough or furrows or abl)),
        "abl_depth": not abl,
        "freckles": not freckles,
        "eumelanin": not (heterochromia or patches),
        "pheomelanin": not amber,
    }
    return IrisMaps(**{name: None if absent[name] else value for name, value in maps.items()})


@eqx.filter_jit
def _grow(iris: Iris, eye: Eye, shape, profile: bool, amounts, key) -> dict[str, NoiseField]:
    """Grow all maps, with those of features whose amount is 0."""
    angles, radii = cell_centres(shape)
    turns, radius = jnp.broadcast_arrays(angles[:, None] / (2 * jnp.pi), radii)
    distance = eye.from_axis(radius)
    seeds = jax.vmap(lambda i: bits(fold_in(key, i), dtype=jnp.uint32))(jnp.arange(6))
    fibres, wreath, crypts, furrows, freckles, slow = seeds
    # One program for all slow fields: bends of the cords, and clouds of pigment and of tissue.
    kinds = (9, 2, 3), (3, 1, 2), (7, 3, 4), (22, 9, 4), (36, 13, 2), (90, 28, 3), (6, 2, 2)
    fields = noise_fields(slow, turns, radius, (*kinds, (5, 2, 2), (60, 24, 2)))
    bend, wide, cloud, mist, arc, wool, blur, openness, curl = fields
    root_radius = eye.iris_radius
    # Along the radius, of cords and folds, relative to rest.
    compression = (root_radius - PUPIL_AT_REST) / (root_radius - eye.pupil_radius)
    # Rings keep their volume: they thicken as their area shrinks, relative to rest.
    eye_at_rest = eye.replace(pupil_radius=jnp.asarray(PUPIL_AT_REST, distance.dtype))
    thickening = eye_at_rest.ring_area(radius) / eye.ring_area(radius)
    mean_thickening = (root_radius**2 - PUPIL_AT_REST**2) / (root_radius**2 - eye.pupil_radius**2)
    mean_stroma = mean_thickening * iris.stroma_thickness
    mean_abl = mean_thickening * iris.abl_thickness
    looseness = amounts["looseness"] * smoothstep(0.5 + 1.6 * openness)
    focus = 0.3 + 0.7 * smoothstep(0.6 + 1.5 * blur + 0.6 * mist)
    bent_turns = turns + compression * (0.006 * bend + (0.0015 + 0.003 * looseness) * arc)
    # Fibres of the ciliary zone curl; those that a wide pupil compresses do so already.
    bent_turns += 0.0006 / compression * smoothstep((radius - 0.2) / 0.3) * curl
    ring = COLLARETTE + _collarette_offset(wreath, turns)
    capacity = 2 * jnp.pi * distance / FIBRE_SPACING  # number of fibres that fit round a ring
    share = amounts["crypts"] / MOST_CRYPTS * jnp.exp(2 * openness)
    bent_turns, opening, bundle, ragged_radius = _fibre_bundles(
        crypts, bent_turns, radius, ring, looseness, mist, share, capacity, shape[0]
    )
    crest = _furrows(furrows, turns, radius, amounts["furrows"])
    # Fibres run straight inside the collarette, and wander outside and round a wide pupil.
    freedom = compression * (0.25 + smoothstep((radius - ring) / 0.2)) * (0.4 + looseness)
    nets = bent_turns, radius, freedom, capacity
    cords, mesh, *streaks = _fibres(fibres, *nets, radius + 0.2 * mist, shape[0] // 4)
    streak, gap, sector, tuft = streaks
    cords, mesh = (_defocus(field, focus) for field in (cords, mesh))
    outside = smoothstep((ragged_radius - ring) / 0.2 + 0.5)
    soft_radius = 0.7 * radius + 0.3 * ragged_radius + 0.08 * mist
    # Between the cords of the pupillary zone lie slits, which narrow outwards.
    taper = jnp.maximum(1 - radius / (ring * (1.1 + 0.9 * mist)), 0.0)
    slit = jnp.exp(-((4 * gap) ** 2) / (taper + 1e-3)) * smoothstep(6 * taper)
    # Near the root the cords bend into arcs.
    root = jnp.exp(-((3 * arc) ** 2)) * smoothstep((radius - 0.6) / 0.3)
    opening = opening * smoothstep((0.6 - cords) / 0.5)  # cords bridge an opening
    opening *= jnp.minimum(1.0, 1.3 / compression)  # a wide pupil closes them
    crests, pupillary = _collarette(wreath, turns, ragged_radius, ring)
    contrast = amounts["fibres"] * (0.5 + 0.5 * focus + 0.5 * amounts["collarette"] * crests)
    # Logarithms of the stroma's thickness: `surface` rises towards the cornea, `inner` lies below.
    inner = contrast * (
        (1.0 + opening) * mesh + 1.2 * cords + 0.8 * wool + 0.3 * streak + 0.4 * root
    )
    frame = 4 * opening * (1 - opening)  # a crypt's rim
    upper = (1.8 + 1.6 * outside) * cords + 2.0 * mesh + 0.8 * outside * looseness * (bundle - 0.3)
    surface = contrast * upper
    clouds = 0.7 * cloud + 0.6 * wide + 0.4 * mist + 0.6 * sector + 0.5 * tuft
    surface += 0.8 * amounts["clouds"] * clouds * (0.4 + 0.6 * outside)
    surface += amounts["collarette"] * (1.1 * crests - 0.3 * pupillary)
    surface -= 0.6 * opening + 0.5 * contrast * slit
    seam = _pupillary_ruff(wreath, turns, radius / compression)
    rim = jnp.where(amounts["ruff"] > 0, seam, 0.0)
    inner += amounts["collarette"] * (1.2 * crests - 0.7 * pupillary)
    inner -= 4.0 * amounts["ruff"] * rim + 2.4 * opening + 1.0 * contrast * slit
    inner += 0.7 * frame
    margin = (1 - seam) * smoothstep(1 - radius / compression / (0.16 + 0.1 * mist))
    edge = smoothstep((radius - 0.78 + 0.2 * cloud + 0.15 * wide + 0.1 * mist) / 0.3)
    inner -= 1.2 * amounts["margins"] * (margin + edge)
    stroma = stroma_profile(radius) if profile else jnp.ones_like(radius)
    stroma = jnp.log(stroma * thickening) + 0.6 * (surface + inner)
    mottling = 0.35 * streak + 0.5 * cloud + 0.3 * crest - 0.6 * cords
    abl = jnp.log(thickening) + amounts["abl"] * mottling
    abl = _limit_range(abl, distance, mean_abl, ABL)
    # Texels cannot resolve finer slopes, and the tissue would look carved.
    height = mean_stroma * _soften(jnp.tanh(0.7 * surface) / 0.7, 2)
    height += jnp.where(amounts["abl"] > 0, abl - mean_abl, 0.0)
    reach = ring + 0.14 + 0.25 * cloud + 0.15 * wide + 0.1 * streak + 0.1 * cords
    zone = smoothstep((reach - soft_radius) / 0.5 + 0.5)
    eumelanin = jnp.log1p(amounts["heterochromia"] * zone * (1 + 0.7 * mist))
    dark = 1.2 * cloud + 1.5 * wide + 0.9 * mist + 0.5 * wool + 0.4 * streak
    thinness = jnp.mean(stroma) - stroma
    dark += 0.7 * thinness - 0.6 * (tuft + sector)
    dark += 1.6 * edge + 2.0 * rim + 0.7 * opening + 1.5 * slit
    dark -= contrast * (1.6 * cords + 0.9 * mesh)
    dark += amounts["collarette"] * (0.6 * pupillary - 0.8 * crests)
    eumelanin += amounts["patches"] * dark
    reach = ring + 0.25 + 0.3 * wide - 0.3 * cloud + 0.1 * streak + 0.1 * cords
    zone = smoothstep((reach - soft_radius) / 0.5 + 0.5)
    cloudy = jnp.maximum(1 + 0.8 * mist + 0.4 * cloud, 0.0)
    pheomelanin = jnp.log1p(amounts["amber"] * zone * cloudy)
    pheomelanin += 0.5 * amounts["patches"] * thinness
    fibrous = amounts["fibres"] > 0
    stroma_range = [jnp.where(fibrous, *both) for both in zip(STROMA, SMOOTH_STROMA, strict=True)]
    folds = FURROW_HEIGHT * jnp.minimum(compression, 2.0) * crest
    distance_at_rest, count = eye_at_rest.from_axis(radius), amounts["freckles"]
    return {
        "stroma_depth": _limit_range(stroma, distance, mean_stroma, stroma_range),
        "abl_depth": abl,
        "relief": amounts["relief"] * height + folds,
        "freckles": _freckles(freckles, turns, distance_at_rest, eye_at_rest, mist + wool, count),
        "eumelanin": _limit_range(eumelanin, distance, 1.0, MELANIN),
        "pheomelanin": _limit_range(pheomelanin, distance, 1.0, MELANIN),
    }


def stroma_profile(radius: _Radius) -> _Radius:
    """Compute the thickness of a generic stroma, mm, at relative radii from 0 (2 mm) to 1 (5.5 mm).

    It is quadratic through 0.645, 0.457 and 0.372 mm at 2.25, 3.5 and 5 mm, minus IPE and ABL  [F09
    Section 3].
    """
    r = 2.0 + 3.5 * radius
    inner_slope, outer_slope = (0.457 - 0.645) / 1.25, (0.372 - 0.457) / 1.5
    thickness = 0.645 + (r - 2.25) * (inner_slope + (r - 3.5) * (outer_slope - inner_slope) / 2.75)
    return thickness - IPE_THICKNESS - 0.05675


def _soften(field: NoiseField, times: int) -> NoiseField:
    """Smooth a field along the angle by (1, 2, 1) / 4 several times."""
    for _ in range(times):
        field = (jnp.roll(field, 1, 0) + 2 * field + jnp.roll(field, -1, 0)) / 4
    return field


def _defocus(field: NoiseField, focus: NoiseField) -> NoiseField:
    """Make a field hazy where the focus, 0 to 1, is low."""
    soft = _soften(field, 12)
    return soft + focus * (field - soft)


def _limit_range(logs, distance, mean, limits) -> NoiseField:
    """Scale values, given by their logarithms, to an area mean, and compress them smoothly to a
    range relative to it: its ends are approached and not reached, so that thick and thin tissue
    keeps its fibres.

    Texels cover areas in proportion to their distance from the axis.
    """
    low, high = limits
    reach = jnp.log(high / low)
    weights = distance / jnp.sum(distance)

    def compress(shift):  # ratios are kept in the middle of the range
        return low * jnp.exp(reach * jax.nn.sigmoid(4 / reach * (logs + shift)))

    def excess(shift, _):
        return jnp.sum(weights * compress(shift)) - 1

    ends = {"lower": -2 * reach - logs.max(), "upper": 2 * reach - logs.min()}
    # A check that the root lies between the ends, as it does, would call Python: such a program
    # cannot be kept. `IrisMaps` refuses values that are no numbers.
    bisection = optx.Bisection(1e-5, 1e-5, flip=False)
    middle = -jnp.sum(weights * logs)
    found = optx.root_find(excess, bisection, middle, options=ends, throw=False)
    relative = compress(found.value)
    return relative * (mean / jnp.sum(weights * relative))


def _fibres(
    seed: Seed, turns, radius, freedom, capacity, ragged, most: int
) -> tuple[NoiseField, ...]:
    """Grow the fibres of the stroma: nets of lens-shaped meshes, the lines where noise is 0.

    Returns:
        Heights of the coarse nets and of the fine ones, about 0, and noise along the fibres for
        streaks, slits, sectors and tufts.
    """
    net_seed, noise_seed = split_seed(seed, 2)

    def net(kind):
        layer_seed, across, along, width, height = kind
        bend, shift, mesh, place, run = split_seed(layer_seed, 5)
        coarse = across // 2, 2 * along
        bent = turns + 0.6 * freedom / across * noise(bend, turns, radius, coarse, 2)
        moved = radius + 0.4 / along * noise(shift, turns, radius, (across // 2, along), 2)
        value = noise(mesh, bent, moved, (across, along))
        # Lines are a texel wide at least, and fainter where they are widened to it.
        step = (jnp.roll(value, -1, 0) - jnp.roll(value, 1, 0)) / 2
        wide = jnp.sqrt(width**2 + 2 * step**2)
        line = width / wide * jnp.exp(-((value / wide) ** 2))
        line *= 0.2 + 0.9 * smoothstep(0.5 + 1.7 * noise(place, turns, radius, (7, 3), 3))
        line *= 0.6 + 0.4 * noise(run, bent, moved, (across, 3 * along))
        # None are drawn where many would share a pixel.
        return height * smoothstep(capacity / across - 0.3) * line

    few = [(min(n, most), max(1, m * min(n, most) // n), *sizes) for n, m, *sizes in FIBRES]
    table = [jnp.asarray(column) for column in zip(*few, strict=True)]
    nets = jax.lax.map(net, (jnp.stack(split_seed(net_seed, len(FIBRES))), *table))
    upper, lower = jnp.sum(nets[:3], 0), jnp.sum(nets[3:], 0)
    kinds = (min(380, most), 14, 1), (90, 1, 1), (22, 1, 2), (53, 2, 2)
    streaks = noise_fields(noise_seed, turns, ragged, kinds)
    return upper - jnp.mean(upper), lower - jnp.mean(lower), *streaks


def _fibre_bundles(
    seed: Seed, turns, radius, ring, looseness, ragged, share, capacity, angles: int
) -> tuple[NoiseField, NoiseField, NoiseField, NoiseField]:
    """Grow gaps between bundles of fibres, which part and join round cells of two sizes.

    Returns:
        Angles (in turns) that follow the fibres, depth of the open cells and height of the bundles,
        0 to 1, and the radius, made ragged by the cells.
    """

    def layer(carry, kind):
        turns, opening, bundle = carry
        layer_seed, across, along, wide = kind
        border, offset, chance, middle = _cells(layer_seed, turns, radius, across, along)
        # Wide cells are open in a wreath, slits round it, and a few of both out to the root.
        wreath = jnp.exp(-(((middle - ring - 0.12) / 0.16) ** 2))
        slits = 0.5 * smoothstep((ring + 0.25 - middle) / 0.3) + 0.01
        probability = share * (wide * wreath + (1 - wide) * slits)
        probability *= smoothstep(capacity / across - 0.3)  # none where many would share a pixel
        openness = smoothstep(1.5 - chance / jnp.maximum(probability, 1e-6))
        opening = jnp.maximum(opening, openness * smoothstep((border - 0.15 + 0.8 * ragged) / 0.8))
        height = jnp.exp(-((border / (0.2 + 0.1 * ragged)) ** 2))
        turns -= (0.35 * looseness + 0.4 * openness) * offset
        return (turns, opening, jnp.maximum(bundle, height)), middle

    layers = [(min(n, angles // 4), *others) for n, *others in BUNDLE_CELLS]
    kinds = jnp.asarray(split_seed(seed, 2)), *jnp.asarray(layers, radius.dtype).T
    start = turns, 0 * radius, 0 * radius
    (turns, opening, bundle), middles = jax.lax.scan(layer, start, kinds)
    return turns, opening, bundle, radius + 0.5 * (middles[0] - radius)


def _cells(seed: Seed, turns, radius, across, along) -> tuple[NoiseField, ...]:
    """Draw cells round scattered points.

    Rows are staggered and distances are between those of a circle and a rhomb, so that cells end in
    points.

    Returns:
        By how much the second point is farther than the nearest, in cells; and of the nearest,
        blended at borders, its offset in turns, a random number from 0 to 1, and its radius.
    """
    draws = split_seed(seed, 4)
    y = radius * along + 1

    def add_point(carry, offset):
        first, second, *sums = carry
        row = jnp.floor(y) + offset[1]
        x = turns * across - 0.5 * (row % 2)
        column = jnp.floor(x) + offset[0]
        a, b, size, number = (hash_uniform(s, column % across, row) for s in draws)
        dx, dy = x - column - 0.5 - 0.4 * a, y - row - 0.5 - 0.4 * b
        distance = (jnp.abs(dx) + jnp.abs(dy) + jnp.hypot(dx, dy)) / 2 + 0.25 * size
        second = jnp.minimum(second, jnp.maximum(first, distance))
        values = 1.0, dx / across, 0.5 + 0.5 * number, radius - dy / along
        weight = jnp.exp(-15 * distance)
        sums = (total + weight * value for total, value in zip(sums, values, strict=True))
        return (jnp.minimum(first, distance), second, *sums), None

    large, zero = jnp.full_like(y, 9.0), jnp.zeros_like(y)
    offsets = jnp.asarray([(i, j) for j in (-1, 0, 1) for i in (-1, 0, 1)], y.dtype)
    start = large, large, zero, zero, zero, zero
    first, second, weight, *sums = jax.lax.scan(add_point, start, offsets)[0]
    return second - first, *(total / weight for total in sums)


def _angular_noise(seed: Seed, turns, cells: int, octaves: int) -> NoiseField:
    """Draw noise that varies with the angle alone, (angles, 1)."""
    angle = turns[:, :1]
    return noise(seed, angle, 0 * angle, (cells, 1), octaves)


def _collarette_offset(seed: Seed, turns) -> NoiseField:
    """Draw the collarette's deviation from its mean radius, (angles, 1): teeth on slow noise."""
    slow, teeth, *_ = split_seed(seed, 5)
    tooth = jnp.abs(_angular_noise(teeth, turns, 31, 2))
    return 0.06 * _angular_noise(slow, turns, 4, 3) + 0.08 * (tooth - 0.3)


def _collarette(seed: Seed, turns, radius, ring) -> tuple[NoiseField, NoiseField]:
    """Compute the height of the collarette, two cords wound round each other, 0 to about 1, and the
    pupillary zone, 1 inside the collarette and 0 outside.
    """
    *_, one, two, along = split_seed(seed, 5)
    height = 0.6 + 0.5 * _angular_noise(along, turns, 24, 3)

    def cord(seed, spread, width):
        offset = radius - ring - spread * _angular_noise(seed, turns, 23, 3)
        return jnp.exp(-((offset / jnp.where(offset < 0, 0.05, width)) ** 2))

    crests = jnp.maximum(cord(one, 0.05, 0.12), 0.8 * cord(two, 0.08, 0.05))
    return height * crests, smoothstep((ring - radius) / 0.25 + 0.3)


def _pupillary_ruff(seed: Seed, turns, radius) -> NoiseField:
    """Compute the cover, 0 to 1, of the scalloped seam of pigment epithelium at the pupil."""
    width = 0.024 + 0.016 * _angular_noise(split_seed(seed, 6)[5], turns, 70, 3)
    return smoothstep((width - radius) / 0.014 + 0.5)


def _furrows(seed: Seed, turns, radius, count: Count) -> NoiseField:
    """Draw crests (to about +0.5) and furrows (to −1) of the folds of contraction."""

    def fold(k, height):
        wander, extent = split_seed(seed + k.astype(jnp.uint32), 2)
        middle = 0.5 + 0.36 * (k + 0.5) / count + 0.04 * _angular_noise(wander, turns, 5, 4)
        depth = smoothstep(0.4 + 1.3 * _angular_noise(extent, turns, 5, 3))
        offset = (radius - middle) / 0.03
        return height + depth * (0.45 * offset**2 - 1) * jnp.exp(-0.5 * offset**2)

    return jax.lax.fori_loop(0, count, fold, jnp.zeros_like(radius))


def _freckles(seed: Seed, turns, distance, eye: Eye, ragged, count: Count) -> NoiseField:
    """Draw soft irregular spots, 0 to 1, of 0.08 to 0.24 mm radius."""

    def spot(k, cover):
        a, b, c, d = draw_uniform(seed, 4, k, distance.dtype)
        middle = eye.from_axis(0.15 + 0.75 * b)
        across = 2 * jnp.pi * ((turns - a + 0.5) % 1.0 - 0.5) * middle
        away = jnp.sqrt(across**2 + (distance - middle) ** 2) / (0.08 * 3.0 ** (c**2))
        shape = smoothstep(1.1 - 0.5 * away + 0.6 * ragged) ** 2
        return jnp.maximum(cover, (0.15 + 0.45 * d) * shape)

    return jax.lax.fori_loop(0, count, spot, jnp.zeros_like(distance))
