"""The base and what runs round the iris: sphincter, limbus and pupil  [L03 Section 2.3, Fig. 3]."""

import numpy as np

from irisjax.ocularist.component import AbstractComponent, setting, texels
from irisjax.ocularist.strokes import Opacity, Strokes, around, varied, wander


class Base(AbstractComponent):
    """Opaque all over the iris."""

    def painted(self, rng, ring, radius):
        """See `AbstractComponent`."""
        return np.ones_like(radius)


class Sphincter(AbstractComponent):
    """A soft ring close to the pupil: fine radial dabs on a thin wash."""

    count: int = setting(150)
    reach: float = setting(0.2)
    irregularity: float = setting(0.5)
    softness: float = setting(0.008)

    def painted(self, rng, ring, radius):
        """See `AbstractComponent`."""
        n, irregularity = self.count, self.irregularity
        girth = 2 * np.pi * ring.place(self.reach / 2)
        strokes = Strokes(
            around(rng, n, irregularity),
            np.full(n, -0.02),
            self.reach * varied(rng, n, 0.5 * irregularity),
            girth / max(n, 1) * varied(rng, n, 0.5),
            np.full(n, 0.004),
            0.7 * varied(rng, n, 0.6 * irregularity),
        )
        dabbed = strokes.paint(rng, ring, self.softness, head=0.35)
        ragged = _ragged(rng, len(radius), 14, 0.25 * irregularity)
        wash = 0.55 * _fall(ring.relative(radius) / (1.3 * self.reach) + ragged)
        return 1 - (1 - wash) * (1 - dabbed.opacity(len(radius), self.softness))


class Limbus(AbstractComponent):
    """A soft border: clear inwards, opaque at the outer edge, frayed between."""

    count: int = setting(260)
    reach: float = setting(0.22)
    irregularity: float = setting(0.5)
    softness: float = setting(0.012)

    def painted(self, rng, ring, radius):
        """See `AbstractComponent`."""
        n, irregularity = self.count, self.irregularity
        angle = around(rng, n, irregularity)
        length = 0.8 * self.reach * varied(rng, n, 0.4 * irregularity)
        strokes = Strokes(
            angle,
            1.05 - length,
            length,
            2 * np.pi / max(n, 1) * varied(rng, n, 0.5),
            np.full(n, 0.006),
            0.9 * varied(rng, n, 0.6 * irregularity),
        )
        frayed = strokes.paint(rng, ring, self.softness, head=0.75)
        inwards = np.maximum(1 - ring.relative(radius), 0) / self.reach
        border = _fall(inwards * np.exp(_ragged(rng, len(radius), 14, 0.2 * irregularity)))
        return 1 - (1 - border) * (1 - frayed.opacity(len(radius), self.softness))


class Pupil(AbstractComponent):
    """A soft ring at the pupil's margin; the pupil itself is the hole in the cones."""

    reach: float = setting(0.06)
    irregularity: float = setting(0.3)

    def painted(self, rng, ring, radius):
        """See `AbstractComponent`."""
        outwards = np.maximum(ring.relative(radius), 0) / self.reach
        return _fall(outwards * np.exp(_ragged(rng, len(radius), 24, 0.4 * self.irregularity)))


def _ragged(rng, size: int, harmonics: int, height: float) -> Opacity:
    """A smooth random function of the angle at each texel, of standard deviation `height`."""
    steps = 8192
    table = height * wander(rng, harmonics)(2 * np.pi * np.arange(steps) / steps)
    x, y = texels(size)
    step = np.rint(np.arctan2(y, x) * (steps / (2 * np.pi))).astype(np.int32)
    return table.astype(np.float32)[step % steps]


def _fall(x):
    """From 1 at 0 to 0 at 1 and beyond, smoothly."""
    x = np.clip(x, 0, 1)
    return 1 - x * x * (3 - 2 * x)
