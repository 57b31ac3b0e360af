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
from jax import Array
from jaxtyping import Float

from irisjax._types import Numbers, Scalar, Spectrum, float_field, optional_field
from irisjax.anatomy.lids import Lids
from irisjax.anatomy.media import AQUEOUS, CORNEA, INDEX, Media
from irisjax.numerics.checks import Range, check_fields, check_range, check_shape, is_known
from irisjax.numerics.roots import safe_sqrt
from irisjax.optics.conicoid import Conicoid, Vector, parts

EYE_LIMITS = {
    "index": INDEX,
    "scatter": Range(0, 1e12, "nm⁴"),
    "aqueous_index": INDEX,
    "iris_depth": Range(2.5, 8, "mm"),
    "iris_slope": Range(-0.5, 0.5),
    "limbus_radius": Range(4, 7, "mm"),
    "limbus_width": Range(0.005, 3, "mm"),
    "darkening": Range(0, 1),
    "width": Range(0, 2, "mm"),
    "fade": Range(0.005, 2, "mm"),
    "unevenness": Range(0, 1),
    "iris_radius": Range(4, 7, "mm"),
    "pupil_radius": Range(0.25, 4.75, "mm"),
    "pupil_margin": Range(0.005, 1.2, "mm"),
    "pupil_centre": Range(-1, 1, "mm"),
    "pupil_harmonics": Range(-0.05, 0.05),
    "radius": Range(8, 16, "mm"),
    "veins": Range(0, 10),
    "yellowing": Range(0, 10),
    "tint": Range(0, 10),
    "gloss": Range(0, 1),
    "hemoglobin": Range(0, 10, "mmol/l"),
    "saturation": Range(0, 1),
    "attenuation": Range(0, 1, "1/mm"),
}
"""Allowed range of each number of an eye and its parts."""
_CORNEAL_RADIUS = Range(3, 100, "mm")


class Cornea(eqx.Module):
    """A cornea of two refracting surfaces, or one.

    The light that its haze takes is lost; it does not return as a veil.

    Attributes:
        anterior: Conicoid of the front.
        posterior: Conicoid of the back; `None` if everything behind the front is aqueous humour.
        index: Refractive index of the corneal tissue.
        scatter: c of log₁₀ T = −0.016 − c λ⁻⁴ [F09 Eq. 16], nm⁴: 21e8 including light scattered
            forwards, 85e8 for the direct beam; `None` for a perfectly clear cornea. Fresnel's
            losses are added, as in F09: if the measured T includes the reflection of the front,
            2.5 % is lost twice each way.

    Raises:
        ValueError: For an index, a haze or a radius out of range.
    """

    anterior: Conicoid = eqx.field(default_factory=lambda: Conicoid(7.8, 0.75))
    posterior: Conicoid | None = eqx.field(default_factory=lambda: Conicoid(6.5, 0.75, 0.52))
    index: Scalar = float_field(CORNEA)
    scatter: Scalar | None = optional_field(21e8)

    @classmethod
    def f09(cls) -> "Cornea":
        """Make F09's single surface, R = 7.8 mm, p = 0.75; for `Eye` with `aqueous_index=1.376`."""
        return cls(posterior=None, index=jnp.asarray(1.376))

    def __check_init__(self) -> None:
        check_fields(self, EYE_LIMITS)
        for name in ("anterior", "posterior"):
            if (surface := getattr(self, name)) is not None:
                check_range(f"{name} radius", surface.radius, _CORNEAL_RADIUS)

    def transmittance(self, wavelengths: Spectrum) -> Spectrum | None:
        """Compute the transmittance of one passage above 310 nm, less reflection  [F09 Eq. 16].

        It is `None` for a clear cornea.
        """
        return None if self.scatter is None else 10.0 ** (-0.016 - self.scatter * wavelengths**-4.0)


