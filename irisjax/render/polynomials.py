"""What texels differ in, as nodes and coefficients of products of Chebyshev polynomials: pigment of
the ABL, thickness of the stroma, concentrations.

A response of the iris is computed at the nodes, turned into coefficients, and checked off them.
Products of high degree in several numbers at once hold nothing of a smooth function and are left
out.
"""

import functools
import itertools
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Float

from irisjax.numerics.interpolation import chebyshev, chebyshev_nodes
from irisjax.numerics.tucker import coefficients
from irisjax.tissue.maps import Scales

_CHECKS = 24


def degrees_of(ranges: Scales, degrees: tuple[int, ...]) -> tuple[int, ...]:
    """Of `degrees`, one for each of the `Scales`, those of scales that vary."""
    return tuple(d for d, r in zip(degrees, ranges, strict=False) if r is not None)


@functools.lru_cache(maxsize=16)
def scale_nodes(degrees: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of all scales that vary, on [−1, 1], shape (nodes, scales), as many as there are
    products (one where no scale varies); and the matrix from values at them to coefficients of the
    products.

    Of all combinations of Chebyshev nodes those that pivoted QR finds most independent,
    approximate Fekete points [Sommariva & Vianello 2009]: a table of few products is made by few
    solutions of the iris.
    """
    every = np.array(list(itertools.product(*(chebyshev_nodes(d + 1) for d in degrees))))
    terms = np.array(kept_products(degrees), int)  # (products, scales)
    products = np.ones((len(every), len(terms)))
    for x, d, k in zip(every.T, degrees, terms.T, strict=True):
        products *= np.polynomial.chebyshev.chebvander(x, d)[:, k]
    found: Any = scipy.linalg.qr(products.T, mode="r", pivoting=True)
    chosen = np.sort(found[1][: len(terms)])
    return every[chosen], np.linalg.inv(products[chosen])


def between(degrees: tuple[int, ...]) -> np.ndarray:
    """Points off the nodes that fill the box evenly, shape (points, scales); one where no scale
    varies.
    """
    steps = np.asarray([0.7548, 0.5698, 0.8192, 0.3249])[: len(degrees)]
    return 2 * ((np.arange(_CHECKS if degrees else 1)[:, None] + 0.5) * steps % 1) - 1


def scales_at_unit(unit: Float[Array, "*s varied"], ranges: Scales) -> Scales:
    """Scales at places in [−1, 1] within their ranges, the last axis of `unit`."""
    places = iter(jnp.moveaxis(unit, -1, 0))
    return Scales(*(None if span is None else from_unit(span, next(places)) for span in ranges))


def scale_places(scales: Scales, ranges: Scales) -> tuple[Float[Array, " pixels"], ...]:
    """Places in [−1, 1] of the scales that vary, at pixels."""
    pairs = zip(scales, ranges, strict=True)
    return tuple(to_unit(span, s) for s, span in pairs if span is not None)


def polynomials_of(
    units: Sequence[Float[Array, " pixels"]], degrees: tuple[int, ...]
) -> tuple[Float[Array, "_ pixels"], ...]:
    """Polynomials at places in [−1, 1], for each scale that varies up to its degree."""
    return tuple(polynomials(x, d + 1) for x, d in zip(units, degrees, strict=True))


def along_nodes(values: Float[Array, "..."], axis: int) -> Float[Array, "..."]:
    """Chebyshev coefficients of values at nodes along an axis."""
    inverse = jnp.asarray(coefficients(values.shape[axis]), values.dtype)
    return jnp.moveaxis(jnp.tensordot(inverse, values, (1, axis)), 0, axis)


def of_products(
    values: Float[Array, "nodes ..."], degrees: tuple[int, ...]
) -> Float[Array, "products ..."]:
    """Coefficients of `basis` from values at `scale_nodes(degrees)`."""
    return jnp.tensordot(jnp.asarray(scale_nodes(degrees)[1], values.dtype), values, (1, 0))


def basis(
    scales: Sequence[Float[Array, "_ pixels"]], like: Float[Array, "..."]
) -> Float[Array, "products pixels"]:
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


def summed(
    coefficients: Float[Array, "products last channels"],
    scales: Sequence[Float[Array, "_ pixels"]],
    factors: Float[Array, "tints last pixels"],
) -> Float[Array, "shown pixels"]:
    """Sum of the coefficients times the products of polynomials of the scales and times factors;
    either the channels or the tints may be one for all of the others.
    """
    products, last, channels = coefficients.shape
    # One matrix product: 50 times as fast as polynomial by polynomial.
    whole = coefficients.reshape(products, last * channels).T
    values = (whole @ basis(scales, factors[0, 0])).reshape(last, channels, -1)
    # One after the other: XLA's sum over an axis that is not the last outlasts the product.
    return functools.reduce(jnp.add, [v * factors[:, k] for k, v in enumerate(values)])


def polynomials(x: Float[Array, " pixels"], count: int) -> Float[Array, "count pixels"]:
    """T₀ … of x in [−1, 1]."""
    return jnp.stack(chebyshev(x, max(count, 2))[0][:count])


# The response changes fast where a layer is thin: equal steps in the logarithm of one plus a few
# times the scale.
BEND = 3.0


def from_unit(span: Float[Array, "2"], x: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """Scale within `span` at x in [−1, 1]."""
    low, high = (jnp.log1p(BEND * s) for s in span)
    return jnp.expm1(low + (x + 1) * ((high - low) / 2)) / BEND


def to_unit(span: Float[Array, "2"], scale: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """Place of a scale in [−1, 1], of those outside `span` its ends."""
    low, high = (jnp.log1p(BEND * s) for s in span)
    return jnp.clip((jnp.log1p(BEND * scale) - low) * (2 / (high - low)) - 1, -1, 1)
