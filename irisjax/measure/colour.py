"""Colour of the iris: tristimulus values, CIE L*a*b* and sRGB.

The CIE's observers and illuminants are colour-science's, written by `experiments.colour_tables`.
"""

from functools import lru_cache, partial
from importlib import resources
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from irisjax._types import Numbers, Spectrum, as_float
from irisjax.measure.measurement import check_wavelengths
from irisjax.numerics.checks import check_known, is_known
from irisjax.numerics.interpolation import piecewise_linear
from irisjax.transport.solution import RESULTS

OBSERVER = "CIE 1931 2 Degree Standard Observer"
"""Default observer, under colour-science's name."""
OBSERVERS = (
    OBSERVER,
    "CIE 1964 10 Degree Standard Observer",
    "CIE 2015 2 Degree Standard Observer",
    "CIE 2015 10 Degree Standard Observer",
)
"""Observers whose tristimulus values are XYZ."""

# Cones of the Bradford transform, as in ICC.1:2022, Annex E.
_BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)
XYZ_TO_SRGB = np.linalg.inv(
    np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
)
"""Matrix from XYZ (D65 white at Y = 1) to linear sRGB [IEC 61966-2-1]."""


class Colour(eqx.Module):
    """A colour under an illuminant for an observer.

    Attributes:
        xyz: Tristimulus values, white at Y = 1.
        lab: CIE 1976 `L*a*b*` relative to that white.
        srgb_linear: Linear sRGB, adapted to D65 (Bradford), not clipped.
        srgb: `srgb_linear` by sRGB's transfer function, whose linear part continues below 0.
        in_gamut: Whether all three linear components lie in [0, 1].
    """

    xyz: Float[Array, "3"]
    lab: Float[Array, "3"]
    srgb_linear: Float[Array, "3"]
    srgb: Float[Array, "3"]
    in_gamut: Bool[Array, ""]
    status: RESULTS
    illuminant: str = eqx.field(static=True)
    observer: str = eqx.field(static=True)


VISIBLE = (420.0, 680.0)
"""Wavelengths (nm) without which there is no colour."""
_WIDEST = 25.0  # nm, of a step


class Observer(eqx.Module):
    """An illuminant and a standard observer on a grid, which turn a reflectance into its colour.

    Attributes:
        weights: (3, wavelengths) from a reflectance to XYZ, white at Y = 1.
        white: XYZ of white.
        to_srgb: (3, 3) from XYZ to linear sRGB, adapted to D65 (Bradford).
    """

    weights: Float[Array, "3 wavelengths"]
    white: Float[Array, "3"]
    to_srgb: Float[Array, "3 3"]
    illuminant: str = eqx.field(static=True)
    observer: str = eqx.field(static=True)

    @classmethod
    def of(
        cls, wavelengths: Numbers, illuminant: str = "D65", observer: str = OBSERVER
    ) -> "Observer":
        """Make the observer of a grid of wavelengths, nm, concrete or traced; `ValueError` for
        concrete ones that leave out a part of the visible range or are far apart.
        """
        check_wavelengths(wavelengths)
        if np.shape(wavelengths)[0] < 2:
            why = "it integrates over the whole grid, which jax.vmap over it would take apart"
            raise ValueError(f"a colour needs at least two wavelengths: {why}")
        if not is_known(wavelengths):
            arrays = _weighting(as_float(wavelengths), illuminant, observer, jnp)
            return cls(*arrays, illuminant, observer)
        grid = np.asarray(wavelengths, np.float64)
        _check_visible(grid)
        return _observer(grid.tobytes(), illuminant, observer, str(jnp.result_type(float)))

    def colour(self, values: Spectrum, status: RESULTS = RESULTS.successful) -> Colour:
        """Compute the colour of a spectral reflectance.

        The status is `invalid_input` where a traced wavelength lies outside the illuminant's table.
        """
        status = RESULTS.where(jnp.isfinite(self.weights).all(), status, RESULTS.invalid_input)
        xyz = self.weights @ values
        linear = self.to_srgb @ xyz
        lab, srgb = lab_of(xyz / self.white), srgb_encode(linear)
        inside = ((linear >= 0) & (linear <= 1)).all()
        return Colour(xyz, lab, linear, srgb, inside, status, self.illuminant, self.observer)


