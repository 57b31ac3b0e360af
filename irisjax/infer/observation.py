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
from irisjax.measure.passbands import BANDWIDTH, Passbands
from irisjax.measure.photometers import Colorimeter, Radiometer, Spectrophotometer
from irisjax.numerics.checks import check_range
from irisjax.tissue.pigments import check_covered

REFLECTANCE, RADIANCE = "reflectance", "radiance"
COLOUR_QUANTITIES = {"XYZ": "xyz", "Lab": "lab", "linear sRGB": "srgb_linear"}
"""Quantities of colours, and the fields of `Colour` that hold them."""

_JITTER = 1e-9  # of the variance, so that values that share nearly all still have a root


class Observation(eqx.Module):
    """Measured values and the instrument that read them. Make one with `spectrum` or `colour_data`.

    Attributes:
        sd: Standard deviations, or `None` where the noise model states them.
        correlation_root: Lower triangular L with L Lᵀ the correlation of the values' errors; `None`
            where they are independent.
        quantity: `"reflectance"`, `"radiance"`, `"XYZ"`, `"Lab"` or `"linear sRGB"`.
        name: What messages and figures call it.
    """

    values: Float[Array, "*batch data"]
    sd: Float[Array, "*batch data"] | None
    instrument: AbstractInstrument
    correlation_root: Float[Array, "data data"] | None
    quantity: str = eqx.field(static=True)
    name: str = eqx.field(static=True)

    @property
    def wavelengths(self) -> Float[Array, " wavelengths"]:
        """Wavelengths of the values, nm (of a colour, those of the model)."""
        return self.instrument.centres

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
    bands: Passbands | float | None = None,
    aperture: float | None = None,
    covariance: Any = None,
    boxcar: float | None = None,
    correlated: float | None = None,
    name: str = "spectrum",
) -> Observation:
    """State a measured reflectance factor, or a radiance under an illuminant (relative to the
    illuminant's at 560 nm, per sr).

    Args:
        wavelengths: In nm, in any order; or one object that has wavelengths and values, such as
            `read_measured` returns (with `sd`, `correlated` and `bandwidth`), or colour-science's
            `SpectralDistribution` and `MultiSpectralDistributions` (repeated scans).
        values: Fractions, one for each wavelength; or repeated scans (wavelengths, scans).
        sd: Standard deviations; by default the scatter of scans, or what the noise model states.
        quantity: `"reflectance"` or `"radiance"`.
        illuminant: Of a radiance, by its name in colour-science.
        cos_incidence: Cosine of the light's angle from the normal, or `"diffuse"`.
        first_surface: Whether the iris's own mirror reflection is in the data.
        cornea: As of instruments; by default a radiance is dimmed by it, a reflectance is not.
        media: Media before the iris.
        bands: What each value is the mean of: `Passbands`, or the full width at half maximum of a
            Gaussian slit, nm.
        aperture: Numerical aperture of a fibre, or of a lens (0: along the normal, as 45°/0°), that
            collects the light; `None` for all of it.
        covariance: Of the values' errors, (wavelengths, wavelengths), in place of `sd`.
        boxcar: Width, nm, of a moving average that made the values: each is the mean over that
            width, and their errors are correlated so far.
        correlated: The same of the errors alone, where the spectrum itself is not smoothed.
        name: What messages and figures call it.

    Raises:
        ValueError: Naming the first wavelength at which something is wrong.
    """
    is_object = hasattr(wavelengths, "wavelengths") and hasattr(wavelengths, "values")
    if is_object == (values is not None):
        message = "give wavelengths and values, or one object that has both; sd by its name"
        raise ValueError(f"{name}: {message}")
    if is_object:
        if covariance is None:
            sd = getattr(wavelengths, "sd", None) if sd is None else sd
            width = getattr(wavelengths, "correlated", None)
            correlated = width if correlated is None and boxcar is None else correlated
        if bands is None and boxcar is None:
            bands = getattr(wavelengths, "bandwidth", None)
        wavelengths, values = wavelengths.wavelengths, wavelengths.values
    if np.ma.is_masked(values) or np.ma.is_masked(wavelengths):
        raise ValueError(f"{name}: some values are masked; leave them out with their wavelengths")
    grid, y = np.asarray(wavelengths, np.float64), np.asarray(values, np.float64)
    if grid.ndim != 1 or y.shape[:1] != grid.shape or y.ndim > 2 or (grid.size and not y.size):
        message = f"{y.shape} values for {grid.shape} wavelengths; need one for each"
        raise ValueError(f"{name}: {message}, or scans of shape (wavelengths, scans)")
    if y.ndim == 2:
        y, scatter = mean_of_scans(y)
        sd = scatter if sd is None and covariance is None else sd
    order = np.argsort(grid, kind="stable")
    grid, y = grid[order], y[order]
    for i in np.flatnonzero(np.diff(grid) == 0)[:1]:
        advice = "average the two, or give scans of shape (wavelengths, scans)"
        raise ValueError(f"{name}: wavelengths must increase, {grid[i]:g} nm is twice: {advice}")
    check_wavelengths(grid)
    check_cosine("cos_incidence", cos_incidence)
    try:
        check_covered(grid)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    for wave in grid[~np.isfinite(y)][:1]:
        raise ValueError(f"{name}: the value at {wave:g} nm is not a finite number")
    root = None
    if covariance is not None:
        if not (sd is None and boxcar is None and correlated is None):
            raise ValueError(f"{name}: give the covariance alone; it has sd and correlation in it")
        sd, root = _sd_and_root(covariance, order, name)
        order = np.arange(order.size)
    if boxcar is not None:
        if bands is not None or correlated is not None:
            raise ValueError(f"{name}: a boxcar has its own band and correlation; give it alone")
        bands, correlated = Passbands.slit(grid, boxcar, "boxcar"), boxcar
    if correlated is not None:
        check_range("correlated", correlated, BANDWIDTH)
        # Two means share the values in the overlap of their intervals.
        overlap = np.maximum(1 - np.abs(grid[:, None] - grid) / correlated, 0)
        root = np.linalg.cholesky(overlap + _JITTER * np.eye(grid.size))
    if sd is not None:
        sd = np.broadcast_to(np.asarray(sd, np.float64), order.shape)[order]
        for i in np.flatnonzero(~(np.isfinite(sd) & (sd > 0)))[:1]:
            message = f"the standard deviation at {grid[i]:g} nm is {sd[i]:g}; it must be > 0"
            raise ValueError(f"{name}: {message}")
    if quantity not in (REFLECTANCE, RADIANCE):
        raise ValueError(f"quantity must be {REFLECTANCE!r} or {RADIANCE!r}, got {quantity!r}")
    settings: dict[str, Any] = {} if cornea is None else {"cornea": cornea}
    settings |= dict(cos_incidence=cos_incidence, first_surface=first_surface, media=media)
    settings |= dict(bands=bands, aperture=aperture)
    if quantity == RADIANCE:
        instrument = Radiometer(grid, illuminant=illuminant, **settings)
    else:
        instrument = Spectrophotometer(grid, **settings)
    sd, root = as_float_or_none(sd), as_float_or_none(root)
    return Observation(as_float(y), sd, instrument, root, quantity, name)


