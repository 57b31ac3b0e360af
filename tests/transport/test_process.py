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


def changed(made, **fields):
    """The same with other fields, unchecked: the runtime types of the test suite are stricter than
    the check itself.
    """
    copy = object.__new__(type(made))
    for name, value in {**vars(made), **fields}.items():
        object.__setattr__(copy, name, value)
    return copy


@pytest.mark.parametrize(
    ("switch", "value", "message"),
    [
        ("phase", "isotropic", "unknown phase 'isotropic'; known: lb06, rayleigh"),
        ("rescatter", "again", "unknown rescatter 'again'; known: to-interface, retest"),
    ],
)
def test_unknown_switch(switch, value, message):
    with pytest.raises(ValueError, match=message):
        changed(ij.ILIT_2006, **{switch: value}).__check_init__()


@pytest.mark.parametrize(
    ("solver", "process"), [(ij.IlitExact, ij.DEPTH_RESOLVED), (ij.RadiativeExact, ij.ILIT_2006)]
)
def test_a_solver_names_the_processes_it_treats(solver, process):
    with pytest.raises(ValueError, match=rf"{solver.__name__} treats \w+ processes, not \w+"):
        changed(solver(), process=process).__check_init__()


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
