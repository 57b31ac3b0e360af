"""Scene files that tests share, and what stands in for what grows for seconds."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np

from irisjax.anatomy.sclera import VeinMap
from irisjax.cli import simulate_cube
from irisjax.grow import presets
from irisjax.grow.procedural import procedural
from irisjax.io import scenes
from irisjax.tissue.maps import IrisMaps


def without_growth(monkeypatch):
    """Small maps that depend on the key and the pupil, for arguments that growing takes; vessels
    that depend on the sclera.
    """
    takes = inspect.signature(procedural)

    def grown(*given, **options):
        said = takes.bind(*given, **options).arguments
        random = np.random.default_rng(np.asarray(jax.random.key_data(said["key"])))
        uneven = random.uniform(0.5, 1.5, (3, 96, 32))
        height, depth = 0.05 * said["eye"].pupil_radius, said["iris"].stroma_thickness
        return IrisMaps(
            relief=height * uneven[0], stroma_depth=depth * uneven[1], eumelanin=uneven[2]
        )

    def veins(eye, *, key):
        return VeinMap(*jnp.full((3, 8, 4), eye.sclera.veins))

    for module in (scenes, presets, simulate_cube):
        monkeypatch.setattr(module, "procedural", grown)
    monkeypatch.setattr(scenes, "veins", veins)


BARE = """
[iris]
level = "low"
eumelanin = 0.05

[maps]
uniform = true

[eye]
cornea = "none"

[camera]
size = [8, 6]

[[light]]
polar_deg = 30
azimuth_deg = 10

[[light]]
position = [10, 20, -40]
irradiance = 1.5
"""
