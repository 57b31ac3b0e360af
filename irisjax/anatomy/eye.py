"""The shapes of the eye in front of its iris: cornea, chamber, iris plane or cone, pupil, sclera.

Eye frame (mm): origin at the corneal apex, +z into the eye, x right and y up as the viewer sees
them.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from irisjax._types import Scalar, as_float, as_float_or_none
from irisjax.anatomy.media import AQUEOUS, CORNEA, INDEX, Media
from irisjax.numerics.checks import Range, check_fields
from irisjax.numerics.roots import safe_sqrt
from irisjax.optics.conicoid import Conicoid, Vector, parts

LIMITS = {
    "index": INDEX,
    "aqueous_index": INDEX,
    "iris_depth": Range(2.5, 8, "mm"),
    "iris_slope": Range(-0.5, 0.5),
    "limbus_radius": Range(4, 7, "mm"),
    "limbus_width": Range(0.005, 3, "mm"),
    "iris_radius": Range(4, 7, "mm"),
    "pupil_radius": Range(0.25, 4.75, "mm"),
    "pupil_margin": Range(0.005, 1.2, "mm"),
    "radius": Range(8, 16, "mm"),
    "veins": Range(0, 10),
    "hemoglobin": Range(0, 10, "mmol/l"),
    "saturation": Range(0, 1),
    "attenuation": Range(0, 1, "1/mm"),
}
"""Allowed range of each number of an eye and its parts."""


def _number(default: float) -> Any:
    return eqx.field(default=default, converter=as_float)


def _optional(default: float | None = None) -> Any:
    return eqx.field(default=default, converter=as_float_or_none)


class Cornea(eqx.Module):
    """Two refracting surfaces, or one.

    - `anterior`, `posterior`: conicoids; without `posterior` everything behind the anterior one is
        aqueous humour, as in F09, which gives it the index 1.376 (`Cornea.f09()`).
    - `index`: of the corneal tissue. `scatter` (nm⁴): c of log₁₀ T = −0.016 − c λ⁻⁴ [F09 Eq. 16],
        21e8 counting light scattered forwards, 85e8 the direct beam; `None` is a perfectly clear
        cornea. Fresnel's shares come on top, as in F09: should the measured T hold the front's
        reflection too, 2.5 % is lost twice each way. What the haze takes is lost and comes back as
        no veil.
    """

    anterior: Conicoid = eqx.field(default_factory=lambda: Conicoid(7.8, 0.75))
    posterior: Conicoid | None = eqx.field(default_factory=lambda: Conicoid(6.5, 0.75, 0.52))
    index: Scalar = _number(CORNEA)
    scatter: Scalar | None = _optional(21e8)

    @classmethod
    def f09(cls) -> "Cornea":
        """The single surface of F09, R = 7.8 mm and p = 0.75; set `aqueous_index=1.376` of `Eye`
        with it.
        """
        return cls(posterior=None, index=jnp.asarray(1.376))

    def transmittance(
        self, wavelengths: Float[Array, " wavelengths"]
    ) -> Float[Array, " wavelengths"] | None:
        """Of one passage, without the mirror losses; `None` for a clear cornea  [F09 Eq. 16]. Above
        310 nm.
        """
        return None if self.scatter is None else 10.0 ** (-0.016 - self.scatter * wavelengths**-4.0)


class Sclera(eqx.Module):
    """The white of the eye, a sphere through the limbus.

    - `radius`, mm; `veins`: density of the drawn vessels, 0 none; `hemoglobin` (mmol/l) and
        `saturation` of the blood in them.
    """

    radius: Scalar = _number(11.5)
    veins: Scalar = _number(1.0)
    hemoglobin: Scalar = _number(2.3)
    saturation: Scalar = _number(0.9)

    def __check_init__(self):
        check_fields(self, LIMITS)


class Eye(eqx.Module):
    """Everything that light meets before and around the iris.

    - `cornea`: `None` for the iris alone, light and camera with it in the aqueous humour.
        `aqueous_index`: of the chamber.
    - `iris_depth`: of the iris plane behind the apex, at the axis, mm; `iris_slope`: its fall
        towards the root (`None`: a plane, as F09; positive: a cone that bulges forward at the
        pupil).
    - `iris_radius`, `pupil_radius`, `limbus_radius` (where cornea meets sclera), mm.
    - `pupil_margin`: width over which the iris's radiance rises from none at the pupil's edge, mm;
        0.005 is sharp in any picture. `limbus_width`: over which iris and sclera blend about the
        limbus, mm  [F09 Section 6.5: about 1 mm].
    - `attenuation`: of the aqueous humour, 1/mm, or `None`: water absorbs 1e-4 over the chamber in
        the visible.
    - `sclera`: `None` for a close-up.

    **Raises:** `ValueError` naming field, value and allowed range.
    """

    cornea: Cornea | None = eqx.field(default_factory=Cornea)
    sclera: Sclera | None = eqx.field(default_factory=Sclera)
    aqueous_index: Scalar = _number(AQUEOUS)
    iris_depth: Scalar = _number(3.6)
    iris_slope: Scalar | None = _optional()
    limbus_radius: Scalar = _number(5.5)
    limbus_width: Scalar = _number(1.0)
    iris_radius: Scalar = _number(5.5)
    pupil_radius: Scalar = _number(1.9)
    pupil_margin: Scalar = _number(0.12)
    attenuation: Scalar | None = _optional()

    def __check_init__(self):
        check_fields(self, LIMITS)
        known = not any(isinstance(r, Tracer) for r in (self.pupil_radius, self.iris_radius))
        if known and float(self.pupil_radius) >= float(self.iris_radius):
            raise ValueError(
                f"pupil_radius = {float(self.pupil_radius):g} mm must be below "
                f"iris_radius = {float(self.iris_radius):g} mm"
            )
        decide = (
            self.cornea,
            self.iris_depth,
            self.iris_slope,
            self.iris_radius,
            self.limbus_radius,
        )
        if self.cornea is not None and not any(
            isinstance(x, Tracer) for x in jax.tree.leaves(decide)
        ):
            slope = 0.0 if self.iris_slope is None else self.iris_slope
            least = float(_least_depth(self.cornea, self.iris_radius, self.limbus_radius, slope))
            if not float(self.iris_depth) > least:
                raise ValueError(
                    f"iris_depth = {float(self.iris_depth):g} mm puts the iris into the cornea or "
                    f"in front of the "
                    f"limbus; for this eye it must be at least "
                    f"{np.ceil(least * 1000 + 0.5) / 1000:g} mm"
                )

    @property
    def media(self) -> Media:
        """The indices before its iris, for instruments that look at it in vivo."""
        cornea = CORNEA if self.cornea is None else self.cornea.index
        return Media(aqueous=self.aqueous_index, cornea=cornea)

    def replace(self, **fields: Any) -> "Eye":
        """A copy with some fields changed."""
        return dataclasses.replace(self, **fields)

    def relative_radius(self, distance):
        """Of distances from the axis (mm) across the iris: 0 at the pupil's edge, 1 at the root."""
        return (distance - self.pupil_radius) / (self.iris_radius - self.pupil_radius)

    def from_axis(self, relative_radius):
        """Distances from the axis, mm: the inverse of `relative_radius`."""
        return self.pupil_radius + (self.iris_radius - self.pupil_radius) * relative_radius

    def meet_iris(self, origin: Vector, direction: Vector):
        """Distance along rays to the plane or cone of the iris, mm."""
        t = (self.iris_depth - origin[..., 2]) / direction[..., 2]
        if self.iris_slope is None:
            return t
        for _ in range(6):  # Newton from the plane: slopes up to 1/2 converge to rounding
            x, y = origin[..., 0] + t * direction[..., 0], origin[..., 1] + t * direction[..., 1]
            r = safe_sqrt(x * x + y * y)
            rise = (
                self.iris_slope
                * (x * direction[..., 0] + y * direction[..., 1])
                / jnp.where(r > 0, r, 1.0)
            )
            miss = origin[..., 2] + t * direction[..., 2] - self.iris_depth - self.iris_slope * r
            t = t - miss / (direction[..., 2] - rise)
        return t

    def iris_normal(self, point: Vector) -> Vector:
        """Unit normal of the iris towards the cornea."""
        x, y, _ = parts(point)
        if self.iris_slope is None:
            return jnp.stack([jnp.zeros_like(x), jnp.zeros_like(x), -jnp.ones_like(x)], axis=-1)
        length = jnp.sqrt(1 + self.iris_slope**2)
        r = safe_sqrt(x * x + y * y)
        rise = self.iris_slope / (jnp.where(r > 0, r, 1.0) * length)
        return jnp.stack([rise * x, rise * y, -jnp.ones_like(x) / length], axis=-1)


@eqx.filter_jit
def _least_depth(cornea: Cornea, iris_radius, limbus_radius, slope) -> Scalar:
    """Depth (mm) that the iris must exceed to lie behind the whole cornea: surfaces bulge forward,
    so that its root meets them first, or, where it rises to the root, its middle."""
    back = cornea.anterior if cornea.posterior is None else cornea.posterior
    r = jnp.minimum(iris_radius, limbus_radius)  # beyond the limbus there is no cornea
    root = back.apex + back.sagitta(r) - slope * r
    limbus = cornea.anterior.apex + cornea.anterior.sagitta(limbus_radius)
    return jnp.maximum(jnp.maximum(root, limbus), back.apex)
