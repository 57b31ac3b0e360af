"""Edges of the physics: nothing, everything, equal indices, grazing light; values, energy, status."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import PROCESSES, any_order, exact, layers, quick_jit
from edges import BASE, COSINES, TINY, grazes

pytestmark = pytest.mark.peer

DEPTHS = np.array([0.0, 1e-12, 1e-6, 1e-3, 0.1, 1.0, 10.0, 1e3, 1e6])
ABL, ABSORPTION, SCATTERING = (
    x.ravel() for x in np.meshgrid(DEPTHS, DEPTHS, DEPTHS, indexing="ij")
)
MEDIA = {
    "iris": (1.336, 1.4733333, 1.4727930, 1.5),
    "all-equal": (1.4, 1.4, 1.4, 1.4),
    "aqueous-abl": (1.45, 1.45, 1.4, 1.5),
    "abl-stroma": (1.336, 1.45, 1.45, 1.5),
    "stroma-ipe": (1.336, 1.45, 1.5, 1.5),
    "guided-stroma": (1.336, 1.4, 1.6, 1.5),
    "guided-both": (1.3, 1.5, 1.55, 1.2),
    "rising": (1.3, 1.4, 1.5, 1.6),
    "falling": (1.6, 1.5, 1.4, 1.3),
    "extreme": (1.0, 3.0, 1.0, 3.0),
    "nearly-equal": (1.4, 1.4 * (1 + 1e-9), 1.4, 1.4 * (1 + 1e-14)),
}


def check(solution, bits):
    """Shares in [0, 1] that close."""
    parts = [
        np.asarray(x).astype(np.float64)
        for x in jax.tree.leaves((solution.reflectance, solution.mirrored, solution.absorbed))
    ]
    for part in parts:
        assert np.isfinite(part).all()
        assert part.min() >= -TINY[bits]
        assert part.max() <= 1 + TINY[bits]
    np.testing.assert_allclose(sum(parts), 1, rtol=0, atol=TINY[bits])


def run_grid(solver):
    """All depths as one spectrum, all media and cosines as a batch: one program."""
    sets = [any_order(layers(ABL, ABSORPTION, SCATTERING, m)) for m in MEDIA.values()]
    made = jax.tree.map(lambda *x: jnp.stack(x), *sets)

    def one(made, cosine):
        return solver.solve(made, ij.Light(cosine))

    run = quick_jit(jax.vmap(one, in_axes=(0, None)))
    return [run(made, jnp.asarray(c, float)) for c in COSINES]


@pytest.mark.parametrize(
    ("name", "bits"), [("lb06-redrawn", 64), ("rayleigh-retest", 64), ("rayleigh-retest", 32)]
)
def test_every_depth_index_and_incidence(name, bits):
    for solution in run_grid(exact(PROCESSES[name], 16)):
        check(solution, bits)
        assert bool((solution.status == ij.RESULTS.successful).all())


# An ABL only dims what the stroma scatters: nothing, little, some and all.
SHALLOW = np.flatnonzero((ABSORPTION + SCATTERING <= 2) & np.isin(ABL, (0.0, 1e-12, 1.0, 1e6)))


@pytest.mark.parametrize("media", MEDIA)
def test_depth_resolved_shallow(media, bits):
    depths = (x[SHALLOW] for x in (ABL, ABSORPTION, SCATTERING))
    made = any_order(layers(*depths, MEDIA[media]))
    for cosine in COSINES:
        solution = shallow(made, jnp.asarray(cosine, float))
        check(solution, bits)
        few = grazes(MEDIA[media], cosine) and bool(solution.status == ij.RESULTS.under_resolved)
        assert few or bool(solution.status == ij.RESULTS.successful)


@quick_jit
def shallow(made, cosine):
    return ij.RadiativeExact(12, 10, 2).solve(made, ij.Light(cosine))


def holds(absorption, scattering, bits):
    """Where the precision bears the number of scatterings, 1/(1 − ω + 1/τ²)."""
    total = np.maximum(absorption + scattering, 1e-300)
    return absorption / total + 1 / np.maximum(total, 1) ** 2 >= (0 if bits == 64 else 2e-6)


@pytest.mark.slow
def test_depth_resolved_at_every_depth():
    made = layers(ABL, ABSORPTION, SCATTERING, MEDIA["guided-both"])
    solver = ij.RadiativeExact().prepare(made, ij.Light(1.0))
    solution = quick_jit(lambda x: solver.solve(x, ij.Light(1.0)))(made)
    check(solution, 64)
    assert bool(solution.status == ij.RESULTS.successful)


def test_depth_resolved_deep(bits):
    """Twenty-two panels for an optical depth of a million; where single precision does not hold it,
    the status says so.
    """
    depths = np.array([1e-12, 1e-3, 1.0, 1e3, 1e6])
    absorption, scattering = (x.ravel() for x in np.meshgrid(depths, depths))
    held = holds(absorption, scattering, bits)
    assert held.sum() > 15
    solver = ij.RadiativeExact(n_panels=22)
    run = quick_jit(lambda x: solver.solve(x, ij.Light(1.0)))
    good = run(
        layers(0.0, np.where(held, absorption, 1.0), np.where(held, scattering, 1.0), MEDIA["iris"])
    )
    check(good, bits)
    assert bool(good.status == ij.RESULTS.successful)
    if bits == 32:
        everything = run(layers(0.0, absorption, scattering, MEDIA["iris"]))
        assert bool(everything.status == ij.RESULTS.ill_conditioned)
        assert all(
            np.isfinite(x).all()
            for x in jax.tree.leaves((everything.reflectance, everything.absorbed))
        )
        np.testing.assert_allclose(everything.energy, 1, rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ["lb06", "rayleigh", "depth-resolved"])
def test_monotonic(name):
    """More absorption is never brighter; in depth-resolved transport more scatterers in matched
    media never darker.
    """
    steps = np.geomspace(1e-9, 2.0, 60)
    deep = name == "depth-resolved"
    solver = ij.RadiativeExact(12, 4, 1) if deep else exact(PROCESSES[name], 12)
    run = quick_jit(lambda x: solver.solve(x, ij.Light(1.0)).reflectance)

    def reflected(abl, absorption, scattering, media):
        made = layers(abl, absorption, scattering, MEDIA[media])
        return np.asarray(run(dataclasses.replace(made, order=BASE.order)))

    assert (np.diff(reflected(steps, 0.1, 0.3, "iris")) <= 1e-14).all()
    if deep:
        # ILIT's tests of the whole layer let weak absorption help: the probability of an event
        # grows with it while few events absorb.
        assert (np.diff(reflected(0.05, steps, 0.3, "iris")) <= 1e-14).all()
    assert (np.diff(reflected(0.05, 0.1, steps, "all-equal")) > 0).all()


def test_number_of_wavelengths():
    """The last of many wavelengths, and the same wavelength throughout."""
    for solver, step in ((ij.IlitExact(12), 1), (ij.RadiativeExact(12, 6, 2), 20)):
        grid = np.linspace(400, 700, 4_000)[::step]

        @quick_jit
        def run(iris, grid, solver=solver):
            return ij.reflectance(iris, grid, solver=solver).values

        values = np.asarray(run(BASE, jnp.asarray(grid)))
        assert values.shape == grid.shape
        assert ((values > 0) & (values < 1)).all()
        alike = run(BASE, jnp.full_like(grid, grid[-1]))
        np.testing.assert_allclose(alike, values[-1], rtol=1e-13)
