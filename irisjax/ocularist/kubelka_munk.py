"""Paints mixed as pigments mix: absorption and scattering add, after Kubelka and Munk.

The K and S that come with the package are constructed, not measured. Only the colour of a paint is
known (`mixing`), so its masstone gets the smoothest reflectance of that colour, its S is grey, and
K follows. Measured K and S are read by `irisjax.io.recipes.read_paints`.
"""

from collections.abc import Mapping, Sequence
from importlib import resources
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy import optimize

from irisjax._types import as_float
from irisjax.measure.colour import Observer, tristimulus_matrix
from irisjax.numerics.checks import Range, check_range
from irisjax.ocularist import mixing
from irisjax.optics.kubelka_munk import absorption_of, thick_layer, under_surface, without_surface

USUAL_SCATTERING = 0.1
"""S of a paint of which only the colour is given, relative to titanium white's."""
COEFFICIENT = Range(0.0, np.inf)
"""Allowed values of K and of S."""

_SURFACE = Range(0.0, 0.99)
_ENDS = 1e-5  # least reflectance that is constructed, and least of 1 − R: z is infinite at the ends
_EXACT = 1e-10  # residual of the equations for the smoothest reflectance


class KubelkaMunkMixer(mixing.AbstractMixer):
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

    def __post_init__(self) -> None:
        Observer.of(self.wavelengths)
        shape, k, s = (len(self.paints), len(self.wavelengths)), self.absorption, self.scattering
        if len(set(self.paints)) != len(self.paints) or not shape == k.shape == s.shape:
            raise ValueError(
                f"K and S of shapes {k.shape} and {s.shape}; need {shape}, one row a paint, each "
                f"paint once: {', '.join(self.paints)}"
            )
        for name, k, s in zip(self.paints, *self._tables(), strict=True):
            check_range(f"K of paint {name!r}", k, COEFFICIENT)
            check_range(f"S of paint {name!r}", s, COEFFICIENT)
            check_range(f"K + S of paint {name!r}", k + s, COEFFICIENT._replace(above=True))
        check_range("surface", self.surface, _SURFACE)

    @classmethod
    def default(cls) -> "KubelkaMunkMixer":
        """The constructed K and S of `PAINTS` and `FURTHER_PAINTS`, 400 to 700 nm by 10 nm."""
        file = resources.files("irisjax.ocularist") / "tables" / "paints.csv"
        with file.open(encoding="utf-8") as opened:
            # Two lines of remarks and the names; after the wavelengths K and S of each paint.
            table = np.loadtxt(opened, delimiter=",", skiprows=3).T
        paints = *mixing.PAINTS, *mixing.FURTHER_PAINTS
        return cls(paints, tuple(table[0].tolist()), table[1::2], table[2::2])

    def with_paints(self, colours: Mapping[str, object]) -> "KubelkaMunkMixer":
        """See `AbstractMixer`. K of the added paints is constructed (`constructed_absorption`); S
        is that of the paint they replace, or `USUAL_SCATTERING`.
        """
        k, s = (dict(zip(self.paints, table, strict=True)) for table in self._tables())
        usual = np.full(len(self.wavelengths), USUAL_SCATTERING, self.scattering.dtype)
        for name, colour in colours.items():
            s.setdefault(name, usual)
            linear = mixing.linear_colour(name, colour)
            found = constructed_absorption(linear, self.wavelengths, s[name], self.surface)
            k[name] = np.asarray(found, usual.dtype)
        tables = (jnp.stack([table[name] for name in k]) for table in (k, s))
        return KubelkaMunkMixer(tuple(k), self.wavelengths, *tables, surface=self.surface)

    def _tables(self):
        return map(mixing.rows, (self.absorption, self.scattering))

    def blend(
        self, first: mixing.CoatIndices, second: mixing.CoatIndices, share: mixing.CoatShares
    ) -> mixing.CoatColours:
        """See `AbstractMixer`; colours outside sRGB are clipped to it."""
        share = share.astype(self.absorption.dtype)[..., None]
        tables = self.absorption, self.scattering
        found = thick_layer(*((1 - share) * t[first] + share * t[second] for t in tables))
        if self.surface is not None:
            found = under_surface(found, *self.surface)
        to_linear, _ = tristimulus_matrix(self.wavelengths, "linear sRGB")
        return jnp.clip(found @ jnp.asarray(to_linear.T, found.dtype), 0.0, 1.0)


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
    widths, steps = np.diff(np.asarray(wavelengths, np.float64)), np.diff(np.eye(n), axis=0)
    roughness = 2 * steps.T @ (steps * (widths.mean() / widths)[:, None])

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
        what = np.round(colour, 4).tolist()
        raise ValueError(f"found no smooth reflectance of linear sRGB {what}")
    return (1 + np.tanh(found.x[:n])) / 2