def _sd_and_root(
    covariance: Any, order: np.ndarray, name: str
) -> tuple[Float[np.ndarray, " data"], Float[np.ndarray, "data data"]]:
    """Standard deviations, and the root of the correlations, of values in this order."""
    c = np.asarray(covariance, np.float64)
    n = order.size
    message = f"{name}: the covariance must be {n} by {n}, symmetric and positive definite"
    if c.shape != (n, n) or not np.allclose(c, c.T, rtol=1e-6, atol=1e-12 * np.abs(c).max()):
        raise ValueError(message)
    sd = np.sqrt(np.maximum(np.diag(c), 0))[order]
    if not (sd > 0).all():
        raise ValueError(message)
    try:
        return sd, np.linalg.cholesky(c[np.ix_(order, order)] / np.outer(sd, sd))
    except np.linalg.LinAlgError:
        raise ValueError(message) from None


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
        allowed = ", ".join(COLOUR_QUANTITIES)
        raise ValueError(f"quantity must be one of {allowed}, got {quantity!r}")
    y = np.asarray(values, np.float64)
    if y.shape != (3,) or not np.isfinite(y).all():
        raise ValueError(f"{name}: a colour is three finite numbers")
    sd, root = _sd_and_root(covariance, np.arange(3), name)
    instrument = Colorimeter(illuminant=illuminant, observer=observer, first_surface=first_surface)
    return Observation(as_float(y), as_float(sd), instrument, as_float(root), quantity, name)


def with_values(
    observation: Observation,
    values: Float[ArrayLike, "*batch data"],
    sd: Float[ArrayLike, "*batch data"] | None = None,
) -> Observation:
    """Return the measurement with other values (and standard deviations), which may be traced."""
    return dataclasses.replace(observation, values=values, sd=observation.sd if sd is None else sd)
