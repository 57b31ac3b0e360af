"""Meshes of painted coats."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from PIL import Image

from irisjax.export.coats import coat_mesh, cone_mesh, write_painting
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
    assert trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).area == pytest.approx(
        area, rel=1e-4
    )


def test_triangles_face_the_viewer_and_agree_with_their_normals():
    mesh = cone_mesh(PROFILE)
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    facing = np.cross(b - a, c - a)
    for i in range(3):
        assert (np.einsum("ij,ij->i", facing, mesh.normals[mesh.faces[:, i]]) > 0).all()
    assert (mesh.normals[:, 2] < 0).all()
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0)


def test_uv_is_a_picture_from_ahead():
    mesh = cone_mesh(PROFILE)
    assert mesh.uv is not None
    np.testing.assert_allclose(10.0 * mesh.uv - 5.0, mesh.vertices[:, :2], atol=1e-12)


def test_a_coat_stands_so_much_higher():
    low, high = (coat_mesh(painting(), name).vertices for name in ("01 base", "02 dots"))
    np.testing.assert_allclose(low - high, np.broadcast_to([0, 0, 0.25], low.shape), atol=1e-12)
    with pytest.raises(ValueError, match="no coat 'glaze'; there are 01 base"):
        coat_mesh(painting(), "glaze")


@pytest.mark.parametrize("form", ["obj", "ply"])
def test_files_hold_meshes_and_pictures(tmp_path, form):
    files = write_painting(tmp_path, painting(), form, around=24)
    assert {p.name for p in files.values()} == {f"01_base.{form}", f"02_dots.{form}"}
    read = trimesh.load(files["02 dots"], force="mesh", process=False)
    assert read.vertices[:, 2].max() == pytest.approx(-(3.0 - 0.25), abs=1e-5)
    picture = np.asarray(Image.open(tmp_path / "02_dots.png"))
    assert picture.shape == (8, 8, 4)
    np.testing.assert_array_equal(picture[..., :3], np.broadcast_to([255, 0, 0], (8, 8, 3)))
    np.testing.assert_allclose(picture[..., 3].ravel(), np.linspace(0, 255, 64), atol=0.51)


def test_an_eyes_outside_is_written_too(tmp_path):
    files = write_painting(tmp_path, painting(), "ply", around=24, eye=prosthesis())
    assert set(files) == {"01 base", "02 dots", "cornea", "white"}
    assert all(path.exists() for path in files.values())


def test_an_unknown_kind_of_file_is_refused(tmp_path):
    with pytest.raises(ValueError, match="unknown kind of mesh 'stl'; known: obj, ply"):
        write_painting(tmp_path, painting(), "stl")
    assert not list(tmp_path.iterdir())
