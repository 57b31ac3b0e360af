import itertools
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import expn

from irisjax.numerics.quadrature import conserving, cosine_rule
from irisjax.optics.fresnel import critical_cosine_squared


def rule_for(*critical, n=36, leave_out_first=False):
    return _rule(jnp.asarray(critical, float), n, leave_out_first)


@partial(jax.jit, static_argnums=(1, 2))
def _rule(critical, n, leave_out_first):
    possible = (True,) * len(critical)
    return cosine_rule(critical, possible, n, leave_out_first=leave_out_first)


def tanh_sinh(length):
    """Double-exponential rule on [0, length]: an integrator with nothing in common with the one
    tested.
    """
    t = np.arange(-4.5, 4.5, 0.01)
    u = np.pi / 2 * np.sinh(t)
    return length / (1 + np.exp(-2 * u)), length * 0.01 * np.pi / 4 * np.cosh(t) / np.cosh(u) ** 2


DEPTHS = np.geomspace(1e-6, 1e3, 91)


def test_exponential_integral():
    """∫ μ exp(−τ/μ) dμ = E₃(τ), the diffuse transmittance over 2, at every depth.

    Reflectances are promised to 1e-10; the rule of 36 nodes is asked for a tenth of that.
    Twice the nodes are better by orders until rounding is met.
    """
    worst = []
    for n in (8, 16, 32, 36, 64):
        rule = rule_for(n=n)
        mu, w = np.asarray(rule.cosine), np.asarray(rule.weight)
        found = np.exp(-DEPTHS[:, None] / mu) @ (w * mu)
        worst.append(np.abs(found - expn(3, DEPTHS)).max())
        # ∫2μ dμ = 1 in a panel's own variable is exact up to the grading's error.
        assert np.sum(2 * mu * w) == pytest.approx(1, abs=max(10.0 ** -(n / 3), 1e-12))
    assert worst[0] < 1e-4
    assert worst[1] < worst[0] / 20
    assert worst[2] < worst[1] / 20
    assert worst[3] < 1e-11
    assert worst[4] < 1e-13


@pytest.mark.parametrize(
    "critical", [(0.3,), (0.9,), (1e-3,), (1e-8,), (0.02, 0.4), (0.4, 0.02), (0.5, 0.5), (0.0, 0.3)]
)
@pytest.mark.parametrize("depth", [0.0, 1e-6, 0.03, 1.0, 30.0])
def test_square_root_kinks(critical, depth):
    rule = rule_for(*(c * c for c in critical), n=72)
    mu = np.asarray(rule.cosine)
    for c in critical:

        def integrand(m, c=c):
            kink = np.sqrt(np.maximum(m * m - c * c, 0))
            return m * np.exp(-depth / np.maximum(m, 1e-300)) / (1 + kink)

        expected = 0.0
        cuts = sorted({0.0, *critical, 1.0})
        for a, b in itertools.pairwise(cuts):
            # In √(μ² − a²) the kink at a panel's start is gone.
            v, w = tanh_sinh(np.sqrt(b * b - a * a))
            m = np.hypot(a, v)
            expected += np.sum(w * integrand(m) * v / m)
        assert integrand(mu) @ np.asarray(rule.weight) == pytest.approx(expected, rel=0, abs=1e-12)


def test_known_kink():
    """∫ μ √(μ² − c²) dμ = (1 − c²)^{3/2}/3 from the critical cosine c on."""
    for c2 in (0.0, 1e-10, 0.18, 0.95):
        rule = rule_for(c2)
        mu, w, excess = (np.asarray(x) for x in (rule.cosine, rule.weight, rule.excess[0]))
        value = np.sum(w * mu * np.sqrt(np.maximum(excess, 0)))
        assert value == pytest.approx((1 - c2) ** 1.5 / 3, rel=1e-12)


media = st.floats(1.0, 3.0)


