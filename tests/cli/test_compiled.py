"""Programs that outlive the process."""

import os
import pickle
import subprocess
import sys
import threading
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from irisjax.cli import compiled
from irisjax.cli.compiled import CachedFunction, ReadAhead


class Layer(eqx.Module):
    depth: jax.Array
    name: str = eqx.field(static=True)


class Seen(NamedTuple):
    values: jax.Array
    count: int
    layer: Layer


TRACED = []


def _seen(layer: Layer, values, power: int, extra=None) -> Seen:
    TRACED.append(power)
    values = jnp.exp(-layer.depth * values) ** power
    return Seen(values, power, Layer(values.sum(), layer.name))


def _times(x, function):
    return function(x)


def _weak(x):
    return x, jnp.asarray(1.0) * 2.0


seen, times, weak = (CachedFunction(eqx.filter_jit(f), f.__name__) for f in (_seen, _times, _weak))


@pytest.fixture
def folder(monkeypatch, tmp_path):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path))
    TRACED.clear()
    forget()
    return tmp_path / "programs"


def files(folder):
    return sorted(p for p in folder.rglob("*") if p.is_file())


def forget():
    """Return to the state of a new process."""
    for one in (seen, times, weak):
        one._known.clear()
        one.__wrapped__._cached.clear_cache()
    compiled._version_of.cache_clear()


def test_arguments_by_name_have_programs_of_their_own(folder):
    layer, values = Layer(jnp.asarray(2.0), "abl"), np.linspace(0, 1, 5)
    for _ in range(2):
        for power in (2, 3):
            found = seen(layer, values, power=power)
            np.testing.assert_allclose(found.values, np.exp(-2 * values) ** power)
        forget()
    assert (TRACED, len(files(folder))) == ([2, 3], 2)


@pytest.mark.peer  # the real command, in two processes
def test_a_picture_is_drawn_with_the_programs_that_were_kept(tmp_path):
    environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "kept")}
    pictures = []
    for name in ("first.png", "second.png"):
        said = ("render", "--preset", "blue", "--size", "48x36", "-o", str(tmp_path / name))
        call = [sys.executable, "-m", "irisjax", *said]
        done = subprocess.run(call, capture_output=True, text=True, env=environment)
        assert (done.returncode, "error" in done.stderr) == (0, False), done.stderr
        pictures.append((tmp_path / name).read_bytes())
    assert pictures[0] == pictures[1]


def test_a_kept_program_gives_what_it_gave_without_tracing(folder):
    layer, values = Layer(jnp.asarray(2.0), "abl"), np.linspace(0, 1, 5)
    first = seen(layer, values, 2)
    assert len(files(folder)) == 1
    traced = len(TRACED)
    forget()
    again = seen(layer, values, 2)
    assert len(TRACED) == traced
    np.testing.assert_array_equal(again.values, first.values)
    np.testing.assert_allclose(again.values, np.exp(-2.0 * values) ** 2, rtol=1e-6)
    assert (again.count, again.layer.name) == (2, "abl")
    # Other numbers in arrays of the same form run in the same program.
    other = seen(Layer(jnp.asarray(0.5), "abl"), 2 * values, 2)
    assert len(TRACED) == traced
    np.testing.assert_allclose(other.values, np.exp(-2.0 * values * 0.5) ** 2, rtol=1e-6)


def test_each_constant_shape_and_precision_has_its_own_program(folder):
    layer, values = Layer(jnp.asarray(2.0), "abl"), np.linspace(0, 1, 5)
    seen(layer, values, 2)
    assert seen(layer, values, 3).count == 3
    assert isinstance(seen(layer, values, 3.0).count, float)
    assert seen(Layer(layer.depth, "stroma"), values, 2).layer.name == "stroma"
    assert seen(layer, values[:3], 2).values.shape == (3,)
    with jax.enable_x64(False):
        single = seen(Layer(jnp.asarray(2.0), "abl"), jnp.ones(5), 2).values.dtype
    assert single == jnp.float32
    assert len(files(folder)) == 6


def test_keys_and_weak_types_are_kept(folder):
    drawn = times(jax.random.key(3), jax.random.normal)
    forget()
    assert float(times(jax.random.key(3), jax.random.normal)) == float(drawn)
    assert float(drawn) == float(jax.random.normal(jax.random.key(3)))
    for _ in range(2):
        assert [x.weak_type for x in weak(jnp.asarray(2.0, jnp.float32))] == [False, True]
        forget()
    assert len(files(folder)) == 2


