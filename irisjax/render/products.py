"""Products of Chebyshev polynomials in a few numbers at once: pigment, thickness, concentrations.

Those of high degree in several numbers at once hold nothing of a smooth function and are left out.
"""

import functools
import itertools

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from irisjax.numerics.interpolation import chebyshev


def basis(scales, like):
    """Products of the polynomials of all scales that are kept; one, `like` an array, where there
    are none.
    """
    if not scales:
        return jnp.ones_like(like)[None]
    rows = [
        functools.reduce(jnp.multiply, [t[k] for t, k in zip(scales, term, strict=True)])
        for term in kept_products(tuple(len(t) - 1 for t in scales))
    ]
    return jnp.stack(rows)


def kept_products(degrees: tuple[int, ...]) -> list[tuple[int, ...]]:
    """Degrees of the factors of the products that are kept: relative to the most of each, they add
    up to one.
    """
    every = itertools.product(*(range(d + 1) for d in degrees))
    return [
        term for term in every if sum(k / d for k, d in zip(term, degrees, strict=True)) < 1 + 1e-9
    ]


def summed(coefficients, scales, factors) -> Float[Array, "channels pixels"]:
    """Sum of `coefficients`, (products, last, channels), times the products of polynomials of the
    scales and times `factors`, (tints, last, pixels).
    """
    products, last, channels = coefficients.shape
    # One matrix product: 50 times as fast as polynomial by polynomial.
    whole = coefficients.reshape(products, last * channels).T
    values = (whole @ basis(scales, factors[0, 0])).reshape(last, channels, -1)
    # One after the other: XLA's sum over an axis that is not the last outlasts the product.
    return functools.reduce(jnp.add, [v * factors[:, k] for k, v in enumerate(values)])


@eqx.filter_jit
def scaled(scale, span, degree: int):
    """Polynomials up to `degree` of a scale that runs over `span`."""
    return polynomials(to_unit(span, scale), degree + 1)


def polynomials(x: Float[Array, " pixels"], count: int) -> Float[Array, "count pixels"]:
    """T₀ … of x in [−1, 1]."""
    return jnp.stack(chebyshev(x, max(count, 2))[0][:count])


# The response changes fast where a layer is thin: equal steps in the logarithm of one plus a few
# times the scale.
_BEND = 3.0


def from_unit(span, x):
    """Scale within `span` at x in [−1, 1]."""
    low, high = (jnp.log1p(_BEND * s) for s in span)
    return jnp.expm1(low + (x + 1) * ((high - low) / 2)) / _BEND


def to_unit(span, scale):
    """Place of a scale in [−1, 1], of those outside `span` its ends."""
    low, high = (jnp.log1p(_BEND * s) for s in span)
    return jnp.clip((jnp.log1p(_BEND * scale) - low) * (2 / (high - low)) - 1, -1, 1)
