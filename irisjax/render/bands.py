"""The few wavelengths a picture is computed at, and their weights towards its channels.

Ten wavelengths stand for 81 (380 to 780 nm in steps of 5): spectra of irides are smooth and alike.
Their colours differ by less than 0.5 ΔE2000 from those of all 81 (`experiments/rendering_bands.py`:
0.32 under D65, 0.29 under A, 0.46 under FL11, on a thousand irides drawn widely). What is no iris,
vessels above all, has `all_bands`.
"""

from functools import lru_cache
from importlib import resources

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax.anatomy.eye import Cornea
from irisjax.measure.colour import OBSERVER, illuminant_power, tristimulus_matrix
from irisjax.numerics.programs import program

GRID = 380 + 5.0 * np.arange(81)
"""Wavelengths (nm) that the bands stand for."""


class Bands(eqx.Module):
    """Wavelengths (nm) and the matrix (channels, bands) from reflectance to the picture's channels.

    - `channels`: their names; `("R", "G", "B")` is linear sRGB, a white sheet under irradiance π is
        (1, 1, 1).
    """

    wavelengths: tuple[float, ...] = eqx.field(static=True)
    weights: Float[Array, "channels bands"]
    channels: tuple[str, ...] = eqx.field(static=True)


def colour_bands(
    illuminant: str = "D65", observer: str = OBSERVER, cornea: Cornea | None = None
) -> Bands:
    """Bands to linear sRGB under an illuminant, adapted to D65;
    twice through the haze of `cornea`.
    """
    nodes, fill = _table()
    matrix = np.asarray(tristimulus_matrix(GRID, "linear sRGB", illuminant, observer)[0])
    if cornea is None or cornea.scatter is None:
        weights = jnp.asarray(matrix @ fill.T, jnp.result_type(float))
    else:
        # Channel by channel and band by band, summed over the wavelengths they stand for.
        each = jnp.asarray(matrix[:, None] * fill[None], jnp.result_type(float))
        weights = (each * _haze(cornea, GRID)).sum(axis=-1)
    return Bands(tuple(nodes.tolist()), weights, ("R", "G", "B"))


def all_bands(illuminant: str = "D65", observer: str = OBSERVER) -> Bands:
    """All of `GRID` to linear sRGB, adapted to D65, without a cornea."""
    matrix = tristimulus_matrix(GRID, "linear sRGB", illuminant, observer)[0]
    return Bands(tuple(GRID.tolist()), jnp.asarray(matrix, jnp.result_type(float)), ("R", "G", "B"))


def spectral_bands(wavelengths, illuminant: str = "D65", cornea: Cornea | None = None) -> Bands:
    """A channel for each wavelength: radiance (1/sr) relative to the illuminant's irradiance at 560
    nm, times π.
    """
    x = np.asarray(wavelengths, np.float64)
    power = jnp.asarray(illuminant_power(illuminant, x), jnp.result_type(float))
    return Bands(
        tuple(x.tolist()), jnp.diag(power * _haze(cornea, x)), tuple(f"{w:g}nm" for w in x)
    )


@program
def _haze(cornea: Cornea | None, wavelengths) -> Array:
    """Share that passes the haze of a cornea twice."""
    x = jnp.asarray(wavelengths, jnp.result_type(float))
    once = None if cornea is None else cornea.transmittance(x)
    return jnp.ones_like(x) if once is None else once**2


@lru_cache(maxsize=1)
def _table() -> tuple[np.ndarray, np.ndarray]:
    """Nodes (bands,) and the matrix (bands, 81) that fills in the rest."""
    with (resources.files("irisjax.render") / "tables" / "bands.csv").open(encoding="utf-8") as f:
        rows = np.loadtxt(
            (line for line in f if not line.startswith("#")), delimiter=",", skiprows=1
        )
    return rows[:, 0], rows[:, 1:]
