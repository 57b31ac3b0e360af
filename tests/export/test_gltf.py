"""The glTF binary: read back by trimesh and by hand, against the specification and plain formulas."""

import functools
import io
import json
import struct

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from PIL import Image

import irisjax as ij
from irisjax.anatomy.sclera import VeinMap
from irisjax.export.gltf import FOOTPRINT, gltf_files
from irisjax.export.mesh import eye_meshes, right_handed, strip_meshes
from irisjax.measure.colour import srgb_decode
from irisjax.tissue.maps import IrisMaps, cell_centres

SHAPE = 48, 256
EYE = ij.Eye(pupil_centre=jnp.asarray([0.2, -0.1]))
RIPPLE = 0.07  # mm


def _unit(value):
    return 0 <= value <= 1


def _texture(value):
    return set(value) == {"index"} and value["index"] >= 0


# The schemas of KhronosGroup/glTF, extensions/2.0/Khronos: all fields, and what each may hold.
SCHEMAS = {
    "KHR_materials_ior": {"ior": lambda v: v == 0 or v >= 1},
    "KHR_materials_transmission": {"transmissionFactor": _unit, "transmissionTexture": _texture},
    "KHR_materials_volume": {
        "thicknessFactor": lambda v: v >= 0,
        "thicknessTexture": _texture,
        "attenuationDistance": lambda v: v > 0,
        "attenuationColor": lambda v: len(v) == 3 and all(map(_unit, v)),
    },
}


def _colour(angle, radius):
    """Smooth, unlike its mirror images, and away from black."""
    return [0.5 + 0.3 * np.cos(angle), 0.5 + 0.3 * np.sin(angle), 0.2 + 0.6 * radius]


def _relief(angle, radius):
    """A tilted plane, and ripples from ring to ring that are finer than the footprint."""
    x = (1.9 + 3.6 * radius) * np.cos(angle) + 0.2 * (1 - radius)
    return 0.05 * x + 0.001 * np.cos(2 * np.pi * 3.6 * radius / RIPPLE)


@functools.cache
def made():
    angle, radius = (np.asarray(c) for c in cell_centres(SHAPE))
    grid = np.meshgrid(angle, radius, indexing="ij")
    maps = IrisMaps(relief=_relief(*grid), stroma_depth=0.2 + 0.4 * grid[1])
    veins = VeinMap(*jnp.ones((3, 8, 4)))
    white = np.full((8, 4, 3), 0.7)
    white[:2] = 0.3  # a dark quarter, right and up
    meshes = eye_meshes(EYE, 0.3) | strip_meshes(EYE, 0.3)
    meshes = {name: right_handed(mesh) for name, mesh in meshes.items()}
    colour = np.stack(_colour(*grid), -1)
    haze = np.array([0.9, 0.8, 0.7])
    scene = ij.Scene(ij.Iris.of_level("low"), maps, EYE, veins=veins)
    return gltf_files(scene, meshes, colour, white, haze)


@functools.cache
def tree():
    """The header, by the layout of the specification."""
    data = made()["eye.glb"]
    magic, version, length, header, kind = struct.unpack("<4sII I4s", data[:20])
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), b"JSON")
    return json.loads(data[20 : 20 + header])


@functools.cache
def loaded():
    return trimesh.load_scene(io.BytesIO(made()["eye.glb"]), file_type="glb", process=False)


def test_a_loader_finds_named_nodes_in_metres():
    nodes = {
        name: loaded().geometry[loaded().graph[name][1]] for name in loaded().graph.nodes_geometry
    }
    across = {name: tuple(np.round(1e3 * mesh.extents, 2)) for name, mesh in nodes.items()}
    strips = "tear_line", "occlusion", "limbus"
    assert set(across) == {"iris", "pupil", "cornea", "sclera", *strips}
    assert across["iris"][:2] == across["cornea"][:2] == (11.0, 11.0)
    assert across["pupil"] == (3.8, 3.8, 0.0)
    assert across["sclera"][0] == pytest.approx(23.0, abs=0.02)
    # The front of the eye faces +z, as glTF's front does.
    assert nodes["cornea"].bounds[1, 2] == 0 > nodes["iris"].bounds[1, 2] == pytest.approx(-3.6e-3)
    for name, mesh in nodes.items():
        corners = mesh.vertex_normals[mesh.faces]
        cosine = np.einsum("tcx,tx->tc", corners, mesh.face_normals)
        assert cosine.min() > 0.9, name
    for name in ("iris", "cornea", "sclera"):
        uv, half = nodes[name].visual.uv, 1e-3 * (11.5 if name == "sclera" else 5.5)
        assert uv.min() >= -1e-6 and uv.max() <= 1 + 1e-6
        np.testing.assert_allclose(uv, 0.5 + nodes[name].vertices[:, :2] / (2 * half), atol=1e-5)
    assert np.ptp(nodes["iris"].visual.uv, axis=0) == pytest.approx(1, abs=0.01)


