"""The mixture of Rayleigh's and Henyey and Greenstein's phase functions: norm, moments, samples."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from irisjax.optics.mixture import PhaseMixture, henyey_greenstein, sample_henyey_greenstein

X, W = np.polynomial.legendre.leggauss(400)
values_at = jax.jit(lambda mixture, cosines: jax.vmap(mixture.value)(cosines))
mean_at = jax.jit(PhaseMixture.mean_over_azimuth)
moments_of = jax.jit(lambda mixture: (mixture.moments(12), *mixture.truncated(12)))
sample, density_at = jax.jit(sample_henyey_greenstein), jax.jit(henyey_greenstein)
GS = (-0.9, -0.3, 0.0, 0.3, 0.8, 0.95)


@pytest.mark.parametrize("g", GS)
def test_moments_are_those_of_the_function(g):
    mixture = PhaseMixture(jnp.array([0.0, 0.4, 1.0]), jnp.full(3, g))
    legendre = np.polynomial.legendre.legvander(X, 11)
    values = values_at(mixture, X)
    wanted = 0.5 * np.einsum("x,xw,xl->wl", W, values, legendre)
    whole, moments, peak = map(np.asarray, moments_of(mixture))
    np.testing.assert_allclose(whole, wanted, atol=1e-10)
    np.testing.assert_allclose(moments[:, 0], 1.0, atol=1e-14)
    assert ((peak >= 0) & (peak < 1)).all()


@pytest.mark.parametrize("bits", [64, 32])
@pytest.mark.parametrize("g", [*GS, 0.99])
def test_mean_over_azimuth(g, bits):
    """From light that turns straight back to grazing light, whose azimuths have a sharp peak."""
    azimuth = (np.arange(20_000) + 0.5) * np.pi / 20_000
    places = np.array([(-1.0, 0.0), (-0.3, 0.2), (0.4, 0.6), (-0.001, 0.998)]).T
    with jax.enable_x64(bits == 64):
        found = mean_at(PhaseMixture(jnp.full(4, 0.3), jnp.full(4, g)), *map(jnp.asarray, places))
    cosine = places[0] + places[1] * np.cos(azimuth)[:, None]
    wanted = 0.3 * 0.75 * (1 + cosine**2) + 0.7 * (1 - g**2) / (1 + g**2 - 2 * g * cosine) ** 1.5
    np.testing.assert_allclose(found, wanted.mean(0), rtol=1e-12 if bits == 64 else 1e-4)


@pytest.mark.parametrize("g", GS)
def test_samples_follow_the_density(g):
    """The cosine at u is where the density's integral is u."""
    u = np.linspace(0.001, 0.999, 201)
    cosine = np.asarray(sample(u, g))
    fine = np.linspace(-1, 1, 400_001)
    density = np.asarray(density_at(fine, g)) / 2
    below = np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(fine))])
    np.testing.assert_allclose(np.interp(cosine, fine, below / below[-1]), u, atol=1e-5)


def test_a_mixture_draws_from_both():
    mixture = PhaseMixture(jnp.full(1, 0.4), jnp.full(1, 0.8))
    u = (np.arange(100_000) + 0.5) / 100_000
    cosine = np.asarray(jax.jit(PhaseMixture.sample_cosine)(mixture, u))
    assert cosine.mean() == pytest.approx(0.6 * 0.8, abs=1e-5)
    assert (cosine**2).mean() == pytest.approx(0.4 * 0.4 + 0.6 * (1 + 2 * 0.64) / 3, abs=1e-4)
