"""Photographs: what the file says of light, colours, the way up and the lens is obeyed."""

import struct
import sys
import zlib

import numpy as np
import OpenImageIO as oiio
import pytest
from PIL import Image, ImageCms

from irisjax import io
from irisjax.measure.colour import srgb_decode, srgb_encode

SHAPE = (72, 96)

# Primaries under D50, as the ICC registry's profiles hold them, and the exponent of the curves.
DISPLAY_P3 = [(0.51512, 0.2412, -0.00105), (0.29198, 0.69225, 0.04189), (0.1571, 0.06657, 0.78407)]
ADOBE_RGB = [(0.60974, 0.31111, 0.01947), (0.20528, 0.62567, 0.06087), (0.14919, 0.06322, 0.74457)]


def fixed(*values):
    return b"".join(struct.pack(">i", round(v * 65536)) for v in values)


def profile_of(space, **tags):
    """A display profile [ICC.1:2010-12, sections 7 to 10]."""
    text = b"desc" + struct.pack(">II", 0, 5) + b"Test\0" + bytes(12 + 67)
    tags |= {
        "wtpt": b"XYZ \0\0\0\0" + fixed(0.9642, 1.0, 0.8249),
        "desc": text,
        "cprt": b"text\0\0\0\0none\0",
    }
    table, body, at = struct.pack(">I", len(tags)), b"", 128 + 4 + 12 * len(tags)
    for name, value in tags.items():
        table += name.encode() + struct.pack(">II", at + len(body), len(value))
        body += value + bytes(-len(value) % 4)
    head = struct.pack(
        ">I4xI4s4s4s12x4s", at + len(body), 0x02400000, b"mntr", space, b"XYZ ", b"acsp"
    )
    head += bytes(28) + fixed(0.9642, 1.0, 0.8249)
    return head.ljust(128, b"\0") + table + body


def curve(gamma):
    return b"curv" + struct.pack(">IIH", 0, 1, round(gamma * 256))


def matrix_profile(primaries, gamma):
    colours = {
        f"{c}XYZ": b"XYZ \0\0\0\0" + fixed(*p) for c, p in zip("rgb", primaries, strict=True)
    }
    return profile_of(b"RGB ", **colours, **{f"{c}TRC": curve(gamma) for c in "rgb"})


def steps(dtype=np.uint8, channels=3, seed=3):
    most = np.iinfo(dtype).max
    return np.random.default_rng(seed).integers(0, most, (*SHAPE, channels), dtype, endpoint=True)


def write(path, values, **attributes):
    kind = {"uint8": "uint8", "uint16": "uint16", "float32": "float"}[values.dtype.name]
    spec = oiio.ImageSpec(values.shape[1], values.shape[0], values.shape[2], kind)
    for name, value in attributes.items():
        if isinstance(value, bytes):
            spec.attribute(
                name, oiio.TypeDesc(f"uint8[{len(value)}]"), np.frombuffer(value, np.uint8)
            )
        else:
            spec.attribute(name, value)
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), spec) and file.write_image(values) and file.close()
    return path


