"""Stages of a clone: the texture, its thickness against the truth, and a second photograph."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import rotate, zoom

from experiments.clone_truth import correlation, true_thickness
from irisjax.io.photographs import read_photograph
from irisjax.photo import clone as cloning
from irisjax.photo.clone import (
    CloneSettings,
    Given,
    clone_eye,
    outline_eye,
    pose_eye,
    tint_of_white,
)
from irisjax.photo.edges import reduce_picture
from irisjax.photo.masks import cut_part, find_mirrored_face
from irisjax.photo.photograph import Photograph
from irisjax.photo.texture import follow_refraction, unrefract
from irisjax.photo.thickness import shape_maps
from irisjax.render.lights import Lights
from irisjax.render.picture import draw
from irisjax.render.scene import Scene
from irisjax.tissue.iris import Iris

PHOTOGRAPHS = Path(__file__).parent.parent.parent / "data" / "photographs"
SETTINGS = CloneSettings()


@pytest.fixture(scope="module")
def first():
    """A photograph at a quarter of its size."""
    found = read_photograph(PHOTOGRAPHS / "blue.jpg")
    cut_off = reduce_picture(found.saturated[..., None].astype(float), 0.25)[..., 0] > 0
    return found._replace(pixels=reduce_picture(found.pixels, 0.25), saturated=cut_off)


@pytest.fixture(scope="module")
def outlined(first):
    return outline_eye(first)


@pytest.fixture(scope="module")
def posed(outlined):
    return pose_eye(outlined, SETTINGS)


def flat(posed):
    """Laid flat on fewer texels than a clone has."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cloning, "follow_refraction", partial(follow_refraction, size=256))
        return cloning.flatten_iris(posed)


@pytest.fixture(scope="module")
def alone(posed):
    return flat(posed)


def test_a_frontal_eye_mirrors_no_face(first, posed):
    x, y = posed.pose.corner
    limbus = cut_part(first, posed.boundaries.limbus).limbus.moved(-x, -y)
    outside = np.zeros(posed.clear.shape, bool)
    assert not find_mirrored_face(posed.part, outside, limbus, posed.view.mirror).any()


def test_a_pupil_fades_about_its_outline_as_wide_as_the_photograph_is_blurred(posed):
    """From the outline on, a pixel of the iris was too dark all the way round."""
    pose, pixel = posed.pose, float(posed.pose.camera.width) / posed.pose.camera.size[0]
    for margin in (0.0, 0.2):
        eye = cloning._with_soft_edges(pose, posed.boundaries._replace(pupil_margin=margin))
        outline = float(pose.eye.pupil_radius)
        wide, middle = float(eye.pupil_margin), float(eye.pupil_radius + eye.pupil_margin / 2)
        assert wide == pytest.approx(np.hypot(margin * outline, 3 * pixel), rel=1e-5)
        assert middle == pytest.approx(outline * (1 + margin / 2), rel=1e-5)


def test_the_tint_of_a_white_comes_back(posed):
    """From a picture of it, across the wavelengths of its channels."""
    scene = Scene(
        Iris(), eye=posed.pose.eye, lights=Lights.distant(0.4, 1.0), camera=posed.pose.camera
    )
    tinted = replace(scene.eye.sclera, tint=np.array([0.3, 0.25, 0.2]))
    picture = np.asarray(draw(scene.replace(eye=scene.eye.replace(sclera=tinted))))
    found = tint_of_white(posed.white.pixels, picture, posed.view, scene)
    np.testing.assert_allclose(found, tinted.tint, rtol=2e-3)
    # A white that hardly any light of the scene reaches gets no tint beyond what an eye may have.
    assert tint_of_white(posed.white.pixels, 1e6 * picture, posed.view, scene).max() == 10


