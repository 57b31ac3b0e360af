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
    """Reads the share of the light falling on the iris that it sends back, at each wavelength."""

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
    """Spectral reflectance of an iris: the share of the light falling on it that it sends back.

    **Arguments:**

    - `wavelengths`: nm, increasing, shape (n,), within the pigment tables; see `wavelengths`.
    - `cos_incidence`, `first_surface`, `cornea`, `media`: see `Spectrophotometer`.
    - `iris`, `solver`, `key`, `throw`: see `observe`.

    **Returns:** a `Reading`. **Raises:** as `observe`.
    """
    instrument = Spectrophotometer(
        wavelengths,
        cos_incidence=cos_incidence,
        first_surface=first_surface,
        cornea=cornea,
        media=media,
    )
    return observe(iris, instrument, solver, key=key, throw=throw)
