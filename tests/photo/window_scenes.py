"""A small eye of uneven thickness, as a camera sees it."""

import functools

import jax.numpy as jnp
import numpy as np

import irisjax as ij
from irisjax.anatomy.eye import Cornea, Eye
from irisjax.photo.pose import Pose
from irisjax.render.camera import Camera
from irisjax.render.lights import Lights
from irisjax.render.picture import illuminate, respond, shade, texture
from irisjax.render.project import View, project_visible
from irisjax.render.scene import Scene
from irisjax.render.separable import Separable
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps

BASE = Iris(fibril_radius=jnp.asarray(57.0))
EYE = Eye(cornea=Cornea(scatter=None), sclera=None)
BARE = EYE.replace(cornea=None)
CAMERA = Camera(polar=0.2, azimuth=0.4, width=13.0, size=(90, 90))
POSE = Pose(CAMERA, (0, 0), EYE, (0.0, 0.0), 2.0, 0.2, 0.01, (0.18, 0.22), None, "given")
LIGHTS = Lights.distant(0.6, 2.0) + Lights.distant(0.3, -1.0, 1.0)
# A cheaper solver: the error of its quadrature is no matter of the windows'.
QUICK = Separable(degrees=(3, 3, 2, 2, 2), solver=ij.IlitExact(8))
SHAPE = CAMERA.shape


@functools.cache
def view(bare: bool = False) -> View:
    """Project what the camera sees of the eye, with its cornea or `bare` of it."""
    return project_visible(BARE if bare else EYE, CAMERA)


def picture_of(seen: View, scene: Scene) -> np.ndarray:
    """The picture that `draw` gives, of a view that is projected already."""
    found = texture(seen, scene)
    light = illuminate(seen, found, scene, scene.tables())
    return np.asarray(shade(seen, found, light, respond(scene)))


def maps() -> IrisMaps:
    """Thickness that varies round the iris and across it."""
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)[:, None]
    across = np.linspace(0, 1, 24)[None]
    return IrisMaps(stroma_depth=jnp.asarray(0.3 + 0.08 * np.cos(3 * angle) - 0.05 * across))
