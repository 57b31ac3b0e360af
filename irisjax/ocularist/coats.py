"""Coats of paint on cones, and their effect on light  [L03 Section 3.3]."""

import itertools
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.anatomy.eye import Cornea, Eye, slope_of
from irisjax.numerics.checks import Range, check_range, is_known
from irisjax.ocularist.cones import Cones
from irisjax.optics.conicoid import Conicoid

OPACITY = Range(0.0, 1.0)
HEIGHT = Range(0.0, 1.0, "mm", meaning="of a coat above the base")
_COLOUR = Range(0.0, 1.0, meaning="linear reflectance of a paint")
LIMBUS = 5.77
"""Distance from the axis (mm) at which the paper's spheres meet: of 11.5 and 7.8 mm, their centres
4.7 mm apart  [L03 Fig. 6, which prints 5.8].
"""
PUPIL_RADIUS = 1.9
"""Radius of a painted eye's pupil by default, mm."""
DEPTH = 2.9
"""Depth (mm) of the cone of the iris behind the cornea, at the axis."""
SLOPE = 0.12
"""Slope of that cone, mm in depth per mm of radius. The pupil's margin lies further forward than
the root [L03 Section 2.2]; by how much is this package's choice.
"""

_Values = Float[Array | np.ndarray, "..."] | float


class Coat(eqx.Module):
    """One coat of paint.

    Attributes:
        name: Unique in a painting.
        opacity: From 0, clear, to 1: a picture of the iris as seen from ahead, whose sides touch
            the root.
        colour: Linear sRGB.
        height: Above the base, towards the cornea, mm.
    """

    name: str = eqx.field(static=True)
    opacity: Float[Array, "rows columns"]
    colour: Float[Array, "3"]
    height: Scalar

    def __check_init__(self) -> None:
        where = f"coat {self.name!r}: "
        check_range(f"{where}opacity", self.opacity, OPACITY)
        check_range(f"{where}colour", self.colour, _COLOUR)
        check_range(f"{where}height", self.height, HEIGHT)


class Painting(eqx.Module):
    """Coats from the bottom up, on cones that differ in height alone.

    Attributes:
        coats: From the bottom up; coats of equal height in their order of painting.
        profile: Cross-section of the lowest surface from the pupil's margin to the root; its radii
            rise.

    Raises:
        ValueError: where two coats have one name, or one lies below another that was painted before
            it.
    """

    coats: tuple[Coat, ...]
    profile: Cones

    def __check_init__(self) -> None:
        names = [coat.name for coat in self.coats]
        twice = {n for n in names if names.count(n) > 1}
        if twice:
            raise ValueError(f"coats need names of their own; more than once: {sorted(twice)}")
        if not is_known(self.profile.radius):
            return
        if (np.diff(np.asarray(self.profile.radius)) <= 0).any():
            raise ValueError("the radii of an iris's profile must rise from the pupil to the root")
        if not is_known([coat.height for coat in self.coats]):
            return
        for before, coat in itertools.pairwise(self.coats):
            low, high = float(coat.height), float(before.height)
            if low < high:
                late = f"coat {coat.name!r} at {low:g} mm is painted after {before.name!r}"
                raise ValueError(f"{late} and lies below it, at {high:g} mm")

    def replace(self, name: str, **fields: Any) -> "Painting":
        """The painting with some fields of a coat changed; all else keeps its arrays.

        Raises:
            ValueError: naming the coats, where there is none of that name.
        """
        names = [coat.name for coat in self.coats]
        if name not in names:
            raise ValueError(f"no coat {name!r}; there are {', '.join(names)}")
        coats, at = list(self.coats), names.index(name)
        coats[at] = Coat(**(vars(coats[at]) | fields))
        return Painting(tuple(coats), self.profile)


def prosthesis(pupil_radius: float = PUPIL_RADIUS) -> Eye:
    """The paper's eye: two spheres, a cornea of index 1.376 that fills the chamber, and a conical
    iris up to the limbus  [L03 Section 3.1, Fig. 6].
    """
    index, limbus = jnp.asarray(1.376), jnp.asarray(LIMBUS)
    return Eye(
        cornea=Cornea(Conicoid(7.8, 1.0), posterior=None, index=index, scatter=None),
        aqueous_index=index,
        iris_depth=jnp.asarray(DEPTH),
        iris_slope=jnp.asarray(SLOPE),
        limbus_radius=limbus,
        iris_radius=limbus,
        pupil_radius=jnp.asarray(pupil_radius),
    )


def profile_of(eye: Eye) -> Cones:
    """The plane or cone of an eye's iris, as a stack of one."""
    radius = jnp.stack([eye.pupil_radius, eye.iris_radius])
    return Cones(eye.iris_depth + slope_of(eye) * radius, radius)


def over(behind: _Values, opacity: _Values, paint: _Values, light: _Values) -> Any:
    """Radiance of a coat over what lies behind it: R = (1 − a) T + a C L  [L03 Eq. 1]."""
    return (1 - opacity) * behind + opacity * paint * light


def through(light: _Values, opacity: _Values, paint: _Values, as_printed: bool = False) -> Any:
    """Light below a coat: the part that misses the paint, and the part that it tints  [L03 Eq. 2].

    The paper prints L' = (1 − a) a C L, by which clear varnish is black; here it is
    ((1 − a) + a C) L. `as_printed` selects the printed form, for comparison.
    """
    if as_printed:
        return (1 - opacity) * opacity * paint * light
    return ((1 - opacity) + opacity * paint) * light
