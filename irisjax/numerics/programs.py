"""Compiled functions that outlive the process.

Tracing and lowering a spectrum's or a picture's program takes longer than running it, and JAX's
compilation cache saves only what comes after. `program` keeps what the compiler made, in the folder
that `keep_programs` names; without one it is `equinox.filter_jit`. The files are pickles: whoever
may write to that folder may run code as its user, as with JAX's cache.
"""

import functools
import hashlib
import importlib.metadata
import itertools
import os
import pickle
import platform
import secrets
import shutil
import sys
import tempfile
import threading
from collections.abc import Callable, Hashable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer
from jax.experimental import serialize_executable

from irisjax.numerics.ahead import Ahead

_MOST_VERSIONS = 4  # of the package, whose programs are kept side by side
_PACKAGES = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy")
_SETTINGS = (
    "jax_enable_x64",
    "jax_default_matmul_precision",
    "jax_default_prng_impl",
    "jax_threefry_partitionable",
)
_FOR_DEBUGGING = ("jax_disable_jit", "jax_debug_nans", "jax_debug_infs", "jax_check_tracer_leaks")
_folder: Path | None = None


def keep_programs(folder: str | Path | None) -> None:
    """Keep programs in this folder from now on; `None`: nowhere."""
    global _folder
    _folder = None if folder is None else Path(folder)


def reading_ahead(name: str) -> AbstractContextManager[None]:
    """While this is entered, threads read the programs that were used under this name last time."""
    if _folder is None:
        return nullcontext()
    return _ahead.reading(_versions(_folder) / "used" / name)


def program(function: Callable[..., Any]) -> "Program":
    """`equinox.filter_jit` of a pure function of a module's top level, whose programs are kept on
    disk; use as a decorator.

    A kept program stands for the same code (of this package and of those it is made with), the
    same settings of JAX, the same shapes and types, and equal arguments that are no arrays. Where
    such an argument cannot be pickled, an array is traced, or there are several devices, nothing
    is kept.
    """
    return Program(function)


class Program:
    """What `program` makes of a function; called as the function is, arguments in their order."""

    def __init__(self, function: Callable[..., Any], name: str | None = None):
        """`name`: under which it is kept, of a function that is not of a module's top level."""
        functools.update_wrapper(self, function)
        self._function, self._compiled = function, eqx.filter_jit(function)
        self._name = f"{function.__module__}.{function.__qualname__}" if name is None else name
        self._kept: dict[Hashable, _Kept | None] = {}
        self._flat: dict[Hashable, Callable[..., Any]] = {}
        self._making = threading.Lock()

    def __call__(self, *args):
        """The function's result."""
        kept, arrays = self._find(args)
        return self._compiled(*args) if kept is None else kept(arrays)

    def bound(self, held) -> Callable[..., Any]:
        """The function of its other arguments, concrete arrays all, with this one held: it is taken
        apart once and not at every call. Its results are arrays.
        """
        found: dict[Hashable, tuple[_Kept | None, list[Any]]] = {}
        if any(isinstance(x, Tracer) for x in jax.tree.leaves(held)):
            return lambda *arrays: self(held, *arrays)
        live = self._live(held)

        def call(*arrays):
            types = tuple((x.shape, x.dtype) for x in arrays)
            if types not in found:
                kept, all_arrays = self._find((held, *arrays))
                first = all_arrays[: len(all_arrays) - len(arrays)]
                found[types] = kept, [jax.numpy.asarray(x) for x in first]
            kept, first = found[types]
            return live(first, *arrays) if kept is None else kept([*first, *arrays])

        return call

    def _live(self, held) -> Callable[..., Any]:
        """`jax.jit` of the function, of the arrays of its first argument and of the others."""
        leaves, structure = jax.tree.flatten(held)
        static = structure, _constants(leaves)
        with self._making:
            if static not in self._flat:
                form = _form_of(held)[1]

                def flat(first, *arrays):
                    return self._function(_filled(form, first), *arrays)

                flat.__name__ = self._function.__name__
                self._flat[static] = jax.jit(flat, compiler_options=_compiler_options())
            return self._flat[static]

    def _find(self, args) -> "tuple[_Kept | None, list[Any]]":
        leaves, structure = jax.tree.flatten(args)
        arrays = [x for x in leaves if _is_array(x)]
        if _folder is None or any(isinstance(x, Tracer) for x in arrays):
            return None, arrays
        types = tuple(_type_of(x) for x in arrays)
        here = (_folder, structure, _constants(leaves), types, *_settings())
        with self._making:
            if here not in self._kept:
                self._kept[here] = self._make(args, types)
        return self._kept[here], arrays

    def _make(self, args, types) -> "_Kept | None":
        debugging = any(getattr(jax.config, name, False) for name in _FOR_DEBUGGING)
        if debugging or jax.device_count() > 1 or _folder is None:
            return None
        form = _form_of(args)[1]
        try:
            seen = [(shape, str(dtype), weak) for shape, dtype, weak in types]
            words = pickle.dumps([self._name, form, seen, _settings(), _machine()], protocol=5)
        except Exception:  # whatever an object says that has no pickle
            return None
        path = _versions(_folder) / hashlib.sha256(words).hexdigest()
        try:
            return _ahead(path)
        except Exception:  # not there, half a file, a compiler of another kind: made again
            compiled, told, linear_algebra = _compiled(self._function, form, types)
        try:
            executable = serialize_executable.serialize(compiled)
            _write(path, pickle.dumps((told, linear_algebra, *executable), protocol=5))
        except Exception:  # results without a pickle, a compiler that gives nothing away
            pass
        return _Kept(compiled, told)


