"""Pictures that move, of frames encoded as sRGB in [0, 1]: GIF by Pillow, numbered PNGs, or MP4 by
PyAV, an extra: VP9, which browsers play, in BT.709 with half the resolution for colours.
"""

import importlib.util
import re
from collections.abc import Iterable, Iterator
from fractions import Fraction
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from irisjax.io.images import check_image_suffix, encode_png, to_steps
from irisjax.io.tables import check_writable, naming, write_together

_RATE = 12  # frames a second
_NUMBER = re.compile(r"%(0\d+)?d")


def check_movie(path: str | Path) -> None:
    """Raise before the frames are computed what `write_movie` would raise for the path."""
    suffix = Path(path).suffix.lower()
    with naming(path):
        check_image_suffix(path, tuple(_WRITERS))
        if suffix == ".mp4" and importlib.util.find_spec("av") is None:
            raise ValueError("MP4 needs PyAV: pip install 'irisjax[video]'")
        if suffix == ".png":
            _frame_path(Path(path), 0)
    check_writable(path)


def first_file(path: str | Path) -> Path:
    """The first file that a picture or a movie of this name writes."""
    path = Path(path)
    numbered = path.suffix.lower() == ".png" and "%" in path.name
    return _frame_path(path, 0) if numbered else path


def write_movie(path: str | Path, frames: Iterable[Any], *, remark: str = "") -> int:
    """Write a movie of 12 frames a second in the form that its suffix names, whole or not at all.

    Args:
        path: `.gif` repeats endlessly; `.mp4` may have any size, odd ones too; `.png` has a number
            in its name, such as `frame_%03d.png`, counted from 0, as ffmpeg expects it.
        frames: Pictures (rows, columns, 3), all of one size.
        remark: Goes into the files' descriptions.

    Returns:
        The number of pixels that were clipped, as by `write_png`.

    Raises:
        ValueError: As `check_movie`, or a frame has another shape or is not finite.
    """
    check_movie(path)
    clipped, shape = 0, None

    def steps() -> Iterator[np.ndarray]:
        nonlocal clipped, shape
        for frame in frames:
            shape = shape or np.shape(frame)
            if np.shape(frame) != shape:
                raise ValueError(f"frames of {shape} and of {np.shape(frame)}")
            values, out = to_steps(frame, 8)
            clipped += out
            yield values
        if shape is None:
            raise ValueError("no frames")

    with naming(path):
        write_together(_WRITERS[Path(path).suffix.lower()](Path(path), steps(), remark))
    return clipped


def _gif(path: Path, frames: Iterator[np.ndarray], remark: str) -> dict[Path, bytes]:
    from PIL import Image as Pillow

    pictures = map(Pillow.fromarray, frames)
    buffer = BytesIO()
    more: dict[str, Any] = {"comment": remark.encode()} if remark else {}
    more |= {"append_images": pictures, "duration": round(100 / _RATE) * 10}
    next(pictures).save(buffer, "gif", save_all=True, loop=0, **more)
    return {path: buffer.getvalue()}


def _mp4(path: Path, frames: Iterator[np.ndarray], remark: str) -> dict[Path, bytes]:
    import av

    buffer = BytesIO()
    with av.open(buffer, "w", format="mp4") as container:
        if remark:
            container.metadata["comment"] = remark
        stream: Any = None
        for number, steps in enumerate(frames):
            if stream is None:
                # Far above what is seen: 1 of 255 levels where colours do not jump.
                quality = {"crf": "8", "b": "0"}
                stream = container.add_stream("libvpx-vp9", rate=_RATE, options=quality)
                stream.height, stream.width = steps.shape[:2]
                stream.pix_fmt, stream.time_base = "yuv420p", Fraction(1, _RATE)
                context = stream.codec_context  # BT.709 with sRGB's transfer function, in [16, 235]
                context.colorspace, context.color_primaries = 1, 1
                context.color_trc, context.color_range = 13, 1
            form: Any = {"format": "yuv420p", "dst_colorspace": "ITU709", "dst_color_range": "MPEG"}
            frame = av.VideoFrame.from_ndarray(steps, format="rgb24").reformat(**form)
            frame.pts = number
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return {path: buffer.getvalue()}


def _pngs(path: Path, frames: Iterator[np.ndarray], remark: str) -> dict[Path, bytes]:
    # Values of 8 bits pass a PNG unchanged.
    return {
        _frame_path(path, number): encode_png(path, steps / 255, remark=remark)[0]
        for number, steps in enumerate(frames)
    }


_WRITERS = {".gif": _gif, ".mp4": _mp4, ".png": _pngs}


def _frame_path(path: Path, number: int) -> Path:
    if len(_NUMBER.findall(path.name)) != 1 or path.name.count("%") != 1:
        message = "the name of numbered frames holds one number, such as frame_%03d.png"
        raise ValueError(f"{path}: {message}")
    return path.with_name(path.name % number)
