"""`irisjax spectrum` of polarised light: its instruments, its header, what it refuses."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from irisjax.cli import measure
from irisjax.measure.polarimeter import PolarisedReading
from irisjax.transport.solution import RESULTS, Absorbed

WAVELENGTHS = np.array([450.0, 620.0])
GRID = ("--wavelengths", "450,620", "--level", "low")


@pytest.fixture
def observed(monkeypatch):
    """Readings that are known; what is asked for."""
    half, seen = jnp.full(2, 0.5), []
    reading = PolarisedReading(
        *(jnp.asarray(WAVELENGTHS), half, None, RESULTS.successful, Absorbed(half, half, half)),
        *(half, None, "degree of linear polarisation", "", half, jnp.ones((2, 4))),
    )
    monkeypatch.setattr(measure, "observe", lambda *given, **_: seen.append(given) or reading)
    return seen


@pytest.mark.parametrize(
    ("arguments", "make", "how"),
    [
        (("cross-polarised",), ij.Analyser, {"setting": "crossed"}),
        (
            ("co-polarised", "--exit-deg", "hemisphere", "--polariser-deg", "30"),
            ij.Analyser,
            {"setting": "parallel", "cos_exit": "hemisphere", "polariser": np.radians(30)},
        ),
        (("degree-of-polarisation",), ij.Polarimeter, {"cos_exit": np.sqrt(0.5)}),
    ],
    ids=["crossed", "parallel", "degree"],
)
def test_instruments_are_the_librarys(irisjax, observed, printed, arguments, make, how):
    status, out, err = irisjax("spectrum", "--instrument", *arguments, *GRID)
    assert (status, err) == (0, "")
    ((iris, found, solver),) = observed
    assert eqx.tree_equal(iris, ij.Iris.of_level("low"), rtol=1e-12)
    assert eqx.tree_equal(found, make(WAVELENGTHS, **how), rtol=1e-12)
    assert solver.process == ij.POLARISED
    header, columns = printed(out)
    assert (header["process"], header["polarised"]) == ("depth-resolved", "yes")
    assert arguments[0].split("-")[0] in header["simulated"]
    assert "photographs" in header["approximation"]
    assert columns["degree_of_linear_polarisation"].tolist() == [0.5, 0.5]
    np.testing.assert_allclose(columns["angle_deg"], np.degrees(0.5))
