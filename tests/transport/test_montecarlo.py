import dataclasses
import functools
import os
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
from irisjax.transport.process import AbstractProcess

GRID = (420.0, 450.0, 550.0, 700.0)
ANALOG = {
    "printed": ij.ILIT_2006,
    "retest": ij.Ilit(phase="rayleigh", rescatter="retest"),
    "redrawn": ij.Ilit(perturb_on_reflection=True),
    "depth-resolved": ij.DEPTH_RESOLVED,
}
FATES = ("values", "mirrored", "abl", "stroma", "ipe")


def shares(m):
    return np.stack([m.values, m.mirrored, m.absorbed.abl, m.absorbed.stroma, m.absorbed.ipe])


@functools.cache
def exactly(**settings):
    """The exact solver, one program for all irides."""
    return quick_jit(lambda iris: ij.reflectance(iris, GRID, **settings))


@pytest.mark.parametrize("level", ["low", "high"])
@pytest.mark.parametrize("name", ["printed", "depth-resolved", "retest", "redrawn"])
def test_analog_agrees_with_exact(name, level):
    n = 40_000
    spheres = "rayleigh-spheres" if name == "retest" else "lb06"
    iris = ij.Iris.of_level(level).replace(scattering=spheres)
    settings = {"cos_incidence": 0.7, "first_surface": False}
    exact = shares(exactly(solver=common.exact(ANALOG[name], 12), **settings)(iris))
    photons = ij.MonteCarlo(n, process=ANALOG[name])
    found = shares(ij.reflectance(iris, GRID, **settings, solver=photons, key=jax.random.key(11)))
    z = (found - exact) / np.sqrt(exact * (1 - exact) / n)
    # 20 comparisons a case, 200 in all: |z| < 4 fails by chance once in 80 runs of other seeds.
    assert np.abs(z).max() < 4
    np.testing.assert_allclose(found.sum(0), 1, atol=1e-12)


def test_standard_error_is_binomial_and_never_none():
    black = ij.Iris.of_level("high").replace(melanin_load=500.0, abl_fraction=1.0)
    m = ij.reflectance(
        black, [450.0], solver=ij.MonteCarlo(1000), key=jax.random.key(0), first_surface=False
    )
    assert m.values[0] == 0
    assert m.standard_error[0] > 1e-4


def test_equal_keys_give_equal_bytes():
    solver = ij.MonteCarlo(40_000)  # the program of the test above
    iris = ij.Iris.of_level("low")
    a, b, c = (
        ij.reflectance(iris, GRID, solver=solver, key=jax.random.key(s), first_surface=False)
        for s in (7, 7, 8)
    )
    assert np.asarray(a.values).tobytes() == np.asarray(b.values).tobytes()
    assert np.asarray(a.values).tobytes() != np.asarray(c.values).tobytes()


def test_lanes_and_blocks_do_not_change_a_photon():
    iris, key, light = ij.Iris.of_level("low"), jax.random.key(3), ij.Light(1.0)
    layers = iris.layers(ij.extinction(np.array(GRID)))
    solver = ij.MonteCarlo(40_000)
    whole = solver.count(layers, light, key=key)
    narrow = dataclasses.replace(solver, lanes=1024).count(layers, light, key=key)
    blocks = [
        solver.count(layers, light, key=key, first=a, last=b)
        for a, b in ((0, 1), (1, 3_000), (3_000, 50_000))
    ]
    np.testing.assert_array_equal(whole.fates, narrow.fates)
    np.testing.assert_array_equal(whole.fates, sum(b.fates for b in blocks))
    assert int(whole.fates.sum()) == 40_000 * len(GRID)


def test_rays_follow_the_illuminant():
    iris, solver, key = ij.Iris.of_level("low"), ij.MonteCarlo(40_000), jax.random.key(0)
    few = ij.IlitExact(12)
    exact = quick_jit(lambda x: ij.radiance(x, GRID, illuminant="A", solver=few))(iris)
    found = ij.radiance(iris, GRID, illuminant="A", solver=solver, key=key)
    assert np.abs((found.values - exact.values) / found.standard_error).max() < 4
    layers = iris.layers(ij.extinction(np.array(GRID)))
    light = ij.Light(1.0, power=jnp.asarray([0.2, 0.4, 0.8, 0.1]))
    photons = solver.count(layers, light, key=key).photons
    np.testing.assert_array_equal(photons, [10_000, 20_000, 40_000, 5_000])


