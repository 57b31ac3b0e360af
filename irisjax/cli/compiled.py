"""Results that commands keep on disk between runs: compiled programs and illumination tables.

Tracing and lowering the program of a spectrum or of a picture takes longer than running it, and
JAX's compilation cache saves only the later steps: without this module the second run of `fit`
takes 1.9 times as long. `keep_compiled` replaces `equinox.filter_jit`, so that the package's
functions become a `CachedFunction`, which reads the compiler's result from a file; the library does
not depend on it. The files are pickles: whoever can write to their folder can run code as its user,
as with JAX's cache.
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
"""Number of illumination tables that are kept (up to 49 MB each), those used last."""
_MOST_VERSIONS = 4  # number of versions of the package whose programs are kept side by side
_MOST_THREADS = 4  # number of threads that read files
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


def cache_folder() -> Path | None:
    """Return the cache's folder. JAX_COMPILATION_CACHE_DIR names another or, if empty, none."""
    if (given := os.environ.get("JAX_COMPILATION_CACHE_DIR")) is not None:
        return Path(given) if given else None
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "irisjax"


def keep_compiled() -> None:
    """Keep the programs of functions by `equinox.filter_jit` in the cache's folder, for modules of
    the package that are imported from now on. The functions must be pure, and be called with
    arguments in their order.
    """
    cache = cache_folder()
    # JAX reads both variables of the environment by itself.
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        jax.config.update("jax_compilation_cache_dir", str(cache))
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    if cache is not None:
        _equinox.filter_jit = _jit_cached


def _jit_cached(function: Any, **options: Any) -> Any:
    """Jit a function by `equinox.filter_jit`; a module's of the package is a `CachedFunction`."""
    jitted, name = _filter_jit(function, **options), getattr(function, "__qualname__", "")
    is_library = function.__module__.startswith("irisjax.") and name.isidentifier()
    return CachedFunction(jitted, f"{function.__module__}.{name}") if is_library else jitted


def cached_tables(scene: "Scene") -> "Illumination | None":
    """Return `scene.tables()` from the cache, or compute and keep it; a broken file is replaced."""
    from irisjax.cli.options import notice

    cache = cache_folder()
    if cache is None or scene.eye.cornea is None:
        return scene.tables()
    caustics, code = scene.grazing(), _version_of(cache / "programs").name
    path = cache / "illumination" / tables_key(scene.eye, caustics, code)
    try:
        tables = _read_tables(path)
        with suppress(OSError):  # the folder may be read-only
            os.utime(path)  # marks when it was last used
        return tables
    except Exception as error:  # reading a pickle that is damaged may raise anything
        if path.exists():
            message = (str(error).strip() or type(error).__name__).split("\n")[0]
            notice(f"{path}: not usable ({message}); made again")
    computed = scene.tables(caustics)
    data = pickle.dumps(computed, protocol=5)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, _digest(path, data) + data)
    except OSError as error:
        notice(f"{path}: the tables could not be kept ({error.strerror})")
    with suppress(OSError):  # another run may remove them too
        for old in _all_but_newest(path.parent, MOST_TABLES):
            old.unlink()
    return computed


def tables_key(eye: "Eye", caustics: bool, code: str) -> str:
    """Name an eye's tables by the SHA-256 of all that they depend on, precision and code too."""
    from irisjax.render.illumination import canonical_eye

    leaves, structure = jax.tree.flatten(canonical_eye(eye))
    values = [(str(x.dtype), x.shape, x.tobytes()) for x in map(np.asarray, leaves)]
    identity = code, caustics, str(jax.numpy.result_type(float)), str(structure), values
    return hashlib.sha256(repr(identity).encode()).hexdigest()


def _read_tables(path: Path) -> "Illumination":
    digest, data = (contents := path.read_bytes())[:32], contents[32:]
    if _digest(path, data) != digest:
        raise ValueError("damaged, or tables of another eye")
    return pickle.loads(data)


def _digest(path: Path, data: bytes) -> bytes:
    return hashlib.sha256(path.name.encode() + data).digest()


