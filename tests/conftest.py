"""Double precision unless a test asks otherwise, runtime type checks, repeatable hypothesis, and a
budget of compiled programs for each file.
"""

import collections
import gc
import hashlib
import importlib.metadata
import os
import platform
from pathlib import Path

gc.disable()  # until all is imported, of which next to nothing is garbage

# The command would otherwise use the user's own cache.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", "")
# Each worker has a core to itself, and matrices and programs are small: several threads would wait
# for each other, which took a fifth of the time of all tests. XLA reads NPROC.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NPROC", "1")

import jaxtyping

jaxtyping.install_import_hook("irisjax", "typechecking.checked")

import jax
import jax.monitoring
import pytest
from hypothesis import given, settings, strategies
from jax._src.interpreters import mlir

jax.config.update("jax_enable_x64", True)

settings.register_profile(
    "deterministic", derandomize=True, deadline=None, database=None, max_examples=50
)
settings.load_profile("deterministic")


def pytest_configure(config):
    """Compiled programs are shared by all workers and later runs; `pytest --cache-clear` deletes
    them, unless the environment names another folder.
    """
    _share_context()
    config.option.loadscopereorder = False  # or workers begin with the files of most tests
    folder = os.environ.get("IRISJAX_TEST_PROGRAMS")
    if folder:
        kept = Path(folder) / f"jaxlib-{importlib.metadata.version('jaxlib')}-{_processor()}"
    elif hasattr(config, "cache"):
        kept = config.cache.mkdir("compiled")
    else:
        return
    # Not through the environment: commands that tests start as processes must not use it. Small
    # programs too: most cost more to compile than to read, and the workers need the same ones.
    jax.config.update("jax_compilation_cache_dir", str(kept))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def _processor():
    """A short name of the processor's instructions: compiled programs run on no other."""
    path = Path("/proc/cpuinfo")
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    flags = next((x for x in lines if x.startswith(("flags", "Features"))), "")
    return hashlib.sha256(f"{platform.machine()} {flags}".encode()).hexdigest()[:12]


def _compile_quickly(tier):
    """Programs of the default tier and of `peer` are compiled without LLVM's optimisation, their
    loops by XLA's older code, and in one piece instead of 32, of which each is made ready apart: a
    program costs a third or less. The tier `slow` runs what users run, as do the commands that an
    experiment times in processes of their own.
    """
    if "not slow" not in tier:
        return
    flags = ["--xla_backend_optimization_level=0"]
    if importlib.metadata.version("jaxlib").startswith("0.10."):  # other releases stop at these
        flags.append("--xla_cpu_use_fusion_emitters=false")
        flags.append("--xla_cpu_parallel_codegen_split_count=1")
    os.environ.setdefault("XLA_FLAGS", " ".join(flags))


def _share_context():
    """All programs are lowered in one MLIR context: to make and delete one for each costs 3 ms, a
    fifth of what a program of one operation costs.
    """
    make = getattr(mlir, "make_ir_context", None)
    if make is None:  # JAX promises no such name
        return
    shared = make()

    def context():
        # While a program is lowered another may be, of a value that its rules need.
        return make() if mlir.ir.Context.current else shared

    mlir.make_ir_context = context


def pytest_ignore_collect(collection_path, config):
    """Files without a test of the tier `peer` are not imported for it."""
    if config.option.markexpr != "peer and not slow" or not collection_path.match("test_*.py"):
        return None
    return b"mark.peer" not in collection_path.read_bytes() or None


def _wants_float32(item):
    call = getattr(item, "callspec", None)
    return "float32" in item.fixturenames or (call is not None and call.params.get("bits") == 32)


