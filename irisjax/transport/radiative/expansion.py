"""Phase functions as series of Legendre functions, on directions."""

import jax
import jax.numpy as jnp
import numpy as np

from irisjax._types import Real, Reals
from irisjax.numerics.roots import safe_sqrt
from irisjax.optics.mixture import PhaseMixture, mean_henyey_greenstein
from irisjax.transport.radiative.doubling import Lines

_KEPT = 4  # moments of a phase function that its values at the nodes have to the last digit
_FINE = 64  # nodes that hold them exactly, for |g| up to 0.95


def legendre(count: int, orders: Reals, cosine: jax.Array) -> jax.Array:
    """P_l^m √((l − m)!/(l + m)!) at cosines, shape (orders, l = 0 to count − 1, cosines); 0 where
    l < m.  [Chandrasekhar 1960, Section 48]
    """
    orders = np.asarray(orders)
    sine = safe_sqrt(1 - cosine * cosine)
    powers = [jnp.ones_like(cosine)]
    for k in range(1, int(orders.max()) + 1):
        powers.append(powers[-1] * sine * float(np.sqrt((2 * k - 1) / (2 * k))))
    diagonal = jnp.stack([powers[m] for m in orders])
    degree, m = np.arange(count)[:, None], orders[None]
    rises = np.maximum(degree**2 - m**2, 1)
    a = (2 * degree - 1) / np.sqrt(rises)
    b = np.sqrt(np.maximum((degree - 1) ** 2 - m**2, 0) / rises)
    steps = np.where(degree > m, a, 0.0), np.where(degree > m, b, 0.0), 1.0 * (degree == m)

    def step(state, factors):
        previous, last = state
        a, b, starts = (f[:, None] for f in factors)
        value = a * cosine[None] * last - b * previous + starts * diagonal
        return (last, value), value

    steps = tuple(jnp.asarray(x, diagonal.dtype) for x in steps)
    values = jax.lax.scan(step, (jnp.zeros_like(diagonal), jnp.zeros_like(diagonal)), steps)[1]
    return jnp.swapaxes(values, 0, 1)


def phase_matrices(
    phase: PhaseMixture, moments: jax.Array, peak: Real, orders: Reals, lines: Lines
) -> tuple[jax.Array, jax.Array]:
    """Azimuthal orders of a phase function without its forward peak, light that keeps its sense of
    travel and light that turns back, each (orders, rows, columns); the first order is 0.

    They are Σ (2l + 1) χ_l Λ_l(μ) Λ_l(±μ') with the `moments` χ_l, but that order 0 goes into the
    nodes by `_means`: `phase` less its share `peak`.
    """
    count, n = moments.shape[-1], lines.nodes
    degree, orders = np.arange(count), np.asarray(orders)
    polynomials = legendre(count, orders, jnp.concatenate([lines.rows, lines.columns]))
    rows, columns = jnp.split(polynomials, [lines.rows.size], axis=-1)
    weighted = _weighted(moments)[None, :, None] * columns
    sign = jnp.asarray((-1.0) ** (degree[None] + orders[:, None]), moments.dtype)[..., None]
    left = jnp.swapaxes(rows, 1, 2)
    same, opposite = left @ weighted, left @ (sign * weighted)
    same_0, opposite_0 = _means(phase, moments, peak, lines)
    return same.at[0, :n].set(same_0), opposite.at[0, :n].set(opposite_0)


