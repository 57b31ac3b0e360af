"""Surfaces of the eye: their intersections with rays, their normals and their texture coordinates.

How a surface sends light back is a property of its material (`outside`, `integrator`).
"""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from irisjax.anatomy.eye import Eye, cornea_of
from irisjax.anatomy.sclera import meet_sclera, sphere, vein_place
from irisjax.numerics.angle import arctan2
from irisjax.optics.conicoid import Vector, advance, dot, from_axis

TextureCoordinates = tuple[Float[Array, "*s"], Float[Array, "*s"]]
"""Angle (radians) of points of a surface, and their relative distance from its inner edge (0) to
its outer edge (1).
"""


class AbstractSurface(eqx.Module):
    """A surface of an eye. Points and unit directions are (…, 3), mm in the eye's frame."""

    eye: eqx.AbstractVar[Eye]

    @abc.abstractmethod
    def intersect(self, origin: Vector, direction: Vector) -> tuple[Vector, Bool[Array, "*s"]]:
        """Return the points where rays meet the surface, and whether they do, from outside."""

    @abc.abstractmethod
    def normal(self, point: Vector) -> Vector:
        """Return unit normals at points, out of the eye."""


class IrisSurface(AbstractSurface):
    """The plane or cone of the iris, from the pupil's edge to the root; its textures are
    `IrisMaps`.
    """

    eye: Eye

    def intersect(self, origin: Vector, direction: Vector) -> tuple[Vector, Bool[Array, "*s"]]:
        """Intersect rays in the chamber, or without a cornea; the pupil counts as iris."""
        t = self.eye.meet_iris(origin, direction)
        point = advance(origin, t, direction)
        cosine = -dot(direction, self.normal(point))
        return point, (t > 0) & (from_axis(point) < self.eye.iris_radius) & (cosine > 0)

    def normal(self, point: Vector) -> Vector:
        """Return unit normals towards the cornea."""
        return self.eye.iris_normal(point)

    def texture_coordinates(self, point: Vector) -> TextureCoordinates:
        """Return angle and relative radius in `IrisMaps`."""
        radius, x, y = self.eye.ring_of(point[..., 0], point[..., 1])
        return arctan2(y, x), radius


class CorneaSurface(AbstractSurface):
    """The front of the cornea with its tear film, up to the limbus."""

    eye: Eye

    def intersect(self, origin: Vector, direction: Vector) -> tuple[Vector, Bool[Array, "*s"]]:
        point, _, met = self.intersect_conicoid(origin, direction)
        return point, met

    def intersect_conicoid(
        self, origin: Vector, direction: Vector
    ) -> tuple[Vector, Bool[Array, "*s"], Bool[Array, "*s"]]:
        """Return where rays meet the whole conicoid, whether they do, and whether within the
        limbus. The iris is visible through the blend beyond it.
        """
        front = self._front
        t, met = front.intersect(origin, direction)
        point = advance(origin, t, direction)
        normal = front.normal(point)
        shown = met & (t > 0) & (dot(direction, normal) < 0) & (normal[..., 2] < 0)
        # The globe begins at the limbus itself.
        return point, shown, shown & (from_axis(point) <= self.eye.limbus_radius * (1 + 1e-4))

    def normal(self, point: Vector) -> Vector:
        return self._front.normal(point)

    @property
    def _front(self):
        return cornea_of(self.eye).anterior


class GlobeSurface(AbstractSurface):
    """The sclera, from the limbus on; its textures are a `VeinMap`."""

    eye: Eye

    def intersect(self, origin: Vector, direction: Vector) -> tuple[Vector, Bool[Array, "*s"]]:
        """Intersect rays, also where the cornea hides the globe."""
        distance, met = meet_sclera(self.eye, origin, direction)
        return advance(origin, distance, direction), met

    def normal(self, point: Vector) -> Vector:
        return sphere(self.eye).normal(point)

    def texture_coordinates(self, point: Vector) -> TextureCoordinates:
        """Return azimuth and relative distance from the limbus to the equator."""
        return vein_place(self.eye, point)

    def behind(self, point: Vector) -> Bool[Array, "*s"]:
        """Return whether points lie behind the equator."""
        globe = sphere(self.eye)
        return point[..., 2] > globe.apex + jnp.asarray(globe.radius)
