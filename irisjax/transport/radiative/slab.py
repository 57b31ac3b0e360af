"""Depth polynomials of a slab: light that sources in it send to each other and to its boundaries,
directly and by reflection at these.

Radiances along one direction are in [0, 1] of the slab's depth a piecewise polynomial (Legendre's,
a panel at a time) folded with exp(−xs), x = width/μ; all integrals are modified spherical Bessel
functions of x/2.
"""

from functools import lru_cache
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from irisjax.numerics import linear
from irisjax.numerics.quadrature import gauss_legendre
from irisjax.optics.fresnel import Shares
from irisjax.transport.process import attenuation, reflections, survival

# Light changes as τ ln τ beside both faces of a slab: panels grow from each face inwards.
_GROWTH = 4.0
Parity: TypeAlias = jax.Array | np.ndarray | int | float
"""A sign, or one a direction."""


class Images(NamedTuple):
    """Sums over the mirror images at a slab's boundaries, geometric series of shape (angles,).

    Attributes:
        series: 1/(1 − t² F F') with the survival t of one crossing and the reflectances F, F'.
        top: Share of light arriving at the top that enters again there.
        across: Share of light arriving at either boundary that enters again at the other.
        bottom: Share of light arriving at the bottom that enters again there.
    """

    series: jax.Array
    top: jax.Array
    across: jax.Array
    bottom: jax.Array


class Bounded(NamedTuple):
    """Integrals of the slab's depth polynomials along some directions, and the mirror images.

    Attributes:
        start: m_i = ∫φ_i e^{−xs} ds over a panel, shape (panels, orders, angles).
        emitted: x·m_i.
        from_top, from_bottom: Survival from a boundary of the slab to the panel (panels, angles).
        through: Survival of the whole slab, (angles,).
        images: See `Images`.
        cosine: Cosines of the directions.
    """

    start: jax.Array
    emitted: jax.Array
    from_top: jax.Array
    from_bottom: jax.Array
    through: jax.Array
    images: Images
    cosine: jax.Array


