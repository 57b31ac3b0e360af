"""Surfaces of revolution as stacks of truncated cones, traced from a cross-section  [L03 Section
3.1, Fig. 7].
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from irisjax.numerics.roots import safe_sqrt
from irisjax.optics.conicoid import Vector, from_axis, parts

_ROUNDING = 16  # units in the last place by which cones reach beyond their seams


class Hit(NamedTuple):
    """Where rays meet a stack: `distance` along them (mm; finite where they miss), number of the
    `cone`, and whether they are `met` at all.
    """

    distance: Float[Array, "*s"]
    cone: Int[Array, "*s"]
    met: Bool[Array, "*s"]


class Cones(eqx.Module):
    """Truncated cones one after the other round the z-axis; a flat one is a ring, one of even
    radius a cylinder.

    **Fields:** `z` and `radius` of the circles where they join, mm, shape (circles,).

    **Raises:** `ValueError` for fewer than two circles, for numbers that are not finite, radii
    below 0, and for neighbours that are the same circle.
    """

    z: Float[Array, " circles"]
    radius: Float[Array, " circles"]

    def __check_init__(self):
        if len(self.z) < 2 or len(self.z) != len(self.radius):
            raise ValueError(
                f"a stack of cones needs two circles or more, a z and a radius each; got "
                f"{len(self.z)} and {len(self.radius)}"
            )
        if isinstance(self.z, Tracer) or isinstance(self.radius, Tracer):
            return
        z, radius = np.asarray(self.z), np.asarray(self.radius)
        for i, pair in enumerate(zip(z, radius, strict=True)):
            if not (np.isfinite(pair).all() and pair[1] >= 0):
                raise ValueError(
                    f"circle {i} of the cones has z = {pair[0]:g} mm and radius = {pair[1]:g} mm; "
                    f"both must be finite, the radius not below 0"
                )
        same = np.flatnonzero((np.diff(z) == 0) & (np.diff(radius) == 0))
        if same.size:
            raise ValueError(f"circles {same[0]} and {same[0] + 1} of the cones are the same")

    @classmethod
    def of(cls, profile) -> "Cones":
        """From a cross-section: pairs (z, radius), mm."""
        points = np.asarray(profile, float)
        if points.ndim != 2 or points.shape[1] != 2:
            raise ValueError(f"a profile is pairs (z, radius), got shape {points.shape}")
        dtype = jnp.result_type(float)
        return cls(jnp.asarray(points[:, 0], dtype), jnp.asarray(points[:, 1], dtype))

    def meet(self, origin: Vector, direction: Vector, least: float = 0.0) -> Hit:
        """First meeting of rays, at a distance above `least` (mm), from either side.

        Origins and unit directions (…, 3), mm. Cones reach a few roundings beyond their seams:
        no ray slips through.
        """
        distance, inside = self._all(origin, direction)
        held = inside & (distance > least)
        ordered = jnp.where(held, distance, jnp.inf)
        first = jnp.argmin(ordered, 0)
        met = held.any(0)
        found = jnp.take_along_axis(distance, first[None], 0)[0]
        return Hit(jnp.where(met, found, 0.0), first % (len(self.z) - 1), met)

    def normal(self, point: Vector, cone: Int[Array, "*s"]) -> Vector:
        """Unit normals of numbered cones at points (…, 3) on them: towards −z, out of the eye; of
        cylinders away from the axis.
        """
        x, y, _ = parts(point)
        r = from_axis(point)
        r = jnp.where(r > 0, r, 1.0)
        rise, out = jnp.diff(self.z)[cone], jnp.diff(self.radius)[cone]
        length = jnp.hypot(rise, out)
        side = jnp.where(out > 0, 1.0, jnp.where(out < 0, -1.0, jnp.sign(rise))) / length
        return jnp.stack([side * rise * x / r, side * rise * y / r, -side * out], -1)

    def height(self, radius: Float[Array, "*s"]) -> Float[Array, "*s"]:
        """z at distances from the axis, of a stack whose radii rise; straight on beyond its ends,
        mm.
        """
        slope = jnp.diff(self.z) / jnp.diff(self.radius)
        i = jnp.clip(jnp.searchsorted(self.radius, radius) - 1, 0, len(self.z) - 2)
        return self.z[i] + slope[i] * (radius - self.radius[i])

    def _all(self, origin: Vector, direction: Vector):
        """Distances to both meetings with every cone's whole cone, (2 × cones, …), and whether
        they lie between its circles.

        On a cone Δz r = w with w = Δr z + r₀ Δz − Δr z₀, squared a quadratic in the distance. Its
        discriminant is Δz² times a sum of squares less a square: what cancels is left out, and
        flat cones lose nothing.
        """
        (ox, oy, oz), (dx, dy, dz) = (parts(v[None]) for v in (origin, direction))
        shape = (-1, *(1,) * (ox.ndim - 1))
        z0, r0 = self.z[:-1].reshape(shape), self.radius[:-1].reshape(shape)
        rise = jnp.diff(self.z).reshape(shape)
        out = jnp.diff(self.radius).reshape(shape)
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
        first = c / jnp.where(q != 0, q, 1.0)
        second = q / jnp.where(a != 0, a, 1.0)
        t = jnp.concatenate([first, second])
        real = jnp.concatenate([(inner >= 0) & (q != 0), (inner >= 0) & (a != 0)])
        # Rays steeper than a cone meet it once and its mirror image once; w tells which is which.
        # Of flat cones the two are one point, and their derivatives two.
        one = (b >= 0) == ((w1 >= 0) != opens)
        known, right = jnp.concatenate([a < 0, a < 0]), jnp.concatenate([one, ~one])
        on, inside = self._between(t, (ox, oy, oz), (dx, dy, dz), shape)
        return t, real & inside & jnp.where(known, right, on)

    def _between(self, t, origin, direction, shape):
        """Whether points lie on their cone, not on its mirror image, and between its circles."""
        x, y, z = (o + t * d for o, d in zip(origin, direction, strict=True))
        r = jnp.sqrt(x * x + y * y)
        ends = [jnp.concatenate([v, v]).reshape(shape) for v in (self.z[:-1], self.radius[:-1])]
        rise, out = (
            jnp.concatenate([v, v]).reshape(shape)
            for v in (jnp.diff(self.z), jnp.diff(self.radius))
        )
        square = rise * rise + out * out
        share = ((z - ends[0]) * rise + (r - ends[1]) * out) / square
        size = jnp.abs(self.z).max() + self.radius.max()
        slack = _ROUNDING * jnp.finfo(t.dtype).eps * size
        # The radius that the cone has at z, times its rise: below 0 on its mirror image.
        sheet = (ends[1] * rise + (z - ends[0]) * out) * rise
        on = sheet >= -slack * jnp.abs(out * rise)
        slack = slack / jnp.sqrt(square)
        return on, (share >= -slack) & (share <= 1 + slack)