# CPU seconds of the files that take longest. Workers take files in the order of collection: these
# first, or one of them is left to one worker when the other has done.
_LONGEST = {
    "test_experiments.py": 99,
    "cli/test_engine.py": 45,
    "grow/test_presets.py": 40,
    "transport/test_polarised_montecarlo.py": 27,
    "cli/test_compiled.py": 20,
    "infer/test_model_comparison.py": 16,
    "test_stress.py": 16,
    "test_pages.py": 15,
    "export/test_mitsuba.py": 14,
    "test_composition.py": 14,
    "transport/test_general_scattering_peer.py": 13,
    "transport/test_polarised_peer.py": 13,
    "transport/test_tabulated.py": 13,
    "transport/test_general_scattering.py": 12,
    "infer/test_other_samplers.py": 11,
    "ocularist/test_painted_scenes.py": 11,
    "infer/test_analysis.py": 11,
    "test_edge_gradients.py": 10,
    "photo/test_outlines.py": 10,
    "transport/test_transmittance.py": 9,
    "transport/test_depth_resolved.py": 9,
    "test_notebooks.py": 9,
    "render/test_single_scattering.py": 9,
    "photo/test_texels.py": 9,
    "render/test_scene.py": 9,
    "render/test_refraction.py": 9,
    "cli/test_clone_command.py": 9,
    "transport/test_exact_limits.py": 8,
    "transport/test_radiative_tabulated.py": 8,
    "photo/test_pigments_of_windows.py": 8,
    "infer/test_problem.py": 8,
    "infer/test_fit.py": 7,
    "measure/test_passbands.py": 7,
    "measure/test_measure.py": 7,
    "photo/test_clone.py": 7,
    "photo/test_simulated_photographs.py": 7,
    "ocularist/test_matching.py": 7,
    "transport/test_montecarlo.py": 6,
    "cli/test_map_command.py": 6,
    "photo/test_pose.py": 7,
    "transport/test_sharp_scattering.py": 6,
    "photo/test_windows.py": 6,
    "transport/test_polarised.py": 6,
    "infer/test_pixels.py": 6,
    "render/test_radiative.py": 6,
    "render/test_lids.py": 6,
    "transport/test_exact.py": 5,
    "render/test_sclera.py": 5,
    "cli/test_paint_command.py": 5,
    "cli/test_spectrum_command.py": 5,
}


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items):
    """The longest files first; within a file, tests of single precision after all others."""
    files = {path: k for k, path in enumerate(dict.fromkeys(item.path for item in items))}
    weights = {path: _LONGEST.get(_name(path), 0) for path in files}
    items.sort(key=lambda x: (-weights[x.path], files[x.path], _wants_float32(x)))
    # Before its first property Hypothesis looks through all objects: there are few now.
    given(strategies.none())(lambda _: None)()
    # Imported modules and collected tests stay: no collection of garbage needs to look through them,
    # and traces leave so little that seldom is enough.
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)
    gc.enable()


def _name(path):
    """A file's path below `tests`."""
    return path.relative_to(Path(__file__).parent).as_posix()


@pytest.fixture(autouse=True)
def _precision(request):
    """The precision of one test; fixtures shared by several tests are made in double precision."""
    jax.config.update("jax_enable_x64", not _wants_float32(request.node))
    yield
    jax.config.update("jax_enable_x64", True)


@pytest.fixture(autouse=True, scope="module")
def _mappings():
    """Deletes the compiled programs in memory before a process reaches Linux's limit of 65,530
    memory mappings, where XLA ends in a segmentation fault. A program has a few dozen mappings.
    """
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and len(maps.read_bytes().splitlines()) > 40_000:
        jax.clear_caches()