@given(media, media, media)
def test_weights_and_nodes(n, above, below):
    """Flux is integrated exactly, and nodes and weights are in range, whatever the media are."""
    critical = [float(critical_cosine_squared(n, m)) for m in (above, below)]
    rule = rule_for(*critical)
    mu, w = np.asarray(rule.cosine), np.asarray(rule.weight)
    assert np.sum(2 * mu * w) == pytest.approx(1, abs=1e-11)
    assert (w >= 0).all()
    assert ((mu > 0) & (mu <= 1)).all()
    assert (np.diff(mu[w > 0]) >= 0).all()
    # atol: the difference on the right cancels, not the rule's.
    expected = mu**2 - np.array(critical)[:, None]
    found = np.asarray(rule.excess)[:, w > 0]
    np.testing.assert_allclose(found, expected[:, w > 0], rtol=0, atol=1e-15)


def test_first_panel_left_out():
    rule = rule_for(0.18, 0.0007, leave_out_first=True)
    assert rule.omitted == pytest.approx(0.0007, rel=1e-14)
    assert rule.panels == 2
    mu, w = np.asarray(rule.cosine), np.asarray(rule.weight)
    assert mu.min() ** 2 > 0.0007
    assert np.sum(2 * mu * w) + float(rule.omitted) == pytest.approx(1, abs=1e-13)


def test_nothing_left_out_if_one_break_is_impossible():
    make = partial(cosine_rule, possible=(True, False), n=32, leave_out_first=True)
    rule = jax.jit(make)(jnp.asarray([0.18, -0.1]))
    assert rule.omitted == 0
    assert rule.cosine.size == 32
    assert np.sum(rule.weight) == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("leave_out", [False, True])
def test_missing_breaks_cost_no_nodes(leave_out):
    """Existing panels share all nodes: a rule for traced break points is as good as for known."""
    for places in [(0.18, -0.3), (-0.3, 0.18), (0.18, 0.18), (0.18, 0.0), (0.18, 1.0)]:
        found = rule_for(*places, n=32, leave_out_first=leave_out)
        left = leave_out and places == (0.18, 0.18)
        known = rule_for(0.18, n=found.cosine.size, leave_out_first=left)
        assert found.panels == known.panels
        assert found.omitted == known.omitted
        np.testing.assert_allclose(found.cosine, known.cosine, rtol=1e-15)
        np.testing.assert_allclose(found.weight, known.weight, rtol=1e-14)
    none = rule_for(-0.1, -0.2, 0.0, n=10)
    known = rule_for(n=none.cosine.size)
    np.testing.assert_allclose(none.weight, known.weight, rtol=1e-14)


def test_gradient_is_that_of_the_nodes_used(bits):
    """Missing, doubled and extreme break points have finite derivatives, zero where unused."""

    @jax.jit
    @jax.grad
    def slope_of_moment(b, n=24):
        rule = cosine_rule(b, (True, True), n, leave_out_first=True)
        return (rule.weight * rule.cosine**3 * jnp.exp(-0.1 / rule.cosine)).sum() + rule.omitted

    for places in [(0.18, -0.3), (-0.1, -0.2), (0.18, 0.18), (0.0, 1.0), (0.18, 0.0007)]:
        slope = slope_of_moment(jnp.asarray(places, float))
        assert np.isfinite(slope).all()
        assert (np.asarray(slope)[np.asarray(places) <= 0] == 0).all()


@pytest.mark.parametrize(("critical", "n"), [((), 36), ((0.18,), 8), ((0.18, 0.0007), 8)])
def test_conserving(critical, n, bits):
    rule = jax.jit(conserving)(rule_for(*critical, n=n))
    near = partial(pytest.approx, abs=8 * float(np.finfo(rule.weight.dtype).eps))
    w, mu = np.float64(rule.weight), np.float64(rule.cosine)
    assert w.sum() == near(1)
    assert np.sum(w * mu**2) == near(1 / 3)
    assert rule.weight.dtype == (np.float64 if bits == 64 else np.float32)