class Sclera(eqx.Module):
    """The white of the eye, a sphere through the limbus.

    Attributes:
        radius: Radius of the sphere, mm.
        veins: Density of the drawn vessels; 0 for none.
        hemoglobin: Haemoglobin in the vessels, mmol/l.
        saturation: Oxygen saturation in the vessels.
        yellowing: Yellow pigment of the white, of that of other bloodless tissues; 0 is a child's,
            bluish white.
        tint: Factors on its reflectance in red, green and blue (at 610, 550 and 450 nm, linear
            between them and constant beyond), such as a photograph shows; `None` for 1.
        gloss: Share of the images in its tear film that it shows: 0 where lids would hide them or
            the conjunctiva is rough.
    """

    radius: Scalar = float_field(11.5)
    veins: Scalar = float_field(1.0)
    hemoglobin: Scalar = float_field(2.3)
    saturation: Scalar = float_field(0.9)
    yellowing: Scalar = float_field(1.0)
    tint: Float[Array, "3"] | None = optional_field(None)
    gloss: Scalar = float_field(1.0)

    def __check_init__(self) -> None:
        check_fields(self, EYE_LIMITS)
        check_shape("tint", self.tint, (3,))


class LimbalRing(eqx.Module):
    """The dark ring of the iris along the limbus, as photographs show it.

    Its defaults are set by eye. It is a factor on the light from the iris, not a layer of tissue.

    Attributes:
        darkening: Share of the light that the ring takes.
        width: Width over which it is darkest, inside the blend of iris and white, mm.
        fade: Width over which it fades towards the pupil, mm.
        unevenness: Share of both widths by which they differ round the eye at most, in waves that
            are the same for all eyes.
    """

    darkening: Scalar = float_field(0.2)
    width: Scalar = float_field(0.1)
    fade: Scalar = float_field(0.6)
    unevenness: Scalar = float_field(0.8)

    def __check_init__(self) -> None:
        check_fields(self, EYE_LIMITS)