class Slab:
    """A layer cut into panels in depth, each with Legendre polynomials φ_i on [0, 1]."""

    def __init__(self, depth: jax.Array, n_depths: int, n_panels: int):
        width = fractions(n_panels)
        edges = np.concatenate([[0.0], np.cumsum(width)])
        self.depth: jax.Array = depth
        self.n_depths: int = n_depths
        self.n_panels: int = n_panels
        self.widths: jax.Array = depth * jnp.asarray(width, depth.dtype)
        self.tops: jax.Array = depth * jnp.asarray(edges[:-1], depth.dtype)
        self.below: jax.Array = depth * jnp.asarray(1 - edges[1:], depth.dtype)
        self.edges = edges
        # Of each order's polynomial, along the middle axis of (panels, orders, angles).
        order = np.arange(n_depths)[None, :, None]
        self._signs = jnp.asarray((-1.0) ** order, depth.dtype)
        self._norms = jnp.asarray(2.0 * order + 1, depth.dtype)

    def bounded(self, cosine: jax.Array, upper: Shares, lower: Shares) -> Bounded:
        """Integrals along directions (angles,), between boundaries that reflect and pass these
        shares of the flux.
        """
        return self.imaged(cosine, self.images(cosine, upper, lower))

    def images(self, cosine: jax.Array, upper: Shares, lower: Shares) -> Images:
        """Mirror images along directions (angles,), between boundaries as for `bounded`."""
        through, loss = survival(self.depth, cosine), attenuation(self.depth, cosine)
        series, _ = reflections(through, loss, upper, lower)
        across = upper[0] * series * (lower[0] * through)
        return Images(series, upper[0] * series, across, lower[0] * series)

    def imaged(self, cosine: jax.Array, images: Images) -> Bounded:
        """Integrals along directions (angles,) with these mirror images."""
        row = cosine[None, :]
        x = self.widths[:, None] / row
        start = _legendre_moments(x, 2 * self.n_depths)
        return Bounded(
            start=start,
            emitted=x[:, None, :] * start,
            from_top=jnp.exp(-self.tops[:, None] / row),
            from_bottom=jnp.exp(-self.below[:, None] / row),
            through=survival(self.depth, cosine),
            images=images,
            cosine=cosine,
        )

    def _sources(self, b: Bounded, parity):
        """Radiance of unit sources φ_j that leaves at the boundaries, and that enters again."""
        emitted = b.emitted[:, : self.n_depths]
        up = (_signed(parity, emitted) * b.from_top[:, None]).reshape(-1, b.cosine.size)
        down = (emitted * self._signs * b.from_bottom[:, None]).reshape(-1, b.cosine.size)
        top, across, bottom = (x[None, :] for x in b.images[1:])
        return up, down, top * up + across * down, across * up + bottom * down

    def _tests(self, b: Bounded):
        """Moments of radiance entering at the top and at the bottom, (panels·orders, angles)."""
        start = b.start[:, : self.n_depths] * self._norms
        return (
            (start * b.from_top[:, None]).reshape(-1, b.cosine.size),
            (start * self._signs * b.from_bottom[:, None]).reshape(-1, b.cosine.size),
        )

    def moments(self, b: Bounded, weight: jax.Array, f: jax.Array, parity: Parity) -> jax.Array:
        """Moments ∫ weight f_l φ_i I of the radiance that unit sources f_k φ_j make, a matrix
        over (rank, panels, orders); `f`: (rank, angles); `parity`: a number, or one an angle.
        """
        rank, panels, n = f.shape[0], self.n_panels, self.n_depths
        weighted = weight[None, :] * f
        out = self.moments_of_images(b, weight, f, parity)
        out = out.reshape(rank, panels, n, rank, panels, n)
        # A panel on itself: ∫∫ φ_i(s) x e^{−x|s−s'|} φ_j(s') = 2 Σ_c overlap_ijc x m_c(x).
        overlap = jnp.asarray(
            2 * (2 * np.arange(n) + 1)[:, None, None] * _overlap(n), self.depth.dtype
        )
        terms = b.emitted @ (weighted[:, None] * f[None]).reshape(rank * rank, -1).T
        terms = jnp.einsum("ijc,pclk->plikj", overlap, terms.reshape(panels, 2 * n, rank, rank))
        for p in range(panels):
            out = out.at[:, p, :, :, p, :].add(terms[p])
        # One panel on another: what leaves the one, thinned by the gap.
        start, emitted = b.start[:, :n] * self._norms, b.emitted[:, :n]
        mirrored_start, mirrored = self._signs * start, self._signs * emitted
        for separation in range(1, panels):
            upper = np.arange(panels - separation)
            lower = upper + separation
            gap = self.depth * jnp.asarray(
                self.edges[lower] - self.edges[upper + 1], self.depth.dtype
            )
            transmission = jnp.exp(-gap[:, None, None] / b.cosine[None, None, :])
            attenuated = weighted[None] * transmission
            pairs = jax.vmap(_between, in_axes=(0, 0, None, 0))
            down = pairs(attenuated, start[lower], f, mirrored[upper])
            up = pairs(attenuated, mirrored_start[upper], f, emitted[lower])
            shape = (panels - separation, rank, n, rank, n)
            out = out.at[:, lower, :, :, upper, :].add(down.reshape(shape))
            out = out.at[:, upper, :, :, lower, :].add(up.reshape(shape))
        return out.reshape(rank * panels * n, rank * panels * n)

    def moments_of_images(
        self, b: Bounded, weight: jax.Array, f: jax.Array, parity: Parity
    ) -> jax.Array:
        """The part of `moments` that the boundaries reflect."""
        _, _, downward, upward = self._sources(b, parity)
        entering_top, entering_bottom = self._tests(b)
        entering = jnp.concatenate([entering_top, _signed(parity, entering_bottom)], axis=-1)
        outgoing = jnp.concatenate([downward, upward], axis=-1)
        return _between(jnp.tile(weight[None, :] * f, 2), entering, jnp.tile(f, 2), outgoing)

    def driving_each(self, b: Bounded, parity: Parity) -> jax.Array:
        """Moments of beams of radiance 1 that enter at the top, (panels·orders, beams)."""
        entering_top, entering_bottom = self._tests(b)
        upward = _signed(parity, b.through) * b.images.bottom
        return b.images.series[None, :] * entering_top + upward[None, :] * entering_bottom

    def leaving_each(self, b: Bounded, parity: Parity) -> tuple[jax.Array, jax.Array]:
        """Radiance of unit sources at the top and at the bottom, (panels·orders, angles)."""
        up, down, downward, upward = self._sources(b, parity)
        through = b.through[None, :]
        return up + through * upward, down + through * downward

    def leaving_of_images_each(self, b: Bounded, parity: Parity) -> tuple[jax.Array, jax.Array]:
        """The part of `leaving_each` that the boundaries reflect."""
        _, _, downward, upward = self._sources(b, parity)
        return b.through[None, :] * upward, b.through[None, :] * downward

    def leaving(self, b: Bounded, source: jax.Array, parity: Parity) -> tuple[jax.Array, jax.Array]:
        """Radiance of sources (angles, panels·orders) at the top and at the bottom, (angles,)."""
        top, bottom = self.leaving_each(b, parity)
        return (source.T * top).sum(0), (source.T * bottom).sum(0)

    def total(self, moments: jax.Array) -> jax.Array:
        """Integral over the slab's depth of moments (panels·orders, …)."""
        return self.widths @ moments[:: self.n_depths]

    def solve(
        self, system: jax.Array, right: jax.Array, balance: jax.Array, lost_beam: jax.Array
    ) -> jax.Array:
        """Solve with the slab's balance of energy, balance·x = lost_beam, in place of one row.

        `right` has a column, `lost_beam` a number for each beam. The balance is a sum of the rows,
        so nothing changes mathematically; in a thick slab that hardly absorbs, the rows' own sum
        would be lost in rounding. What rounding is left is scaled away.
        """
        empty = self.depth <= 0
        scale = 1 / jnp.where(empty, 1.0, self.depth)
        row = self.n_panels // 2 * self.n_depths  # the mean over the thickest panel
        system = system.at[row].set(jnp.where(empty, system[row], balance * scale))
        right = right.at[row].set(jnp.where(empty, right[row], lost_beam * scale))
        # Eliminated last, where a small pivot is the small loss of light that it stands for.
        order = np.append(np.delete(np.arange(right.shape[0]), row), row)
        x = linear.solve(system[order][:, order], right[order])[np.argsort(order)]
        loss = balance @ x
        # Of less light the quotient's derivative would underflow.
        dark = loss <= jnp.finfo(loss.dtype).tiny ** 0.5
        return x * jnp.where(dark, 1.0, lost_beam / jnp.where(dark, 1.0, loss))[None, :]


