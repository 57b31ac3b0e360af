"""The printed phase function's operator, against integrals along great circles and by scipy."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from common import quick_jit
from irisjax.numerics.quadrature import cosine_rule, gauss_legendre, graded
from irisjax.optics.per_angle import averaged_kernel, scattering_operator

STEP = 8  # the great circles take long: every eighth row of the operator


_rule = jax.jit(cosine_rule, static_argnums=(1, 2))
_kernel = jax.jit(averaged_kernel)


def rule_for(*breaks, n=16):
    return _rule(jnp.asarray(breaks, float), (True,) * len(breaks), n)


@functools.cache
def program(count, n=16):
    return jax.jit(lambda b: scattering_operator(cosine_rule(b, (True,) * count, n)))


@pytest.mark.parametrize(
    ("mu", "other"),
    [(0.3, 0.31), (0.9, 0.2), (1e-3, 0.8), (1e-3, 1.3e-3), (0.999, 0.9992), (0.5, 0.50001)],
)
def test_kernel(mu, other, bits):
    """k = 1/(3π²) ∫ (1 + c²)/√(1 − c²) dφ, with 1 − c as a sum of two squares."""
    angles = np.arccos([mu, other])
    ahead = 2 * np.sin((angles[0] - angles[1]) / 2) ** 2
    sines = np.sin(angles[0]) * np.sin(angles[1])

    def integrand(log_phi):  # the logarithm of φ: the peak at φ = 0 is as narrow as |θ − θ'|
        phi = np.exp(log_phi)
        rest = ahead + sines * 2 * np.sin(phi / 2) ** 2
        return phi * (1 + (1 - rest) ** 2) / np.sqrt(rest * (2 - rest))

    ends = np.log([1e-13, abs(angles[0] - angles[1]), 0.3, np.pi])
    pieces = itertools.pairwise(np.unique(ends))
    expected = 2 * sum(quad(integrand, *e, epsrel=1e-13, epsabs=0)[0] for e in pieces)
    arguments = (mu, other, 1 - mu**2, 1 - other**2, abs(mu - other) * (mu + other))
    found = _kernel(*(jnp.asarray([v], float) for v in arguments))
    assert found.dtype == (np.float64 if bits == 64 else np.float32)
    # The mild part's few nodes are worst close to the diagonal, where little is integrated.
    assert found[0] == pytest.approx(expected / (3 * np.pi**2), rel=1e-9 if bits == 64 else 1e-5)


@pytest.mark.parametrize(
    ("breaks", "bits", "error"),
    [
        ((), 64, 1e-10),
        ((0.0223, -0.2), 64, 1e-10),
        ((0.3, 0.3), 64, 1e-10),
        ((1e-4, 0.9), 64, 1e-9),  # as the docstring says of break points next to 0
        ((0.0223,), 32, 1e-6),
    ],
)
def test_as_along_great_circles(breaks, bits, error):
    rule = rule_for(*breaks)
    found = np.asarray(program(len(breaks))(jnp.asarray(breaks, float)))
    assert found.dtype == (np.float64 if bits == 64 else np.float32)
    np.testing.assert_allclose(found[::STEP], along_great_circles(rule), rtol=0, atol=error)


def test_missing_breaks_are_one_panel():
    found = program(2)(jnp.asarray([-0.1, -0.2]))
    np.testing.assert_array_equal(found, program(0, found.shape[0])(jnp.zeros(0)))


@pytest.mark.slow  # a minute of compiling
def test_gradients_are_finite():
    """In a batch, where every number of panels is worked out and one chosen."""

    def some(b):
        return (scattering_operator(cosine_rule(b, (True, True), 8)) ** 2).sum()

    breaks = [(0.0223, 0.3), (0.18, -0.0007), (-0.1, -0.2), (0.3, 0.3), (0.0, 1.0), (0.1, 0.4)]
    assert np.isfinite(quick_jit(jax.vmap(jax.grad(some)))(jnp.asarray(breaks, float))).all()


def test_gradient_against_finite_differences():
    def some(b):
        rule = cosine_rule(b, (True,), 8)
        return (scattering_operator(rule) @ rule.cosine**3) @ rule.weight * 1e3

    b, h = jnp.asarray([0.02]), 1e-4
    run = quick_jit(lambda b: jax.jvp(some, (b,), (jnp.ones(1),)))
    low, less, more, high = (float(run(b + k * h)[0]) for k in (-2, -1, 1, 2))
    difference = (8 * (more - less) - (high - low)) / (12 * h)
    assert run(b)[1] == pytest.approx(float(difference), rel=1e-5, abs=1e-8)


def along_great_circles(rule):
    """The operator by integrals along great circles through each direction.

    Per radian the density is smooth, so the averaged kernel's singularity is never met.
    """
    panels = int(rule.panels)
    starts, widths, cosine = (
        np.asarray(v, float) for v in (rule.starts[:panels], rule.widths[:panels], rule.cosine)
    )
    m = cosine.size // panels
    return np.stack([_into(starts, widths, m, mu) for mu in cosine[::STEP]])


def _into(starts, widths, m, mu):
    """A circle that passes the pole at cosine M meets the cosine |M sin γ| at angle γ from μ = 0.

    Where M crosses a panel's edge the integral over the circles has a kink, and is split.
    """
    x_psi, w_psi = gauss_legendre(112)
    g_psi, slope_psi = graded(x_psi, 0.0, np)
    x_gamma, w_gamma = gauss_legendre(112)
    g_gamma, slope_gamma = graded(x_gamma, 0.0, np)
    # Circles by their angle ψ from the one through μ = 0: M² = μ² + (1 − μ²) sin²ψ.
    kinks = [_arcsin_sqrt((s - mu * mu) / (1 - mu * mu)) for s in starts[1:]]
    ends = list(itertools.pairwise([0.0, *kinks, np.pi / 2]))
    psi = np.concatenate([lo + (hi - lo) * g_psi for lo, hi in ends])
    w_psi = np.concatenate([(hi - lo) * w_psi * slope_psi for lo, hi in ends])
    side = (1 - mu * mu) * np.sin(psi) ** 2
    pole_squared = mu * mu + side
    columns = []
    for start, width in zip(starts, widths, strict=True):
        first, last = (_arcsin_sqrt(edge / pole_squared) for edge in (start, start + width))
        gamma = first[:, None] + (last - first)[:, None] * g_gamma
        v2 = np.sin(gamma) ** 2
        # cos²α averaged over the two senses round the circle.
        cos2 = (mu * mu / pole_squared)[:, None] * v2 + (side / pole_squared)[:, None] * (1 - v2)
        density = (1 + cos2) / (1.5 * np.pi) * (2 / np.pi)
        weights = density * w_gamma * slope_gamma * (w_psi * (last - first))[:, None]
        values = _lagrange_polynomials(start, width, m, pole_squared[:, None] * v2)
        columns.append(np.einsum("ab,abq->q", weights, values))
    return np.concatenate(columns)


def _lagrange_polynomials(start, width, m, square):
    """At μ², by inversion of the panel's own variable."""
    x = gauss_legendre(m)[0]
    g = np.sqrt(np.clip((square - start) / width, 0, 1))
    at = _ungraded(g, start)
    barycentric = np.array([1 / np.prod(4 * (x[j] - np.delete(x, j))) for j in range(m)])
    difference = at[..., None] - x
    terms = barycentric / np.where(difference == 0, 1e-300, difference)
    return terms / terms.sum(-1, keepdims=True)


def _ungraded(g, start):
    """Inverse of `graded`, in closed form."""
    beta = start / (start + 0.05)
    kappa = 3 * (1 - beta) + beta
    y = np.log1p(g * np.expm1(kappa)) / kappa
    return 2 * y / (beta + np.sqrt(beta * beta + 4 * (1 - beta) * y) + (y == 0))


def _arcsin_sqrt(x):
    return np.arcsin(np.sqrt(np.clip(x, 0, 1)))
