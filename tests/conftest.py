"""Float64 unless a test asks otherwise, runtime type checks, and repeatable hypothesis."""

import jaxtyping

jaxtyping.install_import_hook("irisjax", "typechecking.checked")

import jax
import pytest
from hypothesis import settings

jax.config.update("jax_enable_x64", True)

settings.register_profile("deterministic", derandomize=True, deadline=None, database=None, max_examples=50)
settings.load_profile("deterministic")


def _precision(bits):
    # JAX keeps traced helpers between calls; some were traced at the other precision.
    jax.clear_caches()
    jax.config.update("jax_enable_x64", bits == 64)


@pytest.fixture(params=[64, 32], ids=["f64", "f32"])
def bits(request):
    """Both precisions, one after the other."""
    if request.param == 64:
        yield 64
        return
    _precision(32)
    yield 32
    _precision(64)


@pytest.fixture
def float32():
    """Single precision for one test."""
    _precision(32)
    yield
    _precision(64)


@pytest.fixture(scope="session")
def tabulated():
    """Tables of the default process, made once a worker."""
    import irisjax as ij

    return ij.Tabulated.build()
