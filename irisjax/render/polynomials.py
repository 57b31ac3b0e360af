"""Products of Chebyshev polynomials in the numbers that texels differ in: pigment of the ABL,
thickness of the stroma, concentrations.

A response of the iris is computed at the nodes, turned into coefficients, and checked between the
nodes. Products of high degree in several numbers at once contribute nothing to a smooth function
and are left out.
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

_CHECK_COUNT = 24  # points between the nodes at which a table is compared with its solver


def varying_degrees(ranges: Scales, degrees: tuple[int, ...]) -> tuple[int, ...]:
    """Return the degrees of those scales that vary; `degrees` has one for each of the `Scales`."""
    return tuple(d for d, r in zip(degrees, ranges, strict=False) if r is not None)


@functools.lru_cache(maxsize=16)
def scale_nodes(degrees: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Choose interpolation nodes in the scales that vary.

    Of all combinations of Chebyshev nodes those are kept that pivoted QR finds most independent,
    approximate Fekete points [Sommariva & Vianello 2009]: a table of few products then takes few
    solutions of the iris.

    Returns:
        The nodes on [−1, 1], shape (nodes, scales), as many as there are products (one where no
        scale varies), and the matrix from values at them to coefficients of the products.
    """
    grid = np.array(list(itertools.product(*(chebyshev_nodes(d + 1) for d in degrees))))
    terms = np.array(product_degrees(degrees), int)  # (products, scales)
    products = np.ones((len(grid), len(terms)))
    for x, d, k in zip(grid.T, degrees, terms.T, strict=True):
        products *= np.polynomial.chebyshev.chebvander(x, d)[:, k]
    pivoted: Any = scipy.linalg.qr(products.T, mode="r", pivoting=True)
    chosen = np.sort(pivoted[1][: len(terms)])
    return grid[chosen], np.linalg.inv(products[chosen])


def check_points(degrees: tuple[int, ...]) -> np.ndarray:
    """Return points between the nodes that fill [−1, 1] in each scale evenly, shape (points,
    scales); one point where no scale varies.
    """
    steps = np.asarray([0.7548, 0.5698, 0.8192, 0.3249])[: len(degrees)]
    return 2 * ((np.arange(_CHECK_COUNT if degrees else 1)[:, None] + 0.5) * steps % 1) - 1


def scales_from_unit(unit: Float[Array, "*s varied"], ranges: Scales) -> Scales:
    """Map coordinates in [−1, 1], the last axis of `unit`, to scales within their ranges."""
    x = iter(jnp.moveaxis(unit, -1, 0))
    return Scales(*(None if span is None else scale_from_unit(span, next(x)) for span in ranges))


def scales_to_unit(scales: Scales, ranges: Scales) -> tuple[Float[Array, " pixels"], ...]:
    """Map the scales that vary to coordinates in [−1, 1]."""
    pairs = zip(scales, ranges, strict=True)
    return tuple(scale_to_unit(span, s) for s, span in pairs if span is not None)


def scale_polynomials(
    units: Sequence[Float[Array, " pixels"]], degrees: tuple[int, ...]
) -> tuple[Float[Array, "_ pixels"], ...]:
    """Evaluate the polynomials of each scale that varies, up to its degree, at coordinates in
    [−1, 1].
    """
    return tuple(chebyshev_polynomials(x, d + 1) for x, d in zip(units, degrees, strict=True))


def chebyshev_coefficients(values: Float[Array, "..."], axis: int) -> Float[Array, "..."]:
    """Compute Chebyshev coefficients from values at nodes along an axis."""
    inverse = jnp.asarray(coefficients(values.shape[axis]), values.dtype)
    return jnp.moveaxis(jnp.tensordot(inverse, values, (1, axis)), 0, axis)


def product_coefficients(
    values: Float[Array, "nodes ..."], degrees: tuple[int, ...]
) -> Float[Array, "products ..."]:
    """Compute coefficients of `product_basis` from values at `scale_nodes(degrees)`."""
    return jnp.tensordot(jnp.asarray(scale_nodes(degrees)[1], values.dtype), values, (1, 0))


def product_basis(
    polynomials: Sequence[Float[Array, "_ pixels"]], like: Float[Array, "..."]
) -> Float[Array, "products pixels"]:
    """Multiply the polynomials of all scales, for the products that are kept; without scales the
    only product is one, of the shape of `like`.
    """
    if not polynomials:
        return jnp.ones_like(like)[None]
    rows = []
    for term in product_degrees(tuple(len(values) - 1 for values in polynomials)):
        factors = [values[k] for values, k in zip(polynomials, term, strict=True)]
        rows.append(functools.reduce(jnp.multiply, factors))
    return jnp.stack(rows)


def product_degrees(degrees: tuple[int, ...]) -> list[tuple[int, ...]]:
    """List the products that are kept by their factors' degrees, whose sum relative to `degrees`
    is at most one.
    """
    terms = itertools.product(*(range(d + 1) for d in degrees))
    return [
        term for term in terms if sum(k / d for k, d in zip(term, degrees, strict=True)) < 1 + 1e-9
    ]


def evaluate_products(
    coefficients: Float[Array, "products functions channels"],
    polynomials: Sequence[Float[Array, "_ pixels"]],
    factors: Float[Array, "tints functions pixels"],
) -> Float[Array, "shown pixels"]:
    """Sum coefficients times products of the scales' polynomials, times factors.

    Args:
        coefficients: Coefficients of each product with each factor, in each channel.
        polynomials: `scale_polynomials` at the pixels.
        factors: Factors at the pixels, such as functions of directions times light. One tint
            serves all channels, and one channel all tints.
    """
    products, functions, channels = coefficients.shape
    # One matrix product: 50 times as fast as polynomial by polynomial.
    matrix = coefficients.reshape(products, functions * channels).T
    values = (matrix @ product_basis(polynomials, factors[0, 0])).reshape(functions, channels, -1)
    # Added one by one: XLA's sum over an axis that is not the last takes longer than the product.
    return functools.reduce(jnp.add, [v * factors[:, k] for k, v in enumerate(values)])


def chebyshev_polynomials(x: Float[Array, " pixels"], count: int) -> Float[Array, "count pixels"]:
    """Evaluate the first `count` Chebyshev polynomials, from T₀ on, at x in [−1, 1]."""
    return jnp.stack(chebyshev(x, max(count, 2))[0][:count])


BEND = 3.0
"""Factor in log(1 + `BEND` s), in whose equal steps a scale s is sampled: the response changes fast
where a layer is thin.
"""


def scale_from_unit(span: Float[Array, "2"], x: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """Map a coordinate in [−1, 1] to a scale within `span`."""
    low, high = (jnp.log1p(BEND * s) for s in span)
    return jnp.expm1(low + (x + 1) * ((high - low) / 2)) / BEND


def scale_to_unit(span: Float[Array, "2"], scale: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """Map a scale to its coordinate in [−1, 1]; scales outside `span` are clipped."""
    low, high = (jnp.log1p(BEND * s) for s in span)
    return jnp.clip((jnp.log1p(BEND * scale) - low) * (2 / (high - low)) - 1, -1, 1)
