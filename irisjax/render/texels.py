"""What texels differ in, as nodes and coefficients of Chebyshev polynomials: pigment of the ABL,
thickness of the stroma, concentrations.

A response of the iris is computed at the nodes, turned into coefficients, and checked off them.
"""

import functools
import itertools
from typing import Any

import jax.numpy as jnp
import numpy as np
import scipy.linalg

from irisjax.numerics.interpolation import chebyshev_nodes
from irisjax.numerics.tucker import coefficients
from irisjax.render.products import from_unit, kept_products, scaled
from irisjax.render.steps import Once, simply
from irisjax.tissue.maps import Scales

_CHECKS = 24


def degrees_of(ranges: Scales, degrees: tuple[int, ...]) -> tuple[int, ...]:
    """Of `degrees`, one for each of the `Scales`, those of scales that vary."""
    return tuple(d for d, r in zip(degrees, ranges, strict=False) if r is not None)


def grid(degrees: tuple[int, ...]) -> np.ndarray:
    """Nodes of all scales that vary, on [−1, 1], shape (nodes, scales): as many as there are
    products; one where no scale varies.
    """
    return _fekete(degrees)[0]


@functools.lru_cache(maxsize=16)
def _fekete(degrees: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Nodes, and the matrix that turns values at them into coefficients of the products.

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
    """Points off the nodes that fill the box evenly, shape (points, scales)."""
    steps = np.asarray([0.7548, 0.5698, 0.8192, 0.3249])[: len(degrees)]
    return 2 * ((np.arange(_CHECKS)[:, None] + 0.5) * steps % 1) - 1


def scales_at_unit(unit, ranges: Scales) -> Scales:
    """Scales at places in [−1, 1] within their ranges, the last axis of `unit`."""
    found: list[Any] = [None] * len(ranges)
    varied = [i for i, r in enumerate(ranges) if r is not None]
    for k, i in enumerate(varied):
        found[i] = from_unit(ranges[i], unit[..., k])
    return Scales(*found)


def polynomials_of(
    scales: Scales, ranges: Scales, degrees: tuple[int, ...], once: Once = simply
) -> tuple[Any, ...]:
    """Polynomials of each scale that varies, at pixels; `degrees`: one for each that does."""
    names = [name for name, r in zip(Scales._fields, ranges, strict=True) if r is not None]
    some = [(s, r) for s, r in zip(scales, ranges, strict=True) if r is not None]
    return tuple(
        once(f"polynomials of {name}", scaled, *both, degree)
        for name, both, degree in zip(names, some, degrees, strict=True)
    )


def along(values, axis: int):
    """Chebyshev coefficients of values at nodes along an axis."""
    inverse = jnp.asarray(coefficients(values.shape[axis]), values.dtype)
    return jnp.moveaxis(jnp.tensordot(inverse, values, (1, axis)), 0, axis)


def of_products(values, degrees: tuple[int, ...]):
    """Coefficients of `products.basis` from values at `grid(degrees)`, shape (nodes, …).

    **Returns:** shape (products, …).
    """
    return jnp.tensordot(jnp.asarray(_fekete(degrees)[1], values.dtype), values, (1, 0))
