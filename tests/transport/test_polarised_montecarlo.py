"""Photons followed as fields in space against the deterministic solver of Stokes vectors."""

import functools

import jax
import numpy as np
import pytest
from polarised_photons import sampled

import common
import irisjax as ij
from common import any_order, layers

pytestmark = pytest.mark.peer

EXITS = np.array([1.0, 0.8, 0.6])
AZIMUTH = np.array([0.0, 0.3, 2.0])
APERTURE = 0.08
EXACT = ij.RadiativeExact(16, 8, 1, process=ij.POLARISED)
MEDIA = {
    "iris": (1.336, 1.4733333333, 1.4727930095, 1.5),
    "turning": (1.0, 1.3, 1.6, 1.2),  # total reflection at every interface
    "reversed": (1.6, 1.3, 1.2, 1.5),
}


@functools.cache
def deterministic(media, cosine):
    return common.solve(EXACT, any_order(layers(0.05, 0.05, 1.0, media)), cosine, EXITS, AZIMUTH)


def _scores(media, cosine, n, seed=3):
    """Differences over their standard errors: shares of light, matrices of all and of exits."""
    made = any_order(layers(0.05, 0.05, 1.0, media))
    exact = deterministic(media, cosine)
    light = sampled(made, cosine, EXITS, AZIMUTH, jax.random.key(seed), n=n, aperture=APERTURE)
    assert float(light.fates.sum()) == pytest.approx(1, abs=1e-12)
    lost = exact.absorbed
    fates = exact.mirrored, exact.reflectance, lost.abl, lost.stroma, lost.ipe
    pairs = [(p, q, np.sqrt(q * (1 - q) / n)) for p, q in zip(light.fates, fates, strict=True)]
    for name in ("reflected", "brdf"):
        covariance = getattr(light, f"{name}_covariance")
        a, b = getattr(light, name), np.asarray(getattr(exact.polarisation, name))[0]
        # By what polarisers and analysers see; of few photons a cone's intensity only is normal.
        of_i = np.array([1.0, 0, 0, 0])
        filters = [of_i + sign * np.eye(4)[k] for k in (1, 2, 3) for sign in (1, -1)]
        filters = [np.sqrt(2) * of_i] if name == "brdf" and n < 100_000 else filters
        for row in filters:
            for column in filters:
                weight = 0.5 * np.outer(row, column)
                error = np.sqrt(
                    np.einsum("i,...ij,j->...", weight.ravel(), covariance, weight.ravel())
                )
                pairs.append(((a * weight).sum((-1, -2)), (b * weight).sum((-1, -2)), error))
    # Where nothing can leave both are nothing, without error.
    scores = []
    for x, y, z in pairs:
        off, error = np.ravel(x - y), np.ravel(z)
        none = (off == 0) & (error == 0)
        scores.append(np.where(none, 0.0, off) / np.where(none, 1.0, error))
    return np.concatenate(scores)


@pytest.fixture(scope="module", autouse=True)
def _solved():
    """One compilation before the tests."""
    deterministic(MEDIA["iris"], 0.85)


@pytest.mark.parametrize("media", MEDIA)
def test_against_the_deterministic_solver(media):
    scores = _scores(MEDIA[media], 0.85, 16_384)
    assert np.abs(scores).max() < 4
    assert np.sqrt((scores**2).mean()) < 1.5


@pytest.mark.slow
@pytest.mark.parametrize(("media", "cosine"), [("iris", 0.4), ("turning", 1.0)])
def test_against_the_deterministic_solver_with_many_photons(media, cosine):
    scores = _scores(MEDIA[media], cosine, 400_000)
    assert np.abs(scores).max() < 4
    assert np.sqrt((scores**2).mean()) < 1.25


def test_total_reflection_turns_both_ways_alike():
    """Light that a stroma in a thinner medium traps becomes elliptical, of the same hand by the
    deterministic solver as by photons, whose amplitudes are worked out otherwise.
    """
    made, mu, azimuth, aperture = layers(0.0, 0.1, 0.2, (1.3, 1.6, 1.6, 1.0)), 0.5, 1.0, 0.3
    exits = np.array([mu, mu]), np.array([azimuth, -azimuth])  # V has the other sign there
    key = jax.random.key(0)
    found = sampled(any_order(made), 0.85, *exits, key, n=16_384, aperture=aperture)
    v = np.asarray(found.brdf)[:, 3, 1] @ [0.5, -0.5]
    error = 0.5 * np.sqrt(np.asarray(found.brdf_covariance)[:, 13, 13].sum())
    # A cone's mean is about that over the ring which halves its solid angle.
    turn, sine = np.arange(6) * np.pi / 3, np.sqrt(1 - mu**2)
    along, across = np.cos(aperture / np.sqrt(2)), np.sin(aperture / np.sqrt(2))
    up, aside = across * np.cos(turn), across * np.sin(turn)
    ring = along * mu + up * sine, azimuth + np.arctan2(aside, along * sine - up * mu)
    exact = common.solve(EXACT, any_order(made), 0.85, *ring).polarisation
    expected = (np.asarray(exact.brdf)[0, :, 3, 1] * ring[0]).mean() / mu
    assert abs(v - expected) < 4 * error
    assert abs(v) > 5 * error
