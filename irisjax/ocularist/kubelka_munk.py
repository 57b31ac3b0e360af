"""Paints mixed as pigments mix: absorption and scattering add, after Kubelka and Munk.

The K and S that come with the package are constructed, not measured. Only the colour of a paint is
known (`mixing`), so its masstone gets the smoothest reflectance of that colour, its S is grey, and
K follows. Measured K and S are read by `irisjax.io.recipes.read_paints`.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib import resources
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy import optimize

from irisjax._types import as_float
from irisjax.measure.colour import Observer, tristimulus_matrix
from irisjax.numerics.checks import Range, check_range
from irisjax.ocularist.mixing import AbstractMixer, linear_colour
from irisjax.optics.kubelka_munk import (
    absorption_of,
    thick_layer,
    under_surface,
    without_surface,
)

# Round numbers of the order of artists' oils [Okumura 2005]: earths and blacks scatter little, so
# that a white takes much of them; a blue with the scattering of a white would swallow any yellow.
PAINT_SCATTERING = {
    "ivory black": 0.005,
    "titanium white": 1.0,
    "yellow ochre": 0.1,
    "burnt sienna": 0.06,
    "burnt umber": 0.03,
    "ultramarine": 0.03,
    "phthalo blue": 0.03,
    "cadmium yellow": 0.2,
    "cadmium red": 0.1,
    "raw sienna": 0.08,
    "raw umber": 0.03,
}
"""S of the paints that come with the package, relative to titanium white's."""
USUAL_SCATTERING = 0.1
"""S of a paint of which only the colour is given."""
COEFFICIENT = Range(0.0, np.inf)
"""Allowed values of K and of S."""

_SURFACE = Range(0.0, 0.99)
_ENDS = 1e-5  # least reflectance that is constructed, and least of 1 − R: z is infinite at the ends
_EXACT = 1e-10  # residual of the equations for the smoothest reflectance


class KubelkaMunkMixer(AbstractMixer):
    """Mixtures whose K and S are the weighted sums of the paints', in opaque coats
    [Kubelka & Munk 1931; Duncan 1940].

    Attributes:
        paints: Names of the paints.
        wavelengths: Bands of K and S, nm. Colours need all from 420 to 680 nm, in steps of at most
            25 nm.
        absorption: K, shape (paints, bands), in one unit for all.
        scattering: S, likewise.
        surface: k₁ and k₂ of Saunderson's correction for the surface of the paint, which K and S
            then exclude (`optics.kubelka_munk.under_surface`); `None` for no correction.

    Raises:
        ValueError: for wavelengths that make no colour, for shapes that do not go together, for
            negative K or S, and where both are 0.
    """

    paints: tuple[str, ...] = eqx.field(static=True)
    wavelengths: tuple[float, ...] = eqx.field(static=True)
    absorption: Float[Array, "paints bands"] = eqx.field(converter=as_float)
    scattering: Float[Array, "paints bands"] = eqx.field(converter=as_float)
    surface: tuple[float, float] | None = eqx.field(static=True, default=None)

    def __post_init__(self):
        Observer.of(self.wavelengths)
        shape, k, s = (len(self.paints), len(self.wavelengths)), self.absorption, self.scattering
        if len(set(self.paints)) != len(self.paints) or not shape == k.shape == s.shape:
            raise ValueError(
                f"K and S of shapes {k.shape} and {s.shape}; need {shape}, one row a paint, each "
                f"paint once: {', '.join(self.paints)}"
            )
        for name, k, s in zip(self.paints, self.absorption, self.scattering, strict=True):
            check_range(f"K of paint {name!r}", k, COEFFICIENT)
            check_range(f"S of paint {name!r}", s, COEFFICIENT)
            check_range(f"K + S of paint {name!r}", k + s, COEFFICIENT._replace(above=True))
        check_range("surface", self.surface, _SURFACE)

    @classmethod
    def default(cls) -> "KubelkaMunkMixer":
        """The constructed K and S of `PAINTS` and `FURTHER_PAINTS`, 400 to 700 nm by 10 nm."""
        names, wavelengths, absorption, scattering = _shipped()
        return cls(names, wavelengths, as_float(absorption), as_float(scattering))

    def with_paints(self, colours: Mapping[str, Any]) -> "KubelkaMunkMixer":
        """See `AbstractMixer`. K of the added paints is constructed (`constructed_absorption`); S
        is that of the paint they replace, or `USUAL_SCATTERING`.
        """
        k = dict(zip(self.paints, self.absorption, strict=True))
        s = dict(zip(self.paints, self.scattering, strict=True))
        usual = jnp.full_like(self.scattering[0], USUAL_SCATTERING)
        for name, colour in colours.items():
            s.setdefault(name, usual)
            linear = linear_colour(name, colour)
            found = constructed_absorption(linear, self.wavelengths, s[name], self.surface)
            k[name] = jnp.asarray(found, usual.dtype)
        absorption, scattering = (jnp.stack([table[name] for name in k]) for table in (k, s))
        return KubelkaMunkMixer(tuple(k), self.wavelengths, absorption, scattering, self.surface)

    def blend(
        self,
        first: Int[Array, "*coats"],
        second: Int[Array, "*coats"],
        share: Float[Array, "*coats"],
    ) -> Float[Array, "*coats 3"]:
        """See `AbstractMixer`; colours outside sRGB are clipped to it."""
        to_second = share.astype(self.absorption.dtype)[..., None]
        to_first = 1 - to_second
        k, s = (
            to_first * table[first] + to_second * table[second]
            for table in (self.absorption, self.scattering)
        )
        found = thick_layer(k, s)
        if self.surface is not None:
            found = under_surface(found, *self.surface)
        observer = Observer.of(self.wavelengths)
        to_linear = (observer.to_srgb @ observer.weights).astype(found.dtype)
        return jnp.clip(found @ to_linear.T, 0.0, 1.0)


