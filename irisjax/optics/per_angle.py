"""The scattering operator of the density (1 + cos²α)/(3π/2) per radian of the deflection α.

Averaged over the azimuth its kernel over the cosine is, with c = μμ' + √(1−μ²) √(1−μ'²) cos φ,

    k(μ, μ') = 1/(3π²) ∫₀^{2π} (1 + c²)/√(1 − c²) dφ,    ∫₀¹ k dμ' = ½,

singular as −ln |μ − μ'|. It is integrated against the Lagrange polynomials of each panel of a
`CosineRule`, in the panel's own variable x: exact for polynomials in x, singularity included. The
nodes of that integration lie at fixed x, so that only the kernel depends on where the panels are.
"""

import functools
import itertools
from types import ModuleType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax._types import AnyReals
from irisjax.numerics.quadrature import CosineRule, gauss_legendre, graded, graded_rise


def scattering_operator(rule: CosineRule) -> Float[Array, "n n"]:
    """W with S(μ_i) = Σ_q W[i, q] f(μ_q) = ∫₀¹ k(μ_i, μ') f(μ') dμ'.

    For rules that leave nothing out. Errors are below 1e-10, 1e-9 for break points at μ² < 1e-3.
    """
    n, dtype = rule.cosine.shape[0], rule.cosine.dtype

    def one_panel(starts, widths):
        # Always the same: made once, on the host.
        return jnp.asarray(_one_panel_operator(n), dtype)

    def several_panels(starts, widths, *, panels):
        # A batch computes all cases and chooses: those not chosen must be finite too.
        chosen = rule.panels == panels
        starts = jnp.where(chosen, starts[:panels], jnp.asarray(np.arange(panels) / panels, dtype))
        widths = jnp.where(chosen, widths[:panels], 1 / panels)
        return _product_integrated(starts, widths, n // panels, jnp)

    cases = [functools.partial(several_panels, panels=p) for p in range(2, len(rule.starts) + 1)]
    # With one case this is that case, without a branch.
    return jax.lax.switch(rule.panels - 1, [one_panel, *cases], rule.starts, rule.widths)


def averaged_kernel(
    mu: AnyReals,
    other: AnyReals,
    sine_square: AnyReals,
    other_sine_square: AnyReals,
    difference: AnyReals,
    xp: ModuleType = jnp,
) -> Any:
    """k from μ, μ', 1 − μ², 1 − μ'² and |μ² − μ'²| > 0, each as exact as the caller knows it.

    (1 + c²)/√(1−c²) = 2/√(1−c²) − √(1−c²). The first integral is a complete elliptic integral of
    the first kind, 2π/AGM(max(s, s'), √|μ²−μ'²|) with the sines s and s'; the second is mild and
    takes Gauss nodes, dense where c may be near ±1.
    """
    larger, smaller = xp.sqrt(xp.maximum(sine_square, other_sine_square)), xp.sqrt(difference)
    for _ in range(_AGM_STEPS):
        larger, smaller = (larger + smaller) / 2, xp.sqrt(larger * smaller)
    # c = a + b cos φ; with h = 1 − cos φ, 1 ∓ c are sums of positive terms about φ = 0 and about π.
    a, b = mu * other, xp.sqrt(sine_square * other_sine_square)
    beside, across = 1 - a + b, 1 + a + b
    ahead, behind = (difference / (mu + other)) ** 2 / beside, (mu + other) ** 2 / across
    h, w = (xp.asarray(v, b.dtype) for v in _azimuths(xp.finfo(b.dtype).bits))
    t = h[:, None] * b[None]
    ahead, across, beside, behind = (v[None] for v in (ahead, across, beside, behind))
    mild = w @ (xp.sqrt((ahead + t) * (across - t)) + xp.sqrt((beside - t) * (behind + t)))
    return (4 * np.pi / larger - 2 * mild) / (3 * np.pi**2)


_AGM_STEPS = 8  # to rounding, from a ratio of 1e-12 on


@functools.cache
def _azimuths(bits: int) -> tuple[np.ndarray, np.ndarray]:
    """1 − cos φ and weights of ∫ dφ from 0 to π/2, to 1e-12 (1e-8 in single precision)."""
    x, w = gauss_legendre(18 if bits == 64 else 12)
    g, slope = graded(x, 0.0, np)
    return 2 * np.sin(np.pi / 4 * g) ** 2, np.pi / 2 * w * slope


def _product_integrated(starts, widths, m: int, xp: ModuleType):
    """The operator of panels with `m` nodes each."""
    panels, dtype, lagrange = starts.shape[0], starts.dtype, _lagrange(m)
    x = gauss_legendre(m)[0][:, None]
    targets = [_panel_points(starts, widths, a, x, 1 - x, xp) for a in range(panels)]
    pairs, measures = [], []
    for a, b in itertools.product(range(panels), repeat=2):
        target, p = targets[a], _log_nodes(m, a, b)
        source = _panel_points(starts, widths, b, np.atleast_2d(p.x), np.atleast_2d(p.rest), xp)
        if a == b:
            target_x, source_x, step = (xp.asarray(v, dtype) for v in (x, p.x, p.step))
            rise = graded_rise(target_x, source_x, step, starts[a], xp)
            difference = widths[a] * xp.abs(rise) * (source.g + target.g)
        else:
            lower, upper = (target, source) if b > a else (source, target)
            gap = widths[min(a, b) + 1 : max(a, b)].sum()
            difference = gap + (lower.to_end + upper.from_start)
        sines = target.sine_square, source.sine_square
        pairs.append(xp.broadcast_arrays(target.cosine, source.cosine, *sines, difference))
        measures.append(source.slope * xp.asarray(np.atleast_2d(p.weight), dtype))
    # All pairs in one call: the program holds the kernel once, not for each pair of panels.
    arguments = [xp.concatenate([v.ravel() for v in each]) for each in zip(*pairs, strict=True)]
    k = averaged_kernel(*arguments, xp=xp)
    ends = np.cumsum([pair[0].size for pair in pairs])[:-1]
    values = [
        v.reshape(pair[0].shape) * measure
        for v, pair, measure in zip(xp.split(k, ends), pairs, measures, strict=True)
    ]
    own_x = np.stack([_log_nodes(m, a, a).x for a in range(panels)])
    moments = _moments(xp.stack(values[:: panels + 1]), own_x, m, xp)
    rows = []
    for a in range(panels):
        blocks = [
            moments[a]
            if a == b
            else values[a * panels + b] @ xp.asarray(_legendre(_log_nodes(m, a, b).x, m), dtype)
            for b in range(panels)
        ]
        rows.append(xp.stack(blocks, axis=1) @ xp.asarray(lagrange, dtype))
    return xp.concatenate(rows).reshape(panels * m, panels * m)


class _PanelPoints(NamedTuple):
    """Points of a panel in its variable g, with the arguments of the kernel."""

    g: Any
    from_start: Any  # μ² less the panel's start
    to_end: Any  # the panel's end less μ²
    cosine: Any
    sine_square: Any
    slope: Any  # dμ/dx


def _panel_points(starts, widths, panel: int, x, rest, xp) -> _PanelPoints:
    """Points by x and 1 − x."""
    start, width = starts[panel], widths[panel]
    x, rest = (xp.asarray(v, starts.dtype) for v in (x, rest))
    g, slope = graded(x, start, xp)
    from_start = width * g * g
    to_end = width * graded_rise(x, 1.0, rest, start, xp) * (1 + g)
    cosine, sine_square = xp.sqrt(start + from_start), widths[panel + 1 :].sum() + to_end
    return _PanelPoints(g, from_start, to_end, cosine, sine_square, width * g * slope / cosine)


class _LogNodes(NamedTuple):
    """Nodes and weights of ∫₀¹ dx that resolve a logarithm: x, 1 − x, and x less the target's."""

    x: np.ndarray
    rest: np.ndarray
    weight: np.ndarray
    step: np.ndarray


@functools.lru_cache(maxsize=64)
def _log_nodes(m: int, target: int, source: int) -> _LogNodes:
    """Return nodes and weights in panel `source` for the `m` targets of panel `target`."""
    right, left = _dense_at_start(m + 36), _dense_at_end(m // 2 + 32, source == 0)
    if target < source:
        return right
    if target > source:
        return left
    target_x = gauss_legendre(m)[0][:, None]
    return _LogNodes(
        np.concatenate([target_x * left.x, target_x + (1 - target_x) * right.x], 1),
        np.concatenate([(1 - target_x) + target_x * left.rest, (1 - target_x) * right.rest], 1),
        np.concatenate([target_x * left.weight, (1 - target_x) * right.weight], 1),
        np.concatenate([-target_x * left.rest, (1 - target_x) * right.x], 1),
    )


def _dense_at_start(n: int) -> _LogNodes:
    # t⁴: what is left of the logarithm, t³ ln t, Gauss's rule integrates with an error of n⁻⁸.
    t, w = gauss_legendre(n)
    return _LogNodes(t**4, -np.expm1(4 * np.log(t)), 4 * t**3 * w, t**4)


def _dense_at_end(half: int, first: bool) -> _LogNodes:
    """Return 2 `half` points; a panel that does not start at μ = 0 may be steep there too."""
    p = _dense_at_start(2 * half if first else half)
    x, rest, weight = p.rest[::-1], p.x[::-1], p.weight[::-1]
    if not first:
        x, rest = np.concatenate([p.x / 2, 1 - rest / 2]), np.concatenate([1 - p.x / 2, rest / 2])
        weight = np.concatenate([p.weight, weight]) / 2
    return _LogNodes(x, rest, weight, -rest)


def _legendre(x, m: int):
    """Legendre polynomials on [0, 1] of degree below `m`, shape (points, m)."""
    return np.polynomial.legendre.legvander(2 * x - 1, m - 1)


@functools.lru_cache(maxsize=64)
def _lagrange(m: int) -> np.ndarray:
    """Lagrange polynomials of the Gauss nodes by Legendre's, shape (degree, node)."""
    x, w = gauss_legendre(m)
    return (2 * np.arange(m)[:, None] + 1) * _legendre(x, m).T * w


def _moments(values, x, m: int, xp):
    """Σ values P_k(2x − 1) over the last axis for k < `m`, which becomes the last axis.

    In a program by recurrence: the polynomials at all points of all targets would be megabytes of
    constants.
    """
    if xp is np:
        return (values[..., None] * _legendre(x, m)).sum(-2)
    y = jnp.asarray(2 * x - 1, values.dtype)

    def step(state, k):
        previous, current = state
        next_ = ((2 * k + 1) * y * current - k * previous) / (k + 1)
        return (current, next_), (values * current).sum(-1)

    state = (jnp.zeros_like(y), jnp.ones_like(y))
    moments = jax.lax.scan(step, state, jnp.arange(m, dtype=values.dtype))[1]
    return jnp.moveaxis(moments, 0, -1)


@functools.lru_cache(maxsize=32)
def _one_panel_operator(n: int) -> np.ndarray:
    """The operator of one panel, [0, 1]: constants, in double precision whatever the program's."""
    return _product_integrated(np.zeros(1), np.ones(1), n, np)
