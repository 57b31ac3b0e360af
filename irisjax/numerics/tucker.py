"""Smooth functions of a few numbers as tables: Chebyshev polynomials along each axis, compressed.

Along an axis a handful of combinations of the polynomials hold what many polynomials do; what is
left is a small core tensor [Tucker 1966, Psychometrika 31, 279; De Lathauwer, De Moor & Vandewalle
2000, SIAM J. Matrix Anal. Appl. 21, 1253].
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from irisjax.numerics.interpolation import chebyshev_nodes, chebyshev_series


class Tucker(eqx.Module):
    """A table of functions of several coordinates in [−1, 1].

    Attributes:
        factors: Weights of the polynomials along each axis, shape (polynomials, rank).
        core: Shape (rank of each axis …, functions).
    """

    factors: tuple[Float[Array, "_ _"], ...]
    core: Float[Array, "..."]

    @classmethod
    def of(cls, values: np.ndarray, tolerance: float, dtype: DTypeLike) -> "Tucker":
        """Compress values at `chebyshev_nodes` of every axis, shape (nodes of each …, functions).

        Each function is scaled by its largest value for the choice of ranks; what is left out of an
        axis is below `tolerance` in the mean square.
        """
        values = np.asarray(values, np.float64)
        *shape, _ = values.shape
        largest = np.abs(values).reshape(-1, values.shape[-1]).max(axis=0)
        scaled = values / np.where(largest > 0, largest, 1.0)
        for axis, nodes in enumerate(shape):
            scaled = _apply_along(scaled, axis, coefficients(nodes))
        factors, core = [], scaled
        size = np.sqrt(np.sum(scaled**2))
        for axis in range(len(shape)):
            unfolded = np.moveaxis(scaled, axis, 0).reshape(shape[axis], -1)
            left, weights, _ = np.linalg.svd(unfolded, full_matrices=False)
            tail = np.sqrt(np.cumsum(weights[::-1] ** 2)[::-1])
            rank = max(1, int((tail > tolerance * size).sum()))
            factors.append(left[:, :rank])
            core = _apply_along(core, axis, left[:, :rank].T)
        core = core * largest
        return cls(tuple(jnp.asarray(f, dtype) for f in factors), jnp.asarray(core, dtype))

    def basis(self, axis: int, x: Float[Array, " points"]) -> Float[Array, "rank points"]:
        """The functions of one axis at its coordinate."""
        return chebyshev_series(self.factors[axis], x)


def coefficients(nodes: int) -> np.ndarray:
    """The matrix from values at Chebyshev nodes to the weights of the polynomials."""
    return np.linalg.inv(np.polynomial.chebyshev.chebvander(chebyshev_nodes(nodes), nodes - 1))


def grid_points(axes: Sequence[np.ndarray]) -> np.ndarray:
    """All combinations of the axes' nodes, shape (points, axes), the last axis fastest."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def _apply_along(values: np.ndarray, axis: int, matrix: np.ndarray) -> np.ndarray:
    return np.moveaxis(np.tensordot(matrix, values, axes=(1, axis)), 0, axis)
