"""The lids round an eye: a surface of skin with an opening, its lashes, and the caruncle.

The surface is one height over the plane of the face, z(x, y): a dome over the globe that runs out
into a face, a fold above the upper lid, a rounded margin, and behind the margin the bed in which
the globe lies, with the caruncle in its nasal corner. Distances are those of adults
[Vasanthakumar et al. 2013: the opening is 30 mm by 10 mm] or set by eye; no face was measured.
"""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from irisjax._types import Scalar, float_field
from irisjax.numerics.checks import Range, check_fields
from irisjax.numerics.interpolation import smoothstep
from irisjax.numerics.roots import safe_sqrt

LID_LIMITS = {
    "upper": Range(0.5, 6.5, "mm"),
    "lower": Range(0.5, 7.5, "mm"),
    "melanin": Range(0, 0.5),
    "blood": Range(0, 0.2),
}
"""Allowed range of each number of the lids."""
NASAL, TEMPORAL = (14.6, -1.8), (-12.0, 0.6)
"""Corners of the opening: mm from the eye's axis towards the nose, and up."""
DOME = 13.3
"""Radius of the skin over the globe about the middle of the globe, mm."""
THICK = 2.0
"""Thickness of a lid, mm."""
EDGE_WIDTH = 1.3
"""Width over which its edge is round, mm."""
FACE = 30.0
"""Half the side of the maps of skin, mm."""

_Reals = Float[Array, "..."]


class Edge(NamedTuple):
    """Places relative to the margins, mm: `outside` is positive on skin and negative in the
    opening; `upper` and `lower` are measured from one margin alone; `along` runs from −1 at the
    temporal corner to 1 at the nasal one.
    """

    outside: _Reals
    upper: _Reals
    lower: _Reals
    along: _Reals


