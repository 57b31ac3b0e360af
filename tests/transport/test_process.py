import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import irisjax as ij
from irisjax.optics.phase import PHASES
from irisjax.transport.process import PROCESSES, attenuation, entry_density, sample_entry, survival


def test_presets():
    printed = {"phase": "lb06", "rescatter": "to-interface", "perturb_on_reflection": False}
    assert ij.ILIT_2006.describe() == printed
    assert ij.ILIT_CORRECTED.describe() == {**printed, "phase": "rayleigh"}
    assert ij.DEPTH_RESOLVED.describe() == {}
    transports = ij.ILIT_2006.transport, ij.DEPTH_RESOLVED.transport
    assert transports == ("whole-layer", "depth-resolved")
    assert set(PROCESSES) == {"ilit-2006", "ilit-corrected", "depth-resolved"}
    assert ij.ILIT_CORRECTED.phase_function is PHASES["rayleigh"]
    assert ij.DEPTH_RESOLVED.phase_function is PHASES["rayleigh"]


@pytest.mark.parametrize(
    ("switch", "value", "message"),
    [
        ("phase", "isotropic", "unknown phase 'isotropic'; known: lb06, rayleigh"),
        ("rescatter", "again", "unknown rescatter 'again'; known: to-interface, retest"),
    ],
)
def test_unknown_switch(switch, value, message):
    # The runtime types of the test suite are stricter than the check itself: look below them.
    process = object.__new__(ij.Ilit)
    for name in ij.ILIT_2006.describe():
        object.__setattr__(process, name, value if name == switch else getattr(ij.ILIT_2006, name))
    with pytest.raises(ValueError, match=message):
        ij.Ilit.__check_init__(process)


@pytest.mark.parametrize(
    ("solver", "process"), [(ij.IlitExact, ij.DEPTH_RESOLVED), (ij.RadiativeExact, ij.ILIT_2006)]
)
def test_a_solver_names_the_processes_it_treats(solver, process):
    # The runtime types of the test suite are stricter than the check itself: look below them.
    made = object.__new__(solver)
    for name, value in vars(solver()).items():
        object.__setattr__(made, name, process if name == "process" else value)
    with pytest.raises(ValueError, match=rf"{solver.__name__} treats \w+ processes, not \w+"):
        solver.__check_init__(made)


def test_entry_is_cosine_distributed():
    """Eq. 1: α = arccos √(1−u), density 2μ."""
    whole = quad(lambda m: float(entry_density(jnp.asarray(m))), 0, 1)[0]
    assert whole == pytest.approx(1, rel=1e-12)
    u = np.linspace(0, 1, 11)
    mu = np.asarray(sample_entry(jnp.asarray(u)))
    np.testing.assert_allclose(mu, np.cos(np.arccos(np.sqrt(1 - u))), atol=1e-15)
    # Distribution function of the density: μ² = 1 − u.
    np.testing.assert_allclose(mu**2, 1 - u, atol=1e-15)


def test_survival_and_attenuation():
    depth = np.array([0.0, 1e-20, 1e-6, 0.7, 800.0])
    np.testing.assert_allclose(survival(depth, 0.5) + attenuation(depth, 0.5), 1, rtol=1e-15)
    assert attenuation(depth, 0.5)[1] == pytest.approx(2e-20, rel=1e-14)
    assert survival(depth, 0.5)[3] == pytest.approx(np.exp(-1.4), rel=1e-14)
