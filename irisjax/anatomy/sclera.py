"""The globe behind the limbus: its sphere, and where points on it lie in maps of vessels."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye, Sclera
from irisjax.numerics.angle import arctan2
from irisjax.numerics.roots import safe_sqrt
from irisjax.optics.conicoid import Conicoid, Vector, parts


class VeinMap(eqx.Module):
    """Vessels over the white, from the limbus (first column) to the equator of the eye (last),
    round in azimuth.

    Textures of shape (azimuths, polars), cell centres, rows from +x towards +y, columns uniform in
    the polar angle about the sphere's centre: the fields of `Blood`. `depth` also reaches a little
    past a vessel's edge, where `cover` ends it: blood spread evenly over a texel would look yellow,
    as thin blood is.
    """

    depth: Float[Array, "azimuths polars"]
    cover: Float[Array, "azimuths polars"]
    deep: Float[Array, "azimuths polars"]


def sclera_centre(eye: Eye) -> Scalar:
    """z of the sphere's centre, mm: the sphere passes through the limbus, where the cornea ends.

    Without a cornea the limbus lies in the plane of the iris. **Raises:** `ValueError` for an eye
    without sclera.
    """
    sclera = sclera_of(eye)
    return limbus_depth(eye) + jnp.sqrt(sclera.radius**2 - eye.limbus_radius**2)


def limbus_depth(eye: Eye) -> Scalar:
    """z of the limbus, mm."""
    return eye.iris_depth if eye.cornea is None else eye.cornea.anterior.sagitta(eye.limbus_radius)


def limbus_angle(eye: Eye) -> Scalar:
    """Polar angle of the limbus about the sphere's centre, radians."""
    return jnp.arcsin(eye.limbus_radius / sclera_of(eye).radius)


def sphere(eye: Eye) -> Conicoid:
    """The sphere of the sclera; only what lies behind the limbus is white."""
    radius = sclera_of(eye).radius
    return Conicoid(radius, jnp.ones_like(radius), sclera_centre(eye) - radius)


def meet_sclera(eye: Eye, origin: Vector, direction: Vector):
    """Distance along rays (unit vectors) to the sphere, mm, and whether they meet its white part
    from outside.

    The cap in front of the limbus is not white. Whether the cornea hides the white is the caller's
    to ask. Where nothing is met the distance is that of the nearest approach.
    """
    distance, met = sphere(eye).intersect(origin, direction)
    z = origin[..., 2] + distance * direction[..., 2]
    return distance, met & (distance > 0) & (z >= limbus_depth(eye))


def vein_place(eye: Eye, point: Vector) -> tuple[Float[Array, "*s"], Float[Array, "*s"]]:
    """Where points (…, 3) on the sphere, mm in the eye's frame, lie in a `VeinMap`: azimuth,
    radians, and the way from the limbus (0) to the equator (1)."""
    x, y, z = parts(point)
    azimuth = arctan2(y, x)
    polar = arctan2(safe_sqrt(x * x + y * y), sclera_centre(eye) - z)
    limbus = limbus_angle(eye)
    return azimuth, (polar - limbus) / (jnp.pi / 2 - limbus)


def sclera_of(eye: Eye) -> Sclera:
    """The sclera of an eye, or `ValueError` where it has none."""
    if eye.sclera is None:
        raise ValueError("this eye has no sclera (Eye.sclera is None)")
    return eye.sclera
