"""Rays at conicoids: their intersections, the normals there, refraction and reflection.

A surface is p z² − 2 R z + x² + y² = 0 with z counted from its apex along the axis [F09 Eq. 3]; p =
1 is a sphere, 0 < p < 1 a prolate ellipsoid, p = 0 a paraboloid. Vectors are arrays of shape (…,
3).

Most functions are written in components, and materialise what several of them share: XLA then makes
short loops over rays of them. Only `dot` sums over the last axis: by components pictures with many
lamps under radiative transfer would take 1.8 times as long.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from irisjax._types import Real, Scalar, as_float
from irisjax.numerics.fusion import materialise
from irisjax.numerics.roots import safe_sqrt
from irisjax.optics.fresnel import fresnel

Vector = Float[Array, "*s 3"]
Parts = tuple[Float[Array, "*s"], ...]
"""Vectors as separate components."""


class Conicoid(eqx.Module):
    """A conicoid about the z axis.

    Attributes:
        radius: Radius of curvature at the apex, mm.
        shape: p of the equation.
        apex: z of the apex, mm.
    """

    radius: Scalar = eqx.field(converter=as_float)
    shape: Scalar = eqx.field(converter=as_float)
    apex: Scalar = eqx.field(default=0.0, converter=as_float)

    def sagitta(self, r: Float[Array, "*s"]) -> Float[Array, "*s"]:
        """Compute the depth behind the apex at distance `r` from the axis, mm.

        The surface ends at the equator, r = R/√p.
        """
        # The form without cancellation also holds for the paraboloid.
        return r * r / (self.radius + safe_sqrt(self.radius**2 - self.shape * r * r))

    def normal(self, point: Vector) -> Vector:
        """Compute the unit normal that points out of the eye (to negative z at the apex)."""
        x, y, z = parts(point)
        z = self.shape * (z - self.apex) - self.radius
        length = safe_sqrt(x * x + y * y + z * z)
        return from_parts([x / length, y / length, z / length])

    def intersect(
        self, origin: Vector, direction: Vector, far: bool = False
    ) -> tuple[Float[Array, "*s"], Bool[Array, "*s"]]:
        """Intersect rays of unit direction with the surface, for the second time if `far`.

        Returns:
            The distance along each ray, that of the nearest approach for a ray that misses, and
            whether it meets the surface.
        """
        (x, y, z), (u, v, w) = parts(origin), parts(direction)
        z = z - self.apex
        # Counted from the point nearest to the apex: from a far origin what is subtracted below
        # would be of the size of its square.
        ahead = -_sum([x * u, y * v, z * w])
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
        return materialise(ahead + (second if far else first)), square > 0


def parts(a: Float[Array, "*s n"]) -> Parts:
    """Split into components along the last axis, which are faster to compute than one array."""
    return tuple(a[..., i] for i in range(a.shape[-1]))


def from_parts(a: Sequence[Float[Array, "*s"]]) -> Vector:
    """Join components to vectors: the inverse of `parts`."""
    return jnp.stack(list(a), axis=-1)


def advance(origin: Vector, t: Float[Array, "*s"], direction: Vector) -> Vector:
    """Compute the points origin + t direction."""
    pairs = zip(parts(origin), parts(direction), strict=True)
    return from_parts(materialise([o + t * d for o, d in pairs]))


def choose(mask: Bool[Array, "*s"], a: Vector, b: Float[Array, "*#s 3"]) -> Vector:
    """Select vectors of `a` where `mask` is true, otherwise of `b`."""
    return from_parts([jnp.where(mask, x, y) for x, y in zip(parts(a), parts(b), strict=True)])


def from_axis(point: Vector) -> Float[Array, "*s"]:
    """Compute the distance of points from the z axis, with gradient 0 on it."""
    return safe_sqrt(point[..., 0] ** 2 + point[..., 1] ** 2)


def dot(a: Float[Array, "*#s n"], b: Float[Array, "*#s n"]) -> Float[Array, "*#s"]:
    """Compute the scalar product over the last axis."""
    return (a * b).sum(-1)


def _sum(terms: Sequence[Float[Array, "*s"]]) -> Float[Array, "*s"]:
    """Add terms by a sum along an axis, which is computed once as `materialise` has it."""
    return jnp.stack(list(terms)).sum(0)


def norm(a: Float[Array, "*s n"]) -> Float[Array, "*s"]:
    """Compute the length over the last axis, with gradient 0 at 0."""
    return safe_sqrt(dot(a, a))


def refract_vector(
    direction: Vector, normal: Vector, n_in: Real, n_out: Real
) -> tuple[Vector, Float[Array, "*s"]]:
    """Refract unit vectors at an interface whose unit normals point to where they come from.

    Rays from the wrong side get a share of 0 and the smooth continuation of the direction, so that
    a search may cross grazing incidence.

    Returns:
        The directions behind the interface, and the shares that pass, 1 − F (0 under total
        reflection).
    """
    pairs = list(zip(parts(direction), parts(normal), strict=True))
    cosine = -_sum([d * n for d, n in pairs])
    ratio = n_in / n_out
    inside = safe_sqrt(1 - ratio * ratio * (1 - cosine * cosine))
    turn = ratio * cosine - inside
    out = from_parts([ratio * d + turn * n for d, n in pairs])
    return out, fresnel(jnp.maximum(cosine, 0), inside, n_in, n_out)[1]


def reflect_vector(direction: Vector, normal: Vector) -> Vector:
    """Reflect unit vectors at unit normals of either sign, by a share of 1 − `refract_vector`'s."""
    return advance(direction, -2 * dot(direction, normal), normal)