# Number of programs that a file may compile, single operations of `jax.numpy` included: the cost of
# tests is mostly the number of programs. A program read from the cache on disk counts, one that is
# still in memory does not, so a file compiles most when it runs alone. The numbers in the table may
# only fall.
_MOST_PROGRAMS = 420
_PROGRAMS_OF_FILE = {
    "anatomy/test_anatomy.py": 55,
    "measure/test_measure.py": 85,
    "measure/test_passbands.py": 55,
    "measure/test_polarimeter.py": 10,
    "measure/test_refusals.py": 60,
    "numerics/test_angle.py": 20,
    "numerics/test_linear.py": 10,
    "numerics/test_quadrature.py": 50,
    "numerics/test_streams.py": 15,
    "numerics/test_tucker.py": 20,
    "optics/test_fresnel.py": 45,
    "optics/test_kubelka_munk.py": 10,
    "optics/test_mixture.py": 20,
    "optics/test_per_angle.py": 25,
    "optics/test_phase.py": 25,
    "test_architecture.py": 15,
    "test_composition.py": 60,
    "test_paper.py": 20,
    "tissue/test_indices.py": 40,
    "tissue/test_iris.py": 55,
    "tissue/test_scattering.py": 40,
    "transport/test_depth_resolved.py": 120,
    "transport/test_exact.py": 30,
    "transport/test_montecarlo.py": 65,
    "transport/test_polarised.py": 75,
    "transport/test_transmittance.py": 35,
}
_compiled = collections.Counter()
_counts = collections.Counter()


def _count(event, _duration, **_about):
    _compiled[event] += 1


jax.monitoring.register_event_duration_secs_listener(_count)


@pytest.fixture(autouse=True, scope="module")
def _few_programs(request):
    """Fails a file of the default tier that compiles more programs than its budget."""
    event = "/jax/core/compile/backend_compile_duration"
    before = _compiled[event]
    yield
    name = _name(request.path)
    n = _compiled[event] - before
    _counts[name] += n
    budget = _PROGRAMS_OF_FILE.get(name, _MOST_PROGRAMS)
    if n > budget and request.config.option.markexpr == _default_tier(request.config):
        pytest.fail(
            f"{name} compiles {n} programs, its budget is {budget}: share sizes and jitted functions "
            "between tests (pytest --compilations prints the numbers)"
        )


def _default_tier(config):
    return config.getini("addopts")[-1]


def pytest_addoption(parser, pluginmanager):
    """`--compilations`: prints how many programs each file compiled.

    XLA reads its flags once: here, before a folder's `conftest.py` makes its first array.
    """
    _compile_quickly(pluginmanager.get_plugin("pytestconfig").known_args_namespace.markexpr)
    parser.addoption("--compilations", action="store_true", help="programs compiled by each file")


def pytest_sessionfinish(session):
    """A worker of pytest-xdist sends its numbers to the process that prints them."""
    gc.freeze()  # otherwise pytest looks through all that is left for ten seconds
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["programs"] = dict(_counts)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node):
    """Adds the numbers of a worker."""
    _counts.update(getattr(node, "workeroutput", {}).get("programs", {}))


def pytest_terminal_summary(terminalreporter, config):
    """Prints the numbers, highest first."""
    if config.option.compilations:
        for name, n in sorted(_counts.items(), key=lambda x: -x[1]):
            terminalreporter.write_line(f"{n:6d} programs  {name}")


# Packages whose programs must not promote dtypes or ranks implicitly.
_STRICT = {"numerics", "optics", "tissue", "transport", "ocularist"}
# Exceptions: a BRDF divides integer counts by a real solid angle, one photon path serves all
# wavelengths, and pictures of paint use the renderer.
_LAX = {
    "test_montecarlo.py",
    "test_polarised_montecarlo.py",
    "test_painted_scenes.py",
}


@pytest.fixture(autouse=True)
def _no_promotion(request):
    if request.path.parent.name not in _STRICT or request.path.name in _LAX:
        yield
        return
    with jax.numpy_dtype_promotion("strict"), jax.numpy_rank_promotion("raise"):
        yield


@pytest.fixture(params=[64, 32], ids=["f64", "f32"])
def bits(request):
    """Both precisions."""
    return request.param


@pytest.fixture
def float32():
    """Single precision for one test."""


@pytest.fixture(scope="session")
def tabulated():
    """The table of the default process that comes with the package."""
    import irisjax as ij
    from irisjax.transport.defaults import table_for

    return table_for(ij.Iris().indices(), ij.ILIT_2006)