class Lids(eqx.Module):
    """Lids, lashes and skin about an eye, grown by `grow.lids.lids`.

    Attributes:
        upper: Height of the upper lid's margin above the eye's axis, mm.
        lower: Depth of the lower lid's margin below it, mm.
        melanin: Share of the epidermis's volume that is melanosomes.
        blood: Share of the dermis's volume that is blood.
        skin: Slopes of the skin along x and y, and its redness, −1 to 1, on a square of ±`FACE` mm,
            rows from y = −`FACE` up.
        lashes: Points along each lash, mm in the eye's frame, and its radius there.
        fence: Share of the light that lashes take on its way to the eye, over the x and y at which
            it crosses a sphere of `FENCE` mm about the middle of the globe, as `skin`.
        nose: Side of the nose: −1 for −x, 1 for +x.
    """

    upper: Scalar = float_field(4.0)
    lower: Scalar = float_field(5.1)
    melanin: Scalar = float_field(0.015)
    blood: Scalar = float_field(0.013)
    skin: Float[Array, "3 texels texels"] | None = None
    lashes: Float[Array, "lashes points 4"] | None = None
    fence: Float[Array, "side side"] | None = None
    nose: int = eqx.field(static=True, default=-1)

    def __check_init__(self) -> None:
        check_fields(self, LID_LIMITS)
        if self.nose not in (-1, 1):
            raise ValueError(f"lids: nose = {self.nose} must be -1 or 1")

    def margins(self, s: _Reals) -> tuple[_Reals, _Reals]:
        """Heights y of both margins, mm, at places between the corners (−1 to 1)."""
        (_, high), (_, low) = TEMPORAL, NASAL
        line = (high + low) / 2 + (low - high) / 2 * s
        arch = (1 - s * s) * (1 - 0.4 * jnp.maximum(s, 0.0) ** 4)
        upper = line + (self.upper - line_at_axis()) * arch * (1 + 0.12 * s * arch)
        lower = line - (self.lower + line_at_axis()) * arch * (1 - 0.1 * s * arch)
        return upper, lower

    def along(self, x: _Reals) -> _Reals:
        """Place between the corners of points x, mm."""
        (near, _), (far, _) = NASAL, TEMPORAL
        return (self.nose * x - (near + far) / 2) / ((near - far) / 2)

    def edge(self, x: _Reals, y: _Reals) -> Edge:
        """Compute how far points (mm) lie beyond the margins."""
        s = self.along(x)
        clamped = jnp.clip(s, -1.15, 1.15)
        upper, lower = self.margins(clamped)
        # Slopes of the parabolas, to turn heights into distances.
        slope = (self.upper + self.lower) / (NASAL[0] - TEMPORAL[0]) * 2 * clamped
        shrink = 1 / safe_sqrt(1 + slope * slope)
        u, v = (y - upper) * shrink, (lower - y) * shrink
        overhang = jnp.abs(s) - clamped * jnp.sign(s)
        both = (u + v + safe_sqrt((u - v) ** 2 + 0.3)) / 2 + overhang * (NASAL[0] - TEMPORAL[0]) / 2
        return Edge(both, u, v, s)

    def skin_depth(self, x: _Reals, y: _Reals, centre: Scalar) -> _Reals:
        """z of the skin without its opening, mm; `centre` is that of the globe."""
        u = self.nose * x
        # A sphere that does not end at its equator.
        square = DOME * DOME - x * x - y * y
        dome = centre - safe_sqrt((square + safe_sqrt(square * square + 900.0)) / 2)
        high, low, nasal = (_ramp(v - 8.0) for v in (y, -y, u))
        face = centre - 5.3 - 0.04 * u - 0.42 * high - 0.3 * low - 0.25 * nasal
        return (dome + face - safe_sqrt((dome - face) ** 2 + 8.0)) / 2

    def depth(self, x: _Reals, y: _Reals, centre: Scalar) -> _Reals:
        """z of the whole surface, mm: skin with its fold, margin, and bed of the globe."""
        at = self.edge(x, y)
        arch = jnp.maximum(1 - at.along * at.along, 0.0)
        # The fold lies over the upper lid; a shallow groove borders the lower one.
        height = at.upper - (1.1 + 3.0 * arch)
        weight = smoothstep((1.25 - jnp.abs(at.along)) / 0.5)
        fold = 0.9 * smoothstep(height / 1.6 + 0.1) - 0.45 * jnp.exp(-((height / 0.45) ** 2))
        bag = at.lower - (2.0 + 3.5 * arch)
        groove = 0.25 * jnp.exp(-((at.lower - 2.2) ** 2) / 3) - 0.12 * jnp.exp(-((bag / 0.8) ** 2))
        skin = self.skin_depth(x, y, centre) - weight * (fold + groove)
        inward = jnp.clip(1 - at.outside / EDGE_WIDTH, 0.0, 1.0)
        # Thick along the radius of the globe, more along z towards the corners.
        cosine = safe_sqrt(jnp.maximum(1 - (x * x + y * y) / DOME**2, 0.16))
        dropped = THICK / cosine * (1 - safe_sqrt(1 - inward * inward))
        dropped = dropped + 0.9 * _ramp(-at.outside - 0.5)
        return skin + dropped - self.caruncle(x, y)

    def caruncle(self, x: _Reals, y: _Reals) -> _Reals:
        """Height of the caruncle and of the fold beside it over the bed, mm."""
        u = self.nose * x - NASAL[0]
        v = y - NASAL[1]
        lump = 1.5 * jnp.exp(-(((u + 2.6) / 1.4) ** 2) - ((v - 0.2) / 1.3) ** 2)
        return lump + 0.5 * jnp.exp(-(((u + 4.6) / 0.6) ** 2) - (v / 2.2) ** 2)

    def normal(self, x: _Reals, y: _Reals, centre: Scalar) -> tuple[_Reals, _Reals, _Reals]:
        """Components of the unit normal, out of the face."""
        ones, zeros = jnp.ones_like(x), jnp.zeros_like(x)

        def depth(x, y):
            return self.depth(x, y, centre)

        dz_dx, dz_dy = (jax.jvp(depth, (x, y), way)[1] for way in ((ones, zeros), (zeros, ones)))
        length = safe_sqrt(1 + dz_dx * dz_dx + dz_dy * dz_dy)
        return dz_dx / length, dz_dy / length, -1 / length


def _ramp(x: _Reals) -> _Reals:
    """0 below 0 and x above, with a smooth bend 4 mm wide."""
    return (x + safe_sqrt(x * x + 4.0)) / 2


FENCE = 17.5
"""Radius of the sphere on which lashes are drawn that take light from the eye, mm."""
SEEN_FROM = math.radians(45.0)
"""Largest angle from the axis from which lids are drawn: further aside they hide one another."""


def line_at_axis() -> float:
    """Height of the line between the corners on the eye's axis, mm."""
    (near, low), (far, high) = NASAL, TEMPORAL
    return low + (high - low) * near / (near - far)
