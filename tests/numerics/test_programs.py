"""Programs that outlive the process."""

import os
import pickle
import subprocess
import sys
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from irisjax.numerics import programs
from irisjax.numerics.programs import keep_programs, program


class Layer(eqx.Module):
    depth: jax.Array
    name: str = eqx.field(static=True)


class Seen(NamedTuple):
    values: jax.Array
    count: int
    layer: Layer


TRACED = []


@program
def seen(layer: Layer, values, power: int, extra=None) -> Seen:
    TRACED.append(power)
    values = jnp.exp(-layer.depth * values) ** power
    return Seen(values, power, Layer(values.sum(), layer.name))


@program
def times(x, function):
    return function(x)


@program
def weak(x):
    return x, jnp.asarray(1.0) * 2.0


@pytest.fixture
def folder(tmp_path):
    keep_programs(tmp_path)
    TRACED.clear()
    yield tmp_path
    keep_programs(None)


def files(folder):
    return sorted(p for p in folder.rglob("*") if p.is_file())


def forgotten():
    """As a new process finds it."""
    for one in (seen, times, weak):
        one._kept.clear()
    jax.clear_caches()
    programs._versions.cache_clear()


def test_a_kept_program_gives_what_it_gave_without_tracing(folder):
    layer, values = Layer(jnp.asarray(2.0), "abl"), np.linspace(0, 1, 5)
    first = seen(layer, values, 2)
    assert len(files(folder)) == 1
    traced = len(TRACED)
    forgotten()
    again = seen(layer, values, 2)
    assert len(TRACED) == traced
    np.testing.assert_array_equal(again.values, first.values)
    np.testing.assert_allclose(again.values, np.exp(-2.0 * values) ** 2, rtol=1e-6)
    assert (again.count, again.layer.name) == (2, "abl")
    # Other numbers in arrays of the same form run in the same program.
    other = seen(Layer(jnp.asarray(0.5), "abl"), 2 * values, 2)
    assert len(TRACED) == traced
    np.testing.assert_allclose(other.values, np.exp(-2.0 * values * 0.5) ** 2, rtol=1e-6)


def test_what_is_no_array_has_its_own_program(folder):
    layer, values = Layer(jnp.asarray(2.0), "abl"), np.linspace(0, 1, 5)
    seen(layer, values, 2)
    assert seen(layer, values, 3).count == 3
    assert isinstance(seen(layer, values, 3.0).count, float)
    assert seen(Layer(layer.depth, "stroma"), values, 2).layer.name == "stroma"
    assert seen(layer, values[:3], 2).values.shape == (3,)
    assert len(files(folder)) == 5


def test_precision_has_its_own_program(folder):
    with jax.enable_x64(False):
        assert weak(jnp.ones(2))[0].dtype == jnp.float32
        single = seen(Layer(jnp.asarray(2.0), "abl"), jnp.ones(3), 2).values.dtype
    with jax.enable_x64(True):
        double = seen(Layer(jnp.asarray(2.0), "abl"), jnp.ones(3), 2).values.dtype
    assert (single, double) == (jnp.float32, jnp.float64)


def test_keys_are_arrays(folder):
    drawn = times(jax.random.key(3), jax.random.normal)
    forgotten()
    assert float(times(jax.random.key(3), jax.random.normal)) == float(drawn)
    assert float(drawn) == float(jax.random.normal(jax.random.key(3)))


def test_half_a_file_is_made_again(folder):
    layer, values = Layer(jnp.asarray(2.0), "abl"), np.ones(4)
    first = seen(layer, values, 2).values
    (path,) = files(folder)
    path.write_bytes(path.read_bytes()[:100])
    forgotten()
    np.testing.assert_array_equal(seen(layer, values, 2).values, first)
    assert len(path.read_bytes()) > 100


def test_what_cannot_be_kept_is_computed_all_the_same(folder):
    # A function without a name in its module.
    assert float(times(jnp.asarray(2.0), lambda x: 3 * x)) == 6
    assert files(folder) == []


def test_weak_types_stay_weak(folder):
    for _ in range(2):
        assert [x.weak_type for x in weak(jnp.asarray(2.0, jnp.float32))] == [False, True]
        forgotten()
    assert len(files(folder)) == 1


def test_under_a_transformation_it_is_the_function(folder):
    slope = jax.grad(lambda d: seen(Layer(d, "abl"), jnp.ones(1), 2).values.sum())(jnp.asarray(1.0))
    assert float(slope) == pytest.approx(-2 * np.exp(-2.0), rel=1e-5)
    assert files(folder) == []


def test_a_folder_that_cannot_be_written_costs_only_time(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("")
    keep_programs(blocked)
    try:
        assert seen(Layer(jnp.asarray(0.0), "abl"), jnp.ones(2), 7).count == 7
    finally:
        keep_programs(None)
    assert blocked.read_text() == ""


def test_programs_of_older_code_go(folder):
    for i in range(8):
        (folder / f"old{i}").mkdir()
        (folder / f"old{i}" / "program").write_bytes(pickle.dumps(i))
        os.utime(folder / f"old{i}", (i, i))
    seen(Layer(jnp.asarray(2.0), "abl"), jnp.ones(2), 5)
    kept = sorted(p.name for p in folder.iterdir())
    assert len(kept) == 4
    assert kept[-3:] == ["old5", "old6", "old7"]


IN_A_PROCESS = """
import sys, jax, numpy as np
jax.config.update("jax_enable_x64", True)
import irisjax as ij
from irisjax.infer import pieces
from irisjax.numerics import programs
programs.keep_programs(sys.argv[1])
made = programs._compiled
programs._compiled = lambda *given: print("traced") or made(*given)
m = ij.spectrum(np.linspace(400, 700, 4), np.full(4, 0.1), sd=0.01, name=sys.argv[2])
print(repr(float(pieces.density(ij.problem(m))(np.zeros((2, 7)))[1])))
"""


@pytest.mark.heavy  # two processes
def test_another_process_finds_it_whatever_the_file_is_called(tmp_path):
    told = [
        subprocess.run(
            [sys.executable, "-c", IN_A_PROCESS, tmp_path, name],
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
        for name in ("one", "two")
    ]
    assert told[0][0] == "traced"
    assert told[1] == told[0][1:]


LINEAR_ALGEBRA = """
import sys, jax, numpy as np
from irisjax.numerics import programs
programs.keep_programs(sys.argv[1])
print(float(programs.Program(jax.numpy.linalg.det)(np.diag([2.0, 3.0]))))
print(sum(p.is_file() for p in __import__("pathlib").Path(sys.argv[1]).rglob("*")))
"""


@pytest.mark.heavy  # two processes
def test_a_kept_program_finds_lapack(tmp_path):
    for _ in range(2):
        told = subprocess.run(
            [sys.executable, "-c", LINEAR_ALGEBRA, tmp_path],
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
        assert [float(x) for x in told] == [6.0, 1]
