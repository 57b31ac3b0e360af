"""Moving pictures: they decode to the frames they were given, or nothing is written."""

import numpy as np
import pytest

from irisjax import io
from irisjax.io import movies


def frames(rows, columns, count):
    """Colours that change smoothly over the picture and with time."""
    y, x = np.mgrid[:rows, :columns]
    one = np.stack([x / columns, y / rows, 0.5 + 0.4 * np.sin(x / 9)], axis=-1)
    return [one * (0.4 + 0.6 * i / count) for i in range(count)]


def decoded(path):
    if path.suffix == ".mp4":
        import av
        from av.video.reformatter import Interpolation

        # The quick way back to RGB is a level or two too dark.
        careful = Interpolation.BILINEAR | Interpolation.ACCURATE_RND | Interpolation.FULL_CHR_H_INT
        how = {"format": "rgb24", "interpolation": careful}
        with av.open(str(path)) as file:
            assert float(file.streams.video[0].average_rate) == 12
            return [f.reformat(**how).to_ndarray() / 255 for f in file.decode(video=0)]
    from PIL import Image, ImageSequence

    with Image.open(path) as file:
        assert file.info["duration"] == 80 and file.info["loop"] == 0
        return [np.asarray(frame.convert("RGB")) / 255 for frame in ImageSequence.Iterator(file)]


MP4 = pytest.mark.peer  # needs the extra irisjax[video]


# GIF has 256 colours; MP4 keeps half the resolution of colour.
@pytest.mark.parametrize(
    ("suffix", "mean"), [(".gif", 0.05), pytest.param(".mp4", 0.01, marks=MP4)]
)
@pytest.mark.parametrize("size", [(60, 80), (61, 83), (1, 1)])
def test_frames_come_back(tmp_path, suffix, mean, size):
    made = frames(*size, 9)
    path = tmp_path / f"eye{suffix}"
    assert io.write_movie(path, iter(made), remark="simulated") == 0
    found = decoded(path)
    assert len(found) == 9
    for a, b in zip(found, made, strict=True):
        assert a.shape == (*size, 3)
        assert np.abs(a - b).mean() < mean
    assert list(tmp_path.iterdir()) == [path]


@MP4
def test_colours_are_those_of_the_frames(tmp_path):
    """Flat patches, where half the resolution of colour costs nothing: within two levels."""
    patches = np.random.default_rng(0).uniform(0.05, 0.95, (4, 5, 3))
    whole = patches.repeat(32, 0).repeat(32, 1)
    io.write_movie(tmp_path / "p.mp4", [whole] * 3)
    for frame in decoded(tmp_path / "p.mp4"):
        middle = frame.reshape(4, 32, 5, 32, 3)[:, 12:20, :, 12:20].mean((1, 3))
        np.testing.assert_allclose(middle, patches, atol=2.5 / 255)


def test_numbered_frames(tmp_path):
    made = frames(6, 8, 11)
    made[3] = made[3] + 1.0
    assert io.write_movie(tmp_path / "f_%03d.png", made, remark="simulated") == 48
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"f_{i:03d}.png" for i in range(11)]
    for i in (0, 10):
        image = io.read_image(tmp_path / f"f_{i:03d}.png")
        np.testing.assert_allclose(image.pixels, made[i], atol=0.5 / 255 + 1e-6)
        assert image.metadata["ImageDescription"] == "simulated"


@pytest.mark.parametrize("name", ["a.gif", pytest.param("a.mp4", marks=MP4), "a_%d.png"])
def test_nothing_half_written(tmp_path, name):
    def broken(made):
        yield from made
        raise KeyboardInterrupt

    good = frames(4, 6, 2)
    with pytest.raises(KeyboardInterrupt):
        io.write_movie(tmp_path / name, broken(good))
    for wrong in ([good[0], np.full((4, 6, 3), np.nan)], [np.zeros((2, 2))]):
        with pytest.raises(ValueError):
            io.write_movie(tmp_path / name, wrong)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".gif", pytest.param(".mp4", marks=MP4)])
def test_wrong_names_and_frames(tmp_path, suffix):
    for name in ("a.png", "a_%s.png", "a_%d_%d.png", "a_%d%%.png"):
        with pytest.raises(ValueError, match=r"one number, such as frame_%03d\.png"):
            io.check_movie(tmp_path / name)
    with pytest.raises(ValueError, match=r"must end in \.gif or \.mp4 or \.png"):
        io.check_movie(tmp_path / "a.avi")
    with pytest.raises(OSError, match="no such folder"):
        io.check_movie(tmp_path / "nowhere" / f"a{suffix}")
    with pytest.raises(ValueError, match="no frames"):
        io.write_movie(tmp_path / f"a{suffix}", [])
    with pytest.raises(ValueError, match=r"frames of \(4, 6, 3\) and of \(5, 6, 3\)"):
        io.write_movie(tmp_path / f"a{suffix}", frames(4, 6, 1) + frames(5, 6, 1))
    assert not list(tmp_path.iterdir())


def test_missing_extra_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(movies.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"a\.mp4: MP4 needs PyAV: pip install 'irisjax\[video\]'"):
        io.check_movie(tmp_path / "a.mp4")
    io.check_movie(tmp_path / "a.gif")
