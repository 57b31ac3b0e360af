"""Meshes of the eye: where their points lie, which way they face, how they close."""

import functools
import io

import numpy as np
import pytest
import trimesh
from handed_over import least_facing

from irisjax.anatomy.eye import Cornea, Eye
from irisjax.export.mesh import eye_meshes, mesh_files

EYE = Eye()


@functools.cache
def meshes(slope=None):
    return eye_meshes(EYE.replace(iris_slope=slope), 0.2)


@pytest.mark.parametrize("name", ["anterior", "posterior"])
def test_cornea_lies_on_its_conicoid(name):
    surface = getattr(EYE.cornea, name)
    mesh = meshes()[name]
    x, y, z = mesh.vertices.T
    radius, p, z = float(surface.radius), float(surface.shape), z - float(surface.apex)
    np.testing.assert_allclose(p * z**2 - 2 * radius * z + x**2 + y**2, 0, atol=1e-12)
    # The gradient of the equation, outwards.
    gradient = np.stack([x, y, p * z - radius], -1)
    np.testing.assert_allclose(
        mesh.vertex_normals, gradient / np.linalg.norm(gradient, axis=1)[:, None], atol=1e-12
    )
    assert (mesh.vertex_normals[:, 2] < 0).all()


@pytest.mark.parametrize("slope", [None, 0.1])
def test_all_face_outwards_with_unit_normals(slope):
    for name, mesh in meshes(slope).items():
        np.testing.assert_allclose(np.linalg.norm(mesh.vertex_normals, axis=1), 1, atol=1e-12)
        assert least_facing(mesh) > 0.99, name
        assert np.unique(mesh.faces).size == len(mesh.vertices)


@pytest.mark.parametrize("slope", [None, 0.1])
def test_iris_carries_the_coordinates_of_the_maps(slope):
    mesh = meshes(slope)["iris"]
    (u, v), (x, y, z) = (mesh.vertex_attributes[axis] for axis in "uv"), mesh.vertices.T
    assert u.min() == v.min() == 0 and u.max() == v.max() == 1
    r = 1.9 + v * (5.5 - 1.9)
    np.testing.assert_allclose(x + 1j * y, r * np.exp(2j * np.pi * u), atol=1e-12)
    np.testing.assert_allclose(z, 3.6 + (slope or 0) * r, atol=1e-12)
    # No triangle runs back over the seam.
    assert np.ptp(u[mesh.faces], axis=1).max() < 0.1


def test_cornea_and_sclera_close_the_eye():
    parts = [
        trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        for mesh in (meshes()["anterior"], meshes()["sclera"])
    ]
    rims = [np.linalg.norm(p.vertices[:, :2], axis=1) for p in parts]
    assert all(np.isclose(r, 5.5, rtol=0, atol=1e-12).sum() >= 12 for r in rims)
    closed = trimesh.util.concatenate(parts)
    closed.merge_vertices(digits_vertex=9)
    assert closed.is_watertight and closed.is_winding_consistent and closed.volume > 0


@pytest.mark.parametrize("slope", [None, 0.1])
def test_posterior_cornea_ends_on_the_iris(slope):
    mesh = meshes(slope)["posterior"]
    r = np.linalg.norm(mesh.vertices[:, :2], axis=1)
    at = r.argmax()
    assert r[at] > 5.5
    assert mesh.vertices[at, 2] == pytest.approx(3.6 + (slope or 0) * r[at], abs=1e-9)


def test_what_the_eye_lacks_has_no_mesh():
    assert set(eye_meshes(Eye(cornea=None, sclera=None), 0.2)) == {"iris"}
    single = Eye(cornea=Cornea.f09(), aqueous_index=1.376)
    assert set(eye_meshes(single, 0.2)) == {"anterior", "iris", "sclera"}


def test_files_hold_the_meshes():
    files = mesh_files(meshes())
    assert set(files) == {f"{name}.ply" for name in meshes()}
    for name, mesh in meshes().items():
        found = trimesh.load(io.BytesIO(files[f"{name}.ply"]), file_type="ply", process=False)
        near = {"rtol": 1e-6, "atol": 1e-7}
        np.testing.assert_allclose(found.vertices, mesh.vertices, **near)
        np.testing.assert_allclose(found.vertex_normals, mesh.vertex_normals, **near)
        np.testing.assert_array_equal(found.faces, mesh.faces)
        if uv := mesh.vertex_attributes:
            np.testing.assert_allclose(found.visual.uv, np.stack([uv["u"], uv["v"]], -1), **near)


def test_finer_where_asked():
    coarse = eye_meshes(EYE, 0.4)["anterior"]
    assert len(meshes()["anterior"].faces) > 3 * len(coarse.faces)


@pytest.mark.parametrize("spacing", [0.0, np.nan, np.inf])
def test_impossible_spacing_is_refused(spacing):
    with pytest.raises(ValueError, match="spacing"):
        eye_meshes(EYE, spacing)
