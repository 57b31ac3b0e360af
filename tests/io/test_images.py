"""Pictures: what is written can be read again to the last bit, and nothing is half written."""

import os
import threading
import time
from functools import partial

import numpy as np
import pytest
from PIL import Image

from irisjax import io
from irisjax.measure.colour import srgb_decode, srgb_encode
from photograph_files import write


def noise(*shape):
    return np.random.default_rng(7).normal(size=shape).astype(np.float32)


def test_exr_round_trip(tmp_path):
    path, image = tmp_path / "linear.exr", 1e3 * noise(5, 7, 3)
    image[0, 0] = [np.inf, -0.0, 1e-42]
    io.write_exr(path, image, metadata={"seed": "3"})
    back = io.read_image(path)
    assert back.linear and back.channels == ("R", "G", "B") and back.metadata["seed"] == "3"
    np.testing.assert_array_equal(back.pixels, image, strict=True)


def test_spectral_exr_by_the_published_layout(tmp_path):
    path, image = tmp_path / "spectral.exr", noise(2, 3, 4)
    names = io.spectral_channels([400, 550.5, 633, 1000], "T")
    assert names == ("T.400,0nm", "T.550,5nm", "T.633,0nm", "T.1000,0nm")
    io.write_exr(path, image, names)
    back = io.read_image(path)
    assert back.metadata["spectralLayoutVersion"] == "1.0"
    np.testing.assert_array_equal(back.pixels[..., [back.channels.index(n) for n in names]], image)


@pytest.mark.peer
def test_colour_science_reads_the_spectral_layout(tmp_path):
    from colour.io import read_spectral_image_Fichet2021

    image = np.abs(noise(2, 3, 3))
    io.write_exr(tmp_path / "s.exr", image, io.spectral_channels([450, 550, 650]))
    wavelengths, values = read_spectral_image_Fichet2021(str(tmp_path / "s.exr"))["S0"]
    np.testing.assert_allclose(wavelengths, [450, 550, 650])
    np.testing.assert_array_equal(values, image)


@pytest.mark.parametrize("depth", [8, 16])
def test_png_round_trip(tmp_path, depth):
    path, most = tmp_path / "p.png", 2**depth - 1
    steps = np.random.default_rng(1).integers(0, most, (6, 5, 3), endpoint=True)
    assert io.write_png(path, (steps + 0.49) / most, bits=depth, remark="seed 3") == 0
    back = io.read_image(path)
    assert not back.linear and back.metadata["ImageDescription"] == "seed 3"
    np.testing.assert_array_equal(np.rint(back.pixels.astype(np.float64) * most), steps)
    decoded = io.read_image(path, decode=True)
    assert decoded.linear
    np.testing.assert_allclose(srgb_encode(decoded.pixels), steps / most, atol=1e-6)


def test_png_says_what_it_clips(tmp_path):
    image = np.full((2, 2, 3), 0.5)
    image[0, 0] = [-0.1, 1.2, 0.5]
    image[1, 1, 2] = 1.01
    image[1, 0] = 1 + 1e-7  # rounding noise is no colour out of gamut
    assert io.write_png(tmp_path / "p.png", image) == 2
    np.testing.assert_allclose(io.read_image(tmp_path / "p.png").pixels[0, 0], [0, 1, 128 / 255])


def test_decoding_inverts_encoding():
    x = np.concatenate([np.linspace(-0.1, 0.1, 101), np.linspace(0, 20, 101)])
    np.testing.assert_allclose(srgb_decode(srgb_encode(x)), x, rtol=1e-12, atol=1e-15)


def test_equal_pictures_are_equal_bytes(tmp_path):
    image = np.abs(noise(4, 4, 3)) / 9

    def both():
        io.write_exr(tmp_path / "a.exr", image, metadata={"seed": "3"})
        io.write_png(tmp_path / "a.png", image, bits=16)
        return (tmp_path / "a.exr").read_bytes(), (tmp_path / "a.png").read_bytes()

    first = both()
    time.sleep(1.01 - time.time() % 1)  # formats date to the second
    assert both() == first


def test_grey_with_alpha(tmp_path):
    Image.fromarray(np.full((1, 1, 2), 51, np.uint8)).save(tmp_path / "g.png")
    back = io.read_image(tmp_path / "g.png", decode=True)
    np.testing.assert_allclose(back.pixels, [[[0.0331048, 0.2]]], rtol=1e-5)


@pytest.mark.parametrize("suffix", [".exr", ".png", ".hdr", ".jpg"])
@pytest.mark.parametrize("keep", [0, 30, -20])
def test_broken_files_get_one_line(tmp_path, suffix, keep, capfd):
    path = write(tmp_path / f"whole{suffix}", np.abs(noise(16, 32, 3)))
    back = io.read_image(path)
    assert back.linear == (suffix in (".exr", ".hdr")) and back.pixels.shape == (16, 32, 3)
    broken = tmp_path / f"broken{suffix}"
    broken.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(ValueError, match=f"broken\\{suffix}: ") as caught:
        io.read_image(broken)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")  # of libraries in C, which know of no sys.stderr


