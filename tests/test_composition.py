"""Public calls within other programs: loops, batches, derivatives, exports, meshes of devices."""

import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.export
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import quick_jit, slowly
from experiments.closed_formulas import KubelkaMunk

GRID = (430.0, 500.0, 570.0, 640.0)
KEY = jax.random.key(0)
LOW = ij.Iris.of_level("low")
FEW = ij.IlitExact(12, process=ij.ILIT_CORRECTED)  # where the number of angles is not the point


def spectrum(iris, grid=GRID, **settings):
    return ij.reflectance(iris, grid, **settings).values


def test_an_iris_as_the_carry_of_a_scan_that_is_mapped():
    def step(iris, factor):
        iris = iris.replace(eumelanin=iris.eumelanin * factor, stroma_thickness=0.3)
        return iris, spectrum(iris, solver=FEW)

    factors = jnp.asarray([1.0, 1.1, 1.2])
    batch = jax.tree.map(lambda x: np.stack([1.1 * np.asarray(x), x]), LOW)
    last, found = quick_jit(jax.vmap(lambda iris: jax.lax.scan(step, iris, factors)))(batch)
    assert last.order == LOW.order
    irides = (LOW.replace(eumelanin=0.1201 * c, stroma_thickness=0.3) for c in (1, 1.1))
    expected = [spectrum(iris, solver=FEW) for iris in irides]
    np.testing.assert_allclose(found[1, :2], expected, rtol=1e-12)
    loads = jax.lax.scan(lambda i, x: (i.replace(melanin_load=x), i.melanin_load), LOW, factors)[1]
    np.testing.assert_allclose(loads[1:], factors[:2], rtol=1e-12)


@pytest.mark.peer
def test_one_wavelength_at_a_time():
    grid = jnp.asarray(GRID)
    for measure in (ij.reflectance, ij.radiance):

        def one(w, measure=measure):
            return measure(LOW, w[None], solver=FEW).values[0]

        known = measure(LOW, GRID, solver=FEW).values
        np.testing.assert_allclose(quick_jit(jax.vmap(one))(grid), known, rtol=1e-12)
    grid = jnp.arange(400.0, 701, 20)
    traced = quick_jit(lambda w: ij.colour(LOW, w, solver=FEW))(grid)
    known = ij.colour(LOW, np.asarray(grid), solver=FEW)
    for a, b in zip(jax.tree.leaves(traced), jax.tree.leaves(known), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9)
    shifted = quick_jit(jax.vmap(lambda d: ij.colour(LOW, grid + d, solver=FEW).lab))
    expected = [ij.colour(LOW, np.asarray(grid) + d, solver=FEW).lab for d in (0.0, 5.0)]
    found = shifted(jnp.asarray([0.0, 5.0]))
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_exported_programs_give_the_same_numbers():
    """Written as bytes, and read again."""
    pytest.importorskip("flatbuffers", reason="jax.export writes bytes by way of flatbuffers")
    leaves, structure = jax.tree.flatten(LOW)

    def run(grid, *leaves):
        iris = jax.tree.unflatten(structure, leaves)
        return spectrum(iris, grid, solver=FEW, throw=False)

    grid = jnp.asarray(GRID)
    again = jax.export.deserialize(jax.export.export(jax.jit(run))(grid, *leaves).serialize())
    expected = spectrum(LOW, solver=FEW)
    np.testing.assert_allclose(again.call(grid, *leaves), expected, rtol=1e-13)


def like(f, *arguments):
    """What a function returns, with zeros for its numbers: nothing is compiled."""
    return jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(f, *arguments))


def values():
    iris, extinction = LOW, ij.extinction(np.asarray(GRID))
    return {
        "iris": iris,
        "indices": iris.indices(),
        "layers": quick_jit(ij.Iris.layers)(iris, extinction),
        "extinction": extinction,
        "media": ij.Media(),
        "spectrophotometer": ij.Spectrophotometer(GRID),
        "radiometer": ij.Radiometer(GRID),
        "colorimeter": ij.Colorimeter(ij.wavelengths(400, 700, 20)),
        "goniophotometer": ij.Goniophotometer(GRID, cos_exit=[0.3, 0.6]),
        "measurement": like(lambda i: ij.reflectance(i, GRID, solver=FEW), iris),
        "colour": like(lambda i: ij.colour(i, solver=FEW), iris),
        "brdf": like(lambda i: ij.brdf(i, GRID, cos_exit=[0.3, 0.6], solver=FEW), iris),
        "solver": ij.IlitExact(),
        "radiative": ij.RadiativeExact(),
        "monte carlo": ij.MonteCarlo(64),
        "process": ij.ILIT_2006,
        "radiative transfer": ij.DEPTH_RESOLVED,
        "eye": ij.Eye(),
    }


