"""Extinction of the iridal pigments, from tables whose headers name their sources."""

import math
from functools import lru_cache, partial
from importlib import resources
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax._types import Numbers, Spectrum, as_float
from irisjax.numerics.checks import is_known
from irisjax.numerics.interpolation import piecewise_linear

_PER_CM = 0.1  # 1 cm⁻¹ in mm⁻¹

# pigment: (table, column, factor to mm⁻¹ per package unit of concentration). Melanin's tables are
# used as Napierian coefficients; the decadic ones take ln 10. Haemoglobin: cm⁻¹/M to mm⁻¹/(mmol/l).
_SOURCES: dict[str, tuple[str, str, float]] = {
    "eumelanin": ("eumelanin.csv", "extinction", _PER_CM),
    "pheomelanin": ("pheomelanin.csv", "extinction", _PER_CM),
    "oxyhemoglobin": ("hemoglobin.csv", "hbo2", math.log(10) * _PER_CM * 1e-3),
    "deoxyhemoglobin": ("hemoglobin.csv", "hb", math.log(10) * _PER_CM * 1e-3),
    "lutein": ("carotenoids.csv", "lutein", math.log(10) * _PER_CM),
    "zeaxanthin": ("carotenoids.csv", "zeaxanthin", math.log(10) * _PER_CM),
}

PIGMENTS = tuple(_SOURCES)
"""Names of the pigments, in the order of `Extinction`'s fields."""
PER_CENT = 0.88
"""Concentration times intensification, mg/ml, that is one per cent of volume by F09's absorption.
LB06's melanin then absorbs as much as F09's within about a fifth from 400 to 700 nm, so that loads
and priors keep their meaning.
"""


class Extinction(eqx.Module):
    """Napierian extinction of every pigment at wavelengths in nm.

    It is in mm⁻¹ per mg/ml, that of haemoglobin in mm⁻¹ per mmol/l.
    """

    wavelengths: Spectrum
    eumelanin: Spectrum
    pheomelanin: Spectrum
    oxyhemoglobin: Spectrum
    deoxyhemoglobin: Spectrum
    lutein: Spectrum
    zeaxanthin: Spectrum

    def by_f09(self) -> "Extinction":
        """Return a copy with F09's power laws of the melanins, 6.6e10 λ^−3.33 and 2.9e14 λ^−4.75
        mm⁻¹ (λ in nm) where they fill the whole volume  [F09 Eqs. 8, 9].
        """
        x, full = self.wavelengths, 100 * PER_CENT
        melanins = 6.6e10 / full * x**-3.33, 2.9e14 / full * x**-4.75
        return eqx.tree_at(lambda e: (e.eumelanin, e.pheomelanin), self, melanins)

    @property
    def matrix(self) -> Float[Array, "pigments wavelengths"]:
        """Extinction of all pigments, in the order of `PIGMENTS`."""
        return jnp.stack([getattr(self, pigment) for pigment in PIGMENTS])


def table_range(pigment: str) -> tuple[float, float]:
    """Return the first and last wavelength (nm) of a pigment's table."""
    x, _ = _table(pigment)
    return float(x[0]), float(x[-1])


def extinction(wavelengths: Numbers) -> Extinction:
    """Interpolate the extinction of all pigments linearly.

    Concrete wavelengths are interpolated on the host and cached, traced ones inside the program. A
    traced wavelength outside a table has no extinction (NaN), and solutions for it have the status
    `RESULTS.invalid_input`.

    Args:
        wavelengths: Wavelengths in nm, shape (n,).

    Raises:
        ValueError: For a concrete wavelength outside a table, with the table and its range.
    """
    if not is_known(wavelengths):
        x = as_float(wavelengths)
        interpolate = partial(piecewise_linear, x, outside=jnp.nan)
        return Extinction(wavelengths=x, **_interpolate(interpolate))
    grid = np.asarray(wavelengths, np.float64)
    return _on_host(grid.tobytes(), jnp.result_type(float) == jnp.float64)


def common_range() -> tuple[float, float]:
    """Return the range of wavelengths (nm) that every pigment's table covers."""
    ranges = [table_range(p) for p in PIGMENTS]
    return max(r[0] for r in ranges), min(r[1] for r in ranges)


def check_covered(wavelengths: Numbers) -> None:
    """Check that every pigment's table covers some wavelengths (nm).

    Raises:
        ValueError: For the first wavelength that a table does not cover.
    """
    x = np.asarray(wavelengths, np.float64)
    _check_inside(x, common_range(), "{:g} nm is outside the pigment tables")


@lru_cache(maxsize=64)
def _on_host(grid: bytes, double: bool) -> Extinction:
    x = np.frombuffer(grid, np.float64)
    for pigment in PIGMENTS:
        message = f"wavelength {{:g}} nm is outside the {pigment} table"
        _check_inside(x, table_range(pigment), message)
    dtype = np.float64 if double else np.float32
    with jax.ensure_compile_time_eval():
        curves = {"wavelengths": x, **_interpolate(partial(np.interp, x))}
        return Extinction(**{name: jnp.asarray(curve, dtype) for name, curve in curves.items()})


def _check_inside(x: np.ndarray, span: tuple[float, float], message: str) -> None:
    low, high = span
    # A NaN is neither below nor above, so the condition states what is allowed.
    bad = ~((x >= low) & (x <= high))
    if bad.any():
        raise ValueError(f"{message.format(x[bad][0])} ({low:g} to {high:g} nm)")


def _interpolate(interpolate) -> dict[str, Any]:
    return {pigment: interpolate(*_table(pigment)) for pigment in PIGMENTS}


@lru_cache(maxsize=len(_SOURCES))
def _table(pigment: str) -> tuple[np.ndarray, np.ndarray]:
    file, column, factor = _SOURCES[pigment]
    with (resources.files("irisjax.tissue") / "tables" / file).open(encoding="utf-8") as f:
        data = np.genfromtxt(
            (line for line in f if not line.startswith("#")), delimiter=",", names=True
        )
    return data["wavelength_nm"], data[column] * factor