def test_a_damaged_png_is_told_in_one_line(tmp_path, capfd):
    io.write_png(tmp_path / "p.png", np.abs(noise(16, 32, 3)) % 1)
    whole = (tmp_path / "p.png").read_bytes()
    at = whole.index(b"IDAT") + 40
    (tmp_path / "p.png").write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
    with pytest.raises(ValueError, match=r"p\.png: the picture is broken \(its part 'IDAT'"):
        io.read_image(tmp_path / "p.png")
    assert capfd.readouterr() == ("", "")


def test_errors(tmp_path):
    with pytest.raises(FileNotFoundError):
        io.read_image(tmp_path / "none.exr")
    with pytest.raises(OSError, match="no such folder"):
        io.write_exr(tmp_path / "nowhere" / "p.exr", noise(2, 2, 3))
    black = np.zeros((2, 2, 3))
    for message, call, *given in (
        (r"must end in \.exr or \.hdr or", io.read_image, tmp_path / "none.bmp"),
        (r"must end in \.png", io.write_png, tmp_path / "p.jpg", black),
        (r"must end in \.exr", io.write_exr, tmp_path / "p.hdr", black),
        (r"\(rows, columns, 3\), got \(2, 3\)", io.write_png, tmp_path / "p.png", black[0]),
        ("8 or 16 bits, got 12", partial(io.write_png, bits=12), tmp_path / "p.png", black),
        ("4 pixels are not finite", io.write_png, tmp_path / "p.png", black * np.nan),
        ("appears twice", io.write_exr, tmp_path / "p.exr", black[..., :2], ("R", "R")),
        ("unknown layer", io.spectral_channels, [500], "X"),
    ):
        with pytest.raises(ValueError, match=message):
            call(*given)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("height", [1, 16])
def test_bands_make_the_same_file(tmp_path, height):
    values = np.random.default_rng(0).uniform(-0.1, 1.1, (40, 7, 3))
    bands = [values[i : i + height] for i in range(0, 40, height)]
    clipped = io.write_png(tmp_path / "a.png", values, bits=16, remark="both")
    again = io.write_png(tmp_path / "b.png", iter(bands), bits=16, remark="both", rows=40)
    assert again == clipped > 0
    io.write_exr(tmp_path / "a.exr", values)
    io.write_exr(tmp_path / "b.exr", iter(bands), rows=40)
    for suffix in ("png", "exr"):
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


@pytest.mark.parametrize("name", ["p.png", "p.exr"])
def test_bands_are_all_written_or_nothing(tmp_path, name):
    write = io.write_png if name == "p.png" else io.write_exr
    band = np.zeros((4, 6, 3))

    def broken():
        yield band
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write(tmp_path / name, broken(), rows=8)
    with pytest.raises(ValueError, match=rf"{name}: 4 of 8 rows"):
        write(tmp_path / name, iter([band]), rows=8)
    for other in (np.zeros((5, 6, 3)), np.zeros((4, 7, 3))):
        with pytest.raises(ValueError, match=rf"{name}: a band of .* after 4 of 8 rows"):
            write(tmp_path / name, iter([band, other]), rows=8)
    if name == "p.png":
        with pytest.raises(ValueError, match="24 pixels are not finite"):
            write(tmp_path / name, iter([band, band * np.nan]), rows=8)
    assert not list(tmp_path.iterdir())


def test_pictures_go_into_pipes(tmp_path):
    os.mkfifo(tmp_path / "pipe.png")
    found = []
    reader = threading.Thread(target=lambda: found.append((tmp_path / "pipe.png").read_bytes()))
    reader.start()
    io.write_png(tmp_path / "pipe.png", np.zeros((2, 3, 3)))
    reader.join(timeout=20)
    io.write_png(tmp_path / "file.png", np.zeros((2, 3, 3)))
    assert found == [(tmp_path / "file.png").read_bytes()]


def test_environment_from_files(tmp_path):
    radiance, square, grey = np.abs(noise(4, 8, 3)), np.ones((4, 4, 3)), np.ones((4, 8, 1))
    io.write_exr(tmp_path / "e.exr", radiance)
    np.testing.assert_array_equal(io.read_environment(tmp_path / "e.exr").radiance, radiance)
    io.write_png(tmp_path / "e.png", np.full((4, 8, 3), 0.5), bits=16)
    np.testing.assert_allclose(io.read_environment(tmp_path / "e.png").radiance, 0.2140, atol=1e-4)
    for message, pixels, *channels in (
        (r"wrong\.exr: .* twice as wide as high, this is 4 × 4", square),
        (r"wrong\.exr: .* needs the channels R, G, B, found Y", grey, ("Y",)),
        (r"wrong\.exr: radiance is negative or not finite in 32", radiance - 10),
    ):
        io.write_exr(tmp_path / "wrong.exr", pixels, *channels)
        with pytest.raises(ValueError, match=message):
            io.read_environment(tmp_path / "wrong.exr")