def test_half_a_file_is_made_again(folder):
    layer, values = Layer(jnp.asarray(2.0), "abl"), np.ones(4)
    first = seen(layer, values, 2).values
    (path,) = files(folder)
    path.write_bytes(path.read_bytes()[:100])
    forget()
    np.testing.assert_array_equal(seen(layer, values, 2).values, first)
    assert len(path.read_bytes()) > 100


def test_what_cannot_be_kept_is_computed_all_the_same(folder):
    # A function without a name in its module.
    assert float(times(jnp.asarray(2.0), lambda x: 3 * x)) == 6
    # Under a transformation.
    slope = jax.grad(lambda d: seen(Layer(d, "abl"), jnp.ones(1), 2).values.sum())(jnp.asarray(1.0))
    assert float(slope) == pytest.approx(-2 * np.exp(-2.0), rel=1e-5)
    assert files(folder) == []


def test_a_folder_that_cannot_be_written_costs_only_time(monkeypatch, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(blocked))
    forget()
    assert seen(Layer(jnp.asarray(0.0), "abl"), jnp.ones(2), 7).count == 7
    assert blocked.read_text() == ""


def test_programs_of_older_code_go(folder):
    for i in range(8):
        (folder / f"old{i}").mkdir(parents=True)
        (folder / f"old{i}" / "program").write_bytes(pickle.dumps(i))
        os.utime(folder / f"old{i}", (i, i))
    seen(Layer(jnp.asarray(2.0), "abl"), jnp.ones(2), 5)
    kept = sorted(p.name for p in folder.iterdir())
    assert len(kept) == 4
    assert kept[-3:] == ["old5", "old6", "old7"]


IN_A_PROCESS = """
import jax, numpy as np
jax.config.update("jax_enable_x64", True)
from irisjax.cli import compiled
compiled.keep_compiled()
made = compiled._compile
compiled._compile = lambda *given: print("traced") or made(*given)
from irisjax.numerics import chunks
from irisjax.ocularist import mixing  # a module that takes names of others
print(type(mixing.srgb_encode).__name__, float(chunks._concatenate([np.ones(2), np.ones(2)], 3).sum()))
print(float(compiled.CachedFunction(jax.jit(jax.numpy.linalg.det), "det")(np.diag([2.0, 3.0]))))
"""


def test_another_process_finds_programs_and_lapack(folder):
    environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(folder.parent)}
    first, second = (
        subprocess.run(
            [sys.executable, "-c", IN_A_PROCESS],
            capture_output=True,
            text=True,
            check=True,
            env=environment,
        ).stdout.split()
        for _ in range(2)
    )
    assert first.count("traced") == 2
    assert second == [word for word in first if word != "traced"]
    assert second[0] == "CachedFunction"
    np.testing.assert_allclose([float(x) for x in second[1:]], [3.0, 6.0])


@pytest.fixture
def some(folder, monkeypatch):
    """A folder of files in the place of programs."""
    monkeypatch.setattr(compiled, "_version_of", lambda place: place)
    folder.mkdir()
    for name in "abc":
        (folder / name).write_text(name)
    return folder


def used(folder, names, read=Path.read_text):
    """The texts of these files in a new process."""
    ahead = ReadAhead(read)
    with ahead.reading("command"):
        return [ahead(folder / name) for name in names]


def test_files_used_last_time_are_read_before_they_are_asked_for(some):
    assert used(some, "ab") == ["a", "b"]
    read, both = [], threading.Event()

    def counted(path):
        read.append(path.name)
        if len(read) == 2:
            both.set()
        return path.name

    ahead = ReadAhead(counted)
    with ahead.reading("command"):
        assert both.wait(30)
        assert [ahead(some / name) for name in "abc"] == ["a", "b", "c"]
    assert sorted(read) == ["a", "b", "c"]  # each one time
    assert (some / "used" / "command").read_text().split() == ["a", "b", "c"]


def test_no_file_waits_for_those_before(some):
    used(some, "abc")
    held = threading.Event()
    ahead = ReadAhead(lambda path: held.wait(30) if path.name == "a" else path.name)
    with ahead.reading("command"):
        assert ahead(some / "c") == "c"  # while a is being read
        held.set()


def test_a_missing_file_or_broken_notes_raise_only_where_the_file_is_asked_for(some):
    used(some, "abc")
    (some / "b").unlink()
    with pytest.raises(FileNotFoundError):
        used(some, "abc")
    (some / "used" / "command").write_bytes(b"\x00../..\n")
    assert used(some, "a") == ["a"]


def test_an_interrupt_leaves_no_thread_and_the_notes_as_they_were(some):
    used(some, "ab")
    before = threading.active_count()

    def interrupted(path):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        used(some, "a", interrupted)
    assert threading.active_count() == before
    assert (some / "used" / "command").read_text().split() == ["a", "b"]
