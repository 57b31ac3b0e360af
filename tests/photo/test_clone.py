"""Stages of a clone: the texture, its thickness against the truth, and a second photograph."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from experiments.clone_truth import correlation, true_thickness
from irisjax.photo import clone as cloning
from irisjax.photo.clone import (
    CloneSettings,
    Given,
    clone_eye,
    outline_eye,
    pose_eye,
    tint_of_white,
    with_visible_thickness,
)
from irisjax.photo.masks import cut_part, find_mirrored_face
from irisjax.photo.photograph import Photograph
from irisjax.photo.pigments import FREE_NAMES, PigmentFit
from irisjax.photo.texture import follow_refraction, unrefract
from irisjax.photo.thickness import shape_maps
from irisjax.render.lights import Lights
from irisjax.render.picture import surroundings, texture
from irisjax.render.project import trace_tear_film
from irisjax.render.scene import Scene
from irisjax.tissue.iris import Iris
from photo.simulated import photographed, with_highlight

NAME, SCALE = "green_tilted.jpg", 1 / 4
SETTINGS = CloneSettings(focal_px=22569.4 * SCALE)


@pytest.fixture(scope="module")
def first():
    """A photograph and its outlines."""
    return photographed(NAME, SCALE)


def posed_from(photo, eye, settings=SETTINGS, **given):
    """Camera and visible parts, with the true outlines."""
    known = Given(eye.limbus, eye.pupil, **given)
    return pose_eye(outline_eye(photo, known), settings, known)


@pytest.fixture(scope="module")
def posed(first):
    return posed_from(first.photograph(), first)


def flat(posed):
    """Laid flat on fewer texels than a clone has."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cloning, "follow_refraction", partial(follow_refraction, size=256))
        return cloning.flatten_iris(posed)


@pytest.fixture(scope="module")
def alone(posed):
    return flat(posed)


def test_the_mirrored_face_is_masked(first, posed):
    """An eye that is turned mirrors the face beside it: where the rim is brighter by a third than
    without a face, it is masked. An eye that looks into the camera mirrors no face.
    """
    found = posed_from(photographed(NAME.replace(".", "_dirty."), SCALE).photograph(), first)
    outside = np.zeros(found.clear.shape, bool)
    masked = find_mirrored_face(found.part, outside, found.limbus, found.view.mirror)
    rows, columns = found.clear.shape
    row, column = np.ogrid[:rows, :columns]
    iris = found.limbus.relative_radius(column, row) < 0.97
    iris &= found.pupil.relative_radius(column, row) > 1.1
    bare = 1.2 * posed.part[..., 0]
    excess = ndimage.gaussian_filter(found.part[..., 0] - bare, 1.0)
    changed = iris & (excess > 0.33 * bare) & (np.abs(row - rows / 2) < 0.2 * rows)
    assert changed.sum() > 1000 * SCALE**2
    assert masked[changed].mean() > 0.95
    assert masked[iris].mean() < 0.1
    assert not found.clear[masked].any()
    index, ahead = found.view.mirror.index, replace(found.pose.camera, polar=jnp.zeros(()))
    mirror = trace_tear_film(jnp.maximum(index, 0), found.pose.eye, ahead)
    mirror = replace(mirror, index=index)
    assert not find_mirrored_face(found.part, outside, found.limbus, mirror).any()


def test_a_pupil_fades_about_its_outline_as_wide_as_the_photograph_is_blurred(posed):
    """From the outline on, a pixel of the iris was too dark all the way round."""
    pose, pixel = posed.pose, float(posed.pose.camera.width) / posed.pose.camera.size[0]
    for margin in (0.0, 0.2):
        eye = cloning._with_soft_edges(pose, posed.boundaries._replace(pupil_margin=margin))
        outline = float(pose.eye.pupil_radius)
        wide, middle = float(eye.pupil_margin), float(eye.pupil_radius + eye.pupil_margin / 2)
        assert wide == pytest.approx(np.hypot(margin * outline, 3 * pixel), rel=1e-5)
        assert middle == pytest.approx(outline * (1 + margin / 2), rel=1e-5)


