"""Windows of a small eye of uneven thickness, whose colours the tests choose."""

import dataclasses

import jax.numpy as jnp
import numpy as np

import irisjax as ij
from irisjax.anatomy.eye import Cornea, Eye
from irisjax.photo.pose import Pose
from irisjax.photo.window_pixels import choose_pixels, iris_alone
from irisjax.photo.windows import Windows, windows_of
from irisjax.render.camera import Camera
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.separable import Separable
from irisjax.render.stages import look
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps

BASE = Iris(fibril_radius=jnp.asarray(57.0))
EYE = Eye(cornea=Cornea(scatter=None), sclera=None)
CAMERA = Camera(polar=0.2, azimuth=0.4, width=13.0, size=(90, 90))
POSE = Pose(CAMERA, (0, 0), EYE, (0.0, 0.0), 0.2, 0.01, (0.18, 0.22), None, "given", 0.0)
LIGHTS = Lights.distant(0.6, 2.0) + Lights.distant(0.3, -1.0, 1.0)
# A cheaper solver: the error of its quadrature is no matter of the windows'.
QUICK = Separable(degrees=(3, 3, 2, 2, 2), solver=ij.IlitExact(8))
SHAPE = CAMERA.shape
VIEW = look(EYE, CAMERA)


def maps():
    """Thickness that varies round the iris and across it."""
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)[:, None]
    across = np.linspace(0, 1, 24)[None]
    return IrisMaps(stroma_depth=jnp.asarray(0.3 + 0.08 * np.cos(3 * angle) - 0.05 * across))


def windows(pixels, clear=None, integrator=QUICK) -> Windows:
    """Of a picture (rows, columns, 3) of `POSE`."""
    clear = np.ones(SHAPE, bool) if clear is None else clear
    tables = Illumination.build(EYE, caustics=False)
    chosen = choose_pixels(pixels, clear & iris_alone(POSE), VIEW, EYE)
    return windows_of(chosen, EYE, BASE, maps(), LIGHTS, integrator, tables)


def made_windows(colours) -> Windows:
    """Noiseless ones whose colours are `colours(windows)`."""
    bare = windows(np.ones((*SHAPE, 3)))
    return dataclasses.replace(bare, colour=np.asarray(colours(bare)))
