"""The volume that Mitsuba traces for the second set of photographs, against irisjax's solver."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from irisjax.tissue.indices import RefractiveIndices
from irisjax.tissue.layers import Layers
from irisjax.transport.light import Light

ROOT = Path(__file__).parent.parent.parent


@pytest.mark.peer
def test_a_uniform_slab_is_as_bright_as_radiative_transfer_makes_it(monkeypatch):
    """Three wavelengths in diffuse light, seen from above, without a surface that refracts; by
    reciprocity the directional reflectance at normal incidence.
    """
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    monkeypatch.syspath_prepend(str(ROOT))
    from experiments import volumetric_iris as volume

    scattering, absorbing = np.array([3.0, 2.4, 2.0]), np.array([0.4, 0.3, 0.1])
    depth = np.array([0.25, 0.12, 0.05])
    sheet, size = np.broadcast_to(depth, (8, 8, 3)), (4, 8, 8)
    light = np.ones((32, 64))
    known = np.ones(size), scattering, absorbing, sheet
    found = volume.traced_slab(*known, None, light, 1500, 1)[2:6, 2:6].mean((0, 1)) * np.pi
    indices = RefractiveIndices(*(jnp.asarray(1.0),) * 4)
    depths = map(jnp.asarray, (depth, absorbing * volume.DEPTH, scattering * volume.DEPTH))
    layers = Layers(*depths, indices=indices, order=indices.order())
    expected = np.asarray(ij.RadiativeExact().solve(layers, Light(1.0)).reflectance)
    np.testing.assert_allclose(found / volume.irradiance_of(light), expected, rtol=0.03)