class Eye(eqx.Module):
    """The eye in front of and around the iris.

    Attributes:
        cornea: The cornea; `None` for the iris alone, with light and camera in the aqueous humour.
        sclera: The white; `None` for a close-up without it.
        aqueous_index: Refractive index of the aqueous humour, which fills the chamber.
        iris_depth: Depth of the iris behind the apex, at the axis, mm.
        iris_slope: Slope of a conical iris towards the root, positive if it bulges forward at the
            pupil; `None` for a plane, as in F09.
        limbus_radius: Radius of the limbus, where cornea and sclera meet, mm.
        limbus_width: Width over which iris and sclera blend, mm  [F09 Section 6.5: about 1 mm].
        limbal_ring: The dark ring inside that blend; `None` for none.
        iris_radius: Radius of the root of the iris, mm.
        pupil_radius: Radius of the pupil, mm.
        pupil_margin: Width over which the iris fades into the pupil, mm; 0.005 is sharp in any
            picture.
        pupil_centre: Middle of the pupil (x, y), mm from the axis; `None` on it. Circles on the
            iris that are concentric with its pupil or its root lie between the two.
        pupil_harmonics: Cosine and sine of the second, third, … harmonic of the pupil's radius over
            its angle, relative to `pupil_radius`; `None` for a round one.
        attenuation: Attenuation of the aqueous humour, 1/mm, or `None`: water absorbs 1e-4 over the
            chamber in the visible.
        lids: Lids, lashes and skin round it; `None` for none.

    Raises:
        ValueError: For a value out of range, with its field, value and range, and for an iris that
            lies in the cornea.
    """

    cornea: Cornea | None = eqx.field(default_factory=Cornea)
    sclera: Sclera | None = eqx.field(default_factory=Sclera)
    aqueous_index: Scalar = float_field(AQUEOUS)
    iris_depth: Scalar = float_field(3.6)
    iris_slope: Scalar | None = optional_field()
    limbus_radius: Scalar = float_field(5.5)
    limbus_width: Scalar = float_field(1.0)
    limbal_ring: LimbalRing | None = None
    iris_radius: Scalar = float_field(5.5)
    pupil_radius: Scalar = float_field(1.9)
    pupil_margin: Scalar = float_field(0.12)
    pupil_centre: Float[Array, "2"] | None = optional_field()
    pupil_harmonics: Float[Array, "harmonics 2"] | None = optional_field()
    attenuation: Scalar | None = optional_field()
    lids: Lids | None = None

    def __check_init__(self) -> None:
        check_fields(self, EYE_LIMITS)
        check_shape("pupil_harmonics", self.pupil_harmonics, ("harmonics", 2))
        if self.lids is not None and (self.cornea is None or self.sclera is None):
            raise ValueError("lids need an eye with a cornea and a sclera")
        radii = self.pupil_radius, self.iris_radius
        if is_known(radii) and float(radii[0]) >= float(radii[1]):
            raise ValueError(
                f"pupil_radius = {float(radii[0]):g} mm must be below "
                f"iris_radius = {float(radii[1]):g} mm"
            )
        if self.pupil_centre is not None and is_known(self.pupil_centre, *radii):
            self._check_centre(np.asarray(self.pupil_centre))
        ring = self.iris_radius, self.limbus_radius, slope_of(self)
        if self.cornea is not None and is_known(self.cornea, ring, self.iris_depth):
            with jax.ensure_compile_time_eval():  # an eye may be made inside a program
                least_depth = float(_least_depth(self.cornea, *ring))
            if not float(self.iris_depth) > least_depth:
                raise ValueError(
                    f"iris_depth = {float(self.iris_depth):g} mm puts the iris into the cornea or "
                    "in front of the limbus; for this eye it must be at least "
                    f"{np.ceil(least_depth * 1000 + 0.5) / 1000:g} mm"
                )

    @property
    def media(self) -> Media:
        """Refractive indices in front of the iris, for instruments that measure it in vivo."""
        cornea: Any = CORNEA if self.cornea is None else self.cornea.index
        return Media(aqueous=self.aqueous_index, cornea=cornea)

    def replace(self, **fields: object) -> "Eye":
        """Return a copy with some fields changed."""
        return dataclasses.replace(self, **fields)

    def relative_radius(self, distance: Numbers) -> Array:
        """Map radii of rings (mm) to 0 at the pupil's edge and 1 at the root."""
        return (distance - self.pupil_radius) / (self.iris_radius - self.pupil_radius)

    def from_axis(self, relative_radius: Numbers) -> Array:
        """Map relative radii to radii of rings, mm: the inverse of `relative_radius`."""
        return self.pupil_radius + (self.iris_radius - self.pupil_radius) * relative_radius

    def ring_area(self, relative_radius: Numbers) -> Array:
        """Compute the area (mm²) of thin rings over what they span of the relative radius."""
        width = self.iris_radius - self.pupil_radius
        return 2 * jnp.pi * width * self.from_axis(relative_radius)

    def ring_of(self, x: Numbers, y: Numbers) -> tuple[Array, Array, Array]:
        """Compute the relative radius of the ring through points of the iris, and the points
        relative to the middle of the ring, mm: the pupil's for 0, the axis for 1.
        """
        x, y = jnp.asarray(x), jnp.asarray(y)
        edge, root = self.pupil_edge(x, y), self.iris_radius
        if self.pupil_centre is None:
            return (safe_sqrt(x * x + y * y) - edge) / (root - edge), x, y
        return rings_between((x, y), self.pupil_centre, edge, root)

    def pupil_edge(self, x: Numbers, y: Numbers) -> Array:
        """Compute the radius of the pupil, mm, in the direction of points of the iris from its
        middle.
        """
        if self.pupil_harmonics is None:
            return self.pupil_radius
        if self.pupil_centre is not None:
            x, y = x - self.pupil_centre[0], y - self.pupil_centre[1]
        r = safe_sqrt(x * x + y * y)
        r = jnp.where(r > 0, r, 1.0)
        u, v = cosine, sine = x / r, y / r
        deviation = jnp.zeros_like(r)
        for a, b in self.pupil_harmonics:
            cosine, sine = u * cosine - v * sine, v * cosine + u * sine
            deviation = deviation + a * cosine + b * sine
        return self.pupil_radius * (1 + deviation)

    def _check_centre(self, centre: np.ndarray) -> None:
        if centre.shape != (2,):
            raise ValueError(f"pupil_centre has shape {centre.shape}; need x and y")
        limit = float(self.iris_radius - self.pupil_radius)
        if not np.hypot(*centre) < limit:
            raise ValueError(
                f"pupil_centre = {np.hypot(*centre):.2f} mm from the axis puts the pupil beyond "
                f"the root of the iris; it must be below {limit:.2f} mm"
            )

    def meet_iris(self, origin: Vector, direction: Vector) -> Array:
        """Compute the distance along rays to the plane or cone of the iris, mm."""
        (x0, y0, z0), (dx, dy, dz) = parts(origin), parts(direction)
        t = (self.iris_depth - z0) / dz
        if self.iris_slope is None:
            return t
        for _ in range(6):  # Newton from the plane: slopes up to 1/2 converge to rounding
            x, y = x0 + t * dx, y0 + t * dy
            r = safe_sqrt(x * x + y * y)
            slope = self.iris_slope * (x * dx + y * dy) / jnp.where(r > 0, r, 1.0)
            height = z0 + t * dz - self.iris_depth - self.iris_slope * r
            t = t - height / (dz - slope)
        return t

    def iris_normal(self, point: Vector) -> Vector:
        """Compute the unit normal of the iris towards the cornea."""
        x, y, _ = parts(point)
        if self.iris_slope is None:
            return jnp.stack([jnp.zeros_like(x), jnp.zeros_like(x), -jnp.ones_like(x)], axis=-1)
        length = jnp.sqrt(1 + self.iris_slope**2)
        r = safe_sqrt(x * x + y * y)
        rise = self.iris_slope / (jnp.where(r > 0, r, 1.0) * length)
        return jnp.stack([rise * x, rise * y, -jnp.ones_like(x) / length], axis=-1)


