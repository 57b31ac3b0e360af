"""Stroma and collarette: dots, smeared dots, smears and spokes  [L03 Section 2.3, Fig. 3]."""

import numpy as np

from irisjax.ocularist.component import AbstractComponent, setting
from irisjax.ocularist.strokes import Dots, Paint, Ring, Strokes, around, varied, wander

_FADE = 0.08  # relative radius: strokes fade in before and out behind what they cover


class StromaDots(AbstractComponent):
    """Well-defined dots, as many to any part of the area."""

    count: int = setting(320)
    width: float = setting(0.016)
    inner: float = setting(0.06)
    outer: float = setting(0.97)
    irregularity: float = setting(0.7)
    softness: float = setting(0.0035)

    def painted(self, rng, ring, radius):
        """See `AbstractComponent`."""
        dots = _scattered(rng, ring, self)
        return dots.paint(rng, ring, self.softness).opacity(len(radius), self.softness)


class StromaSmearedDots(AbstractComponent):
    """Dots drawn out along the radius, each with a tail of its paint."""

    count: int = setting(220)
    width: float = setting(0.016)
    length: float = setting(0.16)
    inner: float = setting(0.05)
    outer: float = setting(0.97)
    waviness: float = setting(0.3)
    irregularity: float = setting(0.7)
    softness: float = setting(0.0045)

    def painted(self, rng, ring, radius):
        """See `AbstractComponent`."""
        dots = _scattered(rng, ring, self)
        paint = _smeared(rng, ring, self, dots, 0.012 * self.waviness, 0.3)
        return paint.opacity(len(radius), self.softness)


class StromaSmears(AbstractComponent):
    """Radial smears or fibres over nearly all of the iris, in bundles."""

    count: int = setting(420)
    width: float = setting(0.013)
    length: float = setting(0.5)
    inner: float = setting(0.05)
    outer: float = setting(1.0)
    waviness: float = setting(0.5)
    irregularity: float = setting(0.6)
    softness: float = setting(0.004)

    def painted(self, rng, ring, radius):
        """See `AbstractComponent`."""
        n, irregularity = self.count, self.irregularity
        angle = around(rng, n, irregularity)
        room = self.outer - self.inner + 2 * _FADE
        length = np.minimum(self.length * varied(rng, n, 0.7 * irregularity), room)
        strokes = Strokes(
            angle,
            self.inner - _FADE + (room - length) * rng.uniform(0, 1, n),
            length,
            self.width * varied(rng, n, 0.9 * irregularity),
            0.014 * self.waviness * rng.uniform(0.4, 1.6, n),
            0.6 * varied(rng, n, 1.6 * irregularity) * _bundled(rng, angle, irregularity),
        )
        paint = strokes.paint(rng, ring, self.softness, head=0.4)
        return paint.opacity(len(radius), self.softness)


class CollaretteSpokes(AbstractComponent):
    """Spokes from the pupil to a ragged collarette, widest towards it."""

    count: int = setting(120)
    width: float = setting(0.02)
    inner: float = setting(0.0)
    outer: float = setting(0.4)
    waviness: float = setting(0.3)
    irregularity: float = setting(0.6)
    softness: float = setting(0.004)

    def painted(self, rng, ring, radius):
        """See `AbstractComponent`."""
        n, irregularity = self.count, self.irregularity
        angle = around(rng, n, irregularity)
        room = self.outer - self.inner
        start = self.inner - _FADE + 0.45 * room * irregularity * rng.uniform(0, 1, n) ** 2
        # The collarette is a zigzag: spokes end about where their neighbours do.
        ragged = 0.06 * wander(rng, 5)(angle) + 0.09 * wander(rng, 26)(angle)
        ragged += 0.06 * rng.normal(size=n)
        end = self.outer - room * np.clip(-irregularity * ragged, -0.25, 0.6)
        strokes = Strokes(
            angle,
            start,
            end - start,
            self.width * varied(rng, n, 0.8 * irregularity),
            0.02 * self.waviness * rng.uniform(0.4, 1.6, n),
            0.8 * varied(rng, n, 1.2 * irregularity) * _bundled(rng, angle, irregularity),
        )
        paint = strokes.paint(rng, ring, self.softness, head=0.65)
        return paint.opacity(len(radius), self.softness)


class CollaretteDots(AbstractComponent):
    """Dots on the inner half, crowded towards the collarette; with a `length` they are smeared."""

    count: int = setting(170)
    width: float = setting(0.014)
    length: float = setting(0.0)
    inner: float = setting(0.05)
    outer: float = setting(0.5)
    irregularity: float = setting(0.7)
    softness: float = setting(0.0035)

    def painted(self, rng, ring, radius):
        """See `AbstractComponent`."""
        dots = _scattered(rng, ring, self)
        ragged = 0.65 + 0.12 * self.irregularity * wander(rng, 24)(dots.angle)
        spread = (0.1 + 0.2 * rng.uniform(0, 1, self.count)) * rng.normal(size=self.count)
        crowded = self.inner + (self.outer - self.inner) * np.clip(ragged + spread, 0, 1)
        dots = dots._replace(relative=crowded)
        if self.length == 0:
            paint = dots.paint(rng, ring, self.softness)
        else:
            paint = _smeared(rng, ring, self, dots, 0.004, 0.6)
        return paint.opacity(len(radius), self.softness)


def _bundled(rng, angle, irregularity: float):
    """Factors on the paint of strokes: fibres come in bundles, and so does what the brush holds."""
    return np.exp(0.5 * irregularity * wander(rng, 40)(angle))


def _scattered(rng, ring: Ring, of) -> Dots:
    """Dots, as many to any part of the area."""
    n, irregularity = of.count, of.irregularity
    angle = around(rng, n, irregularity)
    # Golden sections keep neighbours apart, as far as they are regular.
    even = rng.uniform() + np.arange(n) * (np.sqrt(5) - 1) / 2
    share = (even + irregularity * rng.uniform(-0.5, 0.5, n)) % 1
    inner, outer = ring.place(of.inner), ring.place(of.outer)
    return Dots(
        angle,
        ring.relative(np.sqrt(inner**2 + share * (outer**2 - inner**2))),
        of.width * varied(rng, n, 0.6 * irregularity),
        2.5 * varied(rng, n, 0.8 * irregularity),
    )


def _smeared(rng, ring: Ring, of, dots: Dots, wave: float, head: float) -> Paint:
    """Dots with tails, which lie a share `head` of their length within the dot."""
    n = of.count
    length = of.length * varied(rng, n, 0.7 * of.irregularity)
    tails = Strokes(
        dots.angle,
        dots.relative - head * length,
        length,
        0.8 * dots.width,
        wave * rng.uniform(0.4, 1.6, n),
        0.7 * dots.depth,
    )
    heads = dots._replace(width=0.7 * dots.width, depth=0.6 * dots.depth)
    return tails.paint(rng, ring, of.softness, head) | heads.paint(rng, ring, of.softness)