class _Kept(NamedTuple):
    """A compiled program of flat arrays and the form of what it gives."""

    program: jax.stages.Compiled
    form: Any

    def __call__(self, arrays):
        return _filled(self.form, self.program(*arrays))


def _read(path: Path) -> _Kept:
    """A program from its file."""
    told, linear_algebra, *executable = pickle.loads(path.read_bytes())
    if linear_algebra:
        _load_lapack()
    return _Kept(serialize_executable.deserialize_and_load(*executable), told)


_ahead = Ahead(_read)


class _Array(NamedTuple):
    """Stands in a form for an array: its place among them."""

    place: int


def _compiled(function, form, types) -> tuple[jax.stages.Compiled, Any, bool]:
    """The compiled program, the form of its results, and whether it calls LAPACK."""
    forms = []

    def flat(*arrays):
        out, told = _form_of(function(*_filled(form, arrays)))
        forms.append(told)
        return out

    # Under a name of its own JAX's cache does not have it: what comes from there cannot be
    # serialised a second time (jaxlib 0.10).
    flat.__name__ = f"kept_{secrets.token_hex(8)}"
    shapes = [jax.ShapeDtypeStruct(shape, dtype, weak_type=weak) for shape, dtype, weak in types]
    lowered = jax.jit(flat, compiler_options=_compiler_options()).lower(*shapes)
    return lowered.compile(), forms[-1], "lapack" in lowered.as_text()


@functools.cache
def _load_lapack() -> None:
    """JAX loads it where it lowers a function of it; a program that is there already would call
    what is not.
    """
    jax.jit(jax.numpy.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), np.float32))


def _compiler_options() -> dict[str, Any] | None:
    """A command waits for its compiler: XLA's older way of joining loops takes half as long, and
    what it makes runs as fast. Other releases of jaxlib stop at this flag.
    """
    known = importlib.metadata.version("jaxlib").startswith("0.10.")
    return (
        {"xla_cpu_use_fusion_emitters": False} if known and jax.default_backend() == "cpu" else None
    )


def _constants(leaves) -> tuple[Any, ...]:
    """What stands between the arrays, with its types: 1 is not 1.0 here."""
    return tuple(None if _is_array(x) else (type(x), x) for x in leaves)


def _is_array(x) -> bool:
    return isinstance(x, jax.Array | np.ndarray | np.generic)


def _type_of(x):
    return x.shape, x.dtype, getattr(x, "weak_type", False)


def _form_of(tree):
    """The arrays of a tree, and the tree with their places instead."""
    arrays, count = [], itertools.count()

    def place(x):
        if not _is_array(x):
            return x
        arrays.append(x)
        return _Array(next(count))

    return arrays, jax.tree.map(place, tree)


def _filled(form, arrays):
    return jax.tree.map(
        lambda x: arrays[x.place] if isinstance(x, _Array) else x,
        form,
        is_leaf=lambda x: isinstance(x, _Array),
    )


def _settings() -> tuple[Any, ...]:
    return (
        jax.default_backend(),
        os.cpu_count(),
        *(str(getattr(jax.config, name, None)) for name in _SETTINGS),
    )


@functools.cache
def _machine() -> tuple[str, ...]:
    """What a processor's programs are compiled for; a home may be shared by several machines."""
    device = jax.devices()[0]
    about = device.device_kind, device.client.platform_version, platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        found = [line for line in lines if line.startswith(("flags", "Features"))][:1]
    except OSError:
        found = [platform.processor()]
    return (*about, *found, os.environ.get("XLA_FLAGS", ""))


@functools.lru_cache(maxsize=4)
def _versions(folder: Path) -> Path:
    """The folder of this version of the code; those of older versions are removed."""
    package = Path(__file__).parents[1]
    files = sorted(p for p in package.rglob("*") if p.suffix != ".pyc" and p.is_file())
    sizes = [(str(p), (s := p.stat()).st_size, s.st_mtime_ns) for p in files]
    about = sizes, sys.version, [importlib.metadata.version(name) for name in _PACKAGES]
    mine = folder / hashlib.sha256(repr(about).encode()).hexdigest()[:16]
    if not mine.exists():
        others = (
            sorted(folder.glob("*"), key=lambda p: p.stat().st_mtime) if folder.exists() else []
        )
        for old in others[: max(0, len(others) - _MOST_VERSIONS + 1)]:
            shutil.rmtree(old, ignore_errors=True)
    return mine


def _write(path: Path, data: bytes) -> None:
    """Whole or not at all; a full disk or a folder that cannot be written costs only time."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as temporary:
            temporary.write(data)
        os.replace(temporary.name, path)
    except OSError:
        pass
