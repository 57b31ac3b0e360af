"""Virtual colorimeter: the colour of the iris."""

from typing import Any

import jax.numpy as jnp

from irisjax._types import PRNGKey
from irisjax.anatomy.media import Media
from irisjax.measure.colour import OBSERVER, Colour, Observer
from irisjax.measure.instrument import AbstractInstrument, Cornea
from irisjax.measure.measurement import wavelengths as grid
from irisjax.measure.observe import observe
from irisjax.tissue.iris import Iris
from irisjax.transport.solution import Solution
from irisjax.transport.solver import AbstractSolver


class Colorimeter(AbstractInstrument):
    """An instrument that reads the colour of the iris's reflectance under an illuminant.

    Its wavelengths are 380–780 nm in steps of 5 nm by default.

    Attributes:
        observer: The illuminant and the standard observer on the wavelengths.
    """

    observer: Observer

    def __init__(
        self,
        wavelengths=None,
        *,
        illuminant: str = "D65",
        observer: str = OBSERVER,
        **settings: Any,
    ):
        wavelengths = grid(380, 780, 5) if wavelengths is None else wavelengths
        super().__init__(wavelengths, **settings)
        self.observer = Observer.of(wavelengths, illuminant, observer)

    def reading(self, light: Solution, factor) -> Colour:
        """See `AbstractInstrument`."""
        values, _ = self.counted(light)
        return self.observer.colour(jnp.asarray(factor * self.gain * values), light.status)


def colour(
    iris: Iris,
    wavelengths=None,
    *,
    illuminant: str = "D65",
    observer: str = OBSERVER,
    solver: AbstractSolver | None = None,
    cos_incidence=1.0,
    first_surface: bool = True,
    cornea: Cornea = "none",
    media: Media | None = None,
    key: PRNGKey | None = None,
    throw: bool = True,
) -> Colour:
    """Compute the colour of the iris's reflectance under an illuminant.

    Light reflected by the first surface is included by default; it adds a little grey to a dark
    iris.

    Args:
        iris: The iris.
        wavelengths: In nm, by default 380–780 nm in steps of 5 nm.
        illuminant: Name of the light source in colour-science.
        observer: Name of the standard observer in colour-science.
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
    instrument = Colorimeter(
        wavelengths,
        illuminant=illuminant,
        observer=observer,
        cos_incidence=cos_incidence,
        first_surface=first_surface,
        cornea=cornea,
        media=media,
    )
    return observe(iris, instrument, solver, key=key, throw=throw)
