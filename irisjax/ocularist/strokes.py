"""Brush strokes and dots: drops of paint along wavy hairs, summed on a square of texels.

The positions of drops do not depend on the size of the picture; a Gaussian gives the brush its soft
edge. Paint on paint covers as coat on coat does: opacity = 1 − exp(−paint per area).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Float32
from scipy import ndimage

Opacity = Float32[np.ndarray, "size size"]
"""An opacity map, 0 (clear) to 1 (opaque), row 0 at the top."""
_Each = Float[np.ndarray, " strokes"]
_Drops = Float32[np.ndarray, " drops"]

_SPACING = 1.6  # standard deviations between drops and between hairs: a ripple of 0.1 %
_MOST_HAIRS = 8
_MOST_DROPS = 600  # of a dot
_LEAST = 0.65  # texels in a standard deviation; with fewer, edges would be those of texels
_ENOUGH = 2.5  # texels in a standard deviation above which more resolution shows nothing
_REACH = 4.5  # radius of a drop, standard deviations


class Annulus(NamedTuple):
    """The iris, with an outer radius of 1 and the `pupil`'s inner one."""

    pupil: float

    def place(self, relative: Any) -> Any:
        """Distance from the axis of relative radii from 0, the pupil's edge, to 1, the root."""
        return self.pupil + (1 - self.pupil) * relative

    def relative(self, place: Any) -> Any:
        """The inverse of `place`."""
        return (place - self.pupil) / (1 - self.pupil)


class Paint(NamedTuple):
    """Drops at (x, y), y up, in outer radii; `amount`: optical depth × area of each."""

    x: _Drops
    y: _Drops
    amount: _Drops

    def __or__(self, other: "Paint") -> "Paint":
        """The drops of both."""
        return Paint(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))

    def opacity(self, size: int, softness: float) -> Opacity:
        """Mean opacity of each of size × size texels; `softness` is the standard deviation of a
        drop in outer radii.
        """
        parts = 1
        while softness * size * parts / 2 < _LEAST:
            parts *= 2
        fine = -np.expm1(-self._depth(size * parts, softness))
        return fine if parts == 1 else fine.reshape(size, parts, size, parts).mean((1, 3))

    def _depth(self, size: int, softness: float) -> Float32[np.ndarray, "size size"]:
        """Mean optical depth of each texel."""
        from PIL import Image

        coarse = min(size, int(np.ceil(2 * _ENOUGH / softness)))
        margin = int(np.ceil(_REACH * softness * coarse / 2)) + 2
        depth = self._gathered(coarse, margin)
        # Gathering has blurred a drop over a texel already, of variance 1/12.
        blur = np.sqrt(max((softness * coarse / 2) ** 2 - 1 / 12, 0.0))
        depth = ndimage.gaussian_filter(depth, blur, mode="constant", truncate=_REACH)
        if coarse == size:
            return depth[margin:-margin, margin:-margin]
        box = (margin, margin, margin + coarse, margin + coarse)
        fine = Image.fromarray(depth).resize((size, size), Image.Resampling.BICUBIC, box)
        return np.maximum(np.asarray(fine), np.float32(0))

    def _gathered(self, size: int, margin: int) -> Float32[np.ndarray, "all all"]:
        """Each drop shared out to the nearest four texels, `margin` of them beyond each side."""
        wide = size + 2 * margin
        # What lies further out ends at the margin's rim, where no drop reaches the square.
        column, row = (
            np.clip(size / 2 * (1 + v) + (margin - 0.5), 0, wide - 1.001) for v in (self.x, -self.y)
        )
        left, top = column.astype(np.int64), row.astype(np.int64)
        right, below = column - left, self.amount * np.float32(size**2 / 4) * (row - top)
        depth = np.zeros(wide * wide)
        for down, amount in enumerate((self.amount * np.float32(size**2 / 4) - below, below)):
            for aside, share in enumerate((1 - right, right)):
                depth += np.bincount((top + down) * wide + left + aside, amount * share, wide**2)
        return depth.reshape(wide, wide).astype(np.float32)


class Strokes(NamedTuple):
    """Radial strokes of several hairs, each hair with its own beginning, end and load; every field
    but the last has shape (strokes,).
    """

    angle: _Each  # radians
    start: _Each  # relative radius of the inner end
    length: _Each  # relative radii
    width: _Each  # outer radii
    wave: _Each  # how far strokes sway to each side, outer radii
    depth: _Each  # optical depth of the paint
    head: float  # where they are widest, from 0 at their inner to 1 at their outer end

    def paint(self, rng: np.random.Generator, ring: Annulus, softness: float) -> Paint:
        """Draw the strokes."""
        if len(self.angle) == 0:
            return Paint(*(np.zeros(0, np.float32) for _ in Paint._fields))
        hairs = int(np.clip(np.ceil(self.width.mean() / (_SPACING * softness)), 2, _MOST_HAIRS))
        longest = (1 - ring.pupil) * self.length.max()
        count = max(int(np.ceil(longest / (_SPACING * softness))), 4)
        t = (np.arange(count) + 0.5) / count
        # Strokes may begin within the pupil, but none runs through the axis.
        r = np.maximum(ring.place(self.start[:, None] + self.length[:, None] * t), 0.005)
        # Near the axis a small step aside would be a large turn.
        turn = self._sway(rng, t, r) / np.maximum(r, 0.15)
        angle = (self.angle[:, None] + turn).astype(np.float32)
        cos, sin = np.cos(angle), np.sin(angle)
        across, load = _hairs(rng, len(self.angle), hairs, t.astype(np.float32), self.head)
        across *= self.width[:, None, None].astype(np.float32) / 2
        area = self.width * self.length * (1 - ring.pupil) / (hairs * count)
        load *= (self.depth * area).astype(np.float32)[:, None, None]
        r = r.astype(np.float32)
        x = (r * cos)[:, None] - across * sin[:, None]
        y = (r * sin)[:, None] + across * cos[:, None]
        return Paint(x.ravel(), y.ravel(), load.ravel())

    def _sway(self, rng, t, r):
        """Displacement aside (strokes, drops), outer radii: one part alone, one with neighbours."""
        harmonics = np.arange(1, 4)
        own = rng.normal(size=(len(self.angle), 3)) / harmonics**1.5
        phases = rng.uniform(0, 2 * np.pi, (3, 1))
        alone = own @ np.sin(np.pi * harmonics[:, None] * t + phases)
        together = np.zeros_like(r)
        for _ in range(5):
            round_, outwards = rng.integers(1, 12), 9 * rng.normal()
            height, phase = rng.normal(), rng.uniform(0, 2 * np.pi)
            together += height * np.sin(round_ * self.angle[:, None] + outwards * r + phase)
        return self.wave[:, None] * (0.6 * alone + 0.5 * together)


