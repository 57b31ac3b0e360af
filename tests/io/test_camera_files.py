"""What a camera adds: focal lengths in Exif, and raw files of its sensor."""

import sys

import numpy as np
import pytest
import tifffile

from irisjax import io
from photograph_files import SHAPE, exif, jpeg

DIAGONAL = np.hypot(36, 24)


@pytest.mark.parametrize(
    ("tags", "expected"),
    [
        ({"film": 50}, 50 / DIAGONAL * np.hypot(*SHAPE)),
        ({"film": 50, "x": 960, "y": 720}, 50 / DIAGONAL * np.hypot(*SHAPE)),  # resized
        ({"film": 50, "x": 960, "y": 640}, 50 / DIAGONAL * np.hypot(960, 640)),  # cut out
        ({"focal": (100, 1), "per": (2540, 1), "unit": 2}, 100 * 100),
        ({"focal": (100, 1), "per": (1000, 1), "unit": 3, "x": 960, "y": 720}, 100 * 100 * 0.1),
        ({"focal": (100, 1)}, None),
        ({"film": 50, "focal": (100, 1), "per": (2540, 1)}, 50 / DIAGONAL * np.hypot(*SHAPE)),
        ({"film": 0, "focal": (0, 1)}, None),
        ({"film": 65000}, None),
        ({}, None),
    ],
)
def test_focal_length(tmp_path, tags, expected):
    """The photograph is upright, and the sensor lay on its side."""
    found = io.read_photograph(jpeg(tmp_path / "p.jpg", exif=exif(6, **tags)))
    assert found.focal_px == (None if expected is None else pytest.approx(expected, rel=1e-3))
    assert any("ignored" in note for note in found.notes) == (tags == {"film": 65000})
    assert any("contradicts" in note for note in found.notes) == ({"film", "focal"} < tags.keys())


def test_raw_without_its_library(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rawpy", None)
    (tmp_path / "p.nef").touch()
    with pytest.raises(ValueError, match=r"p\.nef: .*install irisjax\[raw\]"):
        io.read_photograph(tmp_path / "p.nef")


def dng(path, mosaic, orientation=1):
    """A Bayer mosaic (red first, black 100, white 4000) whose camera has sRGB's primaries."""
    to_camera = np.array(
        [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
    )
    matrix = np.stack([np.rint(to_camera * 10000).astype(int).ravel(), np.full(9, 10000)], 1)
    tags = [
        (50706, "B", 4, (1, 4, 0, 0)),
        (50708, "s", 0, "Test"),
        (33421, "H", 2, (2, 2)),
        (33422, "B", 4, (0, 1, 1, 2)),
        (50714, "H", 1, 100),
        (50717, "H", 1, 4000),
        (50721, "2i", 9, tuple(matrix.ravel().tolist())),
        (50728, "2I", 3, (1, 2, 1, 1, 1, 1)),  # red is half of green in white
        (50778, "H", 1, 21),
        (274, "H", 1, orientation),
    ]
    tifffile.imwrite(path, mosaic, photometric=32803, extratags=tags, metadata=None)
    return path


def test_raw_is_linear_with_the_cameras_white_and_saturation(tmp_path):
    pytest.importorskip("rawpy")
    mosaic = np.full((80, 120), 2050, np.uint16)
    mosaic[::2, ::2] = 100 + 1950 // 2
    mosaic[20:30, 20:30] = 4000
    found = io.read_photograph(dng(tmp_path / "p.dng", mosaic, orientation=6))
    assert found.shape == (120, 80) and found.pixels.dtype == np.float32
    np.testing.assert_allclose(found.pixels[60, 40], 1950 / 3900, rtol=2e-3)
    np.testing.assert_allclose(found.pixels[24, 54], 1, rtol=2e-3)
    burnt = np.zeros((80, 120), bool)
    burnt[19:31, 19:31] = True  # and the pixels whose colours are filled in from it
    np.testing.assert_array_equal(found.saturated, np.rot90(burnt, -1))


def test_raw_that_is_too_small(tmp_path):
    pytest.importorskip("rawpy")
    with pytest.raises(ValueError, match=r"p\.dng: 60 × 80 pixels; a photograph has at least 64"):
        io.read_photograph(dng(tmp_path / "p.dng", np.full((80, 60), 999, np.uint16)))
