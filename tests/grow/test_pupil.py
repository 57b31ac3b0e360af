"""An irregular pupil: its edge, where tissue ends, its hand-over, and scene files."""

import equinox as eqx
import jax
import numpy as np
import pytest

from irisjax.anatomy.eye import Eye
from irisjax.export.mesh import eye_meshes
from irisjax.grow.pupil import irregular_pupil
from irisjax.io.scenes import parse_scene, scene_text
from irisjax.render.camera import Camera
from irisjax.render.project import project_visible
from irisjax.render.shading import camera_share

CENTRE = np.array([-0.3, 0.1])
HARMONICS = np.array([[0.02, -0.01], [0.0, 0.015]])
BARE = Eye(cornea=None, sclera=None, pupil_radius=1.5, pupil_centre=CENTRE)
EYE = BARE.replace(pupil_harmonics=HARMONICS)


def edge(angle):
    """The definition."""
    (a, b), (c, d) = HARMONICS
    off = a * np.cos(2 * angle) + b * np.sin(2 * angle) + c * np.cos(3 * angle)
    return 1.5 * (1 + off + d * np.sin(3 * angle))


@eqx.filter_jit
def edge_of(eye, x, y):
    return eye.pupil_edge(x, y)


@eqx.filter_jit
def ring_of(eye, x, y):
    return eye.ring_of(x, y)


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
    share = np.asarray(camera_share(view.iris, EYE)) / np.asarray(view.iris.share)
    away = np.hypot(x - CENTRE[0], y - CENTRE[1])
    beyond = away - edge(np.arctan2(y - CENTRE[1], x - CENTRE[0]))
    known = (np.asarray(view.iris.share) > 0) & (np.asarray(view.iris.index) >= 0)
    assert (share[known & (beyond < -1e-6)] == 0).all()
    assert (share[known & (beyond > float(EYE.pupil_margin))] == 1).all()
    mixed = (np.asarray(camera_share(view.iris, BARE)) > 0) != (share > 0)
    assert (mixed & known).any()  # the round pupil ends elsewhere


def test_maps_begin_at_the_edge():
    angle = np.linspace(-3, 3, 40)
    way = np.stack([np.cos(angle), np.sin(angle)])
    ring, x, y = ring_of(EYE, *(CENTRE[:, None] + edge(angle) * way))
    np.testing.assert_allclose(ring, 0, atol=2e-6)
    np.testing.assert_allclose(np.arctan2(y, x), angle, atol=2e-6)
    np.testing.assert_allclose(ring_of(EYE, *(5.5 * way))[0], 1, atol=2e-6)
    assert BARE.pupil_edge(1.0, 2.0) is BARE.pupil_radius  # a round one costs nothing


def test_mesh_has_the_edge_and_rings_between_it_and_the_root():
    mesh = eye_meshes(EYE, 0.5)["iris"]
    x, y, _ = np.asarray(mesh.vertices).T
    angle, share = 2 * np.pi * mesh.vertex_attributes["u"], mesh.vertex_attributes["v"]
    radius = (1 - share) * edge(angle) + share * 5.5
    expected = (1 - share) * CENTRE[:, None] + radius * np.stack([np.cos(angle), np.sin(angle)])
    np.testing.assert_allclose(np.stack([x, y]), expected, atol=1e-6)


def test_scene_files_grow_or_state_it():
    text = "[eye]\n{}\nsclera = false\n[maps]\nuniform = true\n"
    grown = parse_scene(text.format("pupil_irregularity = 0.01")).scene()
    assert np.asarray(grown.eye.pupil_harmonics).shape == (6, 2)
    again = parse_scene(scene_text(grown)).scene()
    np.testing.assert_allclose(again.eye.pupil_harmonics, grown.eye.pupil_harmonics, rtol=1e-6)
    assert parse_scene(text.format("pupil_irregularity = 0")).scene().eye.pupil_harmonics is None
    for wrong, said in (
        (
            "pupil_irregularity = 0.2",
            r"eye\.pupil_irregularity = .* must be a number in \[0, 0\.03",
        ),
        ("pupil_harmonics = [[0.01]]", r"eye\.pupil_harmonics = .* must be pairs \[cosine, sine\]"),
        ("pupil_harmonics = [[0.2, 0]]", r"eye\.pupil_harmonics = .* must be a number in \[-0\.05"),
        ("pupil_irregularity = 0.01\npupil_harmonics = [[0.01, 0]]", "not both"),
    ):
        with pytest.raises(ValueError, match=said):
            parse_scene(text.format(wrong)).scene()
