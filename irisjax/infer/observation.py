"""What was measured: a spectrum or a colour, and how the model's reflectance becomes it."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax.anatomy.media import Media
from irisjax.measure.colorimeter import Colorimeter
from irisjax.measure.colour import OBSERVER
from irisjax.measure.instrument import AbstractInstrument, Cornea
from irisjax.measure.measurement import check_cosine, check_wavelengths
from irisjax.measure.radiometer import Radiometer
from irisjax.measure.spectrophotometer import Spectrophotometer
from irisjax.tissue.pigments import check_covered

REFLECTANCE, RADIANCE = "reflectance", "radiance"
COLOURS = {"XYZ": "xyz", "Lab": "lab", "linear sRGB": "srgb_linear"}
"""Quantities of colours, and the fields of `Colour` that hold them."""


class Observation(eqx.Module):
    """Measured values and the instrument that read them. Make one with `spectrum` or `colour_data`.

    - `values`: shape (data,); `sd`: their standard deviations, or `None` where the noise model
        states them.
    - `instrument`: what the model is read by.
    - `quantity`: `"reflectance"`, `"radiance"`, `"XYZ"`, `"Lab"` or `"linear sRGB"`.
    - `covariance_root`: for colours, R with R Rᵀ the covariance; `sd` is then `None`.
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
        return self.quantity in COLOURS

    def of(self, reading) -> Float[Array, " data"]:
        """The part of an instrument's reading that the data are compared with."""
        return getattr(reading, COLOURS.get(self.quantity, "values"))


def spectrum(
    wavelengths,
    values=None,
    sd=None,
    *,
    quantity: str = REFLECTANCE,
    illuminant: str = "D65",
    cos_incidence: float | str = 1.0,
    first_surface: bool = True,
    cornea: Cornea | None = None,
    media: Media | None = None,
    name: str = "spectrum",
) -> Observation:
    """A measured reflectance factor, or the radiance under an illuminant (relative to it at 560 nm,
    per sr).

    `wavelengths` in nm, in any order; `values` (fractions) and `sd` (standard deviations, or
    `None`) one a wavelength. `values` of shape (wavelengths, scans) are repeated scans, see
    `mean_of_scans`; their scatter is the `sd` where none is given. In place of wavelengths and
    values: one object that has both, such as `read_measured` returns (its `sd` is used), or
    colour-science's `SpectralDistribution` and `MultiSpectralDistributions` (repeated scans).
    `cornea` and `media` are the instrument's; by default a radiance is dimmed by the cornea, a
    reflectance is not.

    **Raises:** `ValueError` naming the first wavelength at which something is wrong.
    """
    if (hasattr(wavelengths, "wavelengths") and hasattr(wavelengths, "values")) == (
        values is not None
    ):
        raise ValueError(
            f"{name}: give wavelengths and values, or one object that has both; sd by its name"
        )
    if values is None:
        sd = getattr(wavelengths, "sd", None) if sd is None else sd
        wavelengths, values = wavelengths.wavelengths, wavelengths.values
    grid, y = np.asarray(wavelengths, np.float64), np.asarray(values, np.float64)
    if y.ndim == 2 and y.shape[1]:
        y, scatter = mean_of_scans(y)
        sd = scatter if sd is None else sd
    if grid.ndim != 1 or y.shape != grid.shape:
        raise ValueError(
            f"{name}: {y.shape} values for {grid.shape} wavelengths; need one for each"
        )
    order = np.argsort(grid, kind="stable")
    grid, y = grid[order], y[order]
    check_wavelengths(grid)
    check_cosine("cos_incidence", cos_incidence)
    try:
        check_covered(grid)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    if not np.isfinite(y).all():
        raise ValueError(
            f"{name}: the value at {grid[~np.isfinite(y)][0]:g} nm is not a finite number"
        )
    if sd is not None:
        sd = np.broadcast_to(np.asarray(sd, np.float64), order.shape)[order]
        bad = ~(np.isfinite(sd) & (sd > 0))
        if bad.any():
            raise ValueError(
                f"{name}: the standard deviation at {grid[bad][0]:g} nm is {sd[bad][0]:g}; it must "
                f"be > 0"
            )
    if quantity not in (REFLECTANCE, RADIANCE):
        raise ValueError(f"quantity must be {REFLECTANCE!r} or {RADIANCE!r}, got {quantity!r}")
    settings: dict[str, Any] = {
        "cos_incidence": cos_incidence,
        "first_surface": first_surface,
        "media": media,
    }
    if cornea is not None:
        settings["cornea"] = cornea
    if quantity == RADIANCE:
        instrument = Radiometer(grid, illuminant=illuminant, **settings)
    else:
        instrument = Spectrophotometer(grid, **settings)
    sd = None if sd is None else _array(sd)
    return Observation(_array(y), sd, instrument, None, quantity, name)


def mean_of_scans(scans: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Mean of repeated scans, shape (wavelengths, scans), and the standard deviations of that mean
    by their scatter.

    `None` in place of these for a single scan, and where scans are equal: they say nothing about
    the noise.
    """
    count = scans.shape[1]
    if count < 2:
        return scans.mean(axis=1), None
    # Few scans scatter little somewhere by chance, and would count too much there: lean on all
    # wavelengths together.
    scatter = scans.std(axis=1, ddof=1)
    sd = np.sqrt((scatter**2 + 3 * (scatter**2).mean()) / 4 / count)
    return scans.mean(axis=1), sd if (sd > 0).all() else None


def colour_data(
    values,
    covariance,
    *,
    quantity: str = "XYZ",
    illuminant: str = "D65",
    observer: str = OBSERVER,
    first_surface: bool = True,
    name: str = "colour",
) -> Observation:
    """Measured tristimulus values: `"XYZ"` (white at Y = 1), `"Lab"` or `"linear sRGB"`, with their
    covariance.

    `values` has shape (3,), `covariance` (3, 3). **Raises:** `ValueError` unless the covariance is
    symmetric and positive definite.
    """
    if quantity not in COLOURS:
        raise ValueError(f"quantity must be one of {', '.join(COLOURS)}, got {quantity!r}")
    y, c = np.asarray(values, np.float64), np.asarray(covariance, np.float64)
    if y.shape != (3,) or not np.isfinite(y).all():
        raise ValueError(f"{name}: a colour is three finite numbers")
    if c.shape != (3, 3) or not np.allclose(c, c.T) or np.linalg.eigvalsh(c).min() <= 0:
        raise ValueError(f"{name}: the covariance must be 3 by 3, symmetric and positive definite")
    instrument = Colorimeter(illuminant=illuminant, observer=observer, first_surface=first_surface)
    root = _array(np.linalg.cholesky(c))
    return Observation(_array(y), None, instrument, root, quantity, name)


def with_values(observation: Observation, values, sd=None) -> Observation:
    """The same measurement with other values (and standard deviations); values may be traced."""
    return dataclasses.replace(observation, values=values, sd=observation.sd if sd is None else sd)


def _array(x) -> jax.Array:
    return jnp.asarray(x, jnp.result_type(float))
