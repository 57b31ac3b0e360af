import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from irisjax.numerics.quadrature import conserving, cosine_rule
from irisjax.optics.phase import PHASES

NAMES = list(PHASES)
SAMPLES = {name: jax.jit(phase.sample_cosine) for name, phase in PHASES.items()}
# What the samplers' docstrings promise of the cosine.
SAMPLER_ERROR = {"rayleigh": 8e-8, "lb06": 4e-7}


def density(name, alpha):
    """Per radian of the deflection  [LB06 Section 3.4]."""
    if name == "rayleigh":
        return 0.375 * (1 + np.cos(alpha) ** 2) * np.sin(alpha)
    return (1 + np.cos(alpha) ** 2) / (1.5 * np.pi)


def distribution(name, alpha):
    """Probability of a deflection below alpha."""
    c = np.cos(alpha)
    if name == "rayleigh":
        return 0.5 - 0.375 * (c + c**3 / 3)
    return (1.5 * alpha + 0.25 * np.sin(2 * alpha)) / (1.5 * np.pi)


@functools.cache
def operator(name, critical, n):
    """Cosines, weights and the scattering matrix S = K f."""

    def build(c):
        rule = conserving(cosine_rule(c, (True,) * len(critical), n))
        k = PHASES[name].redistribution(rule)
        collect = jnp.eye(rule.cosine.size) if k.collect is None else k.collect
        # The isotropic part is left to the solver.
        return rule.cosine, rule.weight, 0.5 * rule.weight[None, :] + k.scatter.T @ collect

    return tuple(np.asarray(x) for x in jax.jit(build)(jnp.asarray(critical, float)))


@pytest.mark.parametrize("name", NAMES)
def test_sampler_inverts_the_distribution(name):
    u = np.concatenate(
        [np.linspace(0, 1, 2001), np.geomspace(1e-12, 1e-3, 50), 1 - np.geomspace(1e-12, 1e-3, 50)]
    )
    expected = [
        np.cos(brentq(lambda a, v=v: distribution(name, a) - (1 - v), 0, np.pi, xtol=1e-14))
        for v in u
    ]
    found = np.asarray(SAMPLES[name](jnp.asarray(u)))
    np.testing.assert_allclose(found, expected, rtol=0, atol=SAMPLER_ERROR[name])


@pytest.mark.parametrize("name", NAMES)
def test_sampler_is_symmetric_and_bounded(name, bits):
    u = jnp.linspace(0, 1, 10001)
    c = np.asarray(SAMPLES[name](u))
    assert (np.abs(c) <= 1).all()
    np.testing.assert_allclose(c, -c[::-1], atol=64 * np.finfo(c.dtype).eps)
    assert (np.diff(c) >= 0).all() if bits == 64 else (np.diff(c) > -1e-6).all()


def averaged_over_circle(power, a, b):
    """Mean over ψ of |a + b cos ψ|^power."""
    if power == 0:
        return 1.0
    if power == 1:
        if abs(a) >= b:
            return abs(a)
        return 2 / np.pi * (np.sqrt(b * b - a * a) + a * np.arcsin(a / b))
    psi = (np.arange(32) + 0.5) / 32 * np.pi
    return np.mean((a + b * np.cos(psi)) ** power)


@pytest.mark.parametrize("name", NAMES)
def test_redistribution_of_powers(name):
    """S(μ) = ½∫dα D(α) ⟨|μ'|^k⟩, the deflection integrated about the ray itself (no singular
    kernel).
    """
    mu, w, scatter = operator(name, (0.18,), 36)
    live = w > 0
    for power in (0, 1, 4):
        found = scatter @ np.where(live, mu**power, 0.0)
        for i in np.flatnonzero(live)[:: max(1, live.sum() // 9)]:
            s = np.sqrt(1 - mu[i] ** 2)
            edge = np.arctan2(mu[i], s)

            def integrand(a, i=i, s=s, power=power):
                return density(name, a) * averaged_over_circle(
                    power, mu[i] * np.cos(a), s * np.sin(a)
                )

            pieces = ((0, edge), (edge, np.pi - edge), (np.pi - edge, np.pi))
            expected = 0.5 * sum(quad(integrand, *ends, epsabs=1e-13)[0] for ends in pieces)
            # The printed phase function is asked for 1e-6 in reflectance, Rayleigh's for 1e-10.
            assert found[i] == pytest.approx(expected, rel=0, abs=1e-6 if name == "lb06" else 1e-10)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("critical", [(), (0.18,)])
def test_scattering_conserves(name, critical):
    """Half of all scattered light goes up, half goes down, to rounding and at any number of
    nodes.
    """
    for n in (8, 36):
        mu, w, scatter = operator(name, critical, n)
        for f in (np.ones_like(mu), 2 * mu, np.exp(-0.3 / mu)):
            f = np.where(w > 0, f, 0)
            assert w @ scatter @ f / (w @ f) == pytest.approx(0.5, abs=1e-14)