def test_of_two_irides_the_one_with_visible_fibres_is_taken():
    """If it is about as probable; where thickness shows in none, the more probable one."""
    low = {name: 1.0 for name in FREE_NAMES}
    known = np.zeros(len(FREE_NAMES)), np.eye(len(FREE_NAMES)), np.zeros(3), 1, True
    opaque, clear = (
        PigmentFit(low | {"scattering_scale": scale}, *known, log_density=density)
        for scale, density in ((50.0, 10.0), (0.2, 9.0))
    )

    def taken(density):
        fit = opaque._replace(others=(clear._replace(log_density=density),))
        return with_visible_thickness(fit, lambda iris: 3 / float(iris.scattering_scale), Iris())

    assert taken(9.0).values == clear.values and taken(9.0).others[0].values == opaque.values
    assert taken(7.0).values == opaque.values
    both = opaque._replace(others=(clear,))
    assert with_visible_thickness(both, lambda iris: 0.0, Iris()).values == opaque.values


def test_the_tint_of_a_white_comes_back(posed):
    """From a picture of it, across the wavelengths of its channels."""
    lights = Lights.distant(0.4, 1.0)
    scene = Scene(Iris(), eye=posed.pose.eye, lights=lights, camera=posed.pose.camera)
    tinted = replace(scene.eye.sclera, tint=np.array([0.3, 0.25, 0.2]))
    shown = scene.replace(eye=scene.eye.replace(sclera=tinted))
    picture = surroundings(posed.view, texture(posed.view, shown), shown)
    picture = np.asarray(picture).T.reshape(posed.part.shape)
    found = tint_of_white(posed.white.pixels, picture, posed.view, scene)
    np.testing.assert_allclose(found, tinted.tint, rtol=2e-3)
    # A white that hardly any light of the scene reaches gets no tint beyond what an eye may have.
    assert tint_of_white(posed.white.pixels, 1e6 * picture, posed.view, scene).max() == 10


def test_a_flat_picture_is_not_unrefracted(first, posed):
    """Its pupil is as large as it appears, and nothing is mirrored; a cornea magnifies by 1.13."""
    found = posed_from(first.photograph(), first, CloneSettings(media="flat"))
    limbus, pupil = (np.prod(e.semi_axes) for e in found.boundaries[:2])
    radius = float(found.pose.eye.limbus_radius) * np.sqrt(pupil / limbus)
    assert found.pose.pupil_radius == pytest.approx(radius, rel=0.01)
    assert found.view.mirror is None
    assert posed.pose.pupil_radius < 0.93 * radius


def test_thickness_of_a_photographed_iris_comes_back(alone):
    """The paper's method is better than the generic iris, and the model's than the paper's."""
    truth, shaped = true_thickness("green", alone.texture), cloning.shape_iris(alone, SETTINGS)

    def score(**options):
        made = partial(shape_maps, alone.texture, shaped.freckles, **options)
        return correlation(replace(shaped, estimate=made), truth.thickness, truth.used)[0]

    paper, ours = score(), score(response=0.6, sigma_mm=0.0)
    assert 0 < paper < ours
    assert ours > 0.8


def test_texture_under_a_highlight_is_the_seconds(first, alone):
    burnt = with_highlight(first, -0.476, 0.476, 0.08)
    # Another camera: turned by four degrees and a tenth smaller, a little darker.
    turned = ndimage.rotate(first.pixels, 4.0, reshape=False, order=1, mode="nearest")
    turned = ndimage.zoom(turned, (0.9, 0.9, 1), order=1)
    second = Photograph(0.8 * turned, (turned > 0.99).any(-1), name="second")
    found = flat(posed_from(burnt.photograph(), first, second=second))
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
    part = cut_part(burnt.photograph(), first.limbus).pixels[y : y + rows, x : x + columns]
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
