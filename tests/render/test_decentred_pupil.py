"""A pupil beside the axis: where its maps lie, and scene files; grow/test_pupil.py has the rest."""

import jax.numpy as jnp
import numpy as np
import pytest

from irisjax.anatomy.eye import Eye
from irisjax.io.scenes import parse_scene
from irisjax.render.project import IrisPixels
from irisjax.render.shading import facing_at, relief_field

CENTRE = np.array([-0.35, 0.2])
EYE = Eye(cornea=None, sclera=None, pupil_radius=1.5, pupil_centre=CENTRE)
ROOT = 5.5


def on_ring(angle, share):
    """The definition: circles from the pupil's to the root's, in proportion."""
    radius = 1.5 + share * (ROOT - 1.5)
    return (1 - share) * CENTRE[:, None] + radius * np.stack([np.cos(angle), np.sin(angle)])


def test_rings_lie_between_pupil_and_root():
    rng = np.random.default_rng(2)
    angle, share = rng.uniform(-np.pi, np.pi, 50), rng.uniform(0, 1, 50)
    point = on_ring(angle, share)
    found, x, y = (np.asarray(v) for v in EYE.ring_of(*point))
    np.testing.assert_allclose(found, share, atol=2e-6)
    np.testing.assert_allclose(np.exp(1j * np.arctan2(y, x)), np.exp(1j * angle), atol=2e-6)
    bare = EYE.replace(pupil_centre=None)
    onto = np.asarray(EYE.replace(pupil_centre=np.zeros(2)).ring_of(*point)[0])
    np.testing.assert_allclose(onto, np.asarray(bare.ring_of(*point)[0]), atol=2e-6)


def test_relief_tilts_by_the_slope_of_its_surface():
    """Of a height that is a plain function of x and y: its normals are known."""
    angles, radii = 256, 64
    angle = (np.arange(angles) + 0.5) * (2 * np.pi / angles)
    share = np.broadcast_to((np.arange(radii) + 0.5) / radii, (angles, radii)).ravel()
    x, y = on_ring(np.repeat(angle, radii), share)
    height = 0.1 * np.sin(0.8 * x + 0.5 * y)
    relief = relief_field(jnp.asarray(height.reshape(angles, radii)), EYE)
    rng = np.random.default_rng(3)
    u, v = on_ring(rng.uniform(-np.pi, np.pi, 40), rng.uniform(0.15, 0.85, 40))
    point = tuple(map(jnp.asarray, (u, v, np.full(40, 3.6))))
    ones = jnp.ones(40)
    pixels = IrisPixels(None, point, point, ones, ones)
    normal, _ = facing_at(pixels, EYE, relief)
    found = np.stack([np.asarray(c) for c in normal], -1)
    steep = 0.1 * np.cos(0.8 * u + 0.5 * v)
    # Towards the cornea is −z: the surface is z = −height.
    expected = np.stack([-0.8 * steep, -0.5 * steep, -np.ones(40)], -1)
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    np.testing.assert_allclose(found, expected, atol=2e-4)


def test_scene_files_place_it_and_refuse_what_is_no_eye():
    text = "[eye]\npupil_centre = [0.1, -0.2]\nsclera = false\n[maps]\nuniform = true\n"
    np.testing.assert_allclose(parse_scene(text).scene().eye.pupil_centre, [0.1, -0.2])
    with pytest.raises(ValueError, match=r"eye\.pupil_centre = .* must be"):
        parse_scene("[eye]\npupil_centre = [3.0, 0.0]\n")
    with pytest.raises(ValueError, match=r"root of the iris; it must be below 0\.75 mm"):
        EYE.replace(pupil_radius=4.75, pupil_centre=np.array([0.8, 0.2]))
    with pytest.raises(ValueError, match="need x and y"):
        EYE.replace(pupil_centre=np.zeros(3))
