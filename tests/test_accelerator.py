"""What an accelerator must do as well as a processor: precision, a full device of photons,
a frame.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import GRID
from irisjax.render.picture import draw
from irisjax.transport.defaults import exact_solver

pytestmark = pytest.mark.gpu


@pytest.fixture(autouse=True)
def _accelerator():
    if (found := jax.default_backend()) == "cpu":
        pytest.skip(f"no accelerator: JAX sees the backend {found!r} only")


@pytest.mark.parametrize("process", [ij.ILIT_2006, ij.ILIT_CORRECTED, ij.DEPTH_RESOLVED])
@pytest.mark.parametrize("level", ["low", "high"])
def test_single_precision_is_double_to_its_rounding(process, level):
    def values():
        return np.asarray(
            ij.reflectance(ij.Iris.of_level(level), GRID, solver=exact_solver(process)).values
        )

    double = values()
    with jax.enable_x64(False):
        single = values()
    assert (double.dtype, single.dtype) == (np.float64, np.float32)
    np.testing.assert_allclose(single, double, rtol=2e-5)


def test_photons_that_fill_the_device():
    """10⁷ photons a wavelength: every fate within four standard errors of the exact solver."""
    iris, n = ij.Iris.of_level("low"), 10_000_000
    exact = ij.reflectance(iris, GRID, first_surface=False).values
    found = ij.reflectance(
        iris, GRID, first_surface=False, solver=ij.MonteCarlo(n), key=jax.random.key(0)
    )
    z = (found.values - exact) / np.sqrt(exact * (1 - exact) / n)
    assert jnp.abs(z).max() < 4
    # The bits of a photon are the same on every device.
    few = ij.MonteCarlo(20_000)
    layers = iris.layers(ij.extinction(GRID))
    here = few.count(layers, ij.Light(1.0), key=jax.random.key(3)).fates
    with jax.default_device(jax.devices("cpu")[0]):
        there = few.count(layers, ij.Light(1.0), key=jax.random.key(3)).fates
    # Transcendental functions round differently: a photon in ten thousand may end elsewhere.
    assert np.abs(np.asarray(here) - np.asarray(there)).sum() <= 2e-4 * few.n_photons * len(GRID)


def test_one_frame():
    """The same picture as a processor's, to a thousandth of its brightest pixel."""
    camera = ij.Camera(0.2, 0.7, size=(160, 120), width=13.0)
    eye = ij.Eye(cornea=None, sclera=None)
    scene = ij.Scene(
        ij.Iris.of_level("low"), eye=eye, lights=ij.Lights.distant(0.5, 2.1), camera=camera
    )
    frame = np.asarray(draw(scene))
    with jax.default_device(jax.devices("cpu")[0]):
        expected = np.asarray(draw(scene))
    assert np.isfinite(frame).all() and frame.max() > 0
    np.testing.assert_allclose(frame, expected, rtol=0, atol=1e-3 * expected.max())