def test_materials_follow_the_schemas():
    materials = {m["name"]: m for m in tree()["materials"]}
    used = set()
    for material in materials.values():
        for name, fields in material.get("extensions", {}).items():
            assert fields and all(SCHEMAS[name][field](value) for field, value in fields.items())
        used |= set(material.get("extensions", {}))
    assert sorted(used) == tree()["extensionsUsed"] == sorted(SCHEMAS)
    cornea = materials["cornea"]["extensions"]
    assert cornea["KHR_materials_ior"]["ior"] == pytest.approx(1.336)
    assert cornea["KHR_materials_transmission"]["transmissionFactor"] == 1
    volume = cornea["KHR_materials_volume"]
    assert volume["thicknessFactor"] == volume["attenuationDistance"] == pytest.approx(3.6e-3)
    assert volume["attenuationColor"] == pytest.approx([0.9, 0.8, 0.7])
    film = materials["tear_line"]["extensions"]["KHR_materials_ior"]["ior"]
    assert film == materials["sclera"]["extensions"]["KHR_materials_ior"]["ior"]
    assert film == pytest.approx(1.337)
    iris = materials["iris"]
    assert iris["pbrMetallicRoughness"]["metallicFactor"] == 0
    # The red channel of the roughness; the thickness, which the writer took for it, is elsewhere.
    occlusion = iris["occlusionTexture"]["index"]
    assert occlusion == iris["pbrMetallicRoughness"]["metallicRoughnessTexture"]["index"]
    volume = iris["extensions"]["KHR_materials_volume"]
    assert volume["thicknessTexture"]["index"] != occlusion
    thickest = iris["extensions"]["KHR_materials_volume"]["thicknessFactor"]
    abl = float(ij.Iris.of_level("low").abl_thickness)
    assert thickest == pytest.approx(1e-3 * (0.2 + 0.4 * (1 - 0.5 / 256) + abl))
    size = (1024, 1024)  # pixels at least as fine as 256 texels on 3.6 mm
    stored = [Image.open(io.BytesIO(made()[f"iris_{n}.png"])) for n in ("normal", "thickness")]
    found = loaded().geometry["iris"].visual.material
    assert [p.size for p in (found.baseColorTexture, found.normalTexture, *stored)] == [size] * 4
    assert all(tree()["samplers"][t["sampler"]]["wrapS"] == 33071 for t in tree()["textures"])


