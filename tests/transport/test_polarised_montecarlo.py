"""Photons followed as fields in space against the deterministic solver of Stokes vectors."""

import jax
import numpy as np
import pytest

import common
import irisjax as ij
from common import any_order, layers

EXITS = np.array([1.0, 0.8, 0.8, 0.6, 0.4, 0.3])
AZIMUTH = np.array([0.0, 0.3, 2.0, np.pi / 2, np.pi - 0.2, 1.0])
APERTURE = 0.08
MEDIA = {
    "iris": (1.336, 1.4733333333, 1.4727930095, 1.5),
    "turning": (1.0, 1.3, 1.6, 1.2),  # total reflection at every interface
    "reversed": (1.6, 1.3, 1.2, 1.5),
}


def _scores(media, cosine, n, seed=3):
    """Differences over their standard errors: shares of light, matrices of all and of exits."""
    made = layers(0.05, 0.05, 1.0, media)
    solver = ij.RadiativeExact(n_panels=2, process=ij.POLARISED)
    exact = common.solve(solver, any_order(made), cosine, EXITS, AZIMUTH)
    lit = ij.Light(cosine, ij.Directions(EXITS, AZIMUTH))
    found = ij.PolarisedMonteCarlo(n, APERTURE).solve(made, lit, key=jax.random.key(seed))
    pairs = [(found.reflectance, exact.reflectance, found.standard_error)]
    for name in ("abl", "stroma", "ipe"):
        p, q = (float(getattr(x.absorbed, name)[0]) for x in (found, exact))
        pairs.append((p, q, np.sqrt(q * (1 - q) / n)))
    light, wanted = found.polarisation, exact.polarisation
    for name, covariance in (
        ("reflected", light.reflected_covariance[0]),
        ("brdf", light.brdf_covariance[0]),
    ):
        a, b = (np.asarray(getattr(x, name))[0] for x in (light, wanted))
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


@pytest.mark.parametrize(
    ("media", "cosine"),
    [("iris", 0.85), ("turning", 0.85), ("reversed", 0.85)],
)
def test_against_the_deterministic_solver(media, cosine):
    scores = _scores(MEDIA[media], cosine, 16_384)
    assert np.abs(scores).max() < 4
    assert np.sqrt((scores**2).mean()) < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("media", MEDIA)
@pytest.mark.parametrize("cosine", [1.0, 0.85, 0.4])
def test_against_the_deterministic_solver_with_many_photons(media, cosine):
    scores = _scores(MEDIA[media], cosine, 400_000)
    assert np.abs(scores).max() < 4
    assert np.sqrt((scores**2).mean()) < 1.25


def test_equal_keys_give_equal_bytes():
    made = layers(0.05, 0.05, 1.0, MEDIA["iris"])
    one, two = (
        ij.PolarisedMonteCarlo(2048).solve(made, ij.Light(0.7), key=jax.random.key(k))
        for k in (5, 5)
    )
    assert one.reflectance.tobytes() == two.reflectance.tobytes()
    assert float(one.energy[0]) == pytest.approx(1, abs=1e-12)
    assert one.polarisation is None


def test_refusals():
    made = layers(0.05, 0.05, 1.0, MEDIA["iris"])
    solver, key = ij.PolarisedMonteCarlo(10), jax.random.key(0)
    with pytest.raises(ValueError, match="needs a key"):
        solver.solve(made, ij.Light(1.0))
    with pytest.raises(ValueError, match="reaches below the surface"):
        solver.solve(made, ij.Light(1.0, ij.Directions(0.05)), key=key)
    with pytest.raises(ValueError, match="aperture = 2"):
        ij.PolarisedMonteCarlo(10, 2.0)


def test_total_reflection_turns_both_ways_alike():
    """Light that a stroma in a thinner medium traps becomes elliptical, of the same hand by the
    deterministic solver as by photons, whose amplitudes are worked out otherwise.
    """
    colourless = dict.fromkeys(("eumelanin", "pheomelanin", "oxyhemoglobin", "deoxyhemoglobin"), 0)
    media = {"abl_index": 1.6, "stroma_index": 1.6, "ipe_index": 1.336, "scattering_scale": 8.9}
    iris = ij.Iris(**colourless, **media)
    seen = ij.Polarimeter([450.0], polariser=0.4, cos_incidence=0.5, cos_exit=0.5, azimuth=2.0)
    exact = ij.observe(iris, seen, ij.RadiativeExact(24, process=ij.POLARISED))
    photons = ij.PolarisedMonteCarlo(20_000, 0.3)
    sampled = ij.observe(iris, seen, photons, key=jax.random.key(0))
    # Seen within a cone of 0.3, the light is a tenth less than along its axis.
    np.testing.assert_allclose(sampled.stokes[0, 3], exact.stokes[0, 3], rtol=0.25)
    assert abs(exact.stokes[0, 3]) > 0.01
