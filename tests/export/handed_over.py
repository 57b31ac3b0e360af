"""A scene to hand over, and what is read back of it."""

import jax.numpy as jnp
import numpy as np

import irisjax as ij
from irisjax import io
from irisjax.tissue.maps import cell_centres

EYE = ij.Eye(cornea=None, sclera=None)
CAMERA = ij.Camera(0.2, 0.7, size=(64, 48), width=13.0)
LAMPS = ij.Lights.distant(0.5, 2.1) + ij.Lights.points([30.0, -10.0, -80.0], 1.5)


def sector():
    """A dark sector, from 10° to 70° and in the outer half only."""
    angle, radius = cell_centres((72, 16))
    dark = ((angle > np.radians(10)) & (angle < np.radians(70)))[:, None] & (radius > 0.5)
    return jnp.where(dark, 20.0, 1.0)


def least_facing(mesh):
    """Least cosine between a triangle's own normal, counter-clockwise, and the normals of its
    corners.
    """
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    own = np.cross(b - a, c - a)
    own /= np.linalg.norm(own, axis=1, keepdims=True)
    return min((own * mesh.vertex_normals[mesh.faces[:, i]]).sum(1).min() for i in range(3))


def pixels(path):
    """Pixels of an EXR by channel name."""
    image = io.read_image(path)
    return {name: image.pixels[..., i] for i, name in enumerate(image.channels)}


def rgb(path):
    found = pixels(path)
    return np.stack([found[c] for c in "RGB"], -1)
