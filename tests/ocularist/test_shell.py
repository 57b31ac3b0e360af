"""Cornea and white as cones, against areas and places of spherical caps."""

import numpy as np
import pytest

from irisjax.ocularist.coats import prosthesis
from irisjax.ocularist.shell import shell

CORNEA, WHITE, APART = 7.8, 11.5, 4.7  # [L03 Fig. 6], mm


def _area(cones):
    """Of all sides: π (r₁ + r₂) times the slant."""
    z, r = np.asarray(cones.z), np.asarray(cones.radius)
    return np.sum(np.pi * (r[1:] + r[:-1]) * np.hypot(np.diff(z), np.diff(r)))


def test_circles_lie_on_the_papers_spheres_and_meet_at_the_limbus():
    cornea, white = shell(prosthesis())
    z, r = np.asarray(cornea.z), np.asarray(cornea.radius)
    np.testing.assert_allclose(np.hypot(z - CORNEA, r), CORNEA, rtol=1e-6)
    z, r = np.asarray(white.z), np.asarray(white.radius)
    # The paper's limbus is rounded to 0.01 mm.
    np.testing.assert_allclose(np.hypot(z - CORNEA - APART, r), WHITE, atol=0.01)
    assert (cornea.z[0], cornea.radius[0], white.radius[-1]) == (0, 0, pytest.approx(0, abs=1e-6))
    np.testing.assert_allclose(white.z[0], cornea.z[-1])
    np.testing.assert_allclose(white.radius[0], cornea.radius[-1])


def test_areas_become_those_of_caps_by_fours():
    eye = prosthesis()
    rim = float(eye.limbus_radius)
    # A cap of radius R and height h has 2 π R h.
    cap = 2 * np.pi * CORNEA * (CORNEA - np.sqrt(CORNEA**2 - rim**2))
    rest = 2 * np.pi * WHITE * (WHITE + np.sqrt(WHITE**2 - rim**2))
    off = np.array(
        [
            [
                1 - _area(part) / whole
                for part, whole in zip(shell(eye, n), (cap, rest), strict=True)
            ]
            for n in (33, 65, 129)
        ]
    )
    assert (off > 0).all()
    np.testing.assert_allclose(off[:-1] / off[1:], 4, rtol=0.05)


def test_eyes_without_a_shell():
    eye = prosthesis()
    for part in ("cornea", "sclera"):
        with pytest.raises(ValueError, match="has no shell"):
            shell(eye.replace(**{part: None}))
    with pytest.raises(ValueError, match="circles"):
        shell(eye, 1)
