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
    """Reads the colour of the iris's reflectance, for an `observer` under an illuminant.

    `wavelengths` default to 380–780 nm in steps of 5 nm.
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
    """Colour of the iris's reflectance under an illuminant; see `Colorimeter` and `reflectance`.

    Light mirrored by the first surface counts by default; against a dark iris it adds a little
    grey.
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
