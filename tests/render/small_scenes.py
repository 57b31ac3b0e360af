"""A small eye, its scenes and maps, for several files of tests."""

import jax.numpy as jnp
import numpy as np

import irisjax as ij
from irisjax.anatomy.eye import Cornea, Eye
from irisjax.render.camera import Camera
from irisjax.render.lights import Lights
from irisjax.render.picture import surroundings, texture
from irisjax.render.project import project
from irisjax.render.scene import Scene
from irisjax.render.separable import Separable
from irisjax.tissue.maps import IrisMaps, cell_centres

LIGHT = ij.Iris.of_level("low")
CLEAR = Cornea(scatter=None)
BARE, CLOSE = (
    Eye(cornea=None, sclera=None, pupil_radius=0.25),
    Eye(sclera=None, cornea=CLEAR, pupil_radius=0.25),
)
SMALL = Camera(size=(12, 9), width=11.0)
# A cheaper solver: the error of its quadrature is no matter of the picture's.
QUICK = Separable(degrees=(3, 3, 2, 2, 2), solver=ij.IlitExact(8))


def scene(eye=BARE, polar=0.0, azimuth=0.0, irradiance=np.pi, **parts):
    lights = parts.pop("lights", Lights.distant(polar, azimuth, irradiance))
    return Scene(
        parts.pop("iris", LIGHT),
        eye=eye,
        lights=lights,
        **{"camera": SMALL, "integrator": QUICK, **parts},
    )


def rays_of(camera, eye):
    """A camera's place and unit directions of its lines of sight, (height, width, 3)."""
    rows, columns = camera.shape
    _, direction = camera.rays(jnp.arange(rows * columns), eye)
    return camera.position(eye), direction.reshape(rows, columns, 3)


def ring(height, radii=24, angles=48):
    """A map of (x, y) functions: values at texels of a 0.25 to 5.5 mm iris."""
    angle, radius = map(np.asarray, cell_centres((angles, radii)))
    r = 0.25 + 5.25 * radius
    return height(r * np.cos(angle)[:, None], r * np.sin(angle)[:, None])


def maps_of(**changes):
    """Maps that change nothing but what is asked for: one structure, and one program, for all."""
    even = {
        "abl_depth": LIGHT.abl_thickness, "stroma_depth": LIGHT.stroma_thickness,
        "eumelanin": 1.0, "relief": 0.0,
    } | changes  # fmt: skip
    return IrisMaps(**{name: np.broadcast_to(v, (48, 24)) for name, v in even.items()})


def around(made, view=None):
    """Radiance of everything but the iris, (channels, pixels)."""
    view = project(made.eye, made.camera) if view is None else view
    return np.asarray(surroundings(view, texture(view, made), made))
