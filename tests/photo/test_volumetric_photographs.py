"""The second set of simulated photographs, which another model of light made, and its truth."""

import numpy as np
import pytest
from PIL import Image

from irisjax.photo.outlines import MIN_CONFIDENCE, find_boundaries
from photo import simulated

FOLDER = simulated.FOLDER / "volumetric"
TRUTH = simulated.truths(FOLDER)
SCALE = 0.4


def test_every_picture_has_its_truth_and_is_small():
    assert {t["file"] for t in TRUTH} == {p.name for p in FOLDER.glob("*.jpg")}
    assert all((FOLDER / t["file"]).stat().st_size <= 60_000 for t in TRUTH)
    assert sum(p.stat().st_size for p in FOLDER.iterdir()) < 600_000
    for truth in TRUTH:
        with Image.open(FOLDER / truth["file"]) as image:
            assert list(image.size) == truth["size_px"]
            told = 0xA405 in image.getexif().get_ifd(0x8769)
        assert told == truth["camera"]["focal_in_file"]


def test_means_are_those_of_the_maps():
    for truth in TRUTH:
        with np.load(FOLDER / truth["maps"]) as maps:
            size = len(maps["abl_melanin"])
            along = (np.arange(size) + 0.5) * (12 / size) - 6
            x, y = along[None], -along[:, None]
            dx, dy = x - truth["eye"]["pupil_centre"][0], y - truth["eye"]["pupil_centre"][1]
            ring = np.hypot(dx, dy) > 1.1 * truth["eye"]["pupil_radius"]
            ring &= np.hypot(x, y) < 5
            found = maps["abl_melanin"][ring].mean() * maps["abl_melanin_most"] / 255
            lit = np.unpackbits(maps["lit"], axis=1).astype(bool)
            assert maps["thickness"].shape == (192, 192)
        mean = truth["abl_mean"]
        assert found == pytest.approx(mean["eumelanin"] + mean["pheomelanin"], rel=0.02)
        # The well lit part lies on the iris, and is a good part of it.
        assert lit[ring].mean() > 0.25
        assert not lit[np.hypot(dx, dy) < 0.9 * truth["eye"]["pupil_radius"]].any()


def test_outlines_are_found_or_refused():
    truth = TRUTH[0]
    photo = simulated.reduced(FOLDER / truth["file"], SCALE)
    found = find_boundaries(photo._replace(focal_px=None))
    along, radius = np.linspace(0, 2 * np.pi, 90), SCALE * truth["limbus"]["semi_axes_px"][0]
    for name, sure in (("limbus", found.limbus_confidence), ("pupil", found.pupil_confidence)):
        true = simulated.outline(truth, name, SCALE)
        off = true.relative_radius(*getattr(found, name).points(along).T) - 1
        right = abs(off).max() * true.semi_axes[0] < 0.04 * radius
        assert right or sure < MIN_CONFIDENCE
