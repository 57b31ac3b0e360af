"""Cosine quadrature for layered media.

Integrands of plane-parallel transport have two troubles: square-root kinks at critical angles and
the factor exp(−τ/μ), flat to all orders at grazing. `cosine_rule` splits [0, 1] at the critical
cosines and takes, in each panel [a, b], the variable ν = √(μ² − a²), which is the cosine on the
*other* side of the interface up to a constant and removes the kink; ν is graded exponentially
towards grazing.
"""

from functools import lru_cache
from typing import TYPE_CHECKING, TypeAlias

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

# Grading of a panel that starts at grazing; found by a scan over maps and optical depths 1e-4 to
# 30.
_GRADING = 3.0
# Squared cosine at which a panel's start counts as far from grazing, where no grading is wanted.
_FAR = 0.05

if TYPE_CHECKING:
    AnyArray: TypeAlias = Array
else:
    AnyArray = Array | np.ndarray  # a rule of constants can be built on the host


class CosineRule(eqx.Module):
    """Nodes and weights for ∫₀¹ f(μ) dμ.

    **Fields:**

    - `cosine`: nodes μ, shape (n,), increasing.
    - `weight`: weights, shape (n,), summing to 1 (less the guided part where that is left out).
    - `excess`: μ² − c_k² for each critical c_k² handed in, shape (k, n), free of cancellation.
    - `omitted`: ∫ 2μ dμ over what was left out (the guided panel), 0 otherwise.
    - `starts`, `widths`: μ² at each panel's start and its extent in μ², shape (panels,).
    """

    cosine: Float[AnyArray, " n"]
    weight: Float[AnyArray, " n"]
    excess: Float[AnyArray, "k n"]
    omitted: Float[AnyArray, ""]
    starts: Float[AnyArray, " panels"]
    widths: Float[AnyArray, " panels"]

    @property
    def n_panels(self) -> int:
        """Number of panels, empty ones included."""
        return self.starts.shape[0]


@lru_cache(maxsize=64)
def gauss_legendre(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss–Legendre nodes and weights on [0, 1], as float64 NumPy arrays."""
    x, w = np.polynomial.legendre.leggauss(n)
    return (x + 1) / 2, w / 2


def conserving(rule: CosineRule) -> CosineRule:
    """The rule with weights corrected (by its own error) to integrate 1 and μ² exactly.

    Rayleigh scattering then conserves energy to rounding, whatever the number of nodes.
    """
    square = rule.cosine**2
    w = rule.weight
    m0, m2, m4 = w.sum(), w @ square, w @ square**2
    determinant = m0 * m4 - m2 * m2
    a = ((1 - m0) * m4 - (1 / 3 - m2) * m2) / determinant
    b = ((1 / 3 - m2) * m0 - (1 - m0) * m2) / determinant
    return eqx.tree_at(lambda r: r.weight, rule, w + w * (a + b * square))


def graded(x, start_squared, xp=jnp):
    """Map [0, 1] onto itself, dense near 0 if the panel starts near grazing; returns value and
    slope.

    g(x) = (e^{κy} − 1)/(e^κ − 1), y = (1−β)x² + βx, κ = 3(1−β) + β, β → 1 away from grazing.
    `xp` is `numpy` or `jax.numpy`.
    """
    beta = start_squared / (start_squared + _FAR)
    kappa = _GRADING * (1 - beta) + beta
    y = (1 - beta) * x * x + beta * x
    dy = 2 * (1 - beta) * x + beta
    return xp.expm1(kappa * y) / xp.expm1(kappa), kappa * xp.exp(kappa * y) / xp.expm1(kappa) * dy


def ungraded(g, start_squared, xp=jnp):
    """Inverse of `graded`: the x in [0, 1] with value g."""
    beta = start_squared / (start_squared + _FAR)
    kappa = _GRADING * (1 - beta) + beta
    y = xp.log1p(g * xp.expm1(kappa)) / kappa
    root = xp.sqrt(beta * beta + 4 * (1 - beta) * y)
    return 2 * y / (beta + root + xp.where(y == 0, 1.0, 0.0))


def cosine_rule(
    critical_squared: Float[Array, " k"],
    present: tuple[bool, ...],
    n: int,
    *,
    skip_guided: bool = False,
) -> CosineRule:
    """Quadrature over [0, 1] split at the critical cosines.

    **Arguments:**

    - `critical_squared`: c_k² of each interface, negative where it has no critical angle.
    - `present`: which of them can be positive, known before tracing; only those cost a panel. A
        panel that turns out empty has zero weights.
    - `n`: nodes of a rule of up to two panels; more, met only where indices are traced or extreme,
        take ¾n each.
    - `skip_guided`: leave out [0, min c_k], where every interface reflects totally, and report its
        measure in `omitted`; needs all `present`.
    """
    dtype = critical_squared.dtype
    breaks = [c for c, p in zip(critical_squared, present, strict=True) if p]
    zero = jnp.zeros((), dtype)
    starts = jnp.sort(jnp.clip(jnp.stack([zero, *breaks]), 0.0, 1.0))
    ends = jnp.append(starts[1:], jnp.ones((), dtype))
    panels = list(range(len(breaks) + 1))
    omitted = zero
    if skip_guided and all(present):
        omitted = starts[1]
        panels = panels[1:]
    m = n if len(panels) == 1 else max(2, n // 2 if len(panels) == 2 else n - n // 4)
    x64, w64 = gauss_legendre(m)
    x, w = jnp.asarray(x64, dtype), jnp.asarray(w64, dtype)
    cosines, weights, squares = [], [], []
    for i in panels:
        width_squared = ends[i] - starts[i]
        empty = width_squared <= 0
        width_squared = jnp.where(empty, 1.0, width_squared)
        g, dg = graded(x, starts[i])
        nu_squared = width_squared * g * g
        mu = jnp.sqrt(starts[i] + nu_squared)
        cosines.append(jnp.where(empty, 1.0, mu))
        weights.append(jnp.where(empty, 0.0, w * width_squared * g * dg / mu))
        squares.append(
            jnp.where(empty, 1.0, nu_squared)[None, :]
            + jnp.where(empty, 0.0, starts[i] - critical_squared)[:, None]
        )
    return CosineRule(
        cosine=jnp.concatenate(cosines),
        weight=jnp.concatenate(weights),
        excess=jnp.concatenate(squares, axis=1),
        omitted=omitted,
        starts=starts[panels[0] :],
        widths=(ends - starts)[panels[0] :],
    )


def interpolation(rule: CosineRule, panel: int, mu, xp=jnp):
    """Values at `mu` (inside the panel) of the Lagrange polynomials of one panel's nodes,
    (*mu.shape, m).

    A panel interpolates in its own graded variable, in which the integrands are smooth.
    """
    m = rule.cosine.shape[0] // rule.n_panels
    x = gauss_legendre(m)[0]
    barycentric = np.array([1 / np.prod(4 * (x[j] - np.delete(x, j))) for j in range(m)])
    a, width = rule.starts[panel], rule.widths[panel]
    empty = width <= 0
    g2 = xp.where(empty, 0.25, xp.clip(mu * mu - a, 0.0, None) / xp.where(empty, 1.0, width))
    difference = ungraded(xp.sqrt(xp.where(g2 > 0, g2, 1e-30)), a, xp)[..., None] - x
    exact = difference == 0
    terms = barycentric / xp.where(exact, 1.0, difference)
    values = terms / terms.sum(-1, keepdims=True)
    return xp.where(exact.any(-1, keepdims=True), xp.where(exact, 1.0, 0.0), values)
