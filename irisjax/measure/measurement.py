"""Readings of instruments, and the checks of their settings."""

import equinox as eqx
import numpy as np
from numpy.typing import DTypeLike

from irisjax._types import Numbers, Spectrum
from irisjax.numerics.checks import Range, check_number, is_known
from irisjax.transport.solution import RESULTS, Absorbed

DIFFUSE = "diffuse"
"""Diffuse incidence (a cosine-weighted hemisphere)."""

HEMISPHERE = "hemisphere"
"""Exits into the whole hemisphere, collected by a lens."""

COSINE = Range(0, 1)


class Reading(eqx.Module):
    """The reading of an instrument, one value a wavelength (nm).

    Attributes:
        standard_error: Standard errors of the values where they are sampled, otherwise `None`.
        status: A `RESULTS` item; compare it with `RESULTS.successful`.
        absorbed: Shares of the incident light absorbed in `.abl`, `.stroma` and `.ipe`.
        mirrored: Share reflected by the iris's first surface, whether or not `values` include it.
        transmitted: Share that leaves the pigment epithelium behind; `None` where that is black.
        quantity: Name of the quantity, which has this `unit`.
    """

    wavelengths: Spectrum
    values: Spectrum
    standard_error: Spectrum | None
    status: RESULTS
    absorbed: Absorbed
    mirrored: Spectrum
    transmitted: Spectrum | None
    quantity: str = eqx.field(static=True)
    unit: str = eqx.field(static=True)

    def __repr__(self) -> str:
        if not is_known(self):
            return f"{type(self).__name__}(traced)"
        head = f"{self.quantity} ({self.unit})" if self.unit else self.quantity
        grid = np.asarray(self.wavelengths)
        if grid.ndim != 1 or np.shape(self.values) != grid.shape:
            return f"{head}, batch of shape {np.shape(self.values)}"
        columns = {self.quantity: self.values, "standard_error": self.standard_error}
        columns = {name: np.asarray(c) for name, c in columns.items() if c is not None}
        rows = ["  ".join(["wavelength_nm", *(f"{name:>14}" for name in columns)])]
        for x, *values in zip(grid, *columns.values(), strict=True):
            rows.append("  ".join([f"{x:>13g}", *(f"{v:>14.6g}" for v in values)]))
        if len(rows) > 13:
            rows[7:-6] = ["..."]
        return "\n".join([head, *rows])

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> np.ndarray:
        return np.asarray(self.values, dtype)


def wavelengths(start: float, stop: float, step: float) -> np.ndarray:
    """Return a grid from `start` to `stop` inclusive, in equal steps, nm; `ValueError` unless the
    step is positive and divides the range.
    """
    request = f"wavelengths({start:g}, {stop:g}, {step:g})"
    if not np.isfinite([start, stop, step]).all() or step <= 0 or stop < start:
        raise ValueError(f"{request}: need start <= stop and step > 0, in nm")
    n = round((stop - start) / step)
    if not np.isclose(start + n * step, stop, rtol=0, atol=1e-6 * step):
        raise ValueError(f"{request}: the step does not divide the range")
    return start + step * np.arange(n + 1)


def check_wavelengths(grid: Numbers) -> None:
    """Raise `ValueError` unless a grid of wavelengths is one-dimensional and not empty and, if
    concrete, finite and increasing.
    """
    shape = np.shape(grid)
    if len(shape) != 1 or shape[0] == 0:
        raise ValueError(f"wavelengths must be a list of at least one number, got shape {shape}")
    if not is_known(grid):
        return
    grid = np.asarray(grid)
    if not np.isfinite(grid).all():
        raise ValueError("wavelengths must be finite numbers of nm")
    for i in np.flatnonzero(np.diff(grid) <= 0)[:1]:
        pair = f"{grid[i]:g} nm is followed by {grid[i + 1]:g} nm"
        raise ValueError(f"wavelengths must increase; {pair}")


def check_cosine(name: str, cosine: Numbers) -> None:
    """Raise `ValueError` unless a cosine is one number in [0, 1] (or traced), or `DIFFUSE`."""
    if isinstance(cosine, str):
        if cosine != DIFFUSE:
            raise ValueError(f"{name} must be a number in [0, 1] or {DIFFUSE!r}, got {cosine!r}")
        return
    check_number(name, cosine, COSINE)
