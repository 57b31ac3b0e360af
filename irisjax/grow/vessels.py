"""Vessels on the white of the eye: random trees of tortuous curves, rasterised as chords of blood.

A curve runs in (azimuth, arc), the arc in mm on the sphere from the limbus outwards.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from irisjax._types import PRNGKey
from irisjax.anatomy.eye import Eye, sclera_of
from irisjax.anatomy.sclera import VeinMap, limbus_angle
from irisjax.numerics.checks import check_whole
from irisjax.numerics.streams import words_of

VEINS = {"clear": 0.15, "usual": 0.35, "bloodshot": 1.5}
"""Densities of vessels by name, set by eye."""
_STEP = 0.06  # mm along a curve
_CHUNK = 8192  # segments stamped at once
_BRANCHED_SHARE = 0.97  # share of a vessel's r³ that its daughters take
_BLUR = 0.07  # mm, how far the tissue above an episcleral vessel blurs its edge


class _Curves(NamedTuple):
    """Curves with equal numbers of points; each field has shape (curves, points)."""

    azimuth: np.ndarray
    arc: np.ndarray
    heading: np.ndarray
    radius: np.ndarray


class _Globe(NamedTuple):
    """Radius of the globe (mm) and polar angle of its limbus."""

    radius: float
    limbus: float

    @property
    def end(self) -> float:
        """Arc from the limbus to the equator, mm."""
        return self.radius * (np.pi / 2 - self.limbus)

    def axis_distance(self, arc: np.ndarray) -> np.ndarray:
        """Distance from the axis at an arc, mm."""
        return self.radius * np.sin(self.limbus + np.clip(arc, 0, self.end) / self.radius)


def veins(eye: Eye, *, shape: tuple[int, int] = (1024, 512), key: PRNGKey) -> VeinMap | None:
    """Grow random vessels over the sclera of an eye; `None` where its `veins` are 0.

    Conjunctival trees come from the periphery, many from the corners of the lids, divide r³ among
    their daughters [Murray 1926] and end in arcades along the limbus, with hairpin loops between
    them; trunks have radii of 14 to 38 µm, loops 6 µm, as wide as the conjunctival vessels that OCT
    finds there. Episcleral vessels are fewer, straighter and wider (25 to 70 µm). All fade towards
    the limbus, and a flush represents capillaries too fine to be drawn. Their number grows with
    `eye.sclera.veins`. Approximation: where vessels cross, depth and cover are those of the larger.

    Args:
        eye: The eye, not traced.
        shape: Numbers of azimuths and polar angles.
        key: Random key; equal keys give equal maps.

    Raises:
        ValueError: The eye has no sclera.
    """
    for name, count in zip(("azimuths", "polar angles"), shape, strict=True):
        check_whole(f"number of {name}", count, 2)
    sclera = sclera_of(eye)
    globe, density = _Globe(float(sclera.radius), float(limbus_angle(eye))), float(sclera.veins)
    if density == 0:
        return None
    rng = np.random.default_rng(words_of(key))
    maps = depth, cover, deep = np.zeros((3, *shape))
    levels = [_trunks(rng, globe, round(40 * density), (0.014, 0.038), 0.5)]
    for forks, reach in ((5, 4.0), (3, 2.2), (1, 1.2)):
        levels.append(_branches(rng, globe, levels[-1], forks, reach))
    for curves in (*levels, _loops(rng, globe, round(220 * density))):
        _stamp([(depth, _chord), (cover, _cover)], globe, curves, 0.03)
    # Light that spreads sideways below a vessel meets it too: a faint shadow lies round it.
    for curves in levels[:3]:
        _stamp([(deep, _shadow_cover)], globe, curves, 3 * _BLUR)
    episcleral = _trunks(rng, globe, round(24 * density), (0.025, 0.07), 0.3)
    levels = [episcleral, _branches(rng, globe, episcleral, 4, 3.0)]
    for curves in levels:
        _stamp([(deep, _deep_cover)], globe, curves, 3 * _BLUR)
    arc = globe.end * (np.arange(shape[1]) + 0.5) / shape[1]  # mm from the limbus
    fade = np.clip((arc - 0.2) / 4.0, 0, 1) ** 0.7
    cover *= 0.3 + 0.7 * fade
    deep *= fade
    deep += _flush(rng, density, shape) * (0.4 + 0.6 * fade)
    maps[1:] = np.clip(maps[1:], 0, 1)
    return VeinMap(*jnp.asarray(maps, jnp.result_type(float)))


def _flush(rng, density: float, shape: tuple[int, int]) -> np.ndarray:
    """Draw blotches of capillaries too fine to be drawn, denser towards the corners of the lids."""
    azimuth = 2 * np.pi * (np.arange(shape[0]) + 0.5) / shape[0]
    waves = np.fft.fftfreq(shape[0], 1 / shape[0])[:, None], np.fft.fftfreq(shape[1], 1 / shape[1])
    low_pass = np.exp(-((waves[0] / 14) ** 2) - (waves[1] / 5) ** 2)
    blotches = np.fft.ifft2(np.fft.fft2(rng.normal(size=shape)) * low_pass).real
    flush = 0.07 * density**0.5 * (0.5 + 0.5 * np.cos(azimuth)[:, None] ** 2)
    return flush * np.clip(1 + 0.5 * blotches / blotches.std(), 0, 3)


def _trunks(rng, globe: _Globe, count: int, radii, wander: float) -> _Curves:
    """Grow vessels from the periphery, many from the corners of the lids, at azimuths 0 and π."""
    corner = np.where(rng.random(count) < 0.5, 0.0, np.pi) + rng.normal(0, 0.5, count)
    azimuth = np.where(rng.random(count) < 0.4, corner, rng.uniform(0, 2 * np.pi, count))
    arc = globe.end * rng.uniform(0.6, 1.05, count)
    low, high = radii
    radius = low * (high / low) ** rng.beta(1.2, 2.0, count)
    reach = arc - globe.end * rng.uniform(0.0, 0.35, count)
    return _walk(rng, globe, azimuth, arc, rng.normal(0, 0.35, count), radius, 1.15 * reach, wander)


def _branches(rng, globe: _Globe, parents: _Curves, forks: int, reach: float) -> _Curves:
    """Grow daughters of curves, which divide the r³ that these lose along their length."""
    curves, points = parents.azimuth.shape
    last = np.maximum((parents.radius > 0).sum(axis=1) - 1, 1)[:, None]
    fork = np.clip((last * rng.uniform(0.08, 1.0, (curves, forks))).astype(int), 0, points - 1)
    share = rng.uniform(0.3, 1.0, fork.shape)
    share *= _BRANCHED_SHARE / share.sum(axis=1, keepdims=True)
    curve = np.arange(curves)[:, None]
    alive = parents.radius[curve, fork] > 0
    side = np.where(rng.random(fork.shape) < 0.5, -1.0, 1.0)
    heading = parents.heading[curve, fork] + side * rng.uniform(0.5, 1.3, fork.shape)
    radius = parents.radius[:, :1] * share ** (1 / 3)
    start = parents.azimuth[curve, fork], parents.arc[curve, fork], heading, radius
    azimuth, arc, heading, radius = (field[alive] for field in start)
    lengths = reach * rng.uniform(0.4, 1.6, radius.size)
    return _walk(rng, globe, azimuth, arc, heading, radius, lengths, 0.7)


def _walk(rng, globe: _Globe, azimuth, arc, heading, radius, reach, wander: float) -> _Curves:
    """Grow curves of length `reach` (mm) that start at the angle `heading` from the direction of
    the limbus and turn towards it. Radius 0 marks points past the end.
    """
    count = azimuth.size
    steps = max(int(np.ceil(reach.max(initial=_STEP) / _STEP)), 4)
    out = np.zeros((4, steps + 1, count))
    side = np.where(heading < 0, -1.0, 1.0)
    # The heading varies as the sum of two stationary processes correlated over 0.9 and 0.2 mm.
    spread, memory = wander * np.array([[1], [0.6]]), np.exp(-_STEP / np.array([[0.9], [0.2]]))
    fresh, deviations = spread * np.sqrt(1 - memory**2), spread * rng.normal(size=(2, count))
    for k in range(steps + 1):
        visible = (k * _STEP <= reach) & (arc > 0.05)
        # Near the limbus vessels turn along it and join arcades.
        freedom = np.clip(arc / 1.0, 0, 1)
        direction = freedom * (heading + deviations.sum(0)) + side * (1 - freedom) * 1.5
        remaining = np.cbrt(np.maximum(1 - _BRANCHED_SHARE * k * _STEP / reach, 0))
        out[:, k] = azimuth, arc, direction, np.where(visible, radius * remaining, 0)
        azimuth = azimuth + _STEP * np.sin(direction) / globe.axis_distance(arc)
        arc = arc - _STEP * np.cos(direction)
        heading = heading * (1 - _STEP / 6.0)
        deviations = memory * deviations + fresh * rng.normal(size=(2, count))
    return _Curves(*out.swapaxes(1, 2))


def _loops(rng, globe: _Globe, count: int) -> _Curves:
    """Grow hairpin loops of 6 µm that reach towards the limbus and return."""
    azimuth = rng.uniform(0, 2 * np.pi, count)[:, None]
    base, tip = rng.uniform(0.6, 1.6, count)[:, None], rng.uniform(0.08, 0.4, count)[:, None]
    t = np.linspace(-1, 1, 33)
    lean, width = rng.normal(0, 0.25, (count, 1)), rng.uniform(0.03, 0.12, (count, 1))
    phase = rng.uniform(0, 2 * np.pi, (count, 1))
    across = width * np.sin(t * np.pi / 2) + lean * t * t + 0.03 * np.sin(9 * t + phase)
    arc = tip + (base - tip) * t * t
    turn = azimuth + across / globe.axis_distance(arc)
    return _Curves(turn, arc, np.zeros_like(arc), np.full_like(arc, 0.006))


def _chord(distance, radius, width):
    """Return the mean depth of blood in a round vessel, constant up to a texel past its edge."""
    return np.where(distance < radius + width, np.pi / 2 * radius, 0.0)


def _cover(distance, radius, width):
    """Return the share of a texel that a vessel covers: widths are preserved at any resolution."""
    overlap = np.minimum(distance + width / 2, radius) - np.maximum(distance - width / 2, -radius)
    return np.clip(overlap / width, 0, 1)


def _deep_cover(distance, radius, width):
    """Return the share of the light that meets a deep vessel, blurred by the tissue over it."""
    return 0.5 * (np.tanh((distance + radius) / _BLUR) - np.tanh((distance - radius) / _BLUR))


def _shadow_cover(distance, radius, width):
    """Return the share of the light that meets a conjunctival vessel from below."""
    return 0.35 * _deep_cover(distance, radius, width)


def _stamp(layers, globe: _Globe, curves: _Curves, margin: float) -> None:
    """Draw curves into textures by maxima of their profiles, which end `margin` mm outside."""
    rows, columns = layers[0][0].shape
    along = globe.end / columns
    present = (curves.radius[:, :-1] > 0) & (curves.radius[:, 1:] > 0)
    starts, ends = ([f[:, k:][:, : present.shape[1]][present] for f in curves] for k in (0, 1))
    order = np.argsort(starts[3] + ends[3], kind="stable")
    for first in range(0, order.size, _CHUNK):
        block = order[first : first + _CHUNK]
        (a0, s0, _, r0), (a1, s1, _, r1) = ([f[block] for f in end] for end in (starts, ends))
        r = 0.5 * (r0 + r1)[:, None, None]
        axis_distance = globe.axis_distance(0.5 * (s0 + s1))[:, None, None]
        cell = (2 * np.pi / rows) * axis_distance  # mm
        radius_of_influence = 0.5 * _STEP + float(r.max()) + margin
        reach = (int(np.ceil(radius_of_influence / size)) + 1 for size in (cell.min(), along))
        di, dj = (np.arange(-n, n + 1) for n in reach)
        row = np.floor(0.5 * (a0 + a1) * rows / (2 * np.pi)).astype(int)[:, None] + di
        column = np.floor(0.5 * (s0 + s1) / along).astype(int)[:, None] + dj
        x = ((row + 0.5) * (2 * np.pi / rows) - a0[:, None])[:, :, None] * axis_distance
        y = ((column + 0.5) * along - s0[:, None])[:, None, :]
        u, v = (a1 - a0)[:, None, None] * axis_distance, (s1 - s0)[:, None, None]
        length = np.sqrt(u * u + v * v) + 1e-12
        t = np.clip((x * u + y * v) / length**2, 0, 1)
        distance = np.sqrt((x - t * u) ** 2 + (y - t * v) ** 2)
        width = (cell * np.abs(v) + along * np.abs(u)) / length
        flat = (row % rows)[:, :, None] * columns + np.clip(column, 0, columns - 1)[:, None, :]
        near = ((column >= 0) & (column < columns))[:, None, :] & (distance < r + width + margin)
        flat, distance, width, r = (
            np.broadcast_to(a, near.shape)[near] for a in (flat, distance, width, r)
        )
        for texture, profile in layers:
            np.maximum.at(texture.reshape(-1), flat.astype(int), profile(distance, r, width))