class CachedFunction:
    """A function made by `equinox.filter_jit` whose programs are kept.

    A program is read from its file for the same code (of this package and of those it depends on),
    settings of JAX, shapes and types, and equal arguments that are not arrays. Where such an
    argument cannot be pickled, an array is traced, or there are several devices, the function
    itself is called.
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
        # The types distinguish 1 from 1.0.
        call_key = structure, tuple((type(x), x) for x in constants), types, *_settings()
        if call_key not in self._known:
            with self._making:
                if call_key not in self._known:
                    self._known[call_key] = self._find_program(
                        structure.unflatten(constants), types
                    )
        program = self._known[call_key]
        if program is None:
            return self.__wrapped__(*args, **named)
        return _fill(program.result, program.compiled(*arrays))

    def _find_program(self, form: object, types: tuple[Any, ...]) -> "_Program | None":
        debugging = any(getattr(jax.config, name, False) for name in _FOR_DEBUGGING)
        programs = _programs()
        if debugging or jax.device_count() > 1 or programs is None:
            return None
        described = [(shape, str(dtype), weak) for shape, dtype, weak in types]
        try:
            identity = _canonical([self._name, form, described, _settings(), _machine()])
        except Exception:  # an object without a pickle may raise anything
            return None
        path = programs / hashlib.sha256(identity).hexdigest()
        try:
            program = _files(path)
            return program._replace(result=pickle.loads(program.result))
        except Exception:  # not there, half a file, a compiler of another kind: compile again
            program = _compile(self.__wrapped__, form, types)
        with suppress(Exception):  # results without a pickle, a compiler that cannot serialize
            compiled, result, linear_algebra = program
            executable = serialize_executable.serialize(compiled)
            metadata = pickle.dumps(result, protocol=5), linear_algebra
            _write(path, pickle.dumps((*metadata, *executable), protocol=5))
        return program


class _Array:
    """Placeholder of an array in a form."""


class _Program(NamedTuple):
    """A compiled program of flat arrays, the form of its result, and whether it calls LAPACK."""

    compiled: jax.stages.Compiled
    result: Any
    linear_algebra: bool


def _compile(function: Callable[..., Any], form: object, types: tuple[Any, ...]) -> _Program:
    plain = getattr(function, "__wrapped__", function)
    results = []

    def flat(*arrays):
        args, named = _fill(form, arrays)
        result = plain(*args, **named)
        results.append(eqx.filter(result, _is_array, inverse=True, replace=_Array))
        return jax.tree.leaves(eqx.filter(result, _is_array))

    # A unique name keeps the program out of JAX's cache: programs from there cannot be serialised
    # a second time (jaxlib 0.10).
    flat.__name__ = f"kept_{secrets.token_hex(8)}"
    shapes = [jax.ShapeDtypeStruct(shape, dtype, weak_type=weak) for shape, dtype, weak in types]
    lowered = jax.jit(flat, compiler_options=_compiler_options()).lower(*shapes)
    return _Program(lowered.compile(), results[-1], "lapack" in lowered.as_text())


def _read(path: Path) -> _Program:
    """Read a program. The form of its result stays a pickle: loading it imports modules, and an
    import by two threads at once may fail in both.
    """
    result, linear_algebra, *executable = pickle.loads(path.read_bytes())
    if linear_algebra:
        _load_lapack()
    return _Program(serialize_executable.deserialize_and_load(*executable), result, linear_algebra)


@functools.cache
def _load_lapack() -> None:
    """Have JAX load LAPACK, as it does when it lowers a call, but not for a program of a file."""
    # It is never run, so that it cannot wait for itself.
    lapack = jax.jit(jax.numpy.linalg.cholesky)  # noqa: TID251
    lapack.lower(jax.ShapeDtypeStruct((1, 1), np.float32))


def _compiler_options() -> dict[str, Any] | None:
    """Return options of XLA: its older fusion of loops compiles in half the time, and its programs
    run as fast. Other releases of jaxlib refuse this flag.
    """
    known = importlib.metadata.version("jaxlib").startswith("0.10.")
    on_cpu = known and jax.default_backend() == "cpu"
    return {"xla_cpu_use_fusion_emitters": False} if on_cpu else None


def _canonical(value: object) -> bytes:
    """Pickle a value independently of which of its equal parts are one object, since in a worker
    they are not.
    """
    out = io.BytesIO()
    pickler = pickle.Pickler(out, protocol=5)
    pickler.fast = True
    pickler.dump(value)
    return out.getvalue()


def _is_array(x: object) -> bool:
    return isinstance(x, jax.Array | np.ndarray | np.generic)


def _fill(form: Any, arrays: Iterable[Any]) -> Any:
    remaining = iter(arrays)
    return jax.tree.map(lambda x: next(remaining) if x is _Array else x, form)


def _settings() -> tuple[object, ...]:
    configured = (str(getattr(jax.config, name, None)) for name in _SETTINGS)
    return jax.default_backend(), os.cpu_count(), *configured


@functools.cache
def _machine() -> tuple[str, ...]:
    """Describe the machine that programs are compiled for; several may share a home folder."""
    device = jax.devices()[0]
    description = device.device_kind, device.client.platform_version, platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        flags = [line for line in lines if line.startswith(("flags", "Features"))][:1]
    except OSError:
        flags = [platform.processor()]
    return (*description, *flags, os.environ.get("XLA_FLAGS", ""))


def _programs() -> Path | None:
    cache = cache_folder()
    return None if cache is None else _version_of(cache / "programs")


@functools.lru_cache(maxsize=4)
def _version_of(programs: Path) -> Path:
    """Return the folder of this version of the code, and remove those of older versions."""
    package = Path(__file__).parents[1]
    files = sorted(p for p in package.rglob("*") if p.suffix != ".pyc" and p.is_file())
    sizes = [(str(p), (s := p.stat()).st_size, s.st_mtime_ns) for p in files]
    identity = sizes, sys.version, [importlib.metadata.version(name) for name in _PACKAGES]
    current = programs / hashlib.sha256(repr(identity).encode()).hexdigest()[:16]
    if not current.exists():
        for old in _all_but_newest(programs, _MOST_VERSIONS - 1):
            shutil.rmtree(old, ignore_errors=True)
    return current


def _all_but_newest(parent: Path, count: int) -> list[Path]:
    return sorted(parent.glob("*"), key=lambda p: -p.stat().st_mtime)[count:]


def _write(path: Path, data: bytes) -> None:
    """Write a file atomically; a full disk or a read-only folder costs only time."""
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, data)


class ReadAhead:
    """Reads files by a function of their paths, in advance on threads or on demand."""

    def __init__(self, read: Callable[[Path], Any]):
        self._read = read
        self._begun: dict[Path, Future[Any]] = {}
        self._used: dict[Path, None] = {}

    def __call__(self, path: Path) -> Any:
        """Return the contents of a file; errors of reading it are raised."""
        self._used[path] = None
        begun = self._begun.pop(path, None)
        # A file that no thread has begun need not wait for those before it.
        return self._read(path) if begun is None or begun.cancel() else begun.result()

    @contextmanager
    def reading(self, command: str) -> Iterator[None]:
        """Read the files of the command's last run on threads while this context is entered.

        It does nothing if a file was read before: a later run in one process has most in memory.
        """
        programs = _programs()
        if programs is None or self._used:
            yield
            return
        notes, paths = programs / "used" / command, []
        with suppress(OSError):
            paths = [programs / name for name in notes.read_text("utf-8").split()]
        threads = ThreadPoolExecutor(max(1, min(_MOST_THREADS, (os.cpu_count() or 1) - 1)))
        try:
            self._begun |= {path: threads.submit(self._read, path) for path in paths}
            yield
        finally:
            threads.shutdown(cancel_futures=True)
            self._begun.clear()
        # An interrupted command has not used all files.
        if self._used and set(self._used) != set(paths):
            _write(notes, "\n".join(path.name for path in self._used).encode())


_files = ReadAhead(_read)
reading_ahead: Callable[[str], AbstractContextManager[None]] = _files.reading
"""Context in which threads read the programs that a command used last time, while it imports
modules and reads its input: XLA takes 50 ms for each, in which Python is free.
"""
