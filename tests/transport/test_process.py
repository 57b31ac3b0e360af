import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import irisjax as ij
from irisjax.optics.phase import PHASES
from irisjax.transport.process import PROCESSES, attenuation, entry_density, sample_entry, survival


def test_presets():
    assert ij.ILIT_2006.describe() == {
        "transport": "whole-layer", "phase": "lb06", "rescatter": "to-interface", "perturb_on_reflection": False,
        "scattering": "lb06", "cornea": "auto", "first_surface": True,
    }  # fmt: skip
    assert ij.ILIT_CORRECTED.describe() == {**ij.ILIT_2006.describe(), "phase": "rayleigh"}
    assert ij.DEPTH_RESOLVED.depth_resolved
    assert not ij.ILIT_CORRECTED.depth_resolved
    assert set(PROCESSES) == {"ilit-2006", "ilit-corrected", "depth-resolved"}
    assert ij.ILIT_CORRECTED.phase_function is PHASES["rayleigh"]


@pytest.mark.parametrize(
    ("switch", "value", "message"),
    [
        ("phase", "isotropic", "phase = 'isotropic'; known: lb06, rayleigh"),
        ("rescatter", "again", "rescatter = 'again'; known: to-interface, retest"),
        ("scattering", "mie", "scattering = 'mie'; known: lb06, rayleigh-spheres"),
        ("cornea", "outward", "cornea = 'outward'; known: none, inward, round-trip"),
        ("transport", "diffusion", "transport = 'diffusion'; known: whole-layer, depth-resolved"),
    ],
)
def test_unknown_switch(switch, value, message):
    # The runtime types of the test suite are stricter than the check itself: look below them.
    process = object.__new__(ij.Process)
    for name in (
        "phase",
        "rescatter",
        "perturb_on_reflection",
        "scattering",
        "cornea",
        "first_surface",
        "transport",
    ):
        object.__setattr__(process, name, value if name == switch else getattr(ij.ILIT_2006, name))
    with pytest.raises(ValueError, match=message):
        ij.Process.__check_init__(process)


def test_depth_resolved_is_rayleigh_only():
    with pytest.raises(ValueError, match='takes phase="rayleigh" only'):
        ij.Process(transport="depth-resolved")


def test_entry_is_cosine_distributed():
    """Eq. 1: α = arccos √(1−u), density 2μ."""
    assert quad(lambda m: float(entry_density(jnp.asarray(m))), 0, 1)[0] == pytest.approx(
        1, rel=1e-12
    )
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