def colour_of(
    wavelengths: Numbers, values: Numbers, *, illuminant: str = "D65", observer: str = OBSERVER
) -> Colour:
    """Compute the colour of a spectral reflectance; it is differentiable in the values.

    Args:
        wavelengths: In nm; they must include `VISIBLE`.
        values: Reflectances, one a wavelength.
        illuminant: Name in colour-science.
        observer: Name in colour-science.
    """
    if np.shape(values) != np.shape(wavelengths):
        raise ValueError(f"{np.shape(values)} values for {np.shape(wavelengths)} wavelengths")
    observed = Observer.of(wavelengths, illuminant, observer)
    return observed.colour(jnp.asarray(values, observed.weights.dtype))


def tristimulus_matrix(
    wavelengths: Numbers, space: str = "XYZ", illuminant: str = "D65", observer: str = OBSERVER
) -> tuple[np.ndarray, np.ndarray]:
    """Return the matrix (3, n) from a reflectance to XYZ or `"linear sRGB"`, and white's XYZ."""
    grid = np.asarray(wavelengths, np.float64).tobytes()
    weights, white, to_srgb = _constants(grid, illuminant, observer)
    return (weights if space == "XYZ" else to_srgb @ weights), white


@eqx.filter_jit
def srgb_encode(linear: Numbers) -> Array:
    """sRGB transfer function [IEC 61966-2-1]; negative values follow its linear foot."""
    dark = linear <= 0.0031308
    power = jnp.where(dark, 1.0, linear) ** (1 / 2.4)
    return jnp.where(dark, 12.92 * linear, 1.055 * power - 0.055)


@eqx.filter_jit
def srgb_decode(encoded: Numbers) -> Array:
    """Linear values of sRGB-encoded ones; the inverse of `srgb_encode`."""
    dark = encoded <= 12.92 * 0.0031308
    power = ((jnp.where(dark, 1.0, encoded) + 0.055) / 1.055) ** 2.4
    return jnp.where(dark, encoded / 12.92, power)


@eqx.filter_jit
def agx_encode(linear: Float[Array | np.ndarray, "*s 3"]) -> Float[Array, "*s 3"]:
    """Display values 0 to 1 of linear sRGB by the tone curve AgX [Sobotka 2022].

    Channels are mixed a little, so that bright colours fade to white, and run from 10 stops below
    middle grey (0.18) to 6.5 above along a curve through 0.5 with a slope of 2, whose toe and
    shoulder have the powers 3 and 3.25. A white sheet (1) is shown at 0.79. The mixing is that of
    github.com/bWFuanVzYWth/AgX (MIT licence), the curve follows from the numbers named here.
    """
    linear = jnp.asarray(linear)
    below, above = 10.0, 6.5
    mixing = 0.8 * np.eye(3) + 0.2 * np.array([0.21200536, 0.39218251, 0.39581214])
    unmixing = np.linalg.inv(mixing)
    mixing, unmixing = (jnp.asarray(m, linear.dtype) for m in (mixing, unmixing))
    least = 0.18 * 2.0**-below
    stops = jnp.log2(jnp.maximum(linear @ mixing.T, least) / least)
    pivot = below / (below + above)
    offset = jnp.clip(stops / (below + above), 0, 1) - pivot

    def bent(offset, limit, power):
        """A slope of 2 at 0, and 0.5 at `limit`."""
        scale = ((4 * limit) ** power - 1) / limit**power
        return 2 * offset / (1 + scale * offset**power) ** (1 / power)

    toe, shoulder = jnp.maximum(-offset, 0.0), jnp.maximum(offset, 0.0)
    shown = 0.5 + bent(shoulder, 1 - pivot, 3.25) - bent(toe, pivot, 3.0)
    return jnp.clip(shown @ unmixing.T, 0, 1)


