"""Results that commands keep on disk between runs: compiled programs and illumination tables.

Tracing and lowering the program of a spectrum or of a picture takes longer than running it, and
JAX's compilation cache saves only what comes after: without this module the second run of `fit`
takes 1.9 times as long. `keep_compiled` has `equinox.filter_jit` make `Kept` functions of the
package's, which read the compiler's result from a file; the library knows nothing of it. The files
are pickles: whoever may write to their folder may run code as its user, as with JAX's cache.
"""

import functools
import hashlib
import importlib.metadata
import io
import os
import pickle
import platform
import secrets
import shutil
import sys
import threading
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax.experimental import serialize_executable

from irisjax.io.tables import write_atomically
from irisjax.numerics.checks import is_known

if TYPE_CHECKING:
    from irisjax.anatomy.eye import Eye
    from irisjax.render.illumination import Illumination
    from irisjax.render.scene import Scene

MOST_TABLES = 8
"""Illumination tables that are kept (up to 49 MB each); those not used for longest go first."""
_MOST_VERSIONS = 4  # of the package, whose programs are kept side by side
_MOST_THREADS = 4  # that read files
_PACKAGES = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy")
_SETTINGS = (
    "jax_enable_x64",
    "jax_default_matmul_precision",
    "jax_default_prng_impl",
    "jax_threefry_partitionable",
)
_FOR_DEBUGGING = ("jax_disable_jit", "jax_debug_nans", "jax_debug_infs", "jax_check_tracer_leaks")
_equinox: Any = eqx
_filter_jit = _equinox.filter_jit


def folder() -> Path | None:
    """The cache's folder: JAX_COMPILATION_CACHE_DIR names another, or, when empty, none."""
    if (given := os.environ.get("JAX_COMPILATION_CACHE_DIR")) is not None:
        return Path(given) if given else None
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "irisjax"


def keep_compiled() -> None:
    """Trace and compile once a machine: functions that a module of the package has by
    `equinox.filter_jit` are kept in the cache's folder, if it is imported from now on. They must be
    pure, and be called with arguments in their order.
    """
    place = folder()
    # JAX reads both variables of the environment by itself.
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        jax.config.update("jax_compilation_cache_dir", str(place))
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    if place is not None:
        _equinox.filter_jit = _keeping


def _keeping(function: Any, **options: Any) -> Any:
    """Jit a function by `equinox.filter_jit`; one of the package's modules becomes `Kept`."""
    made, name = _filter_jit(function, **options), getattr(function, "__qualname__", "")
    of_module = function.__module__.startswith("irisjax.") and name.isidentifier()
    return Kept(made, f"{function.__module__}.{name}") if of_module else made


def kept_tables(scene: "Scene") -> "Illumination | None":
    """Return `scene.tables()` from the cache, or compute and keep it; a broken file is replaced."""
    from irisjax.cli.options import notice

    place = folder()
    if place is None or scene.eye.cornea is None:
        return scene.tables()
    caustics, code = scene.grazing(), _version_of(place / "programs").name
    path = place / "illumination" / tables_key(scene.eye, caustics, code)
    try:
        found = _read_tables(path)
        with suppress(OSError):  # a folder may be for reading only
            os.utime(path)  # when it was last of use
        return found
    except Exception as error:  # reading a pickle that is damaged may raise anything
        if path.exists():
            said = (str(error).strip() or type(error).__name__).split("\n")[0]
            notice(f"{path}: not usable ({said}); made again")
    made = scene.tables(caustics)
    data = pickle.dumps(made, protocol=5)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, _digest(path, data) + data)
    except OSError as error:
        notice(f"{path}: the tables could not be kept ({error.strerror})")
    with suppress(OSError):  # another run may remove them too
        for old in _beyond_newest(path.parent, MOST_TABLES):
            old.unlink()
    return made


def tables_key(eye: "Eye", caustics: bool, code: str) -> str:
    """Name of an eye's tables: SHA-256 of all that they depend on, precision and code included."""
    from irisjax.render.illumination import canonical_eye

    leaves, structure = jax.tree.flatten(canonical_eye(eye))
    values = [(str(x.dtype), x.shape, x.tobytes()) for x in map(np.asarray, leaves)]
    about = code, caustics, str(jax.numpy.result_type(float)), str(structure), values
    return hashlib.sha256(repr(about).encode()).hexdigest()


