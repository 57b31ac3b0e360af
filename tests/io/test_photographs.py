"""Photographs: what the file says of light, colours, the way up and the lens is obeyed."""

import struct
import sys
import zlib
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from irisjax import io
from irisjax.measure.colour import srgb_decode, srgb_encode
from photograph_files import SHAPE, exif, jpeg, smooth, steps, write


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_whole_numbers_are_decoded_to_the_last_bit(tmp_path, suffix, dtype):
    values = steps(dtype)
    found = io.read_photograph(write(tmp_path / f"p{suffix}", values))
    most = np.iinfo(dtype).max
    np.testing.assert_allclose(found.pixels, srgb_decode(values / most), rtol=1e-6, atol=1e-9)
    assert found.pixels.dtype == np.float32 and not found.grey and found.name == f"p{suffix}"
    np.testing.assert_array_equal(found.saturated, (values >= 0.995 * most).any(2))
    assert found.focal_px is None and any("sRGB" in note for note in found.notes)


def test_jpeg(tmp_path):
    found = io.read_photograph(jpeg(tmp_path / "p.JPG"))
    assert np.abs(srgb_encode(found.pixels) * 255 - smooth()).max() <= 4
    found = io.read_photograph(jpeg(tmp_path / "p.jpg", exif=exif(space=65535)))
    assert any("Adobe RGB" in note for note in found.notes)
    for name in ("none.jpg", "none.nef"):
        with pytest.raises(FileNotFoundError):
            io.read_photograph(tmp_path / name)


def test_photographs_of_telephones(tmp_path, monkeypatch):
    """WebP is read; HEIC with an extra, which the refusal names."""
    Image.fromarray(smooth()).save(tmp_path / "p.webp", lossless=True)
    found = io.read_photograph(tmp_path / "p.webp")
    np.testing.assert_allclose(found.pixels, srgb_decode(smooth() / 255), rtol=1e-6, atol=1e-9)
    (tmp_path / "p.heic").write_bytes(b"ftypheic")
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    with pytest.raises(ValueError, match=r"p\.heic: HEIC needs pillow_heif.* to JPEG"):
        io.read_photograph(tmp_path / "p.heic")
    opened = SimpleNamespace(to_pillow=lambda: Image.fromarray(smooth()))
    heif = SimpleNamespace(open_heif=lambda path: opened)
    monkeypatch.setitem(sys.modules, "pillow_heif", heif)
    found = io.read_photograph(tmp_path / "p.heic")
    np.testing.assert_allclose(found.pixels, srgb_decode(smooth() / 255), rtol=1e-6, atol=1e-9)
    assert found.name == "p.heic"


@pytest.mark.parametrize("orientation", range(1, 9))
def test_held_as_exif_says(tmp_path, orientation):
    upright = smooth()
    turned = {
        1: upright, 2: upright[:, ::-1], 3: upright[::-1, ::-1], 4: upright[::-1],
        5: upright.swapaxes(0, 1), 6: np.rot90(upright), 7: upright[::-1, ::-1].swapaxes(0, 1),
        8: np.rot90(upright, -1),
    }[orientation]  # fmt: skip
    path = tmp_path / "p.png"
    Image.fromarray(np.ascontiguousarray(turned)).save(path, exif=exif(orientation))
    found = io.read_photograph(path)
    np.testing.assert_allclose(found.pixels, srgb_decode(upright / 255), rtol=1e-6, atol=1e-9)
    assert found.shape == SHAPE