def test_textures_are_planar_and_the_right_way_round():
    """At vertices between pupil and root, read by hand from the file's own picture."""
    iris = loaded().geometry["iris"]
    picture = np.asarray(iris.visual.material.baseColorTexture)[..., :3] / 255
    depth = np.asarray(Image.open(io.BytesIO(made()["iris_thickness.png"])))[..., 1] / 255
    column, row = (
        (uv * 1024).astype(int) for uv in (iris.visual.uv[:, 0], 1 - iris.visual.uv[:, 1])
    )
    # Rings about a centre that moves from the pupil's to the axis: by their definition.
    x, y = 1e3 * iris.vertices[:, :2].T
    share = np.linspace(0, 1, 13)  # of 0.3 mm each
    assert len(x) % share.size == 0
    share = np.repeat(share, len(x) // share.size)
    away = (x - 0.2 * (1 - share)) + 1j * (y + 0.1 * (1 - share))
    np.testing.assert_allclose(abs(away), 1.9 + 3.6 * share, atol=1e-5)
    angle, radius = np.angle(away), share
    pick = (radius > 0.1) & (radius < 0.95)
    expected = np.stack(_colour(angle, radius), -1)[pick]
    np.testing.assert_allclose(srgb_decode(picture[row[pick], column[pick]]), expected, atol=0.02)
    abl = float(ij.Iris.of_level("low").abl_thickness)
    thick = (0.2 + 0.4 * radius[pick] + abl) / (0.6 + abl)
    np.testing.assert_allclose(depth[row[pick], column[pick]], thick, atol=0.01)
    assert (picture[505:519, 530:550] == 0).all()  # the pupil
    white = np.asarray(loaded().geometry["sclera"].visual.material.baseColorTexture)
    assert white[100, 900, 0] < white[900, 900, 0] == white[900, 100, 0]


def test_normals_and_roughness_of_a_rippled_plane():
    files = made()
    normal, rough = (
        np.asarray(Image.open(io.BytesIO(files[f"iris_{n}.png"]))) / 255
        for n in ("normal", "roughness")
    )
    x, y = np.meshgrid(*[(np.arange(1024) + 0.5) / 1024 * 11 - 5.5] * 2)
    ring = (np.hypot(x, y) > 2.2) & (np.hypot(x, y) < 5.2)
    mean = (2 * normal[ring] - 1).mean(0)
    np.testing.assert_allclose(mean[:2] / mean[2], [-0.05, 0], atol=0.004)
    # GGX's alpha is the square of roughness, alpha^2 twice the variance of the slopes along an
    # axis: together that of ripples along one.
    variance = (0.001 * 2 * np.pi / RIPPLE) ** 2 / 2
    assert RIPPLE < FOOTPRINT
    np.testing.assert_allclose((rough[ring][:, 1] ** 4).mean(), variance, rtol=0.1)
    assert (rough[..., 2] == 0).all()  # metallic
    assert (rough[ring][:, 0] > 0.99).all()  # next to nothing of the sky is hidden


def test_occlusion_is_what_an_upright_edge_hides_of_a_sky():
    """Directions of a hemisphere in proportion to their cosine, traced to a wall 2 mm high."""
    mesh = strip_meshes(EYE, 0.3)["occlusion"]
    rows = mesh.vertex_attributes["alpha"].reshape(2, 25, -1)
    alpha = rows[0, :, rows.shape[2] // 2]
    assert (rows[:, 0] == 0.5).all()
    darkest = mesh.vertices[mesh.vertex_attributes["alpha"] == 0.5]
    np.testing.assert_allclose(np.abs(darkest[:, 1]).max(), 5.3, atol=0.05)  # the lids' lines
    u, v = (np.arange(800) + 0.5)[None] / 800, (np.arange(400) + 0.5)[:, None] / 400
    sine, angle = np.sqrt(v), 2 * np.pi * u
    ahead = sine * np.cos(angle)
    for i in (4, 12, 24):
        distance = 0.25 * i
        with np.errstate(divide="ignore"):
            height = np.sqrt(1 - v) * distance / np.where(ahead > 0, ahead, np.nan)
        assert (height < 2.0).mean() == pytest.approx(alpha[i], abs=2e-3)


def test_tear_line_touches_the_eye_and_the_lids():
    mesh = strip_meshes(EYE, 0.3)["tear_line"]
    rows = mesh.vertices.reshape(2, 7, -1, 3)
    normal = mesh.vertex_normals.reshape(rows.shape)
    middle = rows.shape[2] // 2
    for lid, height in enumerate((4.3, -5.3)):
        edge, foot = rows[lid, 0, middle], rows[lid, -1, middle]
        # Both ends lie on a circle, one on the eye and one on the lid.
        centre = foot + 0.25 * normal[lid, -1, middle]
        np.testing.assert_allclose(np.linalg.norm(edge - centre), 0.25, rtol=1e-6)
        assert abs(foot[1]) < abs(edge[1]) and edge[1] == pytest.approx(height, abs=0.2)


def test_limbus_blends_as_pictures_do():
    """Shares of white by the distance from the limbus: a strip within it, a texture beyond."""
    strip = strip_meshes(EYE, 0.3)["limbus"]
    away = np.hypot(*strip.vertices[:, :2].T) - 5.5
    assert away.min() == pytest.approx(-0.5, abs=0.02) and away.max() < 0.03  # lifted off the eye
    share = np.clip(0.5 + away, 0, 1)
    expected = share**2 * (3 - 2 * share)
    np.testing.assert_allclose(strip.vertex_attributes["alpha"], expected, atol=0.04)
    materials = {m["name"]: m for m in tree()["materials"]}
    blended = {name for name, m in materials.items() if m.get("alphaMode") == "BLEND"}
    assert blended == {"limbus", "occlusion"}
    found = {n: m["pbrMetallicRoughness"].get("baseColorFactor") for n, m in materials.items()}
    assert found["limbus"] == pytest.approx([0.6, 0.6, 0.6, 1])  # the mean of the white
    assert found["pupil"] == found["occlusion"] == [0, 0, 0, 1]
    white = np.asarray(loaded().geometry["sclera"].visual.material.baseColorTexture)
    root = np.array([0.5, 0.5, 0.8]) * [0.81, 0.64, 0.49]
    for column in (260, 255, 250, 240):  # to the left of the middle, where the white is 0.7
        away = (511.5 - column) * 23 / 1024 - 5.5
        share = min(max(0.5 + away, 0), 1)
        share = share**2 * (3 - 2 * share)
        expected = share * 0.7 + (1 - share) * root
        np.testing.assert_allclose(srgb_decode(white[512, column, :3] / 255), expected, atol=5e-3)


def test_no_lids_without_a_white():
    assert strip_meshes(EYE.replace(sclera=None)) == {}
