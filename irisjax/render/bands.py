"""The few wavelengths a picture is computed at, and their weights towards its channels.

Ten wavelengths represent 81 (380 to 780 nm in steps of 5): spectra of irides are smooth and alike.
Their colours differ by less than 0.5 ΔE2000 from those of all 81 (`experiments/rendering_bands.py`:
0.32 under D65, 0.29 under A, 0.46 under FL11, on a thousand widely varied irides). Other tissue,
such as vessels, is computed at all 81.
"""

from collections.abc import Sequence
from functools import lru_cache
from importlib import resources

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax.anatomy.eye import Cornea
from irisjax.measure.colour import OBSERVER, illuminant_power, tristimulus_matrix

BAND_GRID = 380 + 5.0 * np.arange(81)
"""Wavelengths (nm) that the bands represent."""


class Bands(eqx.Module):
    """Wavelengths at which a picture is computed, and their weights towards its channels.

    Attributes:
        wavelengths: Wavelengths, nm.
        weights: Matrix from reflectance to the picture's channels.
        white: A white sheet in the picture's channels, computed at all wavelengths: bands are
            fitted to tissue, and their weights would make it 3 % too dark in blue.
        channels: Names of the channels; `("R", "G", "B")` is linear sRGB, in which a white sheet
            under irradiance π is (1, 1, 1).
    """

    wavelengths: tuple[float, ...] = eqx.field(static=True)
    weights: Float[Array, "channels bands"]
    white: Float[Array, " channels"]
    channels: tuple[str, ...] = eqx.field(static=True)


def colour_bands(
    illuminant: str = "D65",
    observer: str = OBSERVER,
    cornea: Cornea | None = None,
    *,
    all_wavelengths: bool = False,
) -> Bands:
    """Bands to linear sRGB under an illuminant, adapted to D65, and twice through the haze of
    `cornea`; with `all_wavelengths` all of `BAND_GRID`.
    """
    nodes, fill = (BAND_GRID, np.eye(BAND_GRID.size)) if all_wavelengths else _load_table()
    matrix = np.asarray(tristimulus_matrix(BAND_GRID, "linear sRGB", illuminant, observer)[0])
    haze = _haze(cornea, jnp.asarray(BAND_GRID, jnp.result_type(float)))
    # Channel by channel and band by band, summed over the wavelengths they stand for.
    weights = (jnp.asarray(matrix[:, None] * fill, haze.dtype) * haze).sum(axis=-1)
    white = (jnp.asarray(matrix, haze.dtype) * haze).sum(axis=-1)
    return Bands(tuple(nodes.tolist()), weights, white, ("R", "G", "B"))


def spectral_bands(
    wavelengths: Sequence[float] | np.ndarray, illuminant: str = "D65", cornea: Cornea | None = None
) -> Bands:
    """Make bands with a channel for each wavelength: radiance (1/sr) relative to the illuminant's
    irradiance at 560 nm, times π. The haze of `cornea` is crossed twice.
    """
    x = np.asarray(wavelengths, np.float64)
    dtype = jnp.result_type(float)
    power = jnp.asarray(illuminant_power(illuminant, x), dtype)
    weights = power * _haze(cornea, jnp.asarray(x, dtype))
    return Bands(tuple(x.tolist()), jnp.diag(weights), weights, tuple(f"{w:g}nm" for w in x))


@eqx.filter_jit
def _haze(cornea: Cornea | None, wavelengths: Array) -> Array:
    """Compute the share of light that passes the haze of a cornea twice."""
    transmittance = None if cornea is None else cornea.transmittance(wavelengths)
    return jnp.ones_like(wavelengths) if transmittance is None else transmittance**2


@lru_cache(maxsize=1)
def _load_table() -> tuple[np.ndarray, np.ndarray]:
    """Read the bands' wavelengths (bands,) and the matrix (bands, 81) that interpolates spectra."""
    with (resources.files("irisjax.render") / "tables" / "bands.csv").open(encoding="utf-8") as f:
        lines = [line for line in f if not line.startswith("#")]
    rows = np.loadtxt(lines, delimiter=",", skiprows=1)
    return rows[:, 0], rows[:, 1:]
