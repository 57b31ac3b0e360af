"""Pictures in and out: OpenEXR and Radiance for linear values, PNG and JPEG for encoded ones.

The formats are OpenImageIO's work; it is imported when a picture is first asked for.
"""

import re
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import numpy as np

from irisjax.io.tables import check_writable, write_atomically
from irisjax.measure.colour import srgb_decode
from irisjax.render.environment import Environment

READABLE = (".exr", ".hdr", ".png", ".jpg", ".jpeg")
"""Kinds of picture that can be read."""

_TYPES = {"uint8": "uint8", "uint16": "uint16", "float32": "float"}  # OpenImageIO makes halves of "float32"
_SPECTRAL = re.compile(r"(S[0-3]|T)\.\d+(,\d+)?nm")


class Image(NamedTuple):
    """A picture from a file, top row first.

    `pixels` (rows, columns, channels) float32; `linear`: whether they are proportional to light, or encoded with a
    transfer function (sRGB's) and in [0, 1]; `channels`: their names; `metadata`: what the file says in words.
    """

    pixels: np.ndarray
    linear: bool
    channels: tuple[str, ...]
    metadata: dict[str, str]


def read_image(path: str | Path, *, decode: bool = False) -> Image:
    """Read a picture; `decode` takes sRGB's transfer function off PNG and JPEG (their alpha stays as it is).

    Cameras' marks of how they were held are obeyed; embedded colour profiles are not. Of a file of several pictures
    the first is read.

    **Raises:** `ValueError` for an unknown suffix or a broken file, `OSError` for one that cannot be opened.
    """
    _check_suffix(path, READABLE)
    with open(path, "rb"):  # the system's word on files that are missing or forbidden
        pass
    import OpenImageIO as oiio

    wishes = oiio.ImageSpec()
    wishes.attribute("oiio:UnassociatedAlpha", 1)  # else colours come multiplied by alpha
    file = oiio.ImageInput.open(str(path), wishes)
    if file is None:
        raise ValueError(f"{path}: not a picture that can be read ({_first_line(oiio.geterror())})")
    try:
        spec = file.spec()
        values = file.read_image("float")
        complaint = file.geterror()  # of a JPEG that is cut short there is one, and values all the same
        if values is None or complaint:
            raise ValueError(f"{path}: the picture is broken ({_first_line(complaint)})")
    finally:
        file.close()
    pixels = np.asarray(values, np.float32).reshape(spec.height, spec.width, spec.nchannels)
    if (orientation := spec.get_int_attribute("Orientation", 1)) != 1:
        held = oiio.ImageBuf(np.ascontiguousarray(pixels))
        held.specmod().attribute("Orientation", orientation)
        pixels = np.asarray(oiio.ImageBufAlgo.reorient(held).get_pixels("float"))
    linear = Path(path).suffix.lower() in (".exr", ".hdr")
    if decode and not linear:
        colours = [i for i, name in enumerate(spec.channelnames) if name != "A"]
        pixels[..., colours] = srgb_decode(pixels[..., colours])
    metadata = {a.name: a.value for a in spec.extra_attribs if isinstance(a.value, str)}
    return Image(pixels, linear or decode, tuple(spec.channelnames), metadata)


def write_png(path: str | Path, encoded, *, bits: int = 8, remark: str = "") -> int:
    """Write sRGB-encoded values (rows, columns, 3) in [0, 1] as a PNG of 8 or 16 bits, rounded to the nearest step.

    Returns how many pixels were clipped: those with a component beyond [0, 1] by more than half a step. `remark` goes
    into the file's description. Equal values give equal bytes.

    **Raises:** `ValueError` for another shape, suffix or number of bits and for values that are not finite.
    """
    check_writable(path)
    data, clipped = encode_png(path, encoded, bits=bits, remark=remark)
    write_atomically(path, data)
    return clipped


def encode_png(path: str | Path, encoded, *, bits: int = 8, remark: str = "") -> tuple[bytes, int]:
    """The bytes that `write_png` writes, and how many pixels were clipped; `path` is only named in errors."""
    _check_suffix(path, (".png",))
    values = _pixels(encoded, 3)
    if bits not in (8, 16):
        raise ValueError(f"a PNG has 8 or 16 bits, got {bits}")
    if not np.isfinite(values).all():
        raise ValueError(f"{path}: {int((~np.isfinite(values)).any(-1).sum())} pixels are not finite")
    most = 2**bits - 1
    steps = np.rint(values.astype(np.float64) * most)
    clipped = int(((steps < 0) | (steps > most)).any(-1).sum())
    attributes = {"Software": "irisjax", "oiio:ColorSpace": "srgb_rec709_scene"}
    data = _encoded(
        path,
        np.clip(steps, 0, most).astype(np.uint8 if bits == 8 else np.uint16),
        ("R", "G", "B"),
        attributes | ({"ImageDescription": remark} if remark else {}),
    )
    return data, clipped


