"""Rays at surfaces of revolution of second order: where they meet, the normal there, and how they go on.

A surface is p z² − 2 R z + x² + y² = 0 with z counted from its apex along the axis [F09 Eq. 3]; p = 1 is a
sphere, 0 < p < 1 a prolate ellipsoid, p = 0 a paraboloid. Vectors are arrays of shape (…, 3).
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from irisjax._types import Scalar, as_float
from irisjax.optics.fresnel import fresnel, safe_sqrt

Vector = Float[Array, "*s 3"]


class Conicoid(eqx.Module):
    """A conicoid about the z axis.

    - `radius`: radius of curvature at the apex, mm.
    - `shape`: p of the equation; `apex`: z of the apex, mm.
    """

    radius: Scalar = eqx.field(converter=as_float)
    shape: Scalar = eqx.field(converter=as_float)
    apex: Scalar = eqx.field(default=0.0, converter=as_float)

    def sagitta(self, r: Float[Array, "*s"]) -> Float[Array, "*s"]:
        """Depth behind the apex at distance `r` from the axis, mm; it ends at the equator, r = R/√p."""
        # The form without cancellation also holds for the paraboloid.
        return r * r / (self.radius + safe_sqrt(self.radius**2 - self.shape * r * r))

    def normal(self, point: Vector) -> Vector:
        """Unit normal that points out of the eye (to negative z at the apex)."""
        z = point[..., 2] - self.apex
        n = jnp.stack([point[..., 0], point[..., 1], self.shape * z - self.radius], axis=-1)
        return n / norm(n)[..., None]

    def intersect(self, origin: Vector, direction: Vector, far: bool = False):
        """Distance along a ray to its first (or `far`: second) crossing, and whether it meets the surface.

        Directions are unit vectors. The distance is that of the nearest approach where nothing is met.
        """
        o = jnp.stack([origin[..., 0], origin[..., 1], origin[..., 2] - self.apex], axis=-1)
        weight = jnp.stack([jnp.ones_like(self.shape), jnp.ones_like(self.shape), self.shape])
        a = (direction * direction * weight).sum(-1)
        b = (o * direction * weight).sum(-1) - self.radius * direction[..., 2]
        c = (o * o * weight).sum(-1) - 2 * self.radius * o[..., 2]
        square = b * b - a * c
        root = safe_sqrt(square)
        # The root of larger size first, the other by Vieta: no cancellation, and a paraboloid's a = 0 does no harm.
        q = -(b + jnp.where(b < 0, -root, root))
        q_safe = jnp.where(q == 0, 1.0, q)
        a_safe = jnp.where(a == 0, 1.0, a)
        large = jnp.where(a == 0, jnp.inf, q / a_safe)
        small = jnp.where(q == 0, 0.0, c / q_safe)
        first, second = jnp.minimum(large, small), jnp.maximum(large, small)
        return (second if far else first), square > 0


def dot(a: Float[Array, "*#s n"], b: Float[Array, "*#s n"]) -> Float[Array, "*#s"]:
    """Scalar product over the last axis."""
    return (a * b).sum(-1)


def norm(a: Float[Array, "*s n"]) -> Float[Array, "*s"]:
    """Length over the last axis, with gradient 0 at 0."""
    return safe_sqrt(dot(a, a))


def refract_vector(direction: Vector, normal: Vector, n_in, n_out):
    """Direction behind an interface, and the share that passes it, 1 − F (0 under total reflection).

    Unit vectors; `normal` points to the side the ray comes from. Rays from the wrong side pass with a share
    of 0 and a direction that is the smooth continuation, so that a search may cross grazing incidence.
    """
    cosine = -dot(direction, normal)
    ratio = n_in / n_out
    inside = safe_sqrt(1 - ratio * ratio * (1 - cosine * cosine))
    out = ratio * direction + (ratio * cosine - inside)[..., None] * normal
    return out, fresnel(jnp.maximum(cosine, 0), inside, n_in, n_out)[1]


def reflect_vector(direction: Vector, normal: Vector) -> Vector:
    """Mirror direction of a unit vector at a unit normal of either sign; its share is 1 − `refract_vector`'s."""
    return direction - 2 * dot(direction, normal)[..., None] * normal
