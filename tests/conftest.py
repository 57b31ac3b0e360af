"""Float64 unless a test asks otherwise, runtime type checks, and repeatable hypothesis."""

import importlib.metadata
import os
from pathlib import Path

os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", "")  # the command's would be the user's own

import jaxtyping

jaxtyping.install_import_hook("irisjax", "typechecking.checked")

import jax
import pytest
from hypothesis import settings

jax.config.update("jax_enable_x64", True)

settings.register_profile(
    "deterministic", derandomize=True, deadline=None, database=None, max_examples=50
)
settings.load_profile("deterministic")


def pytest_configure(config):
    """Programs compiled once for all workers and runs; `pytest --cache-clear` forgets them."""
    _compile_in_half_the_time(config.option.markexpr)
    if hasattr(config, "cache"):
        # Not in the environment: the commands that tests start keep nothing.
        jax.config.update("jax_compilation_cache_dir", str(config.cache.mkdir("compiled")))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


def _compile_in_half_the_time(tier):
    """Loops of the default and the heavy tier are put together by XLA's older code; LLVM optimises
    them as ever.

    `peer` and `slow` run what users run to the letter. Other releases of jaxlib stop at this flag.
    """
    known = importlib.metadata.version("jaxlib").startswith("0.10.")
    if known and "not slow" in tier and "not peer" in tier:
        os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false")


def _wants_float32(item):
    call = getattr(item, "callspec", None)
    return "float32" in item.fixturenames or (call is not None and call.params.get("bits") == 32)


def pytest_collection_modifyitems(items):
    """Single precision last: what is compiled, is compiled once."""
    items.sort(key=_wants_float32)


@pytest.fixture(autouse=True)
def _precision(request):
    """Of one test; what is made once for several is in double precision."""
    jax.config.update("jax_enable_x64", not _wants_float32(request.node))
    yield
    jax.config.update("jax_enable_x64", True)


@pytest.fixture(autouse=True, scope="module")
def _mappings():
    """Compiled programs are dropped before Linux's 65,530 memory mappings a process run out: a few
    dozen each, and at the last one XLA ends in a segmentation fault.
    """
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and len(maps.read_bytes().splitlines()) > 40_000:
        jax.clear_caches()


# Floors whose programs promote neither dtypes nor ranks but by hand; the upper ones follow.
_STRICT = {"numerics", "optics", "tissue", "transport", "ocularist"}
# Cells of a BRDF are counted in integers over a real solid angle; a path serves all wavelengths;
# pictures of paint are the renderer's.
_LAX = {
    "test_montecarlo.py",
    "test_polarised_montecarlo.py",
    "test_painted_light.py",
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
    """Tables of the default process, made once a worker."""
    import irisjax as ij

    return ij.IlitTabulated.build()
