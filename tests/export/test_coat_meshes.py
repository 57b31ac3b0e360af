"""Meshes of painted coats."""

import io
import math

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from handed_over import least_facing
from PIL import Image

from irisjax.export.mesh import cone_mesh, painting_files
from irisjax.ocularist.coats import Coat, Painting, prosthesis
from irisjax.ocularist.cones import Cones

PROFILE = Cones.of([(3.0, 2.0), (3.2, 3.5), (3.2, 5.0)])


def painting():
    shape = jnp.asarray(np.linspace(0, 1, 64).reshape(8, 8))
    return Painting(
        (
            Coat("01 base", jnp.ones((8, 8)), jnp.asarray([0.2, 0.3, 0.4]), jnp.asarray(0.0)),
            Coat("02 dots", shape, jnp.asarray([1.0, 0.0, 0.0]), jnp.asarray(0.25)),
        ),
        PROFILE,
    )


def test_area_is_that_of_truncated_cones():
    mesh = cone_mesh(PROFILE, 512)
    area = math.pi * (2.0 + 3.5) * math.hypot(0.2, 1.5) + math.pi * (25.0 - 3.5**2)
    assert mesh.area == pytest.approx(area, rel=1e-4)


def test_triangles_face_the_viewer_and_agree_with_their_normals():
    mesh = cone_mesh(PROFILE)
    assert least_facing(mesh) > 0
    assert (mesh.vertex_normals[:, 2] < 0).all()
    np.testing.assert_allclose(np.linalg.norm(mesh.vertex_normals, axis=1), 1.0)


def test_uv_is_a_picture_from_ahead():
    mesh = cone_mesh(PROFILE)
    uv = np.stack([mesh.vertex_attributes[axis] for axis in "uv"], -1)
    np.testing.assert_allclose(10.0 * uv - 5.0, mesh.vertices[:, :2], atol=1e-12)


def read(files, name):
    form = name.rpartition(".")[2]
    return trimesh.load(io.BytesIO(files[name]), file_type=form, force="mesh", process=False)


@pytest.mark.parametrize("form", ["obj", "ply"])
def test_files_hold_meshes_and_pictures(form):
    files = painting_files(painting(), form, around=24)
    more = {"01_base.mtl", "02_dots.mtl"} if form == "obj" else set()
    names = {f"01_base.{form}", f"02_dots.{form}"}
    assert set(files) == {*names, "01_base.png", "02_dots.png", *more}
    low, high = (read(files, name).vertices for name in sorted(names))
    assert high[:, 2].max() == pytest.approx(-(3.0 - 0.25), abs=1e-5)
    np.testing.assert_allclose(high - low, np.broadcast_to([0, 0, 0.25], low.shape), atol=1e-6)
    picture = np.asarray(Image.open(io.BytesIO(files["02_dots.png"])))
    assert picture.shape == (8, 8, 4)
    np.testing.assert_array_equal(picture[..., :3], np.broadcast_to([255, 0, 0], (8, 8, 3)))
    np.testing.assert_allclose(picture[..., 3].ravel(), np.linspace(0, 255, 64), atol=0.51)
    if form == "obj":
        assert b"map_Kd 02_dots.png" in files["02_dots.mtl"]


def test_an_eyes_outside_is_written_too():
    files = painting_files(painting(), "ply", around=24, eye=prosthesis())
    assert {"cornea.ply", "white.ply"} < set(files)
    with pytest.raises(ValueError, match="unknown kind of mesh 'stl'; known: obj, ply"):
        painting_files(painting(), "stl")
