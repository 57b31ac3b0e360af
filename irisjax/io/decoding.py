"""A picture's values as its file holds them: OpenImageIO's work, with errors of one line."""

import zlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

if TYPE_CHECKING:
    import OpenImageIO

_PNG = b"\x89PNG\r\n\x1a\n"


def decode_file(
    path: str | Path,
    suffixes: tuple[str, ...],
    *,
    integers: bool,
    check: Callable[["OpenImageIO.ImageSpec"], None] | None = None,
) -> tuple[np.ndarray, "OpenImageIO.ImageSpec", bool]:
    """The first picture of a file as the file holds it, held upright: values (rows, columns,
    channels), OpenImageIO's description (of the picture before it was turned), and whether there
    are more pictures.

    Values are float32, whole numbers brought to [0, 1]; with `integers`, files of 8 and 16 bits
    give uint8 and uint16. `check` may refuse a file by its header, before pixels are decoded.

    **Raises:** `ValueError` for an unknown suffix or a broken file, `OSError` for one that cannot
    be opened.
    """
    check_suffix(path, suffixes)
    with open(path, "rb") as opened:  # the system's word on files that are missing or forbidden
        wrong = _of_png(opened)
    if wrong:
        raise ValueError(f"{path}: the picture is broken ({wrong})")
    import OpenImageIO as oiio

    wishes = oiio.ImageSpec()
    wishes.attribute("oiio:UnassociatedAlpha", 1)  # else colours come multiplied by alpha
    file = oiio.ImageInput.open(str(path), wishes)
    if file is None:
        raise ValueError(f"{path}: not a picture that can be read ({first_line(oiio.geterror())})")
    try:
        spec = file.spec()
        if check is not None:
            check(spec)
        kind = str(spec.format) if integers and str(spec.format) in ("uint8", "uint16") else "float"
        values = file.read_image(kind)
        complaint = (
            file.geterror()
        )  # of a JPEG that is cut short there is one, and values all the same
        if values is None or complaint:
            raise ValueError(f"{path}: the picture is broken ({first_line(complaint)})")
        several = file.seek_subimage(1, 0)
    finally:
        file.close()
    pixels = np.asarray(values).reshape(spec.height, spec.width, spec.nchannels)
    held = spec.get_int_attribute("Orientation", 1)
    pixels = pixels.swapaxes(0, 1) if held in (5, 6, 7, 8) else pixels
    pixels = pixels[::-1] if held in (3, 4, 7, 8) else pixels
    pixels = pixels[:, ::-1] if held in (2, 3, 6, 7) else pixels
    return np.ascontiguousarray(pixels), spec, several


def _of_png(file: BinaryIO) -> str:
    """What is wrong with the chunks of a PNG, empty for a whole one and for any other file.

    libpng finds it too, and prints a line of its own past whoever called it.
    """
    if file.read(len(_PNG)) != _PNG:
        return ""
    while True:
        head = file.read(8)
        count = int.from_bytes(head[:4])
        body, sum_ = file.read(count), file.read(4)
        if len(head) < 8 or len(body) < count or len(sum_) < 4:
            return "the file ends in the middle"
        kind = head[4:]
        # A capital: a part without which there is no picture. libpng is as lenient with others.
        if kind[:1].isupper() and zlib.crc32(kind + body) != int.from_bytes(sum_):
            return f"its part {kind.decode('latin-1')!r} is damaged"
        if kind == b"IEND":
            return ""


def check_suffix(path: str | Path, suffixes: tuple[str, ...]) -> None:
    """Raise `ValueError` for a name that ends in none of `suffixes`."""
    if Path(path).suffix.lower() not in suffixes:
        raise ValueError(f"{path}: a picture's name must end in {' or '.join(suffixes)}")


def first_line(text: str) -> str:
    """Of an error's text."""
    return text.strip().split("\n")[0] or "no reason given"
