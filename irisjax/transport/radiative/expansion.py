"""Phase functions as series of Legendre functions, on directions."""

import jax
import jax.numpy as jnp
import numpy as np

from irisjax.numerics.roots import safe_sqrt
from irisjax.optics.mixture import PhaseMixture
from irisjax.transport.radiative.doubling import Lines


def legendre(count: int, orders, cosine):
    """P_l^m √((l − m)!/(l + m)!) at cosines, shape (orders, l = 0 to count − 1, cosines); 0 where
    l < m.  [Chandrasekhar 1960, Section 48]
    """
    orders = np.asarray(orders)
    sine = safe_sqrt(1 - cosine * cosine)
    powers = [jnp.ones_like(cosine)]
    for k in range(1, int(orders.max()) + 1):
        powers.append(powers[-1] * sine * float(np.sqrt((2 * k - 1) / (2 * k))))
    first = jnp.stack([powers[m] for m in orders])
    degree, m = np.arange(count)[:, None], orders[None]
    rises = np.maximum(degree**2 - m**2, 1)
    a = (2 * degree - 1) / np.sqrt(rises)
    b = np.sqrt(np.maximum((degree - 1) ** 2 - m**2, 0) / rises)
    steps = np.where(degree > m, a, 0.0), np.where(degree > m, b, 0.0), 1.0 * (degree == m)

    def step(known, factors):
        before, last = known
        a, b, starts = (f[:, None] for f in factors)
        now = a * cosine[None] * last - b * before + starts * first
        return (last, now), now

    steps = tuple(jnp.asarray(x, first.dtype) for x in steps)
    found = jax.lax.scan(step, (jnp.zeros_like(first), jnp.zeros_like(first)), steps)[1]
    return jnp.swapaxes(found, 0, 1)


def phase_matrices(moments, orders, lines: Lines):
    """Σ (2l + 1) χ_l Λ_l(μ) Λ_l(±μ') of azimuthal orders, light that keeps its sense of travel and
    light that turns back, each (orders, rows, columns).

    Of order 0 each column is made to send out what it gets, to rounding: a quadrature of few nodes
    misses some of a peaked phase function.
    """
    count, n = moments.shape[-1], lines.nodes
    degree, orders = np.arange(count), np.asarray(orders)
    both = legendre(count, orders, jnp.concatenate([lines.rows, lines.columns]))
    rows, columns = jnp.split(both, [lines.rows.size], axis=-1)
    weighted = _weighted(moments)[None, :, None] * columns
    sign = jnp.asarray((-1.0) ** (degree[None] + orders[:, None]), moments.dtype)[..., None]
    back = jnp.swapaxes(rows, 1, 2)
    same, opposite = back @ weighted, back @ (sign * weighted)
    if orders[0]:
        return same, opposite
    weight = lines.weight[:n]
    missed = 1 - 0.5 * weight @ (same + opposite)[0, :n]
    same = same.at[0, np.arange(n), np.arange(n)].add(2 * missed[:n] / weight)
    lost = missed[n:] / (0.5 * weight @ same[0, :n, n:])
    return same.at[0, :, n:].multiply(1 + lost[None]), opposite


def mean_turned(phase: PhaseMixture, rows, columns):
    """Mean over azimuth of a phase function for light that turns back, of cosines `columns` into
    cosines `rows`; shape (rows, columns).
    """
    sideways = safe_sqrt(1 - rows**2)[:, None] * safe_sqrt(1 - columns**2)[None]
    return phase.mean_over_azimuth(-rows[:, None] * columns[None], sideways)


def series_value(moments, cosine):
    """Σ (2l + 1) χ_l P_l at cosines of the scattering angle, shape (cosines,)."""
    count = moments.shape[-1]
    return _weighted(moments) @ legendre(count, [0], cosine)[0]


def _weighted(moments):
    return jnp.asarray(2 * np.arange(moments.shape[-1]) + 1, moments.dtype) * moments
