"""Quadrature over [0, 1] of functions with square-root kinks and the factor exp(−τ/μ).

exp(−τ/μ) is flat to all orders at μ = 0, and a kink √(μ² − b²) has an infinite slope at its break
point b. `cosine_rule` splits [0, 1] at the break points and takes, in each panel [a, b], the
variable ν = √(μ² − a²), which removes the kink; ν is graded exponentially towards 0 where a panel
starts near 0.
"""

import math
from functools import lru_cache
from types import ModuleType
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from irisjax._types import AnyReals

# Grading of a panel that starts at 0; found by a scan over maps and depths τ from 1e-4 to 30.
_GRADING = 3.0
# μ² at which a panel's start counts as far from 0, where no grading is wanted.
_FAR = 0.05


class CosineRule(eqx.Module):
    """Nodes and weights for ∫₀¹ f(μ) dμ.

    The panels that exist share the nodes evenly: a break point that does not exist costs no
    accuracy.

    Attributes:
        cosine: Nodes μ, shape (n,), increasing.
        weight: Weights, shape (n,), summing to 1 (less the first panel where that is left out).
        excess: μ² − b_k² for each b_k² handed in, shape (k, n), free of cancellation.
        omitted: ∫ 2μ dμ over what was left out, 0 otherwise.
        starts: μ² at each panel's start, shape (most panels,).
        widths: Extent of each panel in μ², shape (most panels,).
        panels: Number of panels; further ones have width 0 and no nodes.
    """

    cosine: Float[Array, " n"]
    weight: Float[Array, " n"]
    excess: Float[Array, "k n"]
    omitted: Float[Array, ""]
    starts: Float[Array, " panels"]
    widths: Float[Array, " panels"]
    panels: Int[Array, ""]