def _signed(parity, x):
    """x times one sign, or one a direction."""
    return (jnp.reshape(parity, (1,) * (x.ndim - 1) + (-1,)) if jnp.ndim(parity) else parity) * x


def _between(f, received, g, sent):
    """Σ_a f_l received_i g_k sent_j as a matrix over (l, i) and (k, j)."""
    left = (f[:, None] * received[None]).reshape(-1, f.shape[-1])
    return left @ (g[:, None] * sent[None]).reshape(-1, g.shape[-1]).T


def fractions(n_panels: int) -> np.ndarray:
    """Shares of the depth that each panel takes."""
    panel = np.arange(n_panels)
    widths = _GROWTH ** np.minimum(panel, panel[::-1])
    return widths / widths.sum()


def _legendre_moments(x, count: int):
    """m_k(x) = ∫₀¹ φ_k(s) e^{−xs} ds = (−1)^k e^{−x/2} i_k(x/2), shape (panels, count, angles).

    Modified spherical Bessel functions by the recurrence that is stable: for thin panels downwards,
    on j_k = (2k+1)!! i_k(z)/z^k, which neither over- nor underflows; for thick ones upwards. No
    divisions.
    """
    z = x / 2
    thick = z > 50.0
    z_thin, inverse = jnp.where(thick, 1.0, z), 1 / jnp.where(thick, z, 100.0)
    top = count + 14
    square = z_thin * z_thin
    j_k, j_k1 = jnp.ones_like(z), (2 * top + 3) / (top + 1 + jnp.sqrt((top + 1.5) ** 2 + square))
    thin = []
    for k in range(top, 0, -1):
        j_k, j_k1 = j_k + square * (1 / ((2 * k + 1) * (2 * k + 3))) * j_k1, j_k
        if k <= count:
            thin.append(j_k)
    thin.reverse()
    first = mean_survival(x)
    power = first / thin[0]
    # coth z is 1 to the last bit here.
    previous, last = first, -first * (1 - inverse)
    moments = [first]
    for k in range(1, count):
        power = -power * z_thin * (1 / (2 * k + 1))
        moments.append(jnp.where(thick, last, power * thin[k]))
        previous, last = last, previous + (2 * k + 1) * inverse * last
    return jnp.stack(moments, axis=-2)


def mean_survival(x: jax.Array) -> jax.Array:
    """(1 − e^{−x})/x, with a gradient that is right at small x too."""
    small, series = _absence_of_small(x)
    z = jnp.where(small, 1.0, x)
    return jnp.where(small, 1 - series, -jnp.expm1(-z) / z)


def mean_absence(x: jax.Array) -> jax.Array:
    """1 − (1 − e^{−x})/x without cancellation."""
    small, series = _absence_of_small(x)
    return jnp.where(small, series, 1 - mean_survival(jnp.where(small, 1.0, x)))


def _absence_of_small(x):
    """Whether x is small, and its `mean_absence` as a series if it is."""
    small = x < 0.1
    y, series = jnp.where(small, x, 0.0), 0.0
    for k in range(8, 1, -1):
        series = y / k * (1 - series)
    return small, series


@lru_cache(maxsize=16)
def _overlap(n: int) -> np.ndarray:
    """½∫[φ_i(s+r)φ_j(s) + φ_i(s)φ_j(s+r)] ds over 0 ≤ s ≤ 1−r as Σ_k overlap[i, j, k] φ_k(r)."""

    def legendre(count, s):
        return np.polynomial.legendre.legvander(2 * s - 1, count - 1).T

    r, w_r = gauss_legendre(2 * n + 2)
    s, w_s = gauss_legendre(n + 2)
    phi_r = legendre(2 * n, r) * (2 * np.arange(2 * n) + 1)[:, None]
    out = np.zeros((n, n, 2 * n))
    for q in range(r.size):
        inner, weight = s * (1 - r[q]), w_s * (1 - r[q])
        product = (legendre(n, inner + r[q]) * weight) @ legendre(n, inner).T
        out += 0.5 * (product + product.T)[..., None] * phi_r[:, q] * w_r[q]
    return out
