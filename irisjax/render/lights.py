"""Lights: distant or at a place, any number, of one spectrum."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax._types import Reals, as_float, as_float_or_none
from irisjax.numerics.checks import Range, check_range, is_known
from irisjax.optics.conicoid import Parts, parts
from irisjax.render.refraction import direction_of

LIGHT_LIMITS = {
    "irradiance": Range(0, 1e6),
    "tint": Range(0, 1e6),
    "radius": Range(0, np.pi + 1e-6, "radians", above=True),  # of regions of an environment to pi
}
"""Allowed range of each number of a light."""
LAMP_DISTANCE = Range(20, np.inf, "mm")
"""Allowed distance of near lamps from the corneal apex."""
_UNIT_LENGTH = Range(1 - 1e-4, 1 + 1e-4)  # of a direction, within rounding


class Lights(eqx.Module):
    """Any number of lights, made with `distant` or `points` and joined with `+`. A single number
    holds for all lights.

    Attributes:
        towards: Unit vectors from the eye to each light, in the eye's frame (+z into the eye).
        irradiance: Irradiance of a surface at the eye, outside the cornea, that faces the light; π
            lights a white sheet to radiance 1.
        tint: Factors on linear sRGB; `None` for the illuminant's own colour.
        distance: Distance from the corneal apex, mm; `None` for lights at infinity.
        radius: Angular radius of each light as seen from the eye, radians, which is that of its
            mirror image; at most π/2 for a lamp.
        illuminant: Spectrum of all lights, by colour-science's name.

    Raises:
        ValueError: A direction is not a unit vector, or a number is negative, not finite or out of
            range.
    """

    towards: Float[Array, "lights 3"] = eqx.field(converter=as_float)
    irradiance: Float[Array, " lights"] = eqx.field(converter=as_float)
    tint: Float[Array, "lights 3"] | None = eqx.field(default=None, converter=as_float_or_none)
    distance: Float[Array, " lights"] | None = eqx.field(default=None, converter=as_float_or_none)
    radius: Float[Array, " lights"] = eqx.field(default=0.03, converter=as_float)
    illuminant: str = eqx.field(static=True, default="D65")

    @classmethod
    def distant(
        cls,
        polar: Reals,
        azimuth: Reals,
        irradiance: Reals = jnp.pi,
        *,
        radius: Reals = 0.03,
        illuminant: str = "D65",
    ) -> "Lights":
        """Make lights at infinity, at `polar` angles from the eye's axis and `azimuth` from +x to
        +y, radians.
        """
        each = [jnp.atleast_1d(as_float(v)) for v in (polar, azimuth, irradiance, radius)]
        try:
            polar, azimuth, irradiance, radius = jnp.broadcast_arrays(*each)
        except ValueError:
            shapes = ", ".join(str(v.shape) for v in each)
            message = f"lights: polar, azimuth, irradiance and radius have shapes {shapes}"
            raise ValueError(f"{message}; each must be one number or one a light") from None
        towards = direction_of(polar, azimuth)
        return cls(towards, irradiance, radius=radius, illuminant=illuminant)

    @classmethod
    def points(
        cls,
        position: Reals | Sequence[Sequence[float]],
        irradiance: Reals = jnp.pi,
        *,
        radius: Reals = 0.03,
        illuminant: str = "D65",
    ) -> "Lights":
        """Make lights at positions (lights, 3), mm in the eye's frame, 20 or more from the apex, at
        which they give `irradiance`.

        The iris's irradiance errs by less than 1 % for lamps from 50 mm on and up to 57° off the
        axis, and by less than 10 % at 20 mm. Beyond 80°, where caustics begin, light is that of a
        parallel beam: the picture jumps there.
        """
        position = jnp.atleast_2d(as_float(position))
        distance = jnp.sqrt((position**2).sum(-1))
        check_range("a lamp's distance", distance, LAMP_DISTANCE)
        return cls(position / distance[:, None], irradiance, None, distance, radius, illuminant)

    def __post_init__(self) -> None:
        towards = as_float(self.towards)
        if towards.ndim != 2 or towards.shape[1] != 3:
            raise ValueError(f"lights: towards has shape {towards.shape}; it must be (lights, 3)")
        object.__setattr__(self, "towards", towards)
        for name in ("irradiance", "radius", "distance", "tint"):
            if (value := getattr(self, name)) is None:
                continue
            shape = towards.shape if name == "tint" else towards.shape[:1]
            try:  # one number for all lights
                object.__setattr__(self, name, jnp.broadcast_to(as_float(value), shape))
            except ValueError:
                message = f"lights: {name} has shape {np.shape(value)}; it must be {shape}"
                raise ValueError(message) from None

    def __check_init__(self) -> None:
        if is_known(self.towards):
            length = np.linalg.norm(np.asarray(self.towards, np.float64), axis=1)
            check_range("length of a lamp's direction", length, _UNIT_LENGTH)
        for name, allowed in LIGHT_LIMITS.items():
            check_range(f"a lamp's {name}", getattr(self, name), allowed)
        if self.distance is not None and is_known(self.distance):
            distance = np.asarray(self.distance)  # infinite beside lamps that are near
            check_range("a lamp's distance", distance[distance != np.inf], LAMP_DISTANCE)

    def __len__(self) -> int:
        return self.towards.shape[0]

    def __add__(self, other: "Lights") -> "Lights":
        if self.illuminant != other.illuminant:
            raise ValueError(
                f"lights of one scene share a spectrum, got {self.illuminant} and "
                f"{other.illuminant}"
            )

        def join(name, default=0.0):
            values = [getattr(self, name), getattr(other, name)]
            given = next((v for v in values if v is not None), None)
            if given is None:
                return None
            for k, lights in enumerate((self, other)):
                if values[k] is None:
                    values[k] = jnp.full((len(lights), *given.shape[1:]), default, given.dtype)
            return jnp.concatenate(values)

        towards, irradiance, radius = (join(n) for n in ("towards", "irradiance", "radius"))
        tint, distance = join("tint", 1.0), join("distance", jnp.inf)
        return Lights(towards, irradiance, tint, distance, radius, self.illuminant)

    @property
    def tint_factors(self) -> Float[Array, "lights tints"]:
        """Factors on the channels of a picture: `tint`, or a single 1 for lights without a tint."""
        return jnp.ones((len(self), 1), self.irradiance.dtype) if self.tint is None else self.tint

    def irradiance_on(self, normal: Float[Array, "3"]) -> Float[Array, " tints"]:
        """Compute the irradiance of a surface at the eye with a unit normal, for each tint."""
        power = self.irradiance * jnp.maximum((self.towards * normal).sum(axis=1), 0.0)
        return self.tint_factors.T @ power

    def polar(self) -> Float[Array, " lights"]:
        """Angle of each light from the axis of the eye, radians."""
        return _polar(self.towards)

    def incident_at(
        self, point: Parts, i: Any = np.s_[:, None]
    ) -> tuple[tuple[Float[Array, "..."], ...], Float[Array, "..."]]:
        """Return unit vectors from points (components, mm) to light `i`, and the irradiance there
        of a surface that faces it; for all lights by default, (lights, points).
        """
        towards, power = parts(self.towards[i]), self.irradiance[i]
        if self.distance is None:
            return towards, power
        near = 1.0 / self.distance[i]  # 0 for a light at infinity
        offset = [t - p * near for t, p in zip(towards, point, strict=True)]
        square = sum(o * o for o in offset)
        length = jnp.sqrt(square)
        return tuple(o / length for o in offset), power / square


@eqx.filter_jit
def _polar(towards):
    return jnp.arctan2(jnp.hypot(towards[:, 0], towards[:, 1]), -towards[:, 2])


def wrapped_cosine(cosine: Float[Array, "..."], reach: float) -> Float[Array, "..."]:
    """Return the effective cosine of incidence on a translucent tissue, which carries light past
    the terminator, down to a cosine of −`reach`. A sphere of it reflects as much as a matt one.
    """
    wrapped = jnp.maximum(cosine + reach, 0.0) ** 2 / (4 * reach)
    return jnp.where(cosine > reach, cosine, wrapped) / (1 + reach**2 / 3)