def test_a_flat_picture_is_not_unrefracted(outlined, posed):
    """Its pupil is as large as it appears, and nothing is mirrored; a cornea magnifies by 1.13."""
    found = pose_eye(outlined, CloneSettings(media="flat"))
    limbus, pupil = (np.prod(e.semi_axes) for e in found.boundaries[:2])
    radius = float(found.pose.eye.limbus_radius) * np.sqrt(pupil / limbus)
    assert found.pose.pupil_radius == pytest.approx(radius, rel=0.01)
    assert found.view.mirror is None
    assert posed.pose.pupil_radius < 0.93 * radius


def test_thickness_of_a_photographed_iris_comes_back(alone):
    """The paper's method is better than the generic iris, and the model's than the paper's."""
    truth, shaped = true_thickness("blue", alone.texture), cloning.shape_iris(alone, SETTINGS)

    def score(**options):
        made = partial(shape_maps, alone.texture, shaped.freckles, **options)
        return correlation(replace(shaped, estimate=made), truth.thickness, truth.used)[0]

    paper, ours = score(), score(response=0.6, sigma_mm=0.0)
    assert 0 < paper < ours
    assert ours > 0.8


def test_texture_under_a_highlight_is_the_seconds(first, alone):
    limbus, pupil = alone.boundaries.limbus, alone.boundaries.pupil
    (x, y), radius = limbus.centre, limbus.semi_axes[0]
    row, column = np.indices(first.shape)
    disc = np.hypot(row - y - 0.476 * radius, column - x + 0.476 * radius) < 0.08 * radius
    pixels = np.where(disc[..., None], np.float32(1), first.pixels)
    burnt = first._replace(pixels=pixels, saturated=first.saturated | disc)
    # Another camera: turned by four degrees and a tenth smaller, a little darker.
    turned = rotate(first.pixels, 4.0, reshape=False, order=1, mode="nearest")
    turned = zoom(turned, (0.9, 0.9, 1), order=1)
    second = Photograph(0.8 * turned, (turned > 0.99).any(-1), name="second")
    given = Given(limbus=limbus, pupil=pupil, second=second)
    found = flat(pose_eye(outline_eye(burnt, given), SETTINGS, given))
    without = unrefract(found.part, found.clear, found.pose, found.refraction)
    hidden = alone.texture.valid & ~without.valid
    assert hidden.sum() > 250
    assert found.texture.valid[hidden].mean() > 0.95
    laid = found.second.registration
    assert laid.correlation > 0.9 and laid.residual < 0.5
    assert laid.scale == pytest.approx(0.9, rel=0.005)
    seen, true = (t.texture.luminance()[hidden] for t in (found, alone))
    assert np.corrcoef(seen, true)[0, 1] > 0.95
    # Pigments come from the first: its pixels are left as they are.
    (x, y), (rows, columns) = found.pose.corner, found.clear.shape
    part = cut_part(burnt, limbus).pixels[y : y + rows, x : x + columns]
    np.testing.assert_array_equal(found.part, part)


@pytest.mark.parametrize("best", [0.07, 2.0])
def test_the_width_with_the_nearest_rendering_is_found(monkeypatch, best):
    def compared(width):
        return SimpleNamespace(rms=0.01 + 0.002 * np.full(3, np.log(width / best) ** 2))

    monkeypatch.setattr(cloning, "compare_with_photograph", compared)
    assert cloning.width_by_rendering(lambda width: width) == pytest.approx(best, rel=0.1)


@pytest.mark.parametrize(
    ("settings", "last", "message"),
    [
        (CloneSettings(media="water"), "pose", "unknown media 'water'; known: cornea-aqueous, f09"),
        (CloneSettings(method="luck"), "pose", "unknown method 'luck'; known: least-squares"),
        (SETTINGS, "lunch", "unknown stage 'lunch'; known: outlines, pose, texture"),
    ],
)
def test_unknown_names_are_refused(settings, last, message):
    empty = Photograph(np.zeros((8, 8, 3)), np.zeros((8, 8), bool))
    with pytest.raises(ValueError, match=message):
        next(clone_eye(empty, settings, last=last))
