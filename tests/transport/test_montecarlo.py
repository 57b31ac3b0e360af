import dataclasses
import functools
import os
import socket
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

import common
import irisjax as ij
from common import quick_jit
from irisjax.measure.colour import illuminant_power
from irisjax.transport.process import AbstractProcess

GRID = np.array([420.0, 450.0, 550.0, 700.0])
ANALOG = {
    "printed": ij.ILIT_2006,
    "retest-redrawn": ij.Ilit(rescatter="retest", perturb_on_reflection=True),
}


def shares(m):
    return np.stack([m.values, m.mirrored, m.absorbed.abl, m.absorbed.stroma, m.absorbed.ipe])


FEW = ij.IlitExact(12)
PHOTONS = ij.MonteCarlo(40_000)
LOW = ij.Iris.of_level("low")


@functools.cache
def exactly(solver):
    """The exact solver, one program for all irides and both directions of light."""
    how = {"solver": solver, "first_surface": False}
    return quick_jit(lambda iris, mu: ij.reflectance(iris, GRID, cos_incidence=mu, **how))


def counted(iris, seed, solver=PHOTONS, cosine=1.0):
    """One program for each solver."""
    how = {"cos_incidence": cosine, "first_surface": False, "throw": False}
    return ij.reflectance(iris, GRID, solver=solver, key=jax.random.key(seed), **how)


@pytest.mark.parametrize("level", ["low", "high"])
@pytest.mark.parametrize("name", ANALOG)
def test_analog_agrees_with_exact(name, level):
    spheres = "rayleigh-spheres" if name == "retest-redrawn" else "lb06"
    iris = ij.Iris.of_level(level).replace(scattering=spheres)
    exact = shares(exactly(common.exact(ANALOG[name], 12))(iris, 0.7))
    solver = dataclasses.replace(PHOTONS, process=ANALOG[name])
    found = shares(counted(iris, 11, solver, 0.7))
    z = (found - exact) / np.sqrt(exact * (1 - exact) / solver.n_photons)
    # 20 comparisons a case, 80 in all: |z| < 4 fails by chance once in 200 runs of other seeds.
    assert np.abs(z).max() < 4
    for all_shares in (found.sum(0), exact.sum(0)):
        np.testing.assert_allclose(all_shares, 1, atol=1e-12)


@pytest.mark.parametrize("level", ["low", "high"])
def test_radiative_transfer_agrees_with_the_reference_table(level):
    wanted = [
        float(row["reflectance"])
        for row in common.reference("depth_resolved_reflectance.csv")
        if (row["level"], row["abl_fraction"], row["mu_i"]) == (level, "0.5", "0.5")
        and float(row["wavelength_nm"]) in GRID
    ]
    assert len(wanted) == len(GRID)
    iris = ij.Iris.of_level(level).replace(abl_fraction=0.5)
    solver = dataclasses.replace(PHOTONS, process=ij.DEPTH_RESOLVED)
    found = counted(iris, 11, solver, 0.5)
    whole = found.values + found.mirrored
    assert np.abs((whole - np.array(wanted)) / found.standard_error).max() < 4
    np.testing.assert_allclose(shares(found).sum(0), 1, atol=1e-12)


def test_standard_error_is_binomial_and_never_none():
    n = PHOTONS.n_photons
    black = ij.Iris.of_level("high").replace(melanin_load=500.0, abl_fraction=1.0)
    for iris, none in ((black, True), (LOW, False)):
        m = counted(iris, 0)
        assert ((m.values == 0) == none).all()
        p = (n * np.asarray(m.values) + 1) / (n + 2)
        np.testing.assert_allclose(m.standard_error, np.sqrt(p * (1 - p) / n), rtol=1e-9)


def test_equal_keys_give_equal_bytes():
    a, b, c = (np.asarray(counted(LOW, s).values).tobytes() for s in (7, 7, 8))
    assert a == b != c


@jax.jit
def narrow(power, first, last):
    """Counts of a block of photons in few lanes."""
    solver, layers = dataclasses.replace(PHOTONS, lanes=1024), LOW.layers(ij.extinction(GRID))
    light, key = ij.Light(1.0, power=power), jax.random.key(3)
    return solver.count(layers, light, key=key, first=first, last=last)


def test_lanes_and_blocks_do_not_change_a_photon():
    blocks = ((0, 1), (1, 3_000), (3_000, 50_000))
    found = sum(np.asarray(narrow(np.ones(4), *block).fates) for block in blocks)
    whole = PHOTONS.n_photons * shares(counted(LOW, 3))
    np.testing.assert_array_equal(np.rint(whole)[[1, 0, 2, 3, 4]].T, found)
    assert found.sum() == PHOTONS.n_photons * len(GRID)


