"""Rays at surfaces of revolution of second order: where they meet, the normal there, and how they
go on.

A surface is p z² − 2 R z + x² + y² = 0 with z counted from its apex along the axis [F09 Eq. 3]; p =
1 is a sphere, 0 < p < 1 a prolate ellipsoid, p = 0 a paraboloid. Vectors are arrays of shape (…,
3).

Most is written in components: XLA then joins a chain of such functions into loops over rays and
never makes the vectors between them, which halves the time. Scalar products stay sums over the last
axis: there XLA keeps what it has, where otherwise it would work out the same again for every result
(tables of an eye: 15 times as long).
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from irisjax._types import Scalar, as_float
from irisjax.numerics.roots import safe_sqrt
from irisjax.optics.fresnel import fresnel

Vector = Float[Array, "*s 3"]
Parts = tuple[Float[Array, "*s"], ...]
"""Vectors, each component by itself."""


class Conicoid(eqx.Module):
    """A conicoid about the z axis.

    - `radius`: radius of curvature at the apex, mm.
    - `shape`: p of the equation; `apex`: z of the apex, mm.
    """

    radius: Scalar = eqx.field(converter=as_float)
    shape: Scalar = eqx.field(converter=as_float)
    apex: Scalar = eqx.field(default=0.0, converter=as_float)

    def sagitta(self, r: Float[Array, "*s"]) -> Float[Array, "*s"]:
        """Depth behind the apex at distance `r` from the axis, mm; it ends at the equator, r =
        R/√p.
        """
        # The form without cancellation also holds for the paraboloid.
        return r * r / (self.radius + safe_sqrt(self.radius**2 - self.shape * r * r))

    def normal(self, point: Vector) -> Vector:
        """Unit normal that points out of the eye (to negative z at the apex)."""
        x, y, z = parts(point)
        n = jnp.stack([x, y, self.shape * (z - self.apex) - self.radius], axis=-1)
        return n / norm(n)[..., None]

    def intersect(self, origin: Vector, direction: Vector, far: bool = False):
        """Distance along a ray to its first (or `far`: second) crossing, and whether it meets the
        surface.

        Directions are unit vectors. The distance is that of the nearest approach where nothing is
        met.
        """
        (x, y, z), (u, v, w) = parts(origin), parts(direction)
        z = z - self.apex
        # Counted from the point nearest to the apex: from a far origin what is subtracted below
        # would be of the size of its square.
        ahead = -dot(joined([x, y, z]), direction)
        x, y, z = x + ahead * u, y + ahead * v, z + ahead * w
        a = u * u + v * v + self.shape * w * w
        b = x * u + y * v + (self.shape * z - self.radius) * w
        c = x * x + y * y + (self.shape * z - 2 * self.radius) * z
        square = b * b - a * c
        root = safe_sqrt(square)
        # The root of larger size first, the other by Vieta: no cancellation, and a paraboloid's a =
        # 0 does no harm.
        q = -(b + jnp.where(b < 0, -root, root))
        q_safe = jnp.where(q == 0, 1.0, q)
        a_safe = jnp.where(a == 0, 1.0, a)
        large = jnp.where(a == 0, jnp.inf, q / a_safe)
        small = jnp.where(q == 0, 0.0, c / q_safe)
        first, second = jnp.minimum(large, small), jnp.maximum(large, small)
        return ahead + (second if far else first), square > 0


def parts(a: Float[Array, "*s n"]) -> Parts:
    """Components along the last axis. Kept apart they are faster to make than as one array."""
    return tuple(a[..., i] for i in range(a.shape[-1]))


def joined(a: Sequence[Float[Array, "*s"]]) -> Vector:
    """`parts` as vectors again."""
    return jnp.stack(list(a), axis=-1)


def along(origin: Vector, t: Float[Array, "*s"], direction: Vector) -> Vector:
    """Points origin + t direction."""
    return jnp.stack(
        [o + t * d for o, d in zip(parts(origin), parts(direction), strict=True)], axis=-1
    )


def choose(mask: Bool[Array, "*s"], a: Vector, b: Float[Array, "*#s 3"]) -> Vector:
    """Vectors of `a` where `mask`, else of `b`."""
    return jnp.stack(
        [jnp.where(mask, x, y) for x, y in zip(parts(a), parts(b), strict=True)], axis=-1
    )


def from_axis(point: Vector) -> Float[Array, "*s"]:
    """Distance of points from the z axis, with gradient 0 on it."""
    return safe_sqrt(point[..., 0] ** 2 + point[..., 1] ** 2)


def dot(a: Float[Array, "*#s n"], b: Float[Array, "*#s n"]) -> Float[Array, "*#s"]:
    """Scalar product over the last axis."""
    return (a * b).sum(-1)


def norm(a: Float[Array, "*s n"]) -> Float[Array, "*s"]:
    """Length over the last axis, with gradient 0 at 0."""
    return safe_sqrt(dot(a, a))


def refract_vector(direction: Vector, normal: Vector, n_in, n_out):
    """Direction behind an interface, and the share that passes it, 1 − F (0 under total
    reflection).

    Unit vectors; `normal` points to the side the ray comes from. Rays from the wrong side pass with
    a share of 0 and a direction that is the smooth continuation, so that a search may cross grazing
    incidence.
    """
    cosine = -dot(direction, normal)
    ratio = n_in / n_out
    inside = safe_sqrt(1 - ratio * ratio * (1 - cosine * cosine))
    turn = ratio * cosine - inside
    out = jnp.stack(
        [ratio * d + turn * n for d, n in zip(parts(direction), parts(normal), strict=True)],
        axis=-1,
    )
    return out, fresnel(jnp.maximum(cosine, 0), inside, n_in, n_out)[1]


def reflect_vector(direction: Vector, normal: Vector) -> Vector:
    """Mirror direction of a unit vector at a unit normal of either sign; its share is 1 −
    `refract_vector`'s.
    """
    return along(direction, -2 * dot(direction, normal), normal)