def _hairs(rng, n: int, hairs: int, t, head: float):
    """Positions across the brush, about ±1, and loads, about 1: (strokes, hairs, drops)."""

    def uniform(low=0.0, high=1.0):
        return rng.uniform(low, high, (n, hairs, 1)).astype(np.float32)

    at = rng.permuted(np.tile((np.arange(hairs) + 0.5) / hairs, (n, 1)), axis=1)
    at = (2 * at[..., None] - 1).astype(np.float32) + uniform(-0.5, 0.5) / hairs
    # A brush set down, drawn and lifted: a lens, fullest at its head, its hairs a little apart.
    lens = np.where(t < head, t / head, (1 - t) / (1 - head)) ** 0.4
    across = at * lens + uniform(-0.3, 0.3) * (t - head)
    begin, end = 0.25 * uniform() ** 2, 1 - 0.4 * uniform() ** 2
    load = smooth_step((t - begin) / 0.08) * smooth_step((end - t) / (0.1 + 0.3 * uniform()))
    load *= 1 + 0.35 * np.sin(9 * t + uniform(0, 2 * np.pi))
    return across, load * rng.gamma(2, 0.5, (n, hairs, 1)).astype(np.float32)


class Dots(NamedTuple):
    """Round dots, each field of shape (dots,)."""

    angle: _Each  # radians
    relative: _Each  # relative radius
    width: _Each  # diameter, outer radii
    depth: _Each  # optical depth of the paint

    def paint(self, rng: np.random.Generator, ring: Annulus, softness: float) -> Paint:
        """Draw dots a little out of round, their drops on Vogel's spiral."""
        n = len(self.angle)
        drops = np.pi * (self.width.max(initial=0) / (2 * _SPACING * softness)) ** 2
        drops = int(np.clip(np.ceil(drops), 12, _MOST_DROPS))
        k = np.arange(drops)
        turn = k * np.pi * (3 - np.sqrt(5)) + rng.uniform(0, 2 * np.pi, (n, 1))
        edge = np.ones_like(turn)
        for m in (1, 2, 3):
            height, phase = 0.16 / m * rng.normal(size=(n, 1)), rng.uniform(0, 2 * np.pi, (n, 1))
            edge += height * np.sin(m * turn + phase)
        r = 0.5 * self.width[:, None] * np.sqrt((k + 0.5) / drops) * edge
        middle = ring.place(self.relative)
        x = (middle * np.cos(self.angle))[:, None] + r * np.cos(turn)
        y = (middle * np.sin(self.angle))[:, None] + r * np.sin(turn)
        amount = np.repeat(self.depth * np.pi / 4 * self.width**2 / drops, drops)
        return Paint(*(v.astype(np.float32).ravel() for v in (x, y, amount)))


def angles_round(rng: np.random.Generator, count: int, irregularity: float) -> _Each:
    """Angles in radians: evenly spaced at irregularity 0, with clumps and gaps at 1."""
    jitter = irregularity * rng.uniform(-0.9, 0.9, count)
    angle = 2 * np.pi * (rng.uniform() + (np.arange(count) + jitter) / max(count, 1))
    return angle + 0.06 * irregularity * smooth_noise(rng, 15)(angle)


def smooth_noise(rng: np.random.Generator, harmonics: int) -> Callable[[np.ndarray], np.ndarray]:
    """A smooth random function of angles (radians), of period 2π, mean 0 and variance 1."""
    m = np.arange(1, harmonics + 1)
    weight = rng.normal(size=(2, harmonics)) / np.sqrt(m)
    weight /= np.sqrt((weight**2).sum() / 2)

    def at(angle: np.ndarray) -> np.ndarray:
        turns = np.asarray(angle)[..., None] * m
        return np.cos(turns) @ weight[0] + np.sin(turns) @ weight[1]

    return at


def log_normal(rng: np.random.Generator, count: int, spread: float) -> _Each:
    """Factors of median 1, log-normal with standard deviation `spread`, none above 3."""
    return np.minimum(np.exp(spread * rng.normal(size=count)), 3)


def smooth_step(x: np.ndarray) -> np.ndarray:
    """A smooth rise from 0 at 0 and below to 1 at 1 and above."""
    x = np.clip(x, 0, 1)
    return x * x * (3 - 2 * x)
