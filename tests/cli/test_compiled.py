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
from irisjax.numerics import chunks


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


VALUES = np.linspace(0, 1, 5)


def layer(depth=2.0, name="abl"):
    return Layer(jnp.asarray(depth), name)


def test_arguments_by_name_have_programs_of_their_own(folder):
    for _ in range(2):
        for power in (2, 3):
            found = seen(layer(), VALUES, power=power)
            np.testing.assert_allclose(found.values, np.exp(-2 * VALUES) ** power)
        forget()
    assert (TRACED, len(files(folder))) == ([2, 3], 2)


@pytest.mark.peer  # the real command, in two processes
def test_a_picture_is_drawn_with_the_programs_that_were_kept(folder, tmp_path):
    pictures = []
    for name in ("first.png", "second.png"):
        said = ("render", "--preset", "blue", "--size", "48x36", "-o", str(tmp_path / name))
        done = subprocess.run(
            [sys.executable, "-m", "irisjax", *said], capture_output=True, text=True
        )
        assert (done.returncode, "error" in done.stderr) == (0, False), done.stderr
        pictures.append((tmp_path / name).read_bytes())
    assert pictures[0] == pictures[1]


def test_a_kept_program_gives_what_it_gave_without_tracing(folder):
    first = seen(layer(), VALUES, 2)
    forget()
    np.testing.assert_array_equal(seen(layer(), VALUES, 2).values, first.values)
    # Other numbers in arrays of the same form run in the same program.
    for depth, values in ((2.0, VALUES), (0.5, 2 * VALUES)):
        found = seen(layer(depth), values, 2)
        np.testing.assert_allclose(found.values, np.exp(-depth * values) ** 2, rtol=1e-6)
        assert (found.count, found.layer.name) == (2, "abl")
    assert (TRACED, len(files(folder))) == ([2], 1)


def test_each_constant_shape_and_precision_has_its_own_program(folder):
    seen(layer(), VALUES, 2)
    assert seen(layer(), VALUES, 3).count == 3
    assert isinstance(seen(layer(), VALUES, 3.0).count, float)
    assert seen(layer(name="stroma"), VALUES, 2).layer.name == "stroma"
    assert seen(layer(), VALUES[:3], 2).values.shape == (3,)
    with jax.enable_x64(False):
        assert seen(layer(), jnp.ones(5), 2).values.dtype == jnp.float32
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
    first = seen(layer(), VALUES, 2).values
    (path,) = files(folder)
    path.write_bytes(path.read_bytes()[:100])
    forget()
    np.testing.assert_array_equal(seen(layer(), VALUES, 2).values, first)
    assert len(path.read_bytes()) > 100


def test_what_cannot_be_kept_is_computed_all_the_same(folder):
    # A function without a name in its module.
    assert float(times(jnp.asarray(2.0), lambda x: 3 * x)) == 6
    # Under a transformation.
    slope = jax.grad(lambda d: seen(layer(d), jnp.ones(1), 2).values.sum())(1.0)
    assert float(slope) == pytest.approx(-2 * np.exp(-2.0), rel=1e-5)
    assert files(folder) == []


def test_a_folder_that_cannot_be_written_costs_only_time(monkeypatch, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(blocked))
    forget()
    assert seen(layer(), VALUES, 7).count == 7
    assert blocked.read_text() == ""


def test_programs_of_older_code_go(folder):
    for i in range(8):
        (folder / f"old{i}").mkdir(parents=True)
        (folder / f"old{i}" / "program").write_bytes(pickle.dumps(i))
        os.utime(folder / f"old{i}", (i, i))
    seen(layer(), VALUES, 5)
    kept = sorted(p.name for p in folder.iterdir())
    assert len(kept) == 4
    assert kept[-3:] == ["old5", "old6", "old7"]


IN_A_PROCESS = """
import jax, numpy as np
jax.config.update("jax_enable_x64", True)
from irisjax.cli import compiled
compiled.keep_compiled()
compiled._compile = lambda *_: 1 / 0
from irisjax.numerics import chunks
from irisjax.ocularist import mixing  # a module that takes names of others
print(type(mixing.srgb_encode).__name__, float(chunks._concatenate([np.ones(2), np.ones(2)], 3).sum()))
print(float(compiled.CachedFunction(jax.jit(jax.numpy.linalg.det), "det")(np.diag([1.0, 1.0, 2.0, 3.0]))))
"""


def test_another_process_finds_programs_and_lapack(folder):
    concatenate = compiled._jit_cached(chunks._concatenate.__wrapped__)
    assert float(concatenate([np.ones(2), np.ones(2)], 3).sum()) == 3
    # A determinant of more than three rows is LAPACK's.
    CachedFunction(jax.jit(jnp.linalg.det), "det")(np.diag([1.0, 1.0, 2.0, 3.0]))
    made = files(folder)
    assert len(made) == 2
    call = [sys.executable, "-c", IN_A_PROCESS]
    kind, *numbers = subprocess.run(call, capture_output=True, text=True, check=True).stdout.split()
    assert kind == "CachedFunction"
    np.testing.assert_allclose([float(x) for x in numbers], [3.0, 6.0])
    assert files(folder) == made


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