@lru_cache(maxsize=64)
def gauss_legendre(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss–Legendre nodes and weights on [0, 1], as float64 NumPy arrays."""
    x, w = np.polynomial.legendre.leggauss(n)
    return (x + 1) / 2, w / 2


def conserving(rule: CosineRule) -> CosineRule:
    """Correct the weights of a rule, by its own error, to integrate 1 and μ² exactly.

    Rayleigh scattering then conserves energy to rounding, whatever the number of nodes.
    """
    square = rule.cosine**2
    w = rule.weight
    m0, m2, m4 = w.sum(), w @ square, w @ square**2
    determinant = m0 * m4 - m2 * m2
    a = ((1 - m0) * m4 - (1 / 3 - m2) * m2) / determinant
    b = ((1 / 3 - m2) * m0 - (1 - m0) * m2) / determinant
    return eqx.tree_at(lambda r: r.weight, rule, w + w * (a + b * square))


def graded(x: AnyReals, start_squared: AnyReals, xp: ModuleType = jnp) -> tuple[Any, Any]:
    """Map [0, 1] onto itself, dense near 0 if the panel starts near 0; returns value and slope.

    g(x) = (e^{κy} − 1)/(e^κ − 1), y = (1−β)x² + βx, κ = 3(1−β) + β, β → 1 away from 0.
    `xp` is `numpy` or `jax.numpy`.
    """
    beta, kappa = _grading(start_squared)
    y = ((1 - beta) * x + beta) * x
    dy = 2 * (1 - beta) * x + beta
    return xp.expm1(kappa * y) / xp.expm1(kappa), kappa * xp.exp(kappa * y) / xp.expm1(kappa) * dy


def graded_rise(
    x: AnyReals, end: AnyReals, step: AnyReals, start_squared: AnyReals, xp: ModuleType = jnp
) -> Any:
    """Compute g(to) − g(x) of `graded` without cancellation; `step` is to − x without rounding."""
    beta, kappa = _grading(start_squared)
    y = ((1 - beta) * x + beta) * x
    dy = step * ((1 - beta) * (x + end) + beta)
    return xp.exp(kappa * y) * xp.expm1(kappa * dy) / xp.expm1(kappa)


def _grading(start_squared):
    beta = start_squared / (start_squared + _FAR)
    return beta, _GRADING * (1 - beta) + beta


def cosine_rule(
    breaks_squared: Float[Array, " k"],
    possible: tuple[bool, ...],
    n: int,
    *,
    leave_out_first: bool = False,
    entering: bool = False,
) -> CosineRule:
    """Quadrature over [0, 1] split at break points.

    Args:
        breaks_squared: b_k² of each break point; there is none where it is not inside (0, 1).
        possible: Which of them can exist, known before tracing; only those cost nodes.
        n: Nodes of a rule of up to two panels. With more that are possible there are 3/4 n for each
            (a few more where that makes the shares even).
        leave_out_first: Whether [0, min b_k] is left out if all break points exist, and its measure
            reported in `omitted`.
        entering: Whether the rule is for light from outside, which every panel begins with grazing
            the layer beyond a break point: each is graded. There are `n` nodes in all, a few more
            where that makes the shares even, for these break points hardly ever exist.
    """
    dtype = breaks_squared.dtype
    breaks = [b for b, p in zip(breaks_squared, possible, strict=True) if p]
    leave_out = leave_out_first and bool(breaks) and all(possible)
    max_panels = len(breaks) + (0 if leave_out else 1)
    edges, panels, all_exist = _edges(breaks, dtype)
    omitted = jnp.zeros((), dtype)
    if leave_out:
        omitted = jnp.where(all_exist, edges[1], 0.0)
        panels = panels - all_exist.astype(panels.dtype)
        # Unless all are there, one edge too many stands at 1.
        edges = jnp.where(all_exist, edges[1:], edges[:-1])
    starts, widths = edges[:-1], edges[1:] - edges[:-1]
    total = _round_up(n, max_panels) if entering else _nodes(n, max_panels)
    x, w, start, width = _on_panels(starts, widths, panels, total)
    g, dg = graded(x, jnp.zeros_like(start) if entering else start)
    nu_squared = width * g * g
    mu = jnp.sqrt(start + nu_squared)
    return CosineRule(
        cosine=mu,
        weight=w * width * g * dg / mu,
        excess=nu_squared[None] + (start[None] - breaks_squared[:, None]),
        omitted=omitted,
        starts=starts,
        widths=widths,
        panels=panels,
    )


def quadratic_rule(
    breaks: Float[Array, " k"], possible: tuple[bool, ...], n: int
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Nodes and weights for ∫₀¹ f(μ) dμ of polynomials with square roots above break points b.

    The variable of a panel that starts at b is √(μ − b), which keeps polynomials what they are.
    Arguments as for `cosine_rule`; the break points themselves, not their squares.
    """
    existing = [b for b, p in zip(breaks, possible, strict=True) if p]
    edges, panels, _ = _edges(existing, breaks.dtype)
    starts, widths = edges[:-1], edges[1:] - edges[:-1]
    x, w, start, width = _on_panels(starts, widths, panels, _nodes(n, len(existing) + 1))
    return start + width * x * x, w * width * 2 * x


def _on_panels(starts, widths, panels, n: int):
    """Find coordinates and weights of `n` nodes on their panels, and the panels' extents."""
    x, w, owner = _panel_nodes(n, starts.size)
    # A named dtype is needed: JAX keeps a NumPy array's first precision for as long as it lives.
    x, w = (jnp.asarray(row, starts.dtype)[panels - 1] for row in (x, w))
    owner = jnp.asarray(owner)[panels - 1]
    return x, w, starts[owner], widths[owner]


def _nodes(n: int, max_panels: int) -> int:
    """Nodes in all, a number that every number of panels up to `max_panels` divides."""
    if max_panels == 1:
        return n
    per_panel = max(2, n // 2 if max_panels == 2 else n - n // 4)
    return _round_up(max_panels * per_panel, max_panels)


def _round_up(n: int, max_panels: int) -> int:
    """At least `n`, and a number that every number of panels up to `max_panels` divides."""
    unit = math.lcm(*range(1, max_panels + 1))
    return unit * math.ceil(n / unit)


@lru_cache(maxsize=64)
def _panel_nodes(n: int, max_panels: int):
    """Nodes and weights on each node's own panel, and its number, for 1 to `max_panels` panels."""
    rules = [gauss_legendre(n // panels) for panels in range(1, max_panels + 1)]
    x, w = (
        np.stack([np.tile(rule[i], panels) for panels, rule in enumerate(rules, 1)]) for i in (0, 1)
    )
    counts = range(1, max_panels + 1)
    owner = np.stack([np.repeat(np.arange(p, dtype=np.int32), n // p) for p in counts])
    return x, w, owner


def _edges(breaks: list[Array], dtype):
    """0, the break points in order and 1s; the number of panels; whether all points exist."""
    distinct, all_exist = [], jnp.asarray(True)
    for i, b in enumerate(breaks):
        exists = (b > 0) & (b < 1)
        all_exist = all_exist & exists
        for other in breaks[:i]:
            exists = exists & (b != other)  # two at one place are one
        distinct.append(exists)
    inner = jnp.stack(
        [jnp.where(d, b, 1.0) for d, b in zip(distinct, breaks, strict=True)]
        + [jnp.ones((), dtype)]
    )
    panels = 1 + sum(d.astype(jnp.int32) for d in distinct)
    return jnp.concatenate([jnp.zeros(1, dtype), jnp.sort(inner)]), jnp.asarray(panels), all_exist
