"""Measured spectra and colours, and the instruments that read them."""

import dataclasses
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from irisjax._types import as_float, as_float_or_none
from irisjax.anatomy.media import Media
from irisjax.measure.colour import OBSERVER
from irisjax.measure.instrument import AbstractInstrument, Crossing
from irisjax.measure.measurement import check_cosine, check_wavelengths
from irisjax.measure.photometers import Colorimeter, Radiometer, Spectrophotometer
from irisjax.tissue.pigments import check_covered

REFLECTANCE, RADIANCE = "reflectance", "radiance"
COLOUR_QUANTITIES = {"XYZ": "xyz", "Lab": "lab", "linear sRGB": "srgb_linear"}
"""Quantities of colours, and the fields of `Colour` that hold them."""


class Observation(eqx.Module):
    """Measured values and the instrument that read them. Make one with `spectrum` or `colour_data`.

    Attributes:
        sd: Standard deviations, or `None` where the noise model states them.
        covariance_root: For colours, R with R Rᵀ the covariance; `sd` is then `None`.
        quantity: `"reflectance"`, `"radiance"`, `"XYZ"`, `"Lab"` or `"linear sRGB"`.
        name: What messages and figures call it.
    """

    values: Float[Array, "*batch data"]
    sd: Float[Array, "*batch data"] | None
    instrument: AbstractInstrument
    covariance_root: Float[Array, "data data"] | None
    quantity: str = eqx.field(static=True)
    name: str = eqx.field(static=True)

    @property
    def wavelengths(self) -> Float[Array, " wavelengths"]:
        """Where the model is evaluated, nm."""
        return self.instrument.wavelengths

    @property
    def is_colour(self) -> bool:
        """Whether the data are tristimulus values."""
        return self.quantity in COLOUR_QUANTITIES

    def of(self, reading: Any) -> Float[Array, " data"]:
        """Return the part of an instrument's reading that is compared with the data."""
        return getattr(reading, COLOUR_QUANTITIES.get(self.quantity, "values"))


def spectrum(
    wavelengths: Any,
    values: Any = None,
    sd: Any = None,
    *,
    quantity: str = REFLECTANCE,
    illuminant: str = "D65",
    cos_incidence: float | str = 1.0,
    first_surface: bool = True,
    cornea: Crossing | None = None,
    media: Media | None = None,
    name: str = "spectrum",
) -> Observation:
    """State a measured reflectance factor, or a radiance under an illuminant (relative to the
    illuminant's at 560 nm, per sr).

    Args:
        wavelengths: In nm, in any order; or one object that has wavelengths and values, such as
            `read_measured` returns (its `sd` is used), or colour-science's `SpectralDistribution`
            and `MultiSpectralDistributions` (repeated scans).
        values: Fractions, one for each wavelength; or repeated scans (wavelengths, scans).
        sd: Standard deviations; by default the scatter of scans, or what the noise model states.
        quantity: `"reflectance"` or `"radiance"`.
        illuminant: Of a radiance, by its name in colour-science.
        cos_incidence: Cosine of the light's angle from the normal, or `"diffuse"`.
        first_surface: Whether the iris's own mirror reflection is in the data.
        cornea: As of instruments; by default a radiance is dimmed by it, a reflectance is not.
        media: Media before the iris.
        name: What messages and figures call it.

    Raises:
        ValueError: Naming the first wavelength at which something is wrong.
    """
    whole = hasattr(wavelengths, "wavelengths") and hasattr(wavelengths, "values")
    if whole == (values is not None):
        said = "give wavelengths and values, or one object that has both; sd by its name"
        raise ValueError(f"{name}: {said}")
    if whole:
        sd = getattr(wavelengths, "sd", None) if sd is None else sd
        wavelengths, values = wavelengths.wavelengths, wavelengths.values
    grid, y = np.asarray(wavelengths, np.float64), np.asarray(values, np.float64)
    if y.ndim == 2 and y.shape[1]:
        y, scatter = mean_of_scans(y)
        sd = scatter if sd is None else sd
    if grid.ndim != 1 or y.shape != grid.shape:
        said = f"{y.shape} values for {grid.shape} wavelengths; need one for each"
        raise ValueError(f"{name}: {said}")
    order = np.argsort(grid, kind="stable")
    grid, y = grid[order], y[order]
    check_wavelengths(grid)
    check_cosine("cos_incidence", cos_incidence)
    try:
        check_covered(grid)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    for wave in grid[~np.isfinite(y)][:1]:
        raise ValueError(f"{name}: the value at {wave:g} nm is not a finite number")
    if sd is not None:
        sd = np.broadcast_to(np.asarray(sd, np.float64), order.shape)[order]
        for i in np.flatnonzero(~(np.isfinite(sd) & (sd > 0)))[:1]:
            said = f"the standard deviation at {grid[i]:g} nm is {sd[i]:g}; it must be > 0"
            raise ValueError(f"{name}: {said}")
    if quantity not in (REFLECTANCE, RADIANCE):
        raise ValueError(f"quantity must be {REFLECTANCE!r} or {RADIANCE!r}, got {quantity!r}")
    settings: dict[str, Any] = {} if cornea is None else {"cornea": cornea}
    settings |= dict(cos_incidence=cos_incidence, first_surface=first_surface, media=media)
    if quantity == RADIANCE:
        instrument = Radiometer(grid, illuminant=illuminant, **settings)
    else:
        instrument = Spectrophotometer(grid, **settings)
    sd = as_float_or_none(sd)
    return Observation(as_float(y), sd, instrument, None, quantity, name)


