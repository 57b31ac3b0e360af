"""Virtual spectrophotometer: directional–hemispherical and diffuse–hemispherical reflectance."""

from typing import Any

from irisjax._types import PRNGKey
from irisjax.anatomy.media import Media
from irisjax.measure.instrument import AbstractInstrument, Cornea
from irisjax.measure.measurement import Reading
from irisjax.measure.observe import observe
from irisjax.tissue.iris import Iris
from irisjax.transport.solution import Solution, dimmed
from irisjax.transport.solver import AbstractSolver


class Spectrophotometer(AbstractInstrument):
    """An instrument that reads the share of the incident light that the iris sends back."""

    def __init__(self, wavelengths, **settings: Any):
        super().__init__(wavelengths, **settings)

    def reading(self, light: Solution, factor) -> Reading:
        """See `AbstractInstrument`."""
        values, error = self.counted(light)
        scale = factor * self.gain
        return Reading(
            wavelengths=self.wavelengths,
            values=scale * values,
            standard_error=None if error is None else scale * error,
            status=light.status,
            absorbed=dimmed(light.absorbed, factor),
            mirrored=factor * light.mirrored,
            quantity="reflectance",
            unit="",
        )


def reflectance(
    iris: Iris,
    wavelengths,
    *,
    solver: AbstractSolver | None = None,
    cos_incidence=1.0,
    first_surface: bool = True,
    cornea: Cornea = "none",
    media: Media | None = None,
    key: PRNGKey | None = None,
    throw: bool = True,
) -> Reading:
    """Compute the spectral reflectance of an iris, the share of incident light it sends back.

    Args:
        iris: The iris.
        wavelengths: In nm, increasing, within the pigment tables; see `wavelengths`.
        solver: See `observe`.
        cos_incidence: See `AbstractInstrument`.
        first_surface: See `AbstractInstrument`.
        cornea: See `AbstractInstrument`.
        media: See `AbstractInstrument`.
        key: See `observe`.
        throw: See `observe`.

    Raises:
        ValueError: As `observe` does.
    """
    instrument = Spectrophotometer(
        wavelengths,
        cos_incidence=cos_incidence,
        first_surface=first_surface,
        cornea=cornea,
        media=media,
    )
    return observe(iris, instrument, solver, key=key, throw=throw)