@eqx.filter_jit
def lab_of(ratio: Numbers) -> Array:
    """CIE 1976 L*a*b* of XYZ relative to white [CIE 15:2018, Eq. 8.3 ff.]."""
    delta = 6 / 29
    dark = ratio <= delta**3
    f = jnp.where(dark, ratio / (3 * delta**2) + 4 / 29, jnp.cbrt(jnp.where(dark, 1.0, ratio)))
    return jnp.stack([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@eqx.filter_jit
def lab_of_srgb(linear: Float[Array | np.ndarray, "*s 3"]) -> Float[Array, "*s 3"]:
    """CIE 1976 L*a*b* under D65 of linear sRGB."""
    to_xyz = np.linalg.inv(XYZ_TO_SRGB)
    to_ratio = jnp.asarray(to_xyz / to_xyz.sum(1, keepdims=True), linear.dtype)
    return jnp.moveaxis(lab_of(jnp.moveaxis(linear @ to_ratio.T, -1, 0)), 0, -1)


def _check_visible(grid: np.ndarray) -> None:
    """Raise `ValueError` where a grid leaves out a part of `VISIBLE` or is too coarse.

    Without what lies beyond `VISIBLE` the colours of LB06's irides move by up to 0.4 CIEDE2000,
    with steps of 25 nm by up to 1.1.
    """
    if grid[0] > VISIBLE[0] or grid[-1] < VISIBLE[1]:
        need = f"it needs all from {VISIBLE[0]:g} to {VISIBLE[1]:g} nm"
        raise ValueError(f"wavelengths from {grid[0]:g} to {grid[-1]:g} nm make no colour: {need}")
    widest = int(np.argmax(np.diff(grid)))
    one, next_ = grid[widest], grid[widest + 1]
    if next_ - one > _WIDEST:
        need = f"{one:g} nm is followed by {next_:g} nm"
        raise ValueError(f"a colour needs steps of at most {_WIDEST:g} nm; {need}")


def illuminant_power(illuminant: str, wavelengths: Numbers) -> Any:
    """Relative spectral power of an illuminant (1 at 560 nm) at `wavelengths` (nm); outside its
    table concrete ones raise `ValueError`, traced ones get NaN.
    """
    grid, values = _spectrum(illuminant)
    values = values / np.interp(560.0, grid, values)
    if not is_known(wavelengths):
        x = as_float(wavelengths)
        return piecewise_linear(x, grid, values, outside=jnp.nan)
    x = np.asarray(wavelengths, np.float64)
    if (x < grid[0]).any() or (x > grid[-1]).any():
        span = f"{grid[0]:g} to {grid[-1]:g} nm"
        raise ValueError(f"illuminant {illuminant} is tabulated from {span} only")
    return np.interp(x, grid, values)


@lru_cache(maxsize=64)
def _observer(grid_bytes: bytes, illuminant: str, observer: str, dtype: str) -> Observer:
    with jax.ensure_compile_time_eval():
        constants = _constants(grid_bytes, illuminant, observer)
        weights, white, to_srgb = (jnp.asarray(x, dtype) for x in constants)
        return Observer(weights, white, to_srgb, illuminant, observer)


@lru_cache(maxsize=64)
def _constants(grid_bytes: bytes, illuminant: str, observer: str):
    return _weighting(np.frombuffer(grid_bytes, np.float64), illuminant, observer, np)


def _weighting(x, illuminant: str, observer: str, xp):
    """The arrays of an `Observer`; `xp` is `numpy`, or `jax.numpy` for a traced grid."""
    check_known("observer", observer, OBSERVERS)
    grid, *cmfs = _tables()[f"observer {observer}"]
    interpolate = partial(np.interp, x, left=0.0, right=0.0)
    if xp is jnp:
        interpolate = partial(piecewise_linear, x, outside=0.0)
    xyz_bar = xp.stack([interpolate(grid, cmf) for cmf in cmfs])
    # Trapezoidal rule on the caller's grid.
    width = xp.concatenate([x[1:2] - x[:1], x[2:] - x[:-2], x[-1:] - x[-2:-1]]) / 2
    weights = xyz_bar * (illuminant_power(illuminant, x) * width)[None]
    weights = weights / weights[1].sum()
    white = weights.sum(axis=1)
    d65 = _BRADFORD @ np.linalg.inv(XYZ_TO_SRGB) @ np.ones(3)
    constants = _BRADFORD, np.linalg.inv(_BRADFORD), d65, XYZ_TO_SRGB
    to_cones, from_cones, d65, to_srgb = (xp.asarray(m, x.dtype) for m in constants)
    adaptation = from_cones @ ((d65 / (to_cones @ white))[:, None] * to_cones)
    return weights, white, to_srgb @ adaptation


def _spectrum(illuminant: str) -> np.ndarray:
    """Wavelengths (nm) and relative power."""
    tables = _tables()
    if (name := f"illuminant {illuminant}") not in tables:
        known = [n.removeprefix("illuminant ") for n in tables if n.startswith("illuminant ")]
        raise ValueError(f"unknown illuminant {illuminant!r}; known: {', '.join(sorted(known))}")
    return tables[name]


@lru_cache(maxsize=1)
def _tables() -> dict[str, np.ndarray]:
    file = resources.files("irisjax.measure") / "tables" / "cie.npz"
    with file.open("rb") as opened, np.load(opened) as arrays:
        return dict(arrays)