def mean_of_scans(
    scans: Float[np.ndarray, "wavelengths scans"],
) -> tuple[Float[np.ndarray, " wavelengths"], Float[np.ndarray, " wavelengths"] | None]:
    """Return the mean of repeated scans, and its standard deviations by their scatter; `None` for a
    single scan and for equal ones, which say nothing about the noise.
    """
    count = scans.shape[1]
    if count < 2:
        return scans.mean(axis=1), None
    # Few scans scatter little at some wavelengths by chance, which would then count too much: mix
    # in the mean scatter of all wavelengths.
    scatter = scans.std(axis=1, ddof=1)
    sd = np.sqrt((scatter**2 + 3 * (scatter**2).mean()) / 4 / count)
    return scans.mean(axis=1), sd if (sd > 0).all() else None


def colour_data(
    values: Any,
    covariance: Any,
    *,
    quantity: str = "XYZ",
    illuminant: str = "D65",
    observer: str = OBSERVER,
    first_surface: bool = True,
    name: str = "colour",
) -> Observation:
    """State measured tristimulus values.

    Args:
        values: Three numbers.
        covariance: Their covariance, (3, 3), symmetric and positive definite.
        quantity: `"XYZ"` (white at Y = 1), `"Lab"` or `"linear sRGB"`.
        illuminant: By its name in colour-science.
        observer: The colour-matching functions, by their name in colour-science.
        first_surface: Whether the iris's own mirror reflection is in the data.
        name: What messages and figures call it.
    """
    if quantity not in COLOUR_QUANTITIES:
        known = ", ".join(COLOUR_QUANTITIES)
        raise ValueError(f"quantity must be one of {known}, got {quantity!r}")
    y, c = np.asarray(values, np.float64), np.asarray(covariance, np.float64)
    if y.shape != (3,) or not np.isfinite(y).all():
        raise ValueError(f"{name}: a colour is three finite numbers")
    if c.shape != (3, 3) or not np.allclose(c, c.T) or np.linalg.eigvalsh(c).min() <= 0:
        raise ValueError(f"{name}: the covariance must be 3 by 3, symmetric and positive definite")
    instrument = Colorimeter(illuminant=illuminant, observer=observer, first_surface=first_surface)
    root = as_float(np.linalg.cholesky(c))
    return Observation(as_float(y), None, instrument, root, quantity, name)


def with_values(
    observation: Observation,
    values: Float[ArrayLike, "*batch data"],
    sd: Float[ArrayLike, "*batch data"] | None = None,
) -> Observation:
    """Return the measurement with other values (and standard deviations), which may be traced."""
    return dataclasses.replace(observation, values=values, sd=observation.sd if sd is None else sd)