def test_public_values_are_pytrees():
    made = values()
    all_through = jax.jit(lambda x: x)(made)  # one program
    for name, value in made.items():
        leaves, structure = jax.tree.flatten(value)
        again, through = jax.tree.unflatten(structure, leaves), all_through[name]
        assert type(again) is type(value), name
        assert jax.tree.structure(again) == jax.tree.structure(through) == structure, name
        assert hash(structure) == hash(jax.tree.structure(again)), name
        for a, b in zip(jax.tree.leaves(through), leaves, strict=True):
            assert (a.dtype, a.shape) == (jnp.asarray(b).dtype, np.shape(b)), name
            np.testing.assert_array_equal(a, b, err_msg=name)


@pytest.mark.peer
def test_traced_or_known_radiative_transfer_is_the_same():
    def run(iris, solver):
        m = ij.reflectance(iris, GRID, solver=solver, throw=False)
        return m.values, m.status == ij.RESULTS.under_resolved

    solver = ij.RadiativeExact(12, 8, n_panels=1)
    for scale, refused in ((1.0, False), (100.0, True)):
        iris = LOW.replace(scattering_scale=scale)
        known = run(iris, solver)
        traced = jax.jit(run, static_argnums=1)(iris, solver)
        np.testing.assert_allclose(traced[0], known[0], rtol=1e-12)
        assert bool(known[1]) == bool(traced[1]) == refused
    thick = LOW.replace(scattering_scale=100.0)
    # Where panels are not given, a known iris takes what it needs; a traced one says so.
    assert not run(thick, ij.RadiativeExact(12, 8))[1]
    assert jax.jit(run, static_argnums=1)(thick, ij.RadiativeExact(12, 8))[1]


def test_traced_or_known_ilit_is_the_same():
    """An iris all of whose fields are traced gets a rule for every order of media."""
    solver = ij.IlitExact(process=ij.ILIT_CORRECTED)
    traced = quick_jit(lambda fields: spectrum(ij.Iris(**fields), solver=solver))
    fields = {name: jnp.asarray(value) for name, value in LOW.parameters().items()}
    np.testing.assert_allclose(traced(fields), spectrum(LOW, solver=solver), rtol=1e-9)


def test_a_base_without_pigments():
    data = ij.spectrum(np.asarray(GRID), np.linspace(0.06, 0.02, 4), sd=np.full(4, 1e-3))
    none = ("eumelanin", "pheomelanin", "oxyhemoglobin", "deoxyhemoglobin")
    base = ij.Iris().replace(**dict.fromkeys(none, 0.0))
    stated = ij.problem(data, base=base, solver=KubelkaMunk())
    z = jnp.zeros(len(stated.free))
    value_and_slope = quick_jit(jax.value_and_grad(type(stated).log_posterior, 1))
    for x in (*value_and_slope(stated, z), *stated.natural(z)):
        assert np.isfinite(x).all()


# Devices --------------------------------------------------------------------------------------

_ON_FOUR = Path(__file__).parent / "on_four_devices.py"


@pytest.mark.parametrize(
    ("cases", "count"),
    [
        pytest.param(["exact: explicit", "radiative: explicit"], 2, marks=pytest.mark.peer),
        slowly([""], 3 * 7 + 3),
    ],
    ids=["two", "all"],
)
def test_solvers_derivatives_and_photons_on_a_mesh(cases, count):
    """The script prints the largest difference of each case by its name, or an error as text."""
    flags = "--xla_force_host_platform_device_count=4 --xla_backend_optimization_level=0"
    environment = {**os.environ, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu", "JAX_ENABLE_X64": "1"}
    place = {"env": environment, "cwd": Path(ij.__file__).parent.parent, "timeout": 550}
    command = [sys.executable, str(_ON_FOUR), *cases]
    done = subprocess.run(command, **place, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert len(found) == count
    for name, difference in found.items():
        limit = {"photons": 0.0, "monte": 0.0, "derivatives": 1e-12}.get(name.split()[0], 1e-13)
        assert isinstance(difference, float) and difference <= limit, (name, difference)
