"""Radiative transfer with a share of Henyey and Greenstein's scattering: limits, tables, photons."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mixed_layers import LB06, MATCHED, REVERSED, _solve, mixed
from mixed_layers import solve as solve_alone

import irisjax as ij
from common import chandrasekhar, layers, quick_jit
from irisjax.optics.mixture import PhaseMixture
from irisjax.transport.radiative import resolution

pytestmark = pytest.mark.peer

DEPTHS = (0.0, 1e-12, 1.0, 1e6)
SOLVER = ij.AddingDoubling(16, 23)  # one program for nearly all
COUNT = 12


def slabs(abl, absorption, scattering, rayleigh, g, indices):
    """Slabs, the last one repeated until there are 12."""
    columns = np.broadcast_arrays(*np.atleast_1d(abl, absorption, scattering, rayleigh, g))
    missing = COUNT - columns[0].size
    return mixed(*(np.pad(x, (0, missing), "edge") for x in columns), indices)


def solve(seen, cosine, solver=SOLVER):
    return solve_alone(seen, jnp.asarray(cosine, float), solver)


def test_deep_isotropic_medium_is_chandrasekhars():
    albedos = np.array([0.5, 0.9, 0.999])
    seen = slabs(0.0, 2.0e4 * (1 - albedos), 2.0e4 * albedos, 0.0, 0.0, MATCHED)
    for mu in (1.0, 0.6):
        found = solve(seen, mu).reflectance
        true = [chandrasekhar(albedo, mu) for albedo in albedos]
        np.testing.assert_allclose(found[: albedos.size], true, rtol=2e-5)


def test_slab_of_a_table():
    """Plane albedo of a conservative isotropic slab of depth 1, light along the normal: 0.34133
    [van de Hulst 1980, Table 12].
    """
    seen = slabs(0.0, 0.0, 1.0, 0.0, 0.0, MATCHED)
    np.testing.assert_allclose(solve(seen, 1.0).reflectance, 0.34133, atol=1e-5)


def test_rayleighs_law_alone_is_the_exact_solver():
    depths = np.linspace(0.0, 2.0, COUNT), np.linspace(0.05, 5.0, COUNT)
    wanted = solve(layers(0.2, *depths, LB06), 1.0, ij.RadiativeExact(40, 10, 2))
    found = solve(slabs(0.2, *depths, 1.0, 0.5, LB06), 1.0)
    np.testing.assert_allclose(found.reflectance, wanted.reflectance, rtol=2e-5)
    for layer in ("abl", "stroma", "ipe"):
        np.testing.assert_allclose(
            getattr(found.absorbed, layer), getattr(wanted.absorbed, layer), rtol=2e-4, atol=1e-7
        )


@pytest.mark.parametrize(
    ("indices", "g", "rayleigh", "bits"),
    [
        (LB06, 0.95, 0.0, 64),
        (LB06, -0.9, 0.4, 64),
        (MATCHED, 0.95, 0.4, 64),
        (REVERSED, 0.95, 0.0, 64),
        (LB06, 0.95, 0.0, 32),
    ],
)
def test_no_wrong_number_at_any_depth(indices, g, rayleigh, bits):
    """Every share is in [0, 1] and they sum to one, whatever the depth, albedo and angle."""
    small = 1e-12 if bits == 64 else 2e-5
    depth, albedo = np.repeat(DEPTHS, 3), np.tile([0.0, 0.7, 1.0], len(DEPTHS))
    if bits == 32:  # refused by name: see below
        kept = (depth < 1e6) | (albedo < 1)
        depth, albedo = depth[kept], albedo[kept]
    seen = slabs(0.1, depth * (1 - albedo), depth * albedo, rayleigh, g, indices)
    for cosine in (1.0, 1e-3):
        light = solve(seen, cosine)
        shares = light.reflectance, *jax.tree.leaves(light.absorbed)
        assert all(np.isfinite(x).all() for x in shares)
        assert min(np.min(x) for x in shares) >= -small
        np.testing.assert_allclose(light.energy, 1.0, atol=max(small, 1e-9))
        # Only where light grazes a peaked slab are 16 angles too few: see below.
        grazes = cosine < 1 and g == 0.95
        assert bool(light.status == ij.RESULTS.successful) or (
            grazes and bool(light.status == ij.RESULTS.too_few_angles)
        )


def test_single_precision_says_where_it_loses_count():
    """Scattered 10¹² times before it is absorbed, light would leave with up to 0.3 % too little."""
    with jax.enable_x64(False):
        made = slabs(0.1, 0.0, 1e6, 0.0, 0.9, LB06)
        status = jax.jit(resolution.status_of)(made, jnp.asarray(True))
        assert bool(status == ij.RESULTS.ill_conditioned)


def test_too_few_doublings_are_said():
    deepest = slabs(0.1, 100.0, 2e6, 0.0, 0.9, LB06)
    assert bool(solve(deepest, 1.0).status == ij.RESULTS.under_resolved)
    seen = slabs(0.1, 10.0, 990.0, 0.0, 0.9, LB06)
    assert SOLVER.prepare(seen, ij.Light(1.0)).n_doublings == 23  # stated is stated
    assert ij.AddingDoubling(16).prepare(seen, ij.Light(1.0)).n_doublings == 16


def test_photons_agree():
    """Of 20,000 photons, within four standard errors, with mismatched indices."""
    absorption, scattering = np.array([0.05, 0.5, 0.02]), np.array([3.0, 5.0, 0.4])
    mixture = np.array([0.1, 0.0, 0.5]), np.array([0.85, 0.7, -0.4])
    seen = mixed(0.1, absorption, scattering, *mixture, LB06)
    solver = ij.MonteCarlo(20_000, process=ij.DEPTH_RESOLVED)
    photons = jax.jit(lambda s: solver.solve(s, ij.Light(1.0), key=jax.random.key(3)))(seen)
    found = solve(slabs(0.1, absorption, scattering, *mixture, LB06), 1.0)
    found = jax.tree.map(lambda x: x[:3] if jnp.ndim(x) else x, found)
    apart = np.asarray((photons.reflectance - found.reflectance) / photons.standard_error)
    assert np.abs(apart).max() < 4
    p, q = (np.asarray(x.absorbed.stroma) for x in (photons, found))
    assert np.abs((p - q) / np.sqrt(q * (1 - q) / 20_000)).max() < 4


def test_gradients_are_those_of_differences():
    def value(x):
        iris = ij.Iris.of_level("low").replace(
            reduced_scattering=x[0], rayleigh_share=x[1], scattering_power=x[2], anisotropy=x[3]
        )
        made = iris.layers(ij.extinction(np.array([420.0, 640.0])), 1.336)
        return _solve(made, 1.0, ij.AddingDoubling(12, 6)).reflectance.sum()

    x, run = jnp.array([1.1, 0.3, 1.2, 0.8]), quick_jit(value)
    step = 1e-5
    wanted = [(run(x + step * d) - run(x - step * d)) / (2 * step) for d in jnp.eye(4)]
    np.testing.assert_allclose(quick_jit(jax.grad(value))(x), wanted, rtol=1e-6)


def angular(seen, cosine, exits, solver=None):
    """BRDF of two slabs at azimuth 0.7, and the status."""
    solver = ij.AddingDoubling(12, 8) if solver is None else solver
    exits = ij.Directions(np.pad(exits, (0, 4 - len(exits)), "edge"), 0.7)
    found = solve_alone(seen, jnp.asarray(cosine), solver, exits)
    return found.brdf, found.status


def test_brdf_of_rayleighs_law_is_the_exact_solvers():
    depths = 0.1, 0.1, np.array([0.5, 2.0])
    found = angular(mixed(*depths, 1.0, 0.0, LB06), 0.9, [0.4])[0]
    exact = angular(layers(*depths, LB06), 0.9, [0.4], ij.RadiativeExact(24, 8, 1))[0]
    np.testing.assert_allclose(found, exact, rtol=2e-4)


def test_a_brdf_whose_moments_are_missing_says_so():
    """Light scattered once in the thin limit is τ p(Θ)/(4π μ μ₀) in every direction; a BRDF is that
    to 5e-3, or has the status. Reflectance takes fewer moments.
    """
    depth, cosine, g = 1e-6, np.array([0.1, 0.3, 0.7, 1.0]), 0.6
    for peak, said in ((g, False), (0.9, True), (-0.9, True)):
        seen = slabs(0.0, 0.0, depth, 0.0, peak, MATCHED)
        assert bool(resolution.brdf_resolved(seen, seen.phase, 12)) != said
        assert bool(solve(seen, 0.9).status == ij.RESULTS.successful)
    found, status = angular(mixed(0.0, 0.0, depth * np.ones(2), 0.0, g, MATCHED), 0.9, cosine)
    turned = -0.9 * cosine + np.sqrt(1 - 0.9**2) * np.sqrt(1 - cosine**2) * np.cos(0.7)
    phase = (1 - g * g) / (1 + g * g - 2 * g * turned) ** 1.5
    np.testing.assert_allclose(found[0], depth * phase / (4 * np.pi * cosine * 0.9), rtol=5e-3)
    assert bool(status == ij.RESULTS.successful)


@pytest.mark.parametrize("solver", [None, ij.RadiativeExact(), ij.MonteCarlo(1000)])
def test_solvers_of_rayleighs_law_refuse(solver):
    iris = ij.Iris(power_law=ij.PowerLaw())
    with pytest.raises(ValueError, match="a power law of scattering takes radiative transfer"):
        ij.reflectance(iris, [500.0], solver=solver, key=jax.random.key(0))


def test_a_picture_refuses():
    with pytest.raises(ValueError, match="not a power law"):
        ij.Scene(iris=ij.Iris(power_law=ij.PowerLaw()))


@pytest.mark.slow
def test_pointwise_derivatives_pass_through_the_phase_function():
    from irisjax.transport.pointwise import Pointwise

    def value(g, solver):
        seen = mixed(0.1, 0.2, np.ones(8), 0.3, 0.5, MATCHED)
        phase = PhaseMixture(seen.phase.rayleigh, g * jnp.ones(8))
        seen = dataclasses.replace(seen, phase=phase)
        return _solve(seen, 1.0, solver).reflectance.sum()

    slope = [eqx.filter_jit(jax.jacfwd(value))(jnp.asarray(0.5), s)
             for s in (ij.AddingDoubling(4, 2), Pointwise(ij.AddingDoubling(4, 2)))]  # fmt: skip
    np.testing.assert_allclose(*slope, rtol=1e-9)
