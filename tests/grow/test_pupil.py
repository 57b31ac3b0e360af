"""A pupil beside the axis, and an irregular one: its edge, where maps lie and tissue ends, its
hand-over, and scene files.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from irisjax.anatomy.eye import Eye
from irisjax.export.mesh import eye_meshes
from irisjax.grow.pupil import irregular_pupil
from irisjax.io.scenes import parse_scene, scene_text
from irisjax.render.camera import Camera
from irisjax.render.project import IrisPixels, project_visible
from irisjax.render.shading import camera_share, facing_at, relief_field

CENTRE = np.array([-0.3, 0.1])
HARMONICS = np.array([[0.02, -0.01], [0.0, 0.015]])
BARE = Eye(cornea=None, sclera=None, pupil_radius=1.5, pupil_centre=CENTRE)
EYE = BARE.replace(pupil_harmonics=HARMONICS)


def edge(angle):
    """The definition."""
    (a, b), (c, d) = HARMONICS
    off = a * np.cos(2 * angle) + b * np.sin(2 * angle) + c * np.cos(3 * angle)
    return 1.5 * (1 + off + d * np.sin(3 * angle))


def on_ring(angle, share, edge=edge):
    """The definition: curves from the pupil's edge to the root's circle, in proportion."""
    radius = (1 - share) * edge(angle) + share * 5.5
    return (1 - share) * CENTRE[:, None] + radius * np.stack([np.cos(angle), np.sin(angle)])


edge_of, ring_of, share_of, tilted = map(
    eqx.filter_jit, (Eye.pupil_edge, Eye.ring_of, camera_share, facing_at)
)


def test_grown_edges_deviate_by_what_is_asked_for():
    angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    found = irregular_pupil(0.015, key=jax.random.key(2))
    radius = np.asarray(edge_of(Eye(pupil_harmonics=found), np.cos(angle), np.sin(angle)))
    np.testing.assert_allclose([radius.mean(), radius.std() / 1.9], [1.9, 0.015], rtol=1e-5)
    np.testing.assert_array_equal(found, irregular_pupil(0.015, key=jax.random.key(2)))
    with pytest.raises(ValueError, match=r"irregularity = 0\.2 is outside"):
        irregular_pupil(0.2, key=jax.random.key(2))


def test_tissue_ends_at_the_edge():
    view = project_visible(EYE, Camera(width=12.0, size=(96, 96)))
    x, y = (np.asarray(v) for v in view.iris.point[:2])
    share = np.asarray(share_of(view.iris, EYE)) / np.asarray(view.iris.share)
    away = np.hypot(x - CENTRE[0], y - CENTRE[1])
    beyond = away - edge(np.arctan2(y - CENTRE[1], x - CENTRE[0]))
    known = (np.asarray(view.iris.share) > 0) & (np.asarray(view.iris.index) >= 0)
    assert (share[known & (beyond < -1e-6)] == 0).all()
    assert (share[known & (beyond > float(EYE.pupil_margin))] == 1).all()
    mixed = (np.asarray(share_of(view.iris, BARE)) > 0) != (share > 0)
    assert (mixed & known).any()  # the round pupil ends elsewhere


def test_mesh_has_the_edge_and_rings_between_it_and_the_root():
    mesh = eye_meshes(EYE, 0.5)["iris"]
    x, y, _ = np.asarray(mesh.vertices).T
    turn, share = (mesh.vertex_attributes[axis] for axis in "uv")
    np.testing.assert_allclose(np.stack([x, y]), on_ring(2 * np.pi * turn, share), atol=1e-6)


def test_rings_lie_between_pupil_and_root():
    rng = np.random.default_rng(2)
    angle, share = rng.uniform(-np.pi, np.pi, 50), rng.uniform(0, 1, 50)
    point = on_ring(angle, share, lambda _: 1.5)
    ends = (EYE, edge, 0 * share), (EYE, edge, 0 * share + 1)
    for eye, inner, shares in ((BARE, lambda _: 1.5, share), *ends):
        found, x, y = (np.asarray(v) for v in ring_of(eye, *on_ring(angle, shares, inner)))
        np.testing.assert_allclose(found, shares, atol=2e-6)
        np.testing.assert_allclose(np.exp(1j * np.arctan2(y, x)), np.exp(1j * angle), atol=2e-6)
    bare = BARE.replace(pupil_centre=None)
    one, other = (ring_of(eye, *point)[0] for eye in (BARE.replace(pupil_centre=np.zeros(2)), bare))
    np.testing.assert_allclose(one, other, atol=2e-6)
    assert BARE.pupil_edge(1.0, 2.0) is BARE.pupil_radius  # a round one costs nothing


def test_relief_tilts_by_the_slope_of_its_surface():
    """The height is a plain function of x and y, whose normals are known."""
    angles, radii = 256, 64
    angle = (np.arange(angles) + 0.5) * (2 * np.pi / angles)
    share = np.broadcast_to((np.arange(radii) + 0.5) / radii, (angles, radii)).ravel()
    x, y = on_ring(np.repeat(angle, radii), share, lambda _: 1.5)
    height = 0.1 * np.sin(0.8 * x + 0.5 * y)
    relief = relief_field(jnp.asarray(height.reshape(angles, radii)), BARE)
    rng = np.random.default_rng(3)
    u, v = on_ring(rng.uniform(-np.pi, np.pi, 40), rng.uniform(0.15, 0.85, 40), lambda _: 1.5)
    point, ones = tuple(map(jnp.asarray, (u, v, np.full(40, 3.6)))), jnp.ones(40)
    normal, _ = tilted(IrisPixels(None, point, point, ones, ones), BARE, relief)
    steep = 0.1 * np.cos(0.8 * u + 0.5 * v)
    # Towards the cornea is −z: the surface is z = −height.
    expected = np.stack([-0.8 * steep, -0.5 * steep, -np.ones(40)])
    expected /= np.linalg.norm(expected, axis=0)
    np.testing.assert_allclose(np.stack(normal), expected, atol=2e-4)


def test_scene_files_grow_or_state_it():
    text = "[eye]\n{}\nsclera = false\n[maps]\nuniform = true\n"
    grown = parse_scene(text.format("pupil_irregularity = 0.01")).scene()
    assert np.asarray(grown.eye.pupil_harmonics).shape == (6, 2)
    again = parse_scene(scene_text(grown)).scene()
    np.testing.assert_allclose(again.eye.pupil_harmonics, grown.eye.pupil_harmonics, rtol=1e-6)
    assert parse_scene(text.format("pupil_irregularity = 0")).scene().eye.pupil_harmonics is None
    for wrong, said in (
        ("pupil_irregularity = 0.2", r"eye\.pupil_irregularity = .* a number in \[0, 0\.03"),
        ("pupil_centre = [3.0, 0.0]", r"eye\.pupil_centre = .* must be"),
        ("pupil_harmonics = [[0.01]]", r"eye\.pupil_harmonics = .* must be pairs \[cosine, sine\]"),
        ("pupil_harmonics = [[0.2, 0]]", r"eye\.pupil_harmonics = .* must be a number in \[-0\.05"),
        ("pupil_irregularity = 0.01\npupil_harmonics = [[0.01, 0]]", "not both"),
    ):
        with pytest.raises(ValueError, match=said):
            parse_scene(text.format(wrong)).scene()
    shown = parse_scene(text.format("pupil_centre = [0.1, -0.2]")).scene().eye
    np.testing.assert_allclose(shown.pupil_centre, [0.1, -0.2])


def test_what_is_no_pupil():
    with pytest.raises(ValueError, match=r"root of the iris; it must be below 0\.75 mm"):
        BARE.replace(pupil_radius=4.75, pupil_centre=np.array([0.8, 0.2]))
    with pytest.raises(ValueError, match="need x and y"):
        BARE.replace(pupil_centre=np.zeros(3))
