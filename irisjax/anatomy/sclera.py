"""The globe behind the limbus: its sphere, and where points on it lie in maps of vessels."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye, sclera_of
from irisjax.numerics.angle import arctan2
from irisjax.numerics.checks import Range, check_fields
from irisjax.numerics.roots import safe_sqrt
from irisjax.optics.conicoid import Conicoid, Vector, parts

_VEIN_LIMITS = {
    "depth": Range(0, np.inf, "mm"),
    "cover": Range(0, np.inf),
    "deep": Range(0, np.inf),
}


class VeinMap(eqx.Module):
    """Maps of the vessels in the white, over azimuth and the polar angle about the sphere's centre.

    Values are at cell centres. Rows run from +x towards +y; columns are uniform in the polar angle,
    from the limbus (first) to the equator of the eye (last).

    Attributes:
        depth: Thickness of the blood in a conjunctival vessel along its normal, mm. It extends a
            little beyond the vessel's edge, where `cover` ends it: blood spread evenly over a texel
            would look yellow, as thin blood does.
        cover: Share of the light, 0 to 1, that meets a conjunctival vessel.
        deep: Share of the light that meets an episcleral vessel.

    Raises:
        ValueError: For a value that is negative or not finite.
    """

    depth: Float[Array, "azimuths polars"]
    cover: Float[Array, "azimuths polars"]
    deep: Float[Array, "azimuths polars"]

    def __check_init__(self) -> None:
        check_fields(self, _VEIN_LIMITS)


def sclera_centre(eye: Eye) -> Scalar:
    """Compute z of the centre, mm, of the sphere through the limbus; see `sclera_of`."""
    return limbus_depth(eye) + jnp.sqrt(sclera_of(eye).radius ** 2 - eye.limbus_radius**2)


def limbus_depth(eye: Eye) -> Scalar:
    """Compute z of the limbus, mm; without a cornea it lies in the plane of the iris."""
    return eye.iris_depth if eye.cornea is None else eye.cornea.anterior.sagitta(eye.limbus_radius)


def limbus_angle(eye: Eye) -> Scalar:
    """Compute the polar angle of the limbus about the sphere's centre, radians."""
    return jnp.arcsin(eye.limbus_radius / sclera_of(eye).radius)


def sphere(eye: Eye) -> Conicoid:
    """Return the sphere of the sclera; only its part behind the limbus is white."""
    radius = sclera_of(eye).radius
    return Conicoid(radius, jnp.ones_like(radius), sclera_centre(eye) - radius)


def meet_sclera(
    eye: Eye, origin: Vector, direction: Vector
) -> tuple[Float[Array, "*s"], Bool[Array, "*s"]]:
    """Compute the distance along rays (unit vectors) to the white, mm, and whether they meet it.

    Only rays from outside that meet the sphere behind the limbus count; the cornea may hide that
    point. A ray that misses has the distance of its nearest approach.
    """
    distance, met = sphere(eye).intersect(origin, direction)
    z = origin[..., 2] + distance * direction[..., 2]
    return distance, met & (distance > 0) & (z >= limbus_depth(eye))


def vein_place(eye: Eye, point: Vector) -> tuple[Float[Array, "*s"], Float[Array, "*s"]]:
    """Compute where points on the sphere, mm in the eye's frame, lie in a `VeinMap`.

    Returns:
        The azimuth, radians, and the relative distance from the limbus (0) to the equator (1).
    """
    x, y, z = parts(point)
    azimuth = arctan2(y, x)
    polar = arctan2(safe_sqrt(x * x + y * y), sclera_centre(eye) - z)
    limbus = limbus_angle(eye)
    return azimuth, (polar - limbus) / (jnp.pi / 2 - limbus)