@pytest.mark.parametrize(
    "kind", ["grey", "palette", "alpha", "grey in RGB", "16-bit grey", "one bit"]
)
def test_kinds_of_png(tmp_path, kind):
    path, grey = tmp_path / "p.png", steps(channels=1)[..., 0]
    picture = {
        "grey": Image.fromarray(grey),
        "palette": Image.fromarray(smooth()).convert("P"),
        "alpha": Image.fromarray(np.concatenate([smooth(), grey[..., None]], 2)),
        "grey in RGB": Image.fromarray(np.stack([grey, grey // 2 * 2, grey], 2)),
        "16-bit grey": Image.fromarray(steps(np.uint16, 1)[..., 0]),
        "one bit": Image.fromarray(grey > 99),
    }[kind]
    picture.save(path)
    found = io.read_photograph(path)
    assert found.pixels.shape == (*SHAPE, 3)
    assert found.grey == (kind not in ("palette", "alpha"))
    if kind == "alpha":
        np.testing.assert_allclose(found.pixels, srgb_decode(smooth() / 255), rtol=1e-6)
        assert any("Transparency" in note for note in found.notes)
    if kind == "16-bit grey":
        expected = srgb_decode(steps(np.uint16, 1) / 65535).repeat(3, 2)
        np.testing.assert_allclose(found.pixels, expected, rtol=1e-6, atol=1e-9)


def test_exr_is_linear(tmp_path):
    values = np.random.default_rng(2).gamma(1, 0.2, (*SHAPE, 3)).astype(np.float32)
    values[0, 0] = [-5e-4, 0.2, 0.2]
    values[0, 1] = [-0.1, 0.2, 0.2]
    found = io.read_photograph(write(tmp_path / "p.exr", values))
    values[0, 0, 0] = 0
    np.testing.assert_array_equal(found.pixels, values)
    assert not found.saturated.any() and not found.grey
    for word in ("primaries", "1 values", "1 pixels"):
        assert any(word in note for note in found.notes)
    tif = io.read_photograph(write(tmp_path / "p.tif", np.abs(values)))
    np.testing.assert_array_equal(tif.pixels, np.abs(values))


@pytest.mark.parametrize("unit", [1e-4, 10, 1e6])
def test_a_linear_file_may_have_any_unit(tmp_path, unit):
    values = np.random.default_rng(0).uniform(0.1, 0.9, (*SHAPE, 3)).astype(np.float32)
    found = io.read_photograph(write(tmp_path / "p.exr", unit * values))
    assert 0.9 < found.pixels.max() < 1.1
    np.testing.assert_allclose(found.pixels / found.pixels.max(), values / values.max(), rtol=1e-5)
    assert not found.grey
    assert any("All values are divided by" in note for note in found.notes)


def test_a_pixel_brighter_than_all_is_no_light(tmp_path):
    values = np.full((*SHAPE, 3), 0.5, np.float32)
    values[3, 5] = 1e30
    found = io.read_photograph(write(tmp_path / "p.exr", values))
    assert found.pixels[3, 5].max() == 1e4 and np.delete(found.pixels, 3, 0).max() == 0.5
    assert any(note.startswith("1 pixels are brighter than 10000") for note in found.notes)


def test_first_of_several(tmp_path):
    other = Image.fromarray(steps())
    for name in ("p.png", "p.tif", "p.mpo"):
        Image.fromarray(smooth()).save(tmp_path / name, save_all=True, append_images=[other])
    (tmp_path / "p.mpo").rename(tmp_path / "p.jpg")
    for name in ("p.png", "p.tif", "p.jpg"):
        found = io.read_photograph(tmp_path / name)
        assert any("several pictures" in note for note in found.notes)
        assert np.abs(srgb_encode(found.pixels) * 255 - smooth()).mean() < 3


def truncated(path, share):
    whole = write(path, steps()).read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    return path


def claiming(path, columns, rows):
    """A small JPEG whose header says otherwise, in a file not too small to be believed."""
    whole = bytearray(jpeg(path).read_bytes())
    at = whole.index(b"\xff\xc0") + 5
    whole[at : at + 4] = struct.pack(">HH", rows, columns)
    path.write_bytes(whole + bytes(columns * rows // 200))
    return path


def png_header(path, columns, rows):
    def chunk(kind, data):
        sum_ = struct.pack(">I", zlib.crc32(kind + data))
        return struct.pack(">I", len(data)) + kind + data + sum_

    head = struct.pack(">IIBBBBB", columns, rows, 8, 2, 0, 0, 0)
    parts = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + parts)
    return path


LIT = np.ones((*SHAPE, 3), np.float32)
SPOT = np.arange(LIT.size).reshape(LIT.shape) == 500


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda p: claiming(p / "p.jpg", 20000, 20000), r"20000 × 20000 pixels are more than 100 million; make it smaller"),
        (lambda p: truncated(p / "p.tif", 0.0), "not a picture that can be read"),
        (lambda p: truncated(p / "p.tif", 0.005), "not a picture that can be read"),
        (lambda p: truncated(p / "p.tif", 0.9), "the picture is broken"),
        (lambda p: png_header(p / "p.png", 20000, 20000), "header claims a 1144 MB image"),
        (lambda p: claiming(p / "p.jpg", 900, 900), "the picture is broken"),
        (lambda p: write(p / "p.png", steps()[:40]), r"96 × 40 pixels; a photograph has at least 64"),
        (lambda p: p / "p.gif", r"p\.gif: a photograph's name must end in .*\.jpg.*\.dng"),
        (lambda p: p / "p", "must end in"),
        (lambda p: Image.new("CMYK", (90, 90)).save(p / "p.jpg") or p / "p.jpg", "CMYK picture for printing"),
        (lambda p: Image.new("CMYK", (90, 90)).save(p / "p.tif") or p / "p.tif", "CMYK picture for printing"),
        (lambda p: (p / "p.jpg").write_text("no picture") and p / "p.jpg", "not a picture that can be read"),
        (lambda p: (p / "p.dng").write_text("no picture") and p / "p.dng", "not a raw file that can be read|need rawpy"),
        (lambda p: write(p / "p.exr", np.ones((*SHAPE, 2), np.float32)), "this has"),
        (lambda p: write(p / "p.exr", -LIT), "no pixel is brighter than 0"),
        (lambda p: write(p / "p.exr", np.where(SPOT, np.nan, LIT)), r"p\.exr: 1 pixels are not finite"),
        (lambda p: write(p / "p.exr", np.where(SPOT, np.inf, LIT)), r"p\.exr: 1 pixels are not finite"),
    ],
)  # fmt: skip
def test_one_clear_line(tmp_path, make, message):
    with pytest.raises(ValueError, match=message) as caught:
        io.read_photograph(make(tmp_path))
    assert str(caught.value).startswith(str(tmp_path)) and "\n" not in str(caught.value)
