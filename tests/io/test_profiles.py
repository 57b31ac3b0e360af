"""Embedded colour profiles are obeyed, in the depth of the file."""

import numpy as np
import pytest
from PIL import ImageCms

from irisjax import io
from irisjax.measure.colour import srgb_decode
from photograph_files import SHAPE, curve, matrix_profile, profile_of, steps, write

# Primaries under D50, as the ICC registry's profiles hold them, and the exponent of the curves.
DISPLAY_P3 = [(0.51512, 0.2412, -0.00105), (0.29198, 0.69225, 0.04189), (0.1571, 0.06657, 0.78407)]
ADOBE_RGB = [(0.60974, 0.31111, 0.01947), (0.20528, 0.62567, 0.06087), (0.14919, 0.06322, 0.74457)]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize(("primaries", "gamma"), [(DISPLAY_P3, 2.2), (ADOBE_RGB, 563 / 256)])
def test_matrix_profile_is_obeyed_in_full_depth(tmp_path, dtype, primaries, gamma):
    from colour import RGB_COLOURSPACES, RGB_to_RGB

    values, most = steps(dtype), np.iinfo(dtype).max
    path = write(tmp_path / "p.tif", values, ICCProfile=matrix_profile(primaries, gamma))
    found = io.read_photograph(path)
    space = "Display P3" if primaries is DISPLAY_P3 else "Adobe RGB (1998)"
    spaces = RGB_COLOURSPACES[space], RGB_COLOURSPACES["sRGB"]
    linear = (values / most) ** (round(gamma * 256) / 256)
    expected = RGB_to_RGB(linear, *spaces, chromatic_adaptation_transform="Bradford")
    # The primaries stand in the profile, and sRGB's in IEC's matrix, with four decimals.
    kept = (expected > 0).all(2)
    np.testing.assert_allclose(found.pixels[kept], expected[kept], atol=6e-4)
    white, profile = np.full((*SHAPE, 3), most, dtype), matrix_profile(primaries, gamma)
    white = write(tmp_path / "w.tif", white, ICCProfile=profile)
    np.testing.assert_allclose(io.read_photograph(white).pixels, 1, atol=1e-6)
    assert any("profile" in note for note in found.notes)


def test_srgb_profile_is_srgb(tmp_path):
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    path = write(tmp_path / "p.png", steps(np.uint16), ICCProfile=profile)
    expected = np.asarray(srgb_decode(steps(np.uint16) / 65535))
    np.testing.assert_allclose(io.read_photograph(path).pixels, expected, atol=3e-4)


def test_profile_without_a_matrix_is_converted_and_noted(tmp_path):
    values = steps(np.uint16, 1)
    path = write(tmp_path / "p.tif", values, ICCProfile=profile_of(b"GRAY", kTRC=curve(1.0)))
    found = io.read_photograph(path)
    assert found.grey and any("8 bits" in note and "uint16" in note for note in found.notes)
    # A step of 8 bits at the bright end of sRGB is 0.009 of the light.
    np.testing.assert_allclose(found.pixels, np.repeat(values / 65535, 3, 2), atol=0.01)


def test_profile_that_cannot_be_used(tmp_path):
    values = np.repeat(steps(channels=1), 3, 2)
    lab = ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB")).tobytes()
    with pytest.raises(ValueError, match="embedded colour profile of Lab"):
        io.read_photograph(write(tmp_path / "lab.tif", values, ICCProfile=lab))
    with pytest.raises(ValueError, match="profile is broken"):
        io.read_photograph(write(tmp_path / "bad.tif", values, ICCProfile=b"nonsense" * 20))
