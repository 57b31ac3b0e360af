"""Coordinates of the tables of radiative transfer: depths, albedo, and cosines in the stroma.

All run over [−1, 1]. Depths by ln(1 + τ/k): fates go as τ ln τ near nothing. Albedos from 0 to
what the table holds at a depth, `most`: all there are where τ_s ≤ 2, and up to 7.5/τ in the deep.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from irisjax.numerics.interpolation import chebyshev_nodes, chebyshev_series
from irisjax.numerics.roots import safe_sqrt
from irisjax.numerics.tucker import grid_points
from irisjax.tissue.indices import RefractiveIndices
from irisjax.tissue.layers import Layers

DEEPEST_ABL, DEEPEST = 20.0, 15.0  # exp(−2·15) is below rounding: deeper is all alike
_KNEE = 3e-4
_ALBEDO, _BEND = 1.25, 8.0
CHUNK = 1024  # points a program takes at once


class Places(NamedTuple):
    """Coordinates of layers, shape (wavelengths,)."""

    abl: jax.Array
    depth: jax.Array
    albedo: jax.Array


def places(abl, depth, albedo) -> Places:
    """Where the layers stand in the tables; beyond the deepest they are alike at equal albedo."""
    shallow = jnp.minimum(depth, DEEPEST)
    return Places(
        _to_unit(jnp.minimum(abl, DEEPEST_ABL), DEEPEST_ABL),
        _to_unit(shallow, DEEPEST),
        2 * albedo / most(shallow) - 1,
    )


def resummed(pole, at: Places, albedo):
    """The leading pole of the sum over orders of scattering, 1/(1 − ω λ); `pole`: λ's polynomials
    in the depth's coordinate.
    """
    return 1 / (1 - albedo * chebyshev_series(pole[:, None], at.depth)[0])


def most(depth):
    """Largest albedo of the tables at an optical depth."""
    return _ALBEDO / (1 + depth / _BEND)


def cosine_place(cosine, indices: RefractiveIndices):
    """Coordinate of cosines in the stroma, of directions that come from outside."""
    low = safe_sqrt(1 - (indices.aqueous / indices.stroma) ** 2)
    return 2 * (cosine - low) / (1 - low) - 1


def nodes(n_abl: int, n_depth: int, n_albedo: int) -> np.ndarray:
    """Chebyshev nodes as (τ_A, τ, ω), shape (points, 3), the albedo's fastest."""
    albedos = (chebyshev_nodes(n_albedo) + 1) / 2
    points = grid_points([_depths(n_abl, DEEPEST_ABL), _depths(n_depth, DEEPEST), albedos])
    points[:, 2] *= most(points[:, 1])
    return points


def in_double(function, points: np.ndarray, outside: np.ndarray, indices: RefractiveIndices):
    """`function` of portions of points (τ_A, τ, ω), of cosines in the aqueous humour and of the
    indices: one program for all, in double precision.
    """
    with jax.enable_x64(True):
        wide = jax.tree.map(lambda n: jnp.asarray(np.asarray(n, np.float64)), indices)
        padded = np.pad(points, ((0, -len(points) % CHUNK), (0, 0)), mode="edge")
        parts = [
            jax.tree.map(np.asarray, function(jnp.asarray(part), jnp.asarray(outside), wide))
            for part in np.split(padded, len(padded) // CHUNK)
        ]
    return jax.tree.map(lambda *x: np.concatenate(x)[: len(points)], *parts)


def layers_at(points, indices: RefractiveIndices) -> Layers:
    """Layers of points (τ_A, τ, ω), one a wavelength."""
    abl, depth, albedo = points.T
    return Layers(abl, depth * (1 - albedo), depth * albedo, indices, indices.order())


def scattered(rng: np.random.Generator, count: int) -> np.ndarray:
    """Points (τ_A, τ, ω) off the nodes, where tissue may be and beyond."""
    abl = np.exp(rng.uniform(np.log(1e-4), np.log(5.0), count))
    depth = np.exp(rng.uniform(np.log(1e-3), np.log(DEEPEST), count))
    return np.stack([abl, depth, rng.random(count) * np.minimum(1, most(depth))], -1)


def outside_nodes(n: int, indices: RefractiveIndices) -> np.ndarray:
    """Chebyshev nodes of the stroma's cosines, as cosines in the aqueous humour."""
    ratio = float(indices.aqueous) / float(indices.stroma)
    low = np.sqrt(max(1 - ratio**2, 0.0))
    inside = low + (1 - low) * (chebyshev_nodes(n) + 1) / 2
    return np.sqrt(1 - (1 - inside**2) / ratio**2)


def _to_unit(depth, deepest: float):
    return jnp.log1p(depth / _KNEE) * (2 / np.log1p(deepest / _KNEE)) - 1


def _depths(n: int, deepest: float) -> np.ndarray:
    return _KNEE * np.expm1((chebyshev_nodes(n) + 1) / 2 * np.log1p(deepest / _KNEE))
