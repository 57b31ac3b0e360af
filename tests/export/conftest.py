"""A hand-over made once a worker."""

import jax.numpy as jnp
import pytest
from handed_over import CAMERA, EYE, LAMPS, sector

import irisjax as ij
from irisjax.export import export
from irisjax.tissue.maps import IrisMaps


@pytest.fixture(scope="session")
def bare(tmp_path_factory):
    """A bare iris with a dark sector under two lamps: scene, folder, and what `export` said."""
    iris, maps = (
        ij.Iris.of_level("low"),
        IrisMaps(eumelanin=sector(), freckles=0.02 * jnp.ones((72, 16))),
    )
    scene = ij.Scene(iris, maps, EYE, LAMPS, camera=CAMERA)
    folder = tmp_path_factory.mktemp("bare") / "eye"
    return scene, folder, export(folder, scene, spacing=0.3)