def slope_of(eye: Eye) -> Any:
    """Return the slope of the iris, 0 of a flat one."""
    return 0.0 if eye.iris_slope is None else eye.iris_slope


def cornea_of(eye: Eye) -> Cornea:
    """Return the cornea of an eye; raise `ValueError` if it has none."""
    if eye.cornea is None:
        raise ValueError("this eye has no cornea (Eye.cornea is None)")
    return eye.cornea


def sclera_of(eye: Eye) -> Sclera:
    """Return the sclera of an eye; raise `ValueError` if it has none."""
    if eye.sclera is None:
        raise ValueError("this eye has no sclera (Eye.sclera is None)")
    return eye.sclera


@eqx.filter_jit
def rings_between(
    point: tuple[Numbers, Numbers], centre: Any, inner: Numbers, outer: Numbers
) -> tuple[Array, Array, Array]:
    """Compute `Eye.ring_of` for rings between a circle of radius `inner` about `centre` and one of
    radius `outer` about the axis, mm.
    """
    # |p - (1 - s) c| = inner + s (outer - inner), a quadratic in s.
    (cx, cy), width = centre, outer - inner
    u, v = jnp.asarray(point[0]) - cx, jnp.asarray(point[1]) - cy
    a = width**2 - cx**2 - cy**2
    b = inner * width - (u * cx + v * cy)
    c = inner**2 - u * u - v * v
    s = (safe_sqrt(jnp.maximum(b * b - a * c, 0.0)) - b) / a
    return s, u + s * cx, v + s * cy


@eqx.filter_jit
def _least_depth(cornea: Cornea, iris_radius, limbus_radius, slope) -> Scalar:
    """Compute the depth (mm) that the iris must exceed to lie behind the whole cornea.

    The root of the iris meets it first, or its middle if the iris rises towards the root.
    """
    posterior = cornea.anterior if cornea.posterior is None else cornea.posterior
    r = jnp.minimum(iris_radius, limbus_radius)  # beyond the limbus there is no cornea
    root = posterior.apex + posterior.sagitta(r) - slope * r
    limbus = cornea.anterior.apex + cornea.anterior.sagitta(limbus_radius)
    return jnp.maximum(jnp.maximum(root, limbus), posterior.apex)
