"""The simulated photographs that come with the project say the truth about themselves."""

import math

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from irisjax.anatomy.eye import Eye
from irisjax.io.scenes import read_scene
from irisjax.photo.masks import cut_part
from irisjax.photo.outlines import MIN_CONFIDENCE, find_boundaries
from irisjax.photo.pose import find_pose
from irisjax.photo.texture import LUMINANCE_WEIGHTS, masked_mean
from photo.simulated import FOLDER, outline, reduced, truths

TRUTH = truths(FOLDER)
CLEAN = [t for t in TRUTH if not t["dirty"]]
SCALE = 0.3
MASKED = "brown_dirty.jpg", "green_tilted_dirty.jpg"


def by_file(truths):
    return pytest.mark.parametrize("truth", truths, ids=[t["file"] for t in truths])


def test_every_picture_has_its_truth():
    assert {t["file"] for t in TRUTH} == {p.name for p in FOLDER.glob("*.jpg")}
    assert (len(TRUTH), len(CLEAN)) == (12, 6)


@by_file(TRUTH)
def test_file(truth):
    path = FOLDER / truth["file"]
    assert path.stat().st_size < 400_000
    with Image.open(path) as image:
        assert list(image.size) == truth["size_px"]
        of_camera = image.getexif().get_ifd(0x8769)
    camera = truth["camera"]
    focal = camera["focal_px"]
    assert focal == pytest.approx(camera["distance"] * truth["size_px"][0] / camera["width"])
    # FocalLengthIn35mmFilm by the diagonal, and FocalLength with pixels per centimetre.
    diagonal = np.hypot(*truth["size_px"])
    assert of_camera[0xA405] * diagonal / 43.27 == pytest.approx(focal, rel=1e-3)
    assert float(of_camera[0x920A]) * float(of_camera[0xA20E]) / 10 == pytest.approx(focal, 1e-4)


@by_file(CLEAN)
@pytest.mark.parametrize("name", ["limbus", "pupil"])
def test_edges_lie_on_the_outlines(truth, name):
    """Dark inside, bright outside, 3 pixels to either side (of the pupil's edge where no highlight
    is near).
    """
    ellipse, along = outline(truth, name), np.linspace(0, 2 * math.pi, 720, endpoint=False)
    with Image.open(FOLDER / truth["file"]) as image:
        picture = np.asarray(image.convert("L"), float)
    sizes = (np.add(ellipse.semi_axes, pixels) for pixels in (-3, 3))
    points = (
        np.round(ellipse._replace(semi_axes=tuple(s)).points(along)).astype(int) for s in sizes
    )
    inside, outside = (picture[row, column] for column, row in (p.T for p in points))
    middle = (np.median(inside) + np.median(outside)) / 2
    # Iris in the shadow of the limbus is hardly brighter than the pupil.
    assert (inside < middle).mean() > 0.97
    assert (outside > middle).mean() > 0.97


def test_outlines_are_found_to_a_hundredth_of_their_radius_and_the_tilt_to_2_degrees():
    truth = next(t for t in TRUTH if t["file"] == "blue_tilted_dirty.jpg")
    photo = reduced(FOLDER / truth["file"], SCALE)
    found = find_boundaries(photo)
    along = np.linspace(0, 2 * math.pi, 90)
    for seen, name in zip(found[:2], ("limbus", "pupil"), strict=True):
        off = outline(truth, name, SCALE).relative_radius(*seen.points(along).T) - 1
        assert abs(off).max() < 0.01
    assert min(found[2:4]) > MIN_CONFIDENCE
    camera = truth["camera"]
    pose = find_pose(found.limbus, found.pupil, Eye(), focal_px=photo.focal_px)
    off = pose.tilt * np.exp(1j * float(pose.camera.azimuth))
    off -= camera["polar"] * np.exp(1j * camera["azimuth"])
    assert math.degrees(abs(off)) < 2


@by_file(CLEAN)
def test_scene(truth):
    """The scene file is of the same eye, camera and lamp."""
    scene = read_scene(FOLDER / truth["scene"]).scene()
    assert scene.iris.parameters() == pytest.approx(truth["iris"], rel=1e-6)
    for name in ("polar", "azimuth", "distance", "width"):
        assert float(getattr(scene.camera, name)) == pytest.approx(truth["camera"][name], abs=1e-6)
    for name, value in truth["eye"].items():
        assert float(getattr(scene.eye, name)) == pytest.approx(value)
    assert float(scene.lights.irradiance[0]) == pytest.approx(truth["lamp"]["irradiance"])
    whole = scene.iris.abl_thickness + scene.iris.stroma_thickness
    for pigment in ("eumelanin", "pheomelanin"):
        layers = (("abl", scene.iris.abl_thickness), ("stroma", scene.iris.stroma_thickness))
        mass = sum(truth["concentrations"][f"{pigment}_{n}"] * float(depth) for n, depth in layers)
        assert mass == pytest.approx(float(getattr(scene.iris, pigment) * whole), rel=1e-5)


@by_file([t for t in TRUTH if t["file"] in MASKED])
def test_what_lids_lashes_and_a_lamp_hide_is_masked(truth):
    """What differs from the same eye without them, in brightness by more than a third.

    Masked for nothing is what a streak has changed by less than 6 %: the thin shadows of lashes
    change it by a tenth, and must not be read as furrows.
    """
    limbus, pupil = (outline(truth, name, 0.5) for name in ("limbus", "pupil"))
    names = truth["file"], truth["file"].replace("_dirty", "")
    dirty, clean = (cut_part(reduced(FOLDER / name, 0.5), limbus) for name in names)
    inner = dirty.moved(pupil)
    shape = dirty.outside.shape
    ring = dirty.limbus.mask(shape) & ~inner.mask(shape)
    seen, bare = (
        np.log(ndimage.gaussian_filter(p.pixels @ LUMINANCE_WEIGHTS, 1.0) + 1e-4)
        for p in (dirty, clean)
    )
    change = seen - bare
    hidden = ring & (np.abs(change - np.median(change[ring])) > 0.35)
    found = ring & ~dirty.clear(inner)[0]
    assert found[hidden].mean() > 0.8
    around = masked_mean(change, ring & ~hidden, 0.05 * dirty.limbus.semi_axes[0])
    touched = hidden | (np.abs(change - around) > 0.06)
    away = ring & (ndimage.distance_transform_edt(~touched) > 6)
    assert found[away].mean() < 0.03
