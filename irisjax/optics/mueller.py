"""Mueller matrices of turned frames, and Stokes vectors of filters.

Stokes vectors are (I, Q, U, V): Q is the intensity of the field along a ray's first axis less that
along its second, U that along the diagonal between them less that across it, V = 2 Im(E_1 E_2*)
with fields ∝ e^{−iωt}; the axes and the ray are right-handed in this order. [Chandrasekhar 1960,
Section 15]
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

_TO_STOKES = np.array([[1.0, 1, 0, 0], [1, -1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
_TO_INTENSITIES = np.linalg.inv(_TO_STOKES)


def rotation(angle: Float[Array, "*s"]) -> Float[Array, "*s 4 4"]:
    """Matrix into axes turned by `angle` (radians) from the first towards the second."""
    c, s = jnp.cos(2 * angle), jnp.sin(2 * angle)
    one, zero = jnp.ones_like(c), jnp.zeros_like(c)
    rows = ((one, zero, zero, zero), (zero, c, s, zero), (zero, -s, c, zero),
            (zero, zero, zero, one))  # fmt: skip
    return jnp.stack([jnp.stack(row, -1) for row in rows], -2)


def polarised_at(angle: Float[Array, "*s"]) -> Float[Array, "*s 4"]:
    """Stokes vector of intensity 1, polarised at `angle` from the first axis towards the second."""
    c, s = jnp.cos(2 * angle), jnp.sin(2 * angle)
    return jnp.stack([jnp.ones_like(c), c, s, jnp.zeros_like(c)], -1)


def stokes(matrix: Float[Array, "*s 4 4"]) -> Float[Array, "*s 4 4"]:
    """A matrix that acts on the intensities along both axes, U and V, as one on I, Q, U, V."""
    left, right = (jnp.asarray(x, matrix.dtype) for x in (_TO_STOKES, _TO_INTENSITIES))
    return left @ matrix @ right