def write_exr(
    path: str | Path, image, channels: Sequence[str] = ("R", "G", "B"), metadata: Mapping[str, str] | None = None
) -> None:
    """Write linear values (rows, columns, channels) as OpenEXR, 32-bit floats, ZIP without loss.

    Channels named by `spectral_channels` make it a spectral image [Fichet, Pacanowski & Wilkie 2021]. The file keeps
    its channels by name, so readers may find them in another order. Equal values give equal bytes.

    **Raises:** `ValueError` for another shape or suffix, and for names that stand twice or not once a channel.
    """
    check_writable(path)
    write_atomically(path, encode_exr(path, image, channels, metadata))


def encode_exr(
    path: str | Path, image, channels: Sequence[str] = ("R", "G", "B"), metadata: Mapping[str, str] | None = None
) -> bytes:
    """The bytes that `write_exr` writes; `path` is only named in errors."""
    _check_suffix(path, (".exr",))
    values = _pixels(image, len(channels))
    if len(set(channels)) != len(channels):
        raise ValueError(f"{path}: a channel name stands twice")
    attributes = {"Software": "irisjax", "compression": "zip"}
    if any(_SPECTRAL.fullmatch(name) for name in channels):
        attributes["spectralLayoutVersion"] = "1.0"
    return _encoded(path, values.astype(np.float32), channels, attributes | dict(metadata or {}))


def write_gif(path: str | Path, frames: Sequence[np.ndarray], seconds: float) -> None:
    """Write pictures (rows, columns, 3), encoded sRGB in [0, 1], as an endless GIF that lasts `seconds` a round."""
    from PIL import Image as Pillow

    _check_suffix(path, (".gif",))
    pictures = [Pillow.fromarray(np.rint(255 * np.clip(np.asarray(f), 0, 1)).astype(np.uint8)) for f in frames]
    buffer = BytesIO()
    each = round(1000 * seconds / len(pictures))
    pictures[0].save(buffer, "gif", save_all=True, append_images=pictures[1:], duration=each, loop=0)
    write_atomically(path, buffer.getvalue())


def spectral_channels(wavelengths: Iterable[float], layer: str = "S0") -> tuple[str, ...]:
    """Channel names of a spectral image, such as S0.550,0nm [Fichet, Pacanowski & Wilkie 2021].

    Layer `"S0"` (to `"S3"`, Stokes components) is for radiance, `"T"` for reflectance; wavelengths in nm.
    """
    if layer not in ("S0", "S1", "S2", "S3", "T"):
        raise ValueError(f"unknown layer {layer!r}; known: S0, S1, S2, S3, T")
    numbers = (np.format_float_positional(w, trim="0") for w in np.asarray(wavelengths, np.float64))
    return tuple(f"{layer}.{number.replace('.', ',')}nm" for number in numbers)


def read_environment(path: str | Path) -> Environment:
    """A latitude-longitude panorama, twice as wide as high, as an `Environment`; PNG and JPEG are decoded.

    Values are taken as linear sRGB. **Raises:** as `read_image`, and `ValueError` for other pictures.
    """
    image = read_image(path, decode=True)
    rows, columns = image.pixels.shape[:2]
    if columns != 2 * rows:
        raise ValueError(f"{path}: a latitude-longitude map is twice as wide as high, this is {columns} × {rows}")
    if not {"R", "G", "B"} <= set(image.channels):
        raise ValueError(f"{path}: an environment needs the channels R, G, B, found {', '.join(image.channels)}")
    rgb = image.pixels[..., [image.channels.index(c) for c in "RGB"]]
    try:
        return Environment(rgb)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _encoded(path: str | Path, values: np.ndarray, channels: Sequence[str], attributes: Mapping[str, str]) -> bytes:
    import OpenImageIO as oiio

    rows, columns, n = values.shape
    spec = oiio.ImageSpec(columns, rows, n, _TYPES[values.dtype.name])
    spec.channelnames = tuple(channels)
    spec.attribute("DateTime", "")  # left to itself, OpenEXR's writer stamps the hour
    for name, value in attributes.items():
        spec.attribute(name, value)
    # OpenImageIO writes to files only; through bytes our own rules for new files hold.
    with tempfile.TemporaryDirectory() as folder:
        temporary = Path(folder, "image" + Path(path).suffix.lower())
        file = oiio.ImageOutput.create(str(temporary))
        if not (file and file.open(str(temporary), spec) and file.write_image(values) and file.close()):
            raise ValueError(f"{path}: {_first_line(file.geterror() if file else oiio.geterror())}")
        return temporary.read_bytes()


def _pixels(image, channels: int) -> np.ndarray:
    values = np.ascontiguousarray(image)
    if values.ndim != 3 or values.shape[2] != channels or 0 in values.shape:
        raise ValueError(f"a picture has the shape (rows, columns, {channels}), got {values.shape}")
    return values


def _check_suffix(path: str | Path, suffixes: tuple[str, ...]) -> None:
    if Path(path).suffix.lower() not in suffixes:
        raise ValueError(f"{path}: a picture's name must end in {' or '.join(suffixes)}")


def _first_line(text: str) -> str:
    return text.strip().split("\n")[0] or "no reason given"