def smooth():
    """A colour picture that JPEG keeps to within a step or two."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return np.stack([2 * x, 3 * y, 200 - x], -1).astype(np.uint8)


def exif(orientation=1, **tags):
    names = {
        "film": 41989,
        "focal": 37386,
        "per": 41486,
        "unit": 41488,
        "x": 40962,
        "y": 40963,
        "space": 40961,
    }
    made = Image.Exif()
    made[274] = orientation
    made.get_ifd(0x8769).update({names[k]: v for k, v in tags.items()})
    return made


def jpeg(path, picture=None, **options):
    picture = smooth() if picture is None else picture
    Image.fromarray(picture).save(path, quality=98, subsampling=0, **options)
    return path


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
    white = write(
        tmp_path / "w.tif",
        np.full((*SHAPE, 3), most, dtype),
        ICCProfile=matrix_profile(primaries, gamma),
    )
    np.testing.assert_allclose(io.read_photograph(white).pixels, 1, atol=1e-6)
    assert any("profile" in note for note in found.notes)


def test_sixteen_bits_survive_a_profile(tmp_path):
    ramp = np.repeat(np.arange(30000, 30000 + SHAPE[1], dtype=np.uint16)[None, :, None], 3, 2)
    values = np.ascontiguousarray(np.repeat(ramp, SHAPE[0], 0))
    path = write(tmp_path / "p.png", values, ICCProfile=matrix_profile(DISPLAY_P3, 2.2))
    pixels = io.read_photograph(path).pixels
    slope = np.diff(pixels[0, :, 1])
    assert (slope > 0).all()
    np.testing.assert_allclose(pixels[0, :, 1], (ramp[0, :, 1] / 65535) ** (563 / 256), rtol=3e-5)


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


def test_adobe_rgb_by_exif_alone_is_noted(tmp_path):
    found = io.read_photograph(jpeg(tmp_path / "p.jpg", exif=exif(space=65535)))
    assert any("Adobe RGB" in note for note in found.notes)


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
        expected = srgb_decode(np.repeat(steps(np.uint16, 1), 3, 2) / 65535)
        np.testing.assert_allclose(found.pixels, expected, rtol=1e-6, atol=1e-9)


def test_exr_is_linear(tmp_path):
    values = np.random.default_rng(2).gamma(1, 2, (*SHAPE, 3)).astype(np.float32)
    values[0, 0] = [-5e-4, 0.2, 0.2]
    values[0, 1] = [-0.1, 0.2, 0.2]
    found = io.read_photograph(write(tmp_path / "p.exr", values))
    values[0, 0, 0] = 0
    np.testing.assert_array_equal(found.pixels, values)
    assert not found.saturated.any() and not found.grey
    assert [
        any(word in note for note in found.notes) for word in ("primaries", "1 values", "1 pixels")
    ] == [True] * 3
    tif = io.read_photograph(write(tmp_path / "p.tif", np.abs(values)))
    np.testing.assert_array_equal(tif.pixels, np.abs(values))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_exr_that_is_not_finite(tmp_path, bad):
    values = np.ones((*SHAPE, 3), np.float32)
    values[3, 4, 1] = bad
    with pytest.raises(ValueError, match=r"p\.exr: 1 pixels are not finite"):
        io.read_photograph(write(tmp_path / "p.exr", values))


def test_first_of_several(tmp_path):
    other = Image.fromarray(steps())
    for name in ("p.png", "p.tif", "p.mpo"):
        Image.fromarray(smooth()).save(tmp_path / name, save_all=True, append_images=[other])
    (tmp_path / "p.mpo").rename(tmp_path / "p.jpg")
    for name in ("p.png", "p.tif", "p.jpg"):
        found = io.read_photograph(tmp_path / name)
        assert any("several pictures" in note for note in found.notes)
        assert np.abs(srgb_encode(found.pixels) * 255 - smooth()).mean() < 3


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
        ({"film": 0, "focal": (0, 1), "per": (1000, 1)}, None),
        ({"film": 65000}, None),
        ({}, None),
    ],
)
@pytest.mark.parametrize("orientation", [1, 6])
def test_focal_length(tmp_path, tags, expected, orientation):
    found = io.read_photograph(jpeg(tmp_path / "p.jpg", exif=exif(orientation, **tags)))
    if expected is None:
        assert found.focal_px is None
    else:
        assert found.focal_px == pytest.approx(expected, rel=1e-3)
    assert any("ignored" in note for note in found.notes) == (tags == {"film": 65000})


def test_focal_lengths_that_disagree(tmp_path):
    tags = exif(film=50, focal=(100, 1), per=(2540, 1))
    found = io.read_photograph(jpeg(tmp_path / "p.jpg", exif=tags))
    assert found.focal_px == pytest.approx(50 / DIAGONAL * np.hypot(*SHAPE))
    assert any("contradicts" in note for note in found.notes)


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif", ".exr"])
@pytest.mark.parametrize("rest", [0, 60, 0.5, 0.9])
def test_truncated(tmp_path, suffix, rest):
    path = tmp_path / f"p{suffix}"
    if suffix == ".jpg":
        jpeg(path, steps())
    else:
        write(path, steps().astype(np.float32) if suffix == ".exr" else steps())
    whole = path.read_bytes()
    path.write_bytes(whole[: int(rest * len(whole)) if rest < 1 else rest])
    with pytest.raises(ValueError, match=r"broken|that can be read") as caught:
        io.read_photograph(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def claiming(path, columns, rows):
    """A small JPEG whose header says otherwise, in a file not too small to be believed."""
    whole = bytearray(jpeg(path).read_bytes())
    at = whole.index(b"\xff\xc0") + 5
    whole[at : at + 4] = struct.pack(">HH", rows, columns)
    path.write_bytes(whole + bytes(columns * rows // 200))
    return path


def png_header(path, columns, rows):
    def chunk(kind, data):
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = struct.pack(">IIBBBBB", columns, rows, 8, 2, 0, 0, 0)
    parts = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + parts)
    return path


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda p: claiming(p / "p.jpg", 20000, 20000), r"20000 × 20000 pixels are more than 100 million"),
        (lambda p: png_header(p / "p.png", 20000, 20000), "header claims a 1144 MB image"),
        (lambda p: claiming(p / "p.jpg", 900, 900), "the picture is broken"),
        (lambda p: write(p / "p.png", steps()[:40]), r"96 × 40 pixels; a photograph has at least 64"),
        (lambda p: p / "p.heic", r"p\.heic: a photograph's name must end in .*\.jpg.*\.dng"),
        (lambda p: p / "p", "must end in"),
        (lambda p: Image.new("CMYK", (90, 90)).save(p / "p.jpg") or p / "p.jpg", "CMYK picture for printing"),
        (lambda p: Image.new("CMYK", (90, 90)).save(p / "p.tif") or p / "p.tif", "CMYK picture for printing"),
        (lambda p: (p / "p.jpg").write_text("no picture") and p / "p.jpg", "not a picture that can be read"),
        (lambda p: (p / "p.dng").write_text("no picture") and p / "p.dng", "not a raw file that can be read"),
        (lambda p: write(p / "p.exr", np.ones((*SHAPE, 2), np.float32)), "this has"),
    ],
)  # fmt: skip
def test_one_clear_line(tmp_path, make, message):
    with pytest.raises(ValueError, match=message) as caught:
        io.read_photograph(make(tmp_path))
    assert "\n" not in str(caught.value)


def test_missing_file(tmp_path):
    for name in ("p.jpg", "p.nef"):
        with pytest.raises(FileNotFoundError):
            io.read_photograph(tmp_path / name)


def test_raw_without_its_library(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rawpy", None)
    (tmp_path / "p.nef").touch()
    with pytest.raises(ValueError, match=r"p\.nef: .*install irisjax\[raw\]"):
        io.read_photograph(tmp_path / "p.nef")


def dng(path, mosaic, orientation=1):
    """A Bayer mosaic (red first, black 100, white 4000) whose camera has sRGB's primaries."""
    tifffile = pytest.importorskip("tifffile")
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
