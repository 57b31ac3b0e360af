"""Smooth functions of a few numbers as tables: Chebyshev polynomials along each axis, compressed.

Along an axis a handful of combinations of the polynomials hold what many polynomials do; what is
left is a small core tensor [Tucker 1966, Psychometrika 31, 279; De Lathauwer, De Moor & Vandewalle
2000, SIAM J. Matrix Anal. Appl. 21, 1253].
"""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from irisjax.numerics.interpolation import chebyshev_nodes, chebyshev_series


class Tucker(eqx.Module):
    """A table of functions of several coordinates in [−1, 1], such as
    `experiments.radiative_table` makes.

    Attributes:
        factors: Weights of the polynomials along each axis, shape (polynomials, rank).
        core: Shape (rank of each axis …, functions).
    """

    factors: tuple[Float[Array, "_ _"], ...]
    core: Float[Array, "..."]

    def basis(self, axis: int, x: Float[Array, " points"]) -> Float[Array, "rank points"]:
        """The functions of one axis at its coordinate."""
        return chebyshev_series(self.factors[axis], x)


def coefficients(nodes: int) -> np.ndarray:
    """The matrix from values at Chebyshev nodes to the weights of the polynomials."""
    return np.linalg.inv(np.polynomial.chebyshev.chebvander(chebyshev_nodes(nodes), nodes - 1))