def _means(phase: PhaseMixture, moments, peak, lines: Lines):
    """Mean over azimuth of a phase function into the nodes, light that keeps its sense of travel
    and light that turns back, each (nodes, columns).

    Far from its peak it is the phase function itself: there its series rings, by more than what
    little is scattered so far, and a thin slab sends back nothing else. Near the peak, which so few
    nodes do not resolve, it is what gives the first `_KEPT` moments over all directions, which
    thick slabs live by, and those over the directions that turn back, which thin ones do.
    [after Wiscombe 1976, who renormalises by the first moment, and Nakajima & Tanaka 1988]
    """
    n, dtype = lines.nodes, moments.dtype
    mu, weight, columns = lines.rows[:n], lines.weight[:n], lines.columns
    sin_row, sin_column = safe_sqrt(1 - mu**2)[:, None], safe_sqrt(1 - columns**2)[None]
    # Of light that keeps its sense of travel, and of light that turns back.
    sense = jnp.asarray([1.0, -1.0], dtype)[:, None, None]
    centre, amplitude = sense * (mu[:, None] * columns[None])[None], (sin_row * sin_column)[None]
    means = phase.mean_over_azimuth(centre, amplitude) / (1 - peak)

    row_basis, column_basis = legendre(_KEPT, [0], mu)[0], legendre(_KEPT, [0], columns)[0]
    x, w = np.polynomial.legendre.leggauss(_FINE)
    height = np.pi / 4 * (x + 1)
    fine, w = jnp.asarray(np.sin(height), dtype), np.pi / 8 * w * np.cos(height)
    fine_amplitude = jnp.asarray(np.cos(height), dtype)[:, None] * sin_column
    backward = phase.mean_over_azimuth(-fine[:, None] * columns[None], fine_amplitude) / (1 - peak)
    backward = (legendre(_KEPT, [0], fine)[0] * jnp.asarray(w, dtype)[None]) @ backward
    sign = jnp.asarray((-1.0) ** np.arange(_KEPT), dtype)[:, None]
    targets = jnp.stack([moments[:_KEPT, None] * column_basis - sign * backward, backward])

    # Corrections go where the peak is, but never to a single node alone.
    narrowest = 1 - 1 / n
    g = jnp.clip(phase.anisotropy, -narrowest, narrowest)
    kernel = mean_henyey_greenstein(centre, amplitude, g)
    kernel = (kernel / jax.lax.stop_gradient(kernel.max(1, keepdims=True))) ** 3
    collect = 0.5 * row_basis * weight[None]
    residuals = targets - jnp.einsum("li,sij->slj", collect, means)
    same, opposite = means + _correction(kernel, row_basis, weight, residuals)

    # Each column sends out what it gets, to rounding.
    deficit = 1 - 0.5 * weight @ (same + opposite)
    same = same.at[np.arange(n), np.arange(n)].add(2 * deficit[:n] / weight)
    scale = deficit[n:] / (0.5 * weight @ same[:, n:])
    return same.at[:, n:].multiply(1 + scale[None]), opposite


def _correction(kernel, basis, weight, residuals):
    """Find the values at nodes with half-range moments `residuals` (senses, moments, columns) whose
    mean square, divided by the weight `kernel` (senses, nodes, columns), is least.

    It uses orthogonal polynomials: beside a sharp peak the normal equations lose float32's digits.
    """
    root, orthogonal, values = jnp.sqrt(kernel * weight[None, :, None]), [], 0.0
    for order in range(_KEPT):
        v, m = root * basis[order][None, :, None], residuals[:, order]
        for q, moment in 2 * orthogonal:  # twice is enough
            overlap = (v * q).sum(1)
            v, m = v - overlap[:, None] * q, m - overlap * moment
        size = jnp.sqrt((v * v).sum(1))
        orthogonal.append((v / size[:, None], m / size))
        values = values + orthogonal[-1][0] * orthogonal[-1][1][:, None]
    return 2 * jnp.sqrt(kernel / weight[None, :, None]) * values


def series_value(moments: jax.Array, cosine: jax.Array) -> jax.Array:
    """Σ (2l + 1) χ_l P_l at cosines of the scattering angle, shape (cosines,)."""
    count = moments.shape[-1]
    return _weighted(moments) @ legendre(count, [0], cosine)[0]


def _weighted(moments):
    return jnp.asarray(2 * np.arange(moments.shape[-1]) + 1, moments.dtype) * moments