def _read_tables(path: Path) -> "Illumination":
    digest, data = (contents := path.read_bytes())[:32], contents[32:]
    if _digest(path, data) != digest:
        raise ValueError("damaged, or tables of another eye")
    return pickle.loads(data)


def _digest(path: Path, data: bytes) -> bytes:
    return hashlib.sha256(path.name.encode() + data).digest()


class Kept:
    """A function made by `equinox.filter_jit` whose programs are kept.

    A program is read from its file for the same code (of this package and of those it is made
    with), settings of JAX, shapes and types, and equal arguments that are no arrays. Where such an
    argument cannot be pickled, an array is traced, or there are several devices, this is the
    function itself.
    """

    def __init__(self, function: Callable[..., Any], name: str):
        self.__wrapped__ = function
        self._name = name
        self._known: dict[Hashable, _Program | None] = {}
        self._making = threading.Lock()

    def __call__(self, *args: Any, **named: Any) -> Any:
        leaves, structure = jax.tree.flatten((args, named))
        arrays = [x for x in leaves if _is_array(x)]
        if not is_known(arrays):
            return self.__wrapped__(*args, **named)
        types = tuple((x.shape, x.dtype, getattr(x, "weak_type", False)) for x in arrays)
        constants = [_Array if _is_array(x) else x for x in leaves]
        # 1 and 1.0 differ here.
        here = structure, tuple((type(x), x) for x in constants), types, *_settings()
        if here not in self._known:
            with self._making:
                if here not in self._known:
                    self._known[here] = self._found(structure.unflatten(constants), types)
        program = self._known[here]
        if program is None:
            return self.__wrapped__(*args, **named)
        return _filled(program.result, program.compiled(*arrays))

    def _found(self, form: object, types: tuple[Any, ...]) -> "_Program | None":
        debugging = any(getattr(jax.config, name, False) for name in _FOR_DEBUGGING)
        place = _programs()
        if debugging or jax.device_count() > 1 or place is None:
            return None
        seen = [(shape, str(dtype), weak) for shape, dtype, weak in types]
        try:
            words = _canonical([self._name, form, seen, _settings(), _machine()])
        except Exception:  # an object without a pickle may raise anything
            return None
        path = place / hashlib.sha256(words).hexdigest()
        try:
            program = _files(path)
            return program._replace(result=pickle.loads(program.result))
        except Exception:  # not there, half a file, a compiler of another kind: compile again
            program = _compiled(self.__wrapped__, form, types)
        with suppress(Exception):  # results without a pickle, a compiler that cannot serialize
            compiled, result, linear_algebra = program
            executable = serialize_executable.serialize(compiled)
            about = pickle.dumps(result, protocol=5), linear_algebra
            _write(path, pickle.dumps((*about, *executable), protocol=5))
        return program


class _Array:
    """Placeholder of an array in a form."""


class _Program(NamedTuple):
    """A compiled program of flat arrays, the form of its result, and whether it calls LAPACK."""

    compiled: jax.stages.Compiled
    result: Any
    linear_algebra: bool


def _compiled(function: Callable[..., Any], form: object, types: tuple[Any, ...]) -> _Program:
    plain = getattr(function, "__wrapped__", function)
    results = []

    def flat(*arrays):
        args, named = _filled(form, arrays)
        out = plain(*args, **named)
        results.append(eqx.filter(out, _is_array, inverse=True, replace=_Array))
        return jax.tree.leaves(eqx.filter(out, _is_array))

    # A unique name keeps the program out of JAX's cache: what comes from there cannot be
    # serialised a second time (jaxlib 0.10).
    flat.__name__ = f"kept_{secrets.token_hex(8)}"
    shapes = [jax.ShapeDtypeStruct(shape, dtype, weak_type=weak) for shape, dtype, weak in types]
    lowered = jax.jit(flat, compiler_options=_compiler_options()).lower(*shapes)
    return _Program(lowered.compile(), results[-1], "lapack" in lowered.as_text())


def _read(path: Path) -> _Program:
    """Read a program, with its result's form as a pickle: whatever that names would be imported
    here, and a module that two threads import at once may fail in both.
    """
    result, linear_algebra, *executable = pickle.loads(path.read_bytes())
    if linear_algebra:
        _load_lapack()
    return _Program(serialize_executable.deserialize_and_load(*executable), result, linear_algebra)


@functools.cache
def _load_lapack() -> None:
    """Have JAX load LAPACK, which it does where it lowers a function of it, but not for a file."""
    jax.jit(jax.numpy.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), np.float32))


