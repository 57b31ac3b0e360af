"""Pictures that move: GIF, MP4, or numbered PNGs for other programs. Every frame is encoded sRGB in
[0, 1].

GIF is written by Pillow and MP4 by PyAV, an extra: VP9, which browsers play and which is free of
royalties, in BT.709 with half the resolution for colours.
"""

import importlib.util
import itertools
import re
from collections.abc import Iterable, Iterator
from fractions import Fraction
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from irisjax.io.images import check_image_suffix, encode_png, to_steps
from irisjax.io.tables import check_writable, write_atomically, write_together

_NUMBER = re.compile(r"%(0\d+)?d")


def check_movie(path: str | Path) -> None:
    """Check before the frames are computed that they can be written.

    Raises:
        ValueError: The suffix is none of `write_movie`'s, or MP4 lacks the extra `video`.
        OSError: The place cannot be written.
    """
    check_image_suffix(path, (".gif", ".mp4", ".png"))
    if Path(path).suffix.lower() == ".png":
        _numbered(path, 0)
    if Path(path).suffix.lower() == ".mp4" and importlib.util.find_spec("av") is None:
        raise ValueError(f"{path}: MP4 needs PyAV: pip install 'irisjax[video]'")
    check_writable(path)


def first_file(path: str | Path) -> Path:
    """The first file that a picture or a movie of this name writes."""
    path = Path(path)
    numbered = path.suffix.lower() == ".png" and "%" in path.name
    return _numbered(path, 0) if numbered else path


def write_movie(
    path: str | Path, frames: Iterable[Any], *, rate: int = 12, remark: str = ""
) -> int:
    """Write a movie in the form that its suffix names; all of it is written or nothing.

    Args:
        path: `.gif` repeats endlessly; `.mp4` may have any size, odd ones too; `.png` has a number
            in its name, such as `frame_%03d.png`, counted from 0, as ffmpeg expects it.
        frames: Pictures (rows, columns, 3), all of one size.
        rate: Frames per second.
        remark: Goes into the files' descriptions.

    Returns:
        The number of pixels that were clipped, as by `write_png`.

    Raises:
        ValueError: As `check_movie`, or a frame has another shape or is not finite.
        OSError: As `check_movie`.
    """
    check_movie(path)
    writer = {".gif": _gif, ".mp4": _mp4, ".png": _numbered_pngs}[Path(path).suffix.lower()]
    return writer(Path(path), iter(frames), rate, remark)


def _gif(path: Path, frames: Iterator[Any], rate: int, remark: str) -> int:
    from PIL import Image as Pillow

    clipped = 0

    def pictures():
        nonlocal clipped
        for steps, out in _steps(path, frames):
            clipped += out
            yield Pillow.fromarray(steps)

    found = pictures()
    buffer = BytesIO()
    more = {"comment": remark.encode()} if remark else {}
    next(found).save(
        buffer,
        "gif",
        save_all=True,
        append_images=found,
        duration=round(100 / rate) * 10,
        loop=0,
        **more,
    )
    write_atomically(path, buffer.getvalue())
    return clipped


def _mp4(path: Path, frames: Iterator[Any], rate: int, remark: str) -> int:
    import av

    clipped = 0
    buffer = BytesIO()
    with av.open(buffer, "w", format="mp4") as container:
        if remark:
            container.metadata["comment"] = remark
        stream: Any = None
        for number, (steps, out) in enumerate(_steps(path, frames)):
            clipped += out
            if stream is None:
                # Constant quality, far above what is seen: 1 of 255 levels on average where colours
                # do not jump.
                stream = container.add_stream(
                    "libvpx-vp9", rate=rate, options={"crf": "8", "b": "0"}
                )
                stream.height, stream.width = steps.shape[:2]
                stream.pix_fmt = "yuv420p"
                stream.time_base = Fraction(1, rate)
                context = stream.codec_context  # BT.709 with sRGB's transfer function, in [16, 235]
                (
                    context.colorspace,
                    context.color_primaries,
                    context.color_trc,
                    context.color_range,
                ) = 1, 1, 13, 1
            frame = av.VideoFrame.from_ndarray(steps, format="rgb24")
            frame = frame.reformat(
                format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG"
            )
            frame.pts = number
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    write_atomically(path, buffer.getvalue())
    return clipped


def _numbered_pngs(path: Path, frames: Iterator[Any], rate: int, remark: str) -> int:
    del rate
    clipped, files = 0, {}
    for number, frame in enumerate(frames):
        name = _numbered(path, number)
        files[name], out = encode_png(name, frame, remark=remark)
        clipped += out
    write_together(files)
    return clipped


def _numbered(path: str | Path, number: int) -> Path:
    name = Path(path).name
    found = _NUMBER.findall(name)
    if len(found) != 1 or name.count("%") != 1:
        raise ValueError(
            f"{path}: the name of numbered frames holds one number, such as frame_%03d.png"
        )
    return Path(path).with_name(name % number)


def _steps(path: Path, frames: Iterator[Any]) -> Iterator[tuple[np.ndarray, int]]:
    """Frames in 8 bits, and how many of their pixels were clipped."""
    first = next(frames, None)
    if first is None:
        raise ValueError(f"{path}: no frames")
    shape = np.shape(first)
    for frame in itertools.chain([first], frames):
        if np.shape(frame) != shape:
            raise ValueError(f"{path}: frames of {shape} and of {np.shape(frame)}")
        yield to_steps(path, frame, 8)
