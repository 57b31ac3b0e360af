"""A small eye for the viewer."""

import pytest
from small import grown

from irisjax.anatomy.eye import Eye
from irisjax.render.camera import Camera
from irisjax.render.scene import Scene
from render.small_scenes import QUICK


@pytest.fixture
def bare():
    """A bare iris in air, small: nothing to tabulate."""
    return Scene(
        *grown(),
        Eye(cornea=None, sclera=None),
        camera=Camera(size=(40, 30)),
        integrator=QUICK,
    )
