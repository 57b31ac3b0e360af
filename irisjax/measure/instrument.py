"""The base class of instruments: incident light, the media that it crosses, readings."""

import abc
from functools import lru_cache
from typing import Any, ClassVar, Literal, TypedDict, TypeVar, get_args

import equinox as eqx
import jax
import jax.numpy as jnp

from irisjax._types import Numbers, Scalar, Spectrum
from irisjax.anatomy.media import Media
from irisjax.measure.measurement import Reading, check_cosine, check_wavelengths
from irisjax.measure.passbands import Passbands, bands_of
from irisjax.numerics.checks import Range, check_known, check_number, check_range, check_scalars
from irisjax.tissue.pigments import Extinction, extinction
from irisjax.transport.light import Directions, Light
from irisjax.transport.solution import Solution

Crossing = Literal["none", "inward", "round-trip"]

R = TypeVar("R", bound=Reading)

GAIN = Range(0, 1e6, meaning="factor of the instrument on every value", above=True)
"""Allowed gains."""

NUMERICAL_APERTURE = Range(0, 1, meaning="numerical aperture in air of what collects the light")
"""Allowed apertures."""


class InstrumentSettings(TypedDict, total=False):
    """Settings that every instrument has, see `AbstractInstrument`."""

    cos_incidence: Numbers
    first_surface: bool
    cornea: Crossing
    media: Media | None
    gain: Numbers
    bands: Passbands | float | None
    aperture: Numbers | None


