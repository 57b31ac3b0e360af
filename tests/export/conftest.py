"""A hand-over made once a worker."""

import jax.numpy as jnp
import pytest
from handed_over import CAMERA, EYE, LAMPS, sector

import irisjax as ij
from irisjax.export import export_scene
from irisjax.tissue.maps import IrisMaps


@pytest.fixture(scope="session")
def bare(tmp_path_factory):
    """A bare iris with a dark sector under two lamps: scene, folder, and what `export_scene` said."""
    maps = IrisMaps(eumelanin=sector(), freckles=0.02 * jnp.ones((72, 16)))
    scene = ij.Scene(ij.Iris.of_level("low"), maps, EYE, LAMPS, camera=CAMERA)
    folder = tmp_path_factory.mktemp("bare") / "eye"
    return scene, folder, export_scene(folder, scene, spacing=0.3, form="glb")