def test_rays_follow_the_illuminant():
    key = jax.random.key(0)
    bare = exactly(FEW)(LOW, 1.0)
    power = illuminant_power("A", GRID) * float(ij.Media().inward(1.0)[0]) / np.pi
    found = ij.radiance(LOW, GRID, illuminant="A", solver=PHOTONS, key=key)
    z = (found.values - power * (bare.values + bare.mirrored)) / found.standard_error
    assert np.abs(z).max() < 4
    photons = narrow(np.array([0.2, 0.4, 0.8, 0.1]), 0, 50_000).photons
    np.testing.assert_array_equal(photons, [10_000, 20_000, 40_000, 5_000])


def test_brdf_counts_cells():
    cosine = np.linspace(0.05, 0.95, 10)  # cells of width 0.1
    photons, key = ij.MonteCarlo(100_000), jax.random.key(2)
    found = ij.brdf(LOW, [550.0], cos_exit=cosine, solver=photons, key=key)
    fine = np.linspace(0.0005, 0.9995, 1000)
    exact = quick_jit(lambda x: ij.brdf(x, [550.0], cos_exit=fine, solver=FEW).values[0])(LOW)
    exact, weight = (np.reshape(x, (10, 100)) for x in (exact, fine))
    cell = (exact * weight).sum(1) / weight.sum(1)
    assert np.abs((found.values[0] - cell) / found.standard_error[0]).max() < 4


def test_works_under_jit_and_vmap_and_ends_where_layers_are_invalid():
    def spectrum(eumelanin, seed):
        found = counted(LOW.replace(eumelanin=eumelanin), seed)
        return found.values, found.status == ij.RESULTS.invalid_input

    values, invalid = jax.jit(jax.vmap(spectrum))(jnp.array([0.1, 0.5, jnp.nan]), jnp.arange(3))
    np.testing.assert_array_equal(values[1], spectrum(0.5, 1)[0])
    assert invalid.tolist() == [False, False, True]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"n_photons": 0}, "n_photons = 0 is outside"),
        ({"n_photons": 2**31}, "outside"),
        ({"n_photons": 10, "lanes": 3}, "lanes"),
    ],
)
def test_wrong_settings_are_named(settings, message):
    # Under the tests' run-time type checks a name that is not known fails before it reaches our
    # own.
    with pytest.raises((ValueError, jaxtyping.TypeCheckError), match=message):
        ij.MonteCarlo(**settings)


def test_what_is_not_offered_is_said():
    with pytest.raises(ValueError, match="needs a key"):
        ij.reflectance(LOW, GRID, solver=ij.MonteCarlo(10))
    deep = ij.MonteCarlo(10, process=ij.DEPTH_RESOLVED)
    with pytest.raises(ValueError, match="use RadiativeExact"):
        ij.brdf(LOW, GRID, cos_exit=0.5, solver=deep, key=jax.random.key(0))

    class Unknown(AbstractProcess):
        name, transport, polarised = "none", "of its own", False

    with pytest.raises(ValueError, match=r"no events of .*known: Ilit, RadiativeTransfer"):
        ij.MonteCarlo(10, process=Unknown())


_PROGRAM = """
import sys, jax
address, number, place = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
if number > 1:
    jax.distributed.initialize(address, number, place)
assert len(jax.devices()) == number
import numpy as np, irisjax as ij
layers = ij.Iris.of_level("low").layers(ij.extinction(np.array([450.0, 550.0])))
for process in (ij.ILIT_2006, ij.DEPTH_RESOLVED):
    solver = ij.MonteCarlo(20_000, mesh=ij.photon_mesh(), process=process)
    counts = solver.count(layers, ij.Light(1.0), key=jax.random.key(3))
    print("counts", np.asarray(counts.fates).ravel().tolist())
"""


def _start(address, number, place):
    flags = "--xla_force_host_platform_device_count=1 --xla_backend_optimization_level=0"
    return subprocess.Popen(
        [sys.executable, "-c", _PROGRAM, address, str(number), str(place)],
        env={**os.environ, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu", "JAX_ENABLE_X64": "1"},
        cwd=Path(ij.__file__).parent.parent,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def _counts(process):
    out, err = process.communicate(timeout=240)
    assert process.returncode == 0, err
    return [line for line in out.splitlines() if line.startswith("counts")]


@pytest.mark.peer  # three processes, each compiling for itself
def test_processes_do_not_change_counts():
    """Devices of one process do not either: tests/on_four_devices.py."""
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        address = "127.0.0.1:" + str(unused.getsockname()[1])
    alone = _counts(_start(address, 1, 0))
    pair = [_start(address, 2, place) for place in range(2)]
    assert len(alone) == 2
    assert [_counts(process) for process in pair] == [alone, alone]
