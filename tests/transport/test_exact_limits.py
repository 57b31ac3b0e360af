"""Exact solvers where the answer is known: matched media, opaque layers, grazing and diffuse light,
and what a BRDF integrates to.
"""

import dataclasses
import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import expn

import common
import irisjax as ij
from common import ILIT, PROCESSES, any_order, layers, quick_jit
from irisjax.optics.fresnel import fresnel_at
from irisjax.transport.process import DEPTH_RESOLVED

pytestmark = pytest.mark.peer

# Depths in optical depth; media are (aqueous, ABL, stroma, IPE).
MATCHED = (1.4, 1.4, 1.4, 1.4)
IRIS = (1.336, 1.4733333333, 1.4727930095, 1.5)

X, W = np.polynomial.legendre.leggauss(64)
X, W = (X + 1) / 2, W / 2


def solve(process, abl, absorption, scattering, media=IRIS, cosine=1.0):
    """One program for each process: with the iris's order of media and, in ILIT, with a BRDF."""
    made = layers(abl, absorption, scattering, media)
    made = dataclasses.replace(made, order=layers(abl, absorption, scattering, IRIS).order)
    exits = None if isinstance(process, ij.RadiativeTransfer) else X
    return common.solve(common.exact(process), made, cosine, exits)


@pytest.mark.parametrize("name", ["lb06", "rayleigh", "lb06-redrawn", "rayleigh-redrawn"])
def test_matched_media_to_interface(name):
    """No interface reflects: into the stroma with 2E₃(τ_A), scattered once, half of it up, out with
    2E₃(τ_A).
    """
    depths = [[0.0, 0.2, 1.0], [0.1, 0.0, 0.5], [0.3, 1.0, 0.05]]
    abl, absorption, scattering = np.array(depths)
    r = solve(PROCESSES[name], abl, absorption, scattering, MATCHED)
    through_abl, through_stroma = 2 * expn(3, abl), 2 * expn(3, absorption + scattering)
    events = through_abl * (1 - through_stroma)
    albedo = scattering / (absorption + scattering)
    np.testing.assert_allclose(r.mirrored, 0, atol=1e-16)
    np.testing.assert_allclose(r.reflectance, events * albedo / 2 * through_abl, rtol=1e-10)
    np.testing.assert_allclose(r.absorbed.stroma, events * (1 - albedo), rtol=1e-10, atol=1e-16)
    np.testing.assert_allclose(
        r.absorbed.ipe, through_abl * through_stroma + events * albedo / 2, rtol=1e-10
    )
    np.testing.assert_allclose(
        r.absorbed.abl, (1 - through_abl) + events * albedo / 2 * (1 - through_abl), rtol=1e-10
    )


@pytest.mark.parametrize("name", PROCESSES)
def test_grazing_incidence(name):
    r = solve(PROCESSES[name], 0.1, 0.1, 0.2, cosine=0.0)
    assert r.mirrored[0] == 1
    assert r.reflectance[0] == 0
    assert r.absorbed.total()[0] == 0


@pytest.mark.parametrize("name", ILIT)
def test_incidence_enters_by_the_first_transmission_only(name):
    cosines = jnp.asarray([1.0, 0.7, 0.2, 0.01])
    made = layers(0.1, 0.1, 0.2, IRIS)
    f, t = fresnel_at(cosines, made.indices.aqueous, made.indices.abl)
    runs = [solve(PROCESSES[name], 0.1, 0.1, 0.2, cosine=c) for c in cosines]
    mirrored, r = (np.array([getattr(x, n)[0] for x in runs]) for n in ("mirrored", "reflectance"))
    np.testing.assert_allclose(mirrored, f, rtol=1e-13)
    np.testing.assert_allclose(r / t, np.full(4, r[0] / t[0]), rtol=1e-12)