def test_brdf_counts_cells():
    iris = ij.Iris.of_level("low")
    cosine = np.linspace(0.05, 0.95, 10)  # cells of width 0.1
    photons = ij.MonteCarlo(100_000)
    found = ij.brdf(iris, [550.0], cos_exit=cosine, solver=photons, key=jax.random.key(2))
    fine = np.linspace(0.0005, 0.9995, 1000)
    few = ij.IlitExact(12)
    exact = quick_jit(lambda x: ij.brdf(x, [550.0], cos_exit=fine, solver=few).values[0])(iris)
    exact = np.asarray(exact).reshape(10, 100)
    weight = fine.reshape(10, 100)
    cell = (exact * weight).sum(1) / weight.sum(1)
    assert np.abs((found.values[0] - cell) / found.standard_error[0]).max() < 4


def test_works_under_jit_and_vmap():
    solver, key = ij.MonteCarlo(40_000), jax.random.key(0)

    def spectrum(eumelanin, key):
        return ij.reflectance(
            ij.Iris.of_level("low").replace(eumelanin=eumelanin), GRID, solver=solver, key=key
        ).values

    keys = jax.random.split(key, 2)
    both = jax.jit(jax.vmap(spectrum))(jnp.asarray([0.1, 0.5]), keys)
    np.testing.assert_array_equal(both[1], spectrum(0.5, keys[1]))


def test_invalid_layers_end_at_once():
    iris = ij.Iris.of_level("low")

    def status(c):
        m = ij.reflectance(
            iris.replace(eumelanin=c), GRID, solver=ij.MonteCarlo(1_000), key=jax.random.key(0),
            throw=False,
        )  # fmt: skip
        return m.status == ij.RESULTS.invalid_input

    assert jax.jit(status)(jnp.nan)
    assert not jax.jit(status)(0.1)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"n_photons": 0}, "n_photons = 0 is outside"),
        ({"n_photons": -3}, "outside"),
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
    iris, key = ij.Iris.of_level("low"), jax.random.key(0)
    with pytest.raises(ValueError, match="needs a key"):
        ij.reflectance(iris, GRID, solver=ij.MonteCarlo(10))
    deep = ij.MonteCarlo(10, process=ij.DEPTH_RESOLVED)
    with pytest.raises(ValueError, match="use RadiativeExact"):
        ij.brdf(iris, GRID, cos_exit=0.5, solver=deep, key=key)

    class Unknown(AbstractProcess):
        name, transport, polarised = "none", "of its own", False

    with pytest.raises(ValueError, match=r"no events of .*known: Ilit, RadiativeTransfer"):
        ij.MonteCarlo(10, process=Unknown())


_PROGRAM = """
import sys, jax
if sys.argv[1] != "-":
    jax.distributed.initialize(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
import numpy as np, irisjax as ij
layers = ij.Iris.of_level("low").layers(ij.extinction(np.array([450.0, 550.0])))
for process in (ij.ILIT_2006, ij.DEPTH_RESOLVED):
    solver = ij.MonteCarlo(20_000, mesh=ij.photon_mesh(), process=process)
    counts = solver.count(layers, ij.Light(1.0), key=jax.random.key(3))
    print("counts", len(jax.devices()), np.asarray(counts.fates).ravel().tolist())
"""


def _start(n_devices, *arguments):
    flags = f"--xla_force_host_platform_device_count={n_devices} --xla_backend_optimization_level=0"
    return subprocess.Popen(
        [sys.executable, "-c", _PROGRAM, *arguments],
        env={**os.environ, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu", "JAX_ENABLE_X64": "1"},
        cwd=Path(ij.__file__).parent.parent,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def _counts(process):
    out, err = process.communicate(timeout=240)
    assert process.returncode == 0, err
    lines = [line.split(maxsplit=2)[1:] for line in out.splitlines() if line.startswith("counts")]
    return [int(n) for n, _ in lines], [counts for _, counts in lines]


@pytest.mark.peer  # four processes, each compiling for itself
def test_devices_and_processes_do_not_change_counts(unused_port):
    one = _counts(_start(1, "-"))
    four = _counts(_start(4, "-"))
    address = f"127.0.0.1:{unused_port}"
    pair = [_start(1, address, "2", str(i)) for i in range(2)]
    pair = [_counts(p) for p in pair]
    assert (one[0], four[0], pair[0][0]) == ([1, 1], [4, 4], [2, 2])
    assert one[1] == four[1] == pair[0][1] == pair[1][1]


@pytest.fixture
def unused_port():
    import socket

    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]