def _compiler_options() -> dict[str, Any] | None:
    """Options of XLA: its older way of joining loops takes half as long, and its programs run as
    fast. Other releases of jaxlib stop at this flag.
    """
    known = importlib.metadata.version("jaxlib").startswith("0.10.")
    on_cpu = known and jax.default_backend() == "cpu"
    return {"xla_cpu_use_fusion_emitters": False} if on_cpu else None


def _canonical(value: object) -> bytes:
    """A pickle that does not depend on which equal parts are one object, as a worker's are not."""
    out = io.BytesIO()
    pickler = pickle.Pickler(out, protocol=5)
    pickler.fast = True
    pickler.dump(value)
    return out.getvalue()


def _is_array(x: object) -> bool:
    return isinstance(x, jax.Array | np.ndarray | np.generic)


def _filled(form: Any, arrays: Iterable[Any]) -> Any:
    left = iter(arrays)
    return jax.tree.map(lambda x: next(left) if x is _Array else x, form)


def _settings() -> tuple[object, ...]:
    configured = (str(getattr(jax.config, name, None)) for name in _SETTINGS)
    return jax.default_backend(), os.cpu_count(), *configured


@functools.cache
def _machine() -> tuple[str, ...]:
    """Describe the machine that programs are compiled for: several may share a home folder."""
    device = jax.devices()[0]
    about = device.device_kind, device.client.platform_version, platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        found = [line for line in lines if line.startswith(("flags", "Features"))][:1]
    except OSError:
        found = [platform.processor()]
    return (*about, *found, os.environ.get("XLA_FLAGS", ""))


def _programs() -> Path | None:
    place = folder()
    return None if place is None else _version_of(place / "programs")


@functools.lru_cache(maxsize=4)
def _version_of(place: Path) -> Path:
    """The folder of this version of the code; those of older versions are removed."""
    package = Path(__file__).parents[1]
    files = sorted(p for p in package.rglob("*") if p.suffix != ".pyc" and p.is_file())
    sizes = [(str(p), (s := p.stat()).st_size, s.st_mtime_ns) for p in files]
    about = sizes, sys.version, [importlib.metadata.version(name) for name in _PACKAGES]
    mine = place / hashlib.sha256(repr(about).encode()).hexdigest()[:16]
    if not mine.exists():
        for old in _beyond_newest(place, _MOST_VERSIONS - 1):
            shutil.rmtree(old, ignore_errors=True)
    return mine


def _beyond_newest(place: Path, count: int) -> list[Path]:
    """All but the newest files and folders in a folder."""
    return sorted(place.glob("*"), key=lambda p: -p.stat().st_mtime)[count:]


def _write(path: Path, data: bytes) -> None:
    """Write whole or not at all; a full disk or a read-only folder costs only time."""
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, data)


class Ahead:
    """Reads files by a function of their paths, in advance on threads or on demand."""

    def __init__(self, read: Callable[[Path], Any]):
        self._read = read
        self._begun: dict[Path, Future[Any]] = {}
        self._used: dict[Path, None] = {}

    def __call__(self, path: Path) -> Any:
        """Return what the file holds; raises what reading it raises."""
        self._used[path] = None
        begun = self._begun.pop(path, None)
        # A file that no thread has begun need not wait for those before it.
        return self._read(path) if begun is None or begun.cancel() else begun.result()

    @contextmanager
    def reading(self, command: str) -> Iterator[None]:
        """Read the files of the command's last run on threads while this context is entered.

        Does nothing if a file was read before: a later run in one process has most in memory.
        """
        place = _programs()
        if place is None or self._used:
            yield
            return
        notes, last = place / "used" / command, []
        with suppress(OSError):
            last = [place / name for name in notes.read_text("utf-8").split()]
        threads = ThreadPoolExecutor(max(1, min(_MOST_THREADS, (os.cpu_count() or 1) - 1)))
        try:
            self._begun |= {path: threads.submit(self._read, path) for path in last}
            yield
        finally:
            threads.shutdown(cancel_futures=True)
            self._begun.clear()
        # A command that was broken off has not used all.
        if self._used and set(self._used) != set(last):
            _write(notes, "\n".join(path.name for path in self._used).encode())


_files = Ahead(_read)
reading_ahead: Callable[[str], AbstractContextManager[None]] = _files.reading
"""While a command imports modules and reads its input, threads read the programs that it used last
time: to read one takes XLA 50 ms, in which Python is free."""