def hemisphere(media):
    """Cosines in the aqueous humour and the shares along them of light from all round, between the
    cosines where an interface begins to reflect totally: smooth in √(μ² − edge²).
    """
    critical = {np.sqrt(max(0.0, 1 - (n / media[0]) ** 2)) for n in media[1:]}
    edges = sorted({0.0, 1.0} | critical)
    above, below = np.array(edges[1:])[:, None] ** 2, np.array(edges[:-1])[:, None] ** 2
    squares = below + (above - below) * X**2
    return np.sqrt(squares).ravel(), ((above - below) * 2 * X * W).ravel()


_AT_THE_ABL, _AT_THE_STROMA = (1.45, 1.35, 1.4, 1.42), (1.5, 1.6, 1.4, 1.3)


@functools.cache
def lit(solver):
    """Reflectance of diffuse light, and of beams."""

    def reflectance(made, cosine):
        return solver.solve(made, ij.Light(cosine)).reflectance

    beams = quick_jit(jax.vmap(reflectance, in_axes=(None, 0)))
    return quick_jit(lambda made: reflectance(made, None)), beams


FEW = ij.IlitExact(12, process=ij.ILIT_CORRECTED)


@pytest.mark.parametrize(
    ("solver", "media"),
    [(FEW, IRIS), (FEW, _AT_THE_ABL), (ij.RadiativeExact(40, 4, 1), _AT_THE_STROMA)],
    ids=["ilit", "ilit-abl", "depth-resolved"],
)
def test_diffuse_incidence_is_the_mean_over_the_hemisphere(solver, media):
    """Interfaces that light comes to from the denser side mirror a part of it totally."""
    depth = np.array([1e-3, 1e-2, 0.1, 1.0])
    made = any_order(layers(depth, depth, 2 * depth, media))
    missing = 256 - len(hemisphere(media)[0])  # one shape for all media
    cosines, shares = (np.pad(x, (0, missing)) for x in hemisphere(media))
    diffuse, beams = lit(solver)
    np.testing.assert_allclose(diffuse(made), shares @ np.array(beams(made, cosines)), rtol=1e-7)


@pytest.mark.parametrize(
    ("solver", "tolerance"),
    [
        (ij.RadiativeExact(40, 2, 1), 1e-7),
        (ij.AddingDoubling(32, 0), 1e-6),
        (ij.RadiativeExact(40, 2, 1, process=ij.POLARISED), 1e-7),
    ],
    ids=["scalar", "doubling", "polarised"],
)
def test_diffuse_light_in_thin_layers_that_only_absorb(solver, tolerance):
    """What passes of light from all round is 2E₃(τ), of which grazing light is the hard part."""
    depth = np.geomspace(1e-6, 10, 15)
    found = common.solve(solver, layers(0.0, depth, 0.0, MATCHED), ij.DIFFUSE)
    lost = np.where(depth < 1e-2, _lost_in_thin(depth), 1 - 2 * expn(3, depth))
    np.testing.assert_allclose(found.absorbed.stroma, lost, rtol=tolerance)


def _lost_in_thin(depth):
    """1 − 2E₃(τ) without what cancels  [DLMF 8.19.8]."""
    powers = sum((-depth) ** k / (math.factorial(k) * (k - 2)) for k in (0, 1, 3, 4, 5, 6))
    return 1 + 2 * powers - depth**2 * (1.5 - np.euler_gamma - np.log(depth))


@pytest.mark.parametrize("name", ILIT)
def test_brdf_integrates_to_reflectance(name):
    for cosine in (1.0, 0.3):
        r = solve(
            PROCESSES[name], [0.02, 0.3, 1.0], [0.05, 0.0, 1.5], [0.2, 2.5, 0.3], cosine=cosine
        )
        np.testing.assert_allclose(r.brdf @ (2 * np.pi * X * W), r.reflectance, rtol=1e-9)


def test_status_of_bad_depths():
    for bad in (-0.1, np.nan, np.inf):
        for process in (ij.ILIT_2006, DEPTH_RESOLVED):
            result = solve(process, bad, 0.1, 0.2).status
            assert bool(result == ij.RESULTS.invalid_input)