def constructed_absorption(
    colour: np.ndarray,
    wavelengths: Sequence[float] | np.ndarray,
    scattering: Any,
    surface: tuple[float, float] | None = None,
) -> np.ndarray:
    """K, shape (bands,), of a paint whose masstone has a linear sRGB `colour`, given its S.

    A colour brighter than a paint can be under its `surface` becomes the brightest possible.

    Raises:
        ValueError: where there is no smooth reflectance of the colour.
    """
    masstone = smoothest_reflectance(colour, wavelengths)
    if surface is not None:
        masstone = np.minimum(without_surface(masstone, *surface), 1 - _ENDS)
    return absorption_of(masstone, np.asarray(scattering, np.float64))


def smoothest_reflectance(
    colour: np.ndarray, wavelengths: Sequence[float] | np.ndarray
) -> np.ndarray:
    """The smoothest reflectance of a linear sRGB colour under D65, shape (bands,).

    Smooth is least ∫ (dz/dλ)² dλ, where R = (1 + tanh z)/2. This is one of the many spectra of the
    colour and not that of a particular pigment; on average it is close to those of commercial
    paints. [Burns 2020, least hyperbolic tangent slope squared]

    Args:
        colour: Linear sRGB, shape (3,).
        wavelengths: Bands, nm.

    Raises:
        ValueError: for a colour that no such reflectance was found for.
    """
    to_colour, _ = tristimulus_matrix(wavelengths, "linear sRGB")
    wanted = np.clip(np.asarray(colour, np.float64), _ENDS, 1 - _ENDS)
    n = to_colour.shape[1]
    widths = np.diff(np.asarray(wavelengths, np.float64))
    slopes = np.diff(np.eye(n), axis=0) * np.sqrt(widths.mean() / widths)[:, None]
    roughness = 2 * slopes.T @ slopes

    def stationarity(x):
        """Derivatives of roughness + multipliers · (colour − wanted), and their Jacobian."""
        t, pull = np.tanh(x[:n]), to_colour.T @ x[n:]
        slope = (1 - t * t) / 2
        towards = to_colour * slope
        left = [roughness @ x[:n] + slope * pull, to_colour @ (1 + t) / 2 - wanted]
        curvature = roughness - np.diag(2 * slope * t * pull)
        return np.concatenate(left), np.block([[curvature, towards.T], [towards, np.zeros((3, 3))]])

    found = optimize.root(stationarity, np.zeros(n + 3), jac=True, method="lm", tol=1e-12)
    if not np.abs(found.fun).max() < _EXACT:
        raise ValueError(
            f"found no smooth reflectance of linear sRGB {np.round(colour, 4).tolist()}"
        )
    return (1 + np.tanh(found.x[:n])) / 2


def paired_columns(columns: Sequence[str]) -> dict[str, tuple[int, int]]:
    """Indices of the columns `PAINT_K` and `PAINT_S` of each paint, in the order of the K.

    Raises:
        ValueError: naming a column that is neither, appears twice or has no partner.
    """
    places: dict[tuple[str, str], int] = {}
    for j, column in enumerate(columns):
        paint, _, letter = column.strip().rpartition("_")
        if not paint or letter not in ("K", "S"):
            raise ValueError(f"column {column!r} is neither PAINT_K nor PAINT_S")
        if (paint, letter) in places:
            raise ValueError(f"column {column!r} appears twice")
        places[paint, letter] = j
    for paint, letter in places:
        other = "S" if letter == "K" else "K"
        if (paint, other) not in places:
            raise ValueError(f"column {paint}_{letter} has no {paint}_{other} beside it")
    return {p: (j, places[p, "S"]) for (p, letter), j in places.items() if letter == "K"}


@lru_cache(maxsize=1)
def _shipped():
    file = resources.files("irisjax.ocularist") / "tables" / "paints.csv"
    with file.open(encoding="utf-8") as opened:
        lines = [line for line in opened if not line.startswith("#")]
    table = np.loadtxt(lines[1:], delimiter=",").T
    pairs = paired_columns(lines[0].strip().split(",")[1:])
    k, s = np.moveaxis(np.stack([table[1:][list(pair)] for pair in pairs.values()]), 1, 0)
    return tuple(pairs), tuple(table[0].tolist()), k, s
