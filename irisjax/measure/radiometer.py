"""Virtual radiometer: what an eye sends back of an illuminant, as measured in vivo."""

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
    """Reads the reflected spectral radiance under an illuminant  [LB06 Section 4].

    The illuminant's relative spectral power E (1 at 560 nm) falls on the eye; light is dimmed on
    its way through tear film and cornea (by default inward only; light mirrored by the tear film is
    dropped), and what comes back is shared over the hemisphere, L = R·E/π. A perfect white diffuser
    in the eye's place reads E/π.

    - `illuminant`: a name known to colour-science; `power` its E at the wavelengths.
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
        """As in LB06: the number of rays at each wavelength follows the illuminant."""
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
    """Reflected spectral radiance of an iris under an illuminant; see `Radiometer`.

    `cos_incidence` is measured in air, where the light crosses the cornea. For the other arguments
    see `reflectance`.
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