class AbstractInstrument(eqx.Module):
    """An instrument, an immutable value; a new one is a subclass with its own `reading`.

    Attributes:
        pigments: Extinction of the pigments at the wavelengths, which are given in nm.
        cos_incidence: Cosine of the light's angle to the iris's normal, in the aqueous humour (in
            air if the light crosses the cornea); `None` for diffuse light, given as `"diffuse"`.
        media: Refractive indices in front of the iris (those of an eye are `Eye.media`).
        gain: Factor of the instrument on every value.
        bands: `Passbands` of a slit or of filters; each value is the mean over a band. A number
            is the full width at half maximum of a Gaussian slit, nm; `None` means light of one
            wavelength each.
        cornea: Whether light crosses tear film and cornea on its way in (`"inward"`), both ways
            (`"round-trip"`, out along the normal, as to a camera in front of the eye, where its
            radiance is divided by the square of the aqueous humour's index), or not (`"none"`).
        first_surface: Whether light reflected by the iris's own surface is included.
        aperture: Numerical aperture, in air, of what collects the light about the normal: a fibre
            or a lens; 0 for light along the normal (45°/0°). `None` for all that is sent back, as a
            sphere collects it.

    Raises:
        ValueError: For a setting out of range, with its value and what is allowed.
    """

    polarised: ClassVar[bool] = False
    """Whether the instrument needs a polarised process."""
    has_bands: ClassVar[bool] = False
    """Whether its values can be means over bands."""
    has_aperture: ClassVar[bool] = False
    """Whether it can collect light from a cone."""

    pigments: Extinction
    cos_incidence: Scalar | None
    media: Media
    gain: Scalar
    bands: Passbands | None
    aperture: Scalar | None
    cornea: Crossing = eqx.field(static=True)
    first_surface: bool = eqx.field(static=True)

    def __init__(
        self,
        wavelengths: Numbers,
        *,
        cos_incidence: Numbers = 1.0,
        first_surface: bool = True,
        cornea: Crossing = "none",
        media: Media | None = None,
        gain: Numbers = 1.0,
        bands: Passbands | float | None = None,
        aperture: Numbers | None = None,
    ):
        check_wavelengths(wavelengths)
        if aperture is not None:
            if not self.has_aperture:
                raise ValueError(f"a {type(self).__name__} has no aperture, got {aperture!r}")
            if isinstance(cos_incidence, str):
                law = "by reciprocity it reads what light along the normal gives in all directions"
                raise ValueError(f"diffuse light and an aperture: {law}; give neither")
            check_range("aperture", aperture, NUMERICAL_APERTURE)
        if bands is not None and not self.has_bands:
            raise ValueError(f"a {type(self).__name__} has no bands, got bands = {bands!r}")
        self.bands = bands_of(wavelengths, bands)
        wavelengths = wavelengths if self.bands is None else self.bands.wavelengths
        check_cosine("cos_incidence", cos_incidence)
        check_known("cornea", cornea, get_args(Crossing))
        diffuse = isinstance(cos_incidence, str)
        if diffuse and cornea != "none":
            law = "through the cornea light comes from one direction"
            raise ValueError(f'cos_incidence = "diffuse" needs cornea="none": {law}')
        self.pigments = extinction(wavelengths)
        check_number("gain", gain, GAIN)
        dtype = self.pigments.wavelengths.dtype
        self.cos_incidence = None if diffuse else _number(cos_incidence, dtype)
        self.media = Media.default() if media is None else media
        check_scalars(self.media, ("aqueous", "cornea", "tear"))
        self.gain = _number(gain, dtype)
        self.aperture = None if aperture is None else _number(aperture, dtype)
        self.cornea, self.first_surface = cornea, first_surface

    @property
    def wavelengths(self) -> Spectrum:
        """Wavelengths at which the model is evaluated, nm."""
        return self.pigments.wavelengths

    @property
    def centres(self) -> Spectrum:
        """Wavelengths of the reading, nm: those of the model, or the bands' mean wavelengths."""
        return self.wavelengths if self.bands is None else self.bands.centres

    def incident(self) -> tuple[Scalar, Light]:
        """Compute the factor on light on its way to the iris and back, and the light there."""
        factor, cosine = jnp.ones_like(self.gain), self.cos_incidence
        if cosine is not None and self.cornea != "none":
            factor, cosine = self.media.inward(cosine)
            factor = factor * self.outward
        return factor, Light(cosine, self.exits, self.rays, self.polarised)

    @property
    def outward(self) -> Scalar | float:
        """Factor on radiance on its way back to an instrument in air (1 unless `"round-trip"`)."""
        if self.cornea != "round-trip":
            return 1.0
        # Radiance over n² is invariant under refraction.
        return self.media.inward(jnp.ones_like(self.gain))[0] / self.media.aqueous**2

    def counted(self, solution: Solution) -> tuple[Spectrum, Spectrum | None]:
        """Return the share of the light that comes back, one value a wavelength, and its error."""
        if self.first_surface:
            return solution.reflectance + solution.mirrored, solution.total_error
        return solution.reflectance, solution.standard_error

    @property
    def rays(self) -> Spectrum | None:
        """Relative number of rays a wavelength for solvers that sample; `None` for equally many."""
        return None

    @property
    def exits(self) -> Directions | None:
        """Exit directions of a BRDF, or `None`."""
        return None

    def spectrum(
        self, solution: Solution, factor: Scalar, scale: Numbers, quantity: str, *, unit: str = ""
    ) -> Reading:
        """Return what counts of a solution, times `scale`, as a `Reading`."""
        values, error = self.counted(solution)
        error = None if error is None else scale * error
        return self.result(solution, factor, scale * values, error, quantity=quantity, unit=unit)

    def result(
        self,
        solution: Solution,
        factor: Scalar,
        values: Spectrum,
        error: Spectrum | None,
        kind: type[R] = Reading,
        **more: Any,
    ) -> R:
        """Return values as a `Reading`, with the solution's status and shares of the light."""
        shares = solution.absorbed, solution.mirrored, solution.transmitted
        shares = jax.tree.map(lambda x: factor / self.outward * x, shares)
        if self.bands is not None:
            values, shares = jax.tree.map(self.bands.mean, (values, shares))
            error = None if error is None else self.bands.error(error)
        return kind(self.centres, values, error, solution.status, *shares, **more)

    @abc.abstractmethod
    def reading(self, solution: Solution, factor: Scalar) -> Any:
        """Compute the reading from a solution; `factor` dims the light on its way."""


def _number(value, dtype) -> jax.Array:
    """A setting as a strongly typed array, so that 1, 1.0 and an array share one program."""
    if isinstance(value, (int, float)):
        return _constant(float(value), dtype)
    return jnp.asarray(value, dtype)


@lru_cache(maxsize=64)
def _constant(value: float, dtype) -> jax.Array:
    with jax.ensure_compile_time_eval():
        return jnp.asarray(value, dtype)
