"""Virtual radiometer: the radiance of an eye under an illuminant, as measured in vivo."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from irisjax._types import PRNGKey, Spectrum
from irisjax.anatomy.media import Media
from irisjax.measure.colour import illuminant_power
from irisjax.measure.instrument import AbstractInstrument, Cornea
from irisjax.measure.measurement import Reading
from irisjax.measure.observe import observe
from irisjax.tissue.iris import Iris
from irisjax.transport.solution import RESULTS, Solution, dimmed
from irisjax.transport.solver import AbstractSolver


class Radiometer(AbstractInstrument):
    """An instrument that reads the spectral radiance under an illuminant  [LB06 Section 4].

    The illuminant's relative spectral power E (1 at 560 nm) falls on the eye. Light is dimmed on
    its way through tear film and cornea (by default inward only; light reflected by the tear film
    is not included) and returns evenly over the hemisphere, L = R·E/π. The reading of a perfect
    white diffuser in place of the eye is E/π.

    Attributes:
        power: E at the wavelengths.
        illuminant: Name of the light source in colour-science.
    """

    power: Spectrum
    illuminant: str = eqx.field(static=True)

    def __init__(
        self,
        wavelengths,
        *,
        illuminant: str = "D65",
        cornea: Cornea = "inward",
        **settings: Any,
    ):
        super().__init__(wavelengths, cornea=cornea, **settings)
        power = illuminant_power(illuminant, wavelengths)
        self.power = jnp.asarray(power, self.wavelengths.dtype)
        self.illuminant = illuminant

    @property
    def rays(self) -> Spectrum:
        """Relative number of rays at each wavelength: the illuminant's power, as in LB06."""
        return self.power

    def reading(self, light: Solution, factor) -> Reading:
        """See `AbstractInstrument`."""
        values, error = self.counted(light)
        scale = factor * self.gain * self.power / jnp.pi
        return Reading(
            wavelengths=self.wavelengths,
            values=scale * values,
            standard_error=None if error is None else scale * error,
            status=RESULTS.where(
                jnp.isfinite(self.power).all(), light.status, RESULTS.invalid_input
            ),
            absorbed=dimmed(light.absorbed, factor),
            mirrored=factor * light.mirrored,
            quantity="radiance",
            unit="relative/sr",
        )


def radiance(
    iris: Iris,
    wavelengths,
    *,
    illuminant: str = "D65",
    solver: AbstractSolver | None = None,
    cos_incidence=1.0,
    first_surface: bool = True,
    cornea: Cornea = "inward",
    media: Media | None = None,
    key: PRNGKey | None = None,
    throw: bool = True,
) -> Reading:
    """Compute the spectral radiance of an iris under an illuminant; see `Radiometer`.

    Args:
        iris: The iris.
        wavelengths: In nm, increasing, within the pigment tables.
        illuminant: Name of the light source in colour-science.
        solver: See `observe`.
        cos_incidence: Cosine of the angle of incidence, in air if the light crosses the cornea.
        first_surface: See `AbstractInstrument`.
        cornea: See `AbstractInstrument`.
        media: See `AbstractInstrument`.
        key: See `observe`.
        throw: See `observe`.

    Raises:
        ValueError: As `observe` does.
    """
    instrument = Radiometer(
        wavelengths,
        illuminant=illuminant,
        cos_incidence=cos_incidence,
        first_surface=first_surface,
        cornea=cornea,
        media=media,
    )
    return observe(iris, instrument, solver, key=key, throw=throw)
