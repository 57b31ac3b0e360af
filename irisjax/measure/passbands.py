"""Passbands of slits, filters and pixels."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from irisjax._types import Numbers, Spectrum
from irisjax.measure.colour import illuminant_power
from irisjax.measure.measurement import check_wavelengths
from irisjax.numerics.checks import Range, check_known, check_range, is_known
from irisjax.tissue.pigments import common_range

BANDWIDTH = Range(0, 300, "nm", above=True)
"""Allowed full widths at half maximum."""

_NODES = 6  # at least, a full width at half maximum
_TABLES = 2.0  # nm between the values of the pigment tables, which are the kinks of a spectrum
_LEAST = 1e-7  # share of a band's light below which a wavelength is left out
_SIGMA = 1 / np.sqrt(8 * np.log(2))  # of a Gaussian, in full widths at half maximum


def _gaussian(x: np.ndarray) -> np.ndarray:
    from scipy.special import ndtr  # a quarter of a second, which a command without bands saves

    return x * ndtr(x / _SIGMA) + _SIGMA * np.exp(-0.5 * (x / _SIGMA) ** 2) / np.sqrt(2 * np.pi)


# Second antiderivatives of a band's shape, both in full widths from its centre.
_TWICE_INTEGRATED = {
    "gaussian": _gaussian,
    "boxcar": lambda x: (np.maximum(x + 0.5, 0) ** 2 - np.maximum(x - 0.5, 0) ** 2) / 2,
}


class Passbands(eqx.Module):
    """The light that each value of an instrument is the mean of.

    Attributes:
        centres: Mean wavelength of each band, nm, increasing.
        wavelengths: Wavelengths at which the model is evaluated, nm.
        weights: Share of each of these in each band; rows add to one.
    """

    centres: Float[Array, " bands"]
    wavelengths: Spectrum
    weights: Float[Array, "bands wavelengths"]

    @classmethod
    def slit(cls, wavelengths: Numbers, width: Numbers, shape: str = "gaussian") -> "Passbands":
        """Return bands about the wavelengths at which an instrument is read.

        The mean over a band is exact for a spectrum that is linear between points 2 nm apart, or a
        sixth of the width. Bands are cut where the pigment tables end.

        Args:
            wavelengths: Centres, nm, increasing.
            width: Full width at half maximum, nm, of all bands or of each.
            shape: Of the slit: `"gaussian"`, or `"boxcar"`, the moving average of some instruments'
                programs.

        Raises:
            ValueError: For a width or shape out of range.
        """
        check_known("shape", shape, _TWICE_INTEGRATED)
        check_wavelengths(wavelengths)
        check_range("bandwidth", width, BANDWIDTH)
        centres = np.asarray(wavelengths, float)
        widths = np.broadcast_to(np.asarray(width, float), centres.shape)[:, None]
        step = _TABLES / np.ceil(_TABLES * _NODES / widths.min())
        low, high = common_range()
        # Points of one lattice, so that bands that overlap share them.
        grid = np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step
        padded = np.concatenate([[grid[0] - step], grid, [grid[-1] + step]])
        distance = (padded - centres[:, None]) / widths
        # The integral of a shape times the hat function of a point.
        weights = np.diff(_TWICE_INTEGRATED[shape](distance), n=2)
        lost = weights.sum(1) < _LEAST
        if lost.any():
            span = f"the pigment tables have {low:g} to {high:g} nm"
            raise ValueError(f"no band about {centres[lost][0]:g} nm: {span}")
        weights = np.maximum(weights, 0) / weights.sum(1, keepdims=True)
        near = (weights > _LEAST).any(0)
        grid, weights = grid[near], weights[:, near]
        return cls._of(centres, grid, weights)

    @classmethod
    def of(
        cls, wavelengths: Numbers, sensitivities: Numbers, illuminant: str | None = None
    ) -> "Passbands":
        """Return the bands of filters or of a camera's channels.

        Args:
            wavelengths: In nm, increasing.
            sensitivities: Sensitivity of each band, shape (wavelengths, bands), in any unit.
            illuminant: Name in colour-science of the light, if the sensitivities are those of the
                sensor and filter alone; a reflectance is relative to a white in the same light.

        Raises:
            ValueError: For sensitivities that are negative or zero throughout.
        """
        check_wavelengths(wavelengths)
        grid, curves = np.asarray(wavelengths, float), np.asarray(sensitivities, float).T
        if curves.ndim != 2 or curves.shape[1] != grid.size:
            raise ValueError(f"sensitivities of shape {curves.T.shape} for {grid.size} wavelengths")
        if not (np.isfinite(curves).all() and (curves >= 0).all() and curves.any(1).all()):
            raise ValueError(
                "sensitivities must be zero or more, and each band somewhere above zero"
            )
        if illuminant is not None:
            curves = curves * illuminant_power(illuminant, grid)
        curves = curves * np.gradient(grid) if grid.size > 1 else curves
        order = np.argsort((curves @ grid) / curves.sum(1), kind="stable")
        curves = curves[order]
        used = curves.any(0)
        return cls._of((curves @ grid) / curves.sum(1), grid[used], curves[:, used])

    @classmethod
    def _of(cls, centres: np.ndarray, grid: np.ndarray, curves: np.ndarray) -> "Passbands":
        dtype = jnp.result_type(float)
        shares = curves / curves.sum(1, keepdims=True)
        return cls(*(jnp.asarray(x, dtype) for x in (centres, grid, shares)))

    def mean(self, values: Float[ArrayLike, "*batch wavelengths"]) -> Float[Array, "*batch bands"]:
        """Return the mean of each band."""
        return jnp.asarray(values) @ self.weights.T

    def error(self, errors: Float[Array, "*batch wavelengths"]) -> Float[Array, "*batch bands"]:
        """Return the standard errors of the means, from those of independent values."""
        return jnp.sqrt((errors * errors) @ (self.weights * self.weights).T)

    def matched(self, wavelengths: Numbers) -> "Passbands":
        """Return these bands, checked against the wavelengths that data state for them.

        Raises:
            ValueError: Unless there is one wavelength for each band, no further from its centre
                than the standard deviation of its light, or 1 nm.
        """
        data, centres = np.asarray(wavelengths, float), np.asarray(self.centres)
        if data.shape != centres.shape:
            some = ", ".join(f"{x:.4g}" for x in centres[:8]) + ", ..." * (centres.size > 8)
            counts = f"{data.size} values for {centres.size} bands, centred at {some} nm"
            raise ValueError(f"{counts}; need a value for each band and a band for each value")
        grid, weights = np.asarray(self.wavelengths), np.asarray(self.weights)
        spread = np.sqrt((weights * (grid - centres[:, None]) ** 2).sum(1))
        for x, centre, width in zip(np.sort(data), centres, spread, strict=True):
            if abs(x - centre) > max(width, 1.0):
                raise ValueError(
                    f"no band is centred near {x:g} nm: the next is at {centre:.4g} nm"
                )
        return self


def bands_of(wavelengths: Numbers, bands: "Passbands | float | None") -> "Passbands | None":
    """Return the bands of an instrument that is read at these wavelengths, a number being the full
    width at half maximum of a Gaussian slit, nm.
    """
    if bands is None or isinstance(bands, Passbands):
        return bands if bands is None else bands.matched(wavelengths)
    if not is_known(wavelengths):
        raise ValueError(
            "a bandwidth needs concrete wavelengths; make its Passbands outside of jit"
        )
    return Passbands.slit(wavelengths, bands)
