"""Surfaces of revolution as stacks of truncated cones, traced from a cross-section, and the outside
of an eye as two of them  [L03 Section 3.1, Figs. 6, 7].
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from irisjax._types import as_float
from irisjax.anatomy.eye import Eye
from irisjax.numerics.checks import check_whole, is_known
from irisjax.numerics.roots import safe_sqrt
from irisjax.optics.conicoid import Vector, from_axis, parts

_ROUNDING = 16  # units in the last place by which cones reach beyond their seams


class Hit(NamedTuple):
    """Intersections of rays with a stack of cones."""

    distance: Float[Array, "*s"]  # along the ray, mm; 0 where it misses
    cone: Int[Array, "*s"]  # index of the cone
    met: Bool[Array, "*s"]  # whether the ray meets any cone


class Cones(eqx.Module):
    """A stack of truncated cones round the z-axis; a flat one is a ring, one of constant radius a
    cylinder.

    Attributes:
        z: Positions of the circles where cones join, mm, shape (circles,).
        radius: Radii of these circles, mm.

    Raises:
        ValueError: for fewer than two circles, for numbers that are not finite, radii below 0, and
            for neighbours that are the same circle.
    """

    z: Float[Array, " circles"]
    radius: Float[Array, " circles"]

    def __check_init__(self) -> None:
        circles, radii = len(self.z), len(self.radius)
        if circles < 2 or circles != radii:
            need = "a stack of cones needs two circles or more, a z and a radius each"
            raise ValueError(f"{need}; got {circles} and {radii}")
        if not is_known(self.z, self.radius):
            return
        every = np.stack([self.z, self.radius], 1)
        for i, (z, radius) in enumerate(every):
            if not (np.isfinite([z, radius]).all() and radius >= 0):
                circle = f"circle {i} of the cones has z = {z:g} mm and radius = {radius:g} mm"
                raise ValueError(f"{circle}; both must be finite, the radius not below 0")
        same = np.flatnonzero((np.diff(every, axis=0) == 0).all(1))
        if same.size:
            raise ValueError(f"circles {same[0]} and {same[0] + 1} of the cones are the same")

    @classmethod
    def of(cls, profile: Sequence[Any] | np.ndarray) -> "Cones":
        """Make cones of a cross-section: pairs (z, radius), mm."""
        points = np.asarray(profile, float)
        if points.ndim != 2 or points.shape[1] != 2:
            raise ValueError(f"a profile is pairs (z, radius), got shape {points.shape}")
        return cls(*map(as_float, points.T))

    def meet(self, origin: Vector, direction: Vector, least: float = 0.0) -> Hit:
        """First intersection of rays from either side, at a distance above `least` (mm).

        Origins (mm) and unit directions have shape (…, 3). Cones extend a few roundings beyond
        their seams, so that no ray slips through.
        """
        distance, on = (v.reshape(-1, *v.shape[2:]) for v in self._all(origin, direction))
        held = on & (distance > least)
        first, met = jnp.argmin(jnp.where(held, distance, jnp.inf), 0), held.any(0)
        found = jnp.take_along_axis(distance, first[None], 0)[0]
        return Hit(jnp.where(met, found, 0.0), first % (len(self.z) - 1), met)

    def normal(self, point: Vector, cone: Int[Array, "*s"]) -> Vector:
        """Unit normals of cones, by index, at points (…, 3) on them: towards −z, out of the eye;
        of cylinders away from the axis.
        """
        x, y, _ = parts(point)
        r = from_axis(point)
        r = jnp.where(r > 0, r, 1.0)
        rise, out = jnp.diff(self.z)[cone], jnp.diff(self.radius)[cone]
        side = jnp.sign(jnp.where(out == 0, rise, out)) / jnp.hypot(rise, out)
        return jnp.stack([side * rise * x / r, side * rise * y / r, -side * out], -1)

    def height(self, radius: Float[Array, "*s"]) -> Float[Array, "*s"]:
        """z (mm) at distances from the axis, for a stack whose radii rise; extrapolated linearly
        beyond its ends.
        """
        return jnp.interp(radius, self.radius, self.z, left="extrapolate", right="extrapolate")

    def _all(self, origin: Vector, direction: Vector):
        """Distances to both intersections with every untruncated cone, (2, cones, …), and whether
        they lie on the cone itself and between its circles.

        On a cone Δz r = w with w = Δr z + r₀ Δz − Δr z₀, squared a quadratic in the distance. Its
        discriminant is Δz² times a sum of squares less a square; written so, nothing cancels, and
        flat cones lose no precision.
        """
        (ox, oy, oz), (dx, dy, dz) = (parts(v[None, None]) for v in (origin, direction))
        ends = self.z[:-1], self.radius[:-1], jnp.diff(self.z), jnp.diff(self.radius)
        z0, r0, rise, out = (v.reshape(1, -1, *(1,) * (ox.ndim - 2)) for v in ends)
        w0, w1 = r0 * rise + out * (oz - z0), out * dz
        across, away = safe_sqrt(dx * dx + dy * dy), safe_sqrt(ox * ox + oy * oy)
        a = (rise * across - w1) * (rise * across + w1)
        b = rise * rise * (ox * dx + oy * dy) - w0 * w1
        c = (rise * away - w0) * (rise * away + w0)
        inner = (w0 * dx - w1 * ox) ** 2 + (w0 * dy - w1 * oy) ** 2
        inner = inner - rise * rise * (ox * dy - oy * dx) ** 2
        opens = rise >= 0
        root = jnp.where(opens, rise, -rise) * jnp.sqrt(jnp.where(inner > 0, inner, 0.0))
        q = -(b + jnp.where(b >= 0, root, -root))
        t = jnp.concatenate([c / jnp.where(q != 0, q, 1.0), q / jnp.where(a != 0, a, 1.0)])
        real = (inner >= 0) & jnp.concatenate([q != 0, a != 0])
        # Rays steeper than a cone meet it once and its mirror image once; the sign of w decides.
        # On flat cones the two are one point with two derivatives.
        one = (b >= 0) == ((w1 >= 0) != opens)
        x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
        r = jnp.sqrt(x * x + y * y)
        slack = _ROUNDING * jnp.finfo(t.dtype).eps * (jnp.abs(self.z).max() + self.radius.max())
        # The radius that the cone has at z, times its rise: below 0 on its mirror image.
        sheet = (r0 * rise + (z - z0) * out) * rise
        steep = jnp.concatenate([one, ~one])
        right = jnp.where(a < 0, steep, sheet >= -slack * jnp.abs(out * rise))
        square = rise * rise + out * out
        share, slack = ((z - z0) * rise + (r - r0) * out) / square, slack / jnp.sqrt(square)
        return t, real & right & (share >= -slack) & (share <= 1 + slack)


def shell(eye: Eye, circles: int = 64) -> dict[str, Cones]:
    """The cross-section of an eye's outside, as the paper draws it: its cornea from the apex to the
    limbus, and its white from there to the back of the eye.

    For `prosthesis` these are spheres of 7.8 and 11.5 mm, their centres 4.7 mm apart
    [L03 Fig. 6]. Between circles the cones lie within them, by R (1 − cos(δ/2)) at most for circles
    that are δ apart as seen from the centre.

    Args:
        eye: With a cornea and a white.
        circles: Number of circles of each part.

    Raises:
        ValueError: for an eye without cornea or white, and for fewer than two circles.
    """
    if eye.cornea is None or eye.sclera is None:
        raise ValueError("an eye without cornea or white has no shell")
    check_whole("circles", circles, 2)
    rim, wide, share = eye.limbus_radius, eye.sclera.radius, jnp.linspace(0, 1, circles)
    cornea = Cones(eye.cornea.anterior.sagitta(rim * share), rim * share)
    begin = jnp.arcsin(rim / wide)
    turn = begin + (jnp.pi - begin) * share
    middle = cornea.z[-1] + wide * jnp.cos(begin)
    behind = jnp.maximum(wide * jnp.sin(turn), 0.0)  # rounding may give less at the back pole
    return {"cornea": cornea, "white": Cones(middle - wide * jnp.cos(turn), behind)}
