"""Pictures in and out: OpenEXR and Radiance for linear values, PNG and JPEG for encoded ones.

The formats are OpenImageIO's work; it is imported when a picture is first asked for.
"""

import itertools
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from irisjax.io.decoding import check_suffix, decode_file, first_line
from irisjax.io.tables import check_writable, replacing
from irisjax.measure.colour import srgb_decode
from irisjax.render.environment import Environment

T = TypeVar("T")

READABLE = (".exr", ".hdr", ".png", ".jpg", ".jpeg")
"""Kinds of picture that can be read."""

_TYPES = {
    "uint8": "uint8",
    "uint16": "uint16",
    "float32": "float",
}  # OpenImageIO makes halves of "float32"
_SPECTRAL = re.compile(r"(S[0-3]|T)\.\d+(,\d+)?nm")


class Image(NamedTuple):
    """A picture from a file, top row first.

    `pixels` (rows, columns, channels) float32; `linear`: whether they are proportional to light, or
    encoded with a transfer function (sRGB's) and in [0, 1]; `channels`: their names; `metadata`:
    what the file says in words.
    """

    pixels: np.ndarray
    linear: bool
    channels: tuple[str, ...]
    metadata: dict[str, str]


def read_image(path: str | Path, *, decode: bool = False) -> Image:
    """Read a picture; `decode` takes sRGB's transfer function off PNG and JPEG (their alpha stays
    as it is).

    Cameras' marks of how they were held are obeyed; embedded colour profiles are not. Of a file of
    several pictures the first is read.

    **Raises:** `ValueError` for an unknown suffix or a broken file, `OSError` for one that cannot
    be opened.
    """
    pixels, spec, _ = decode_file(path, READABLE, integers=False)
    linear = Path(path).suffix.lower() in (".exr", ".hdr")
    if decode and not linear:
        colours = [i for i, name in enumerate(spec.channelnames) if name != "A"]
        pixels[..., colours] = srgb_decode(pixels[..., colours])
    metadata = {a.name: a.value for a in spec.extra_attribs if isinstance(a.value, str)}
    return Image(pixels, linear or decode, tuple(spec.channelnames), metadata)


def write_png(
    path: str | Path, encoded, *, bits: int = 8, remark: str = "", rows: int | None = None
) -> int:
    """Write sRGB-encoded values (rows, columns, 3) in [0, 1] as a PNG of 8 or 16 bits, rounded to
    the nearest step.

    Returns how many pixels were clipped: those with a component beyond [0, 1] by more than half a
    step. `remark` goes into the file's description. Equal values give equal bytes. With `rows`,
    their number in all, `encoded` is an iterator of bands from the top to the bottom, each written
    as it comes.

    **Raises:** `ValueError` for another shape, suffix or number of bits and for values that are not
    finite.
    """
    check_suffix(path, (".png",))
    clipped = 0

    def steps():
        nonlocal clipped
        for band in [encoded] if rows is None else encoded:
            values, out = to_steps(path, band, bits)
            clipped += out
            yield values

    attributes = {"Software": "irisjax", "oiio:ColorSpace": "srgb_rec709_scene"}
    if remark:
        attributes["ImageDescription"] = remark
    _write(path, steps(), rows, ("R", "G", "B"), attributes)
    return clipped


def write_exr(
    path: str | Path,
    image,
    channels: Sequence[str] = ("R", "G", "B"),
    metadata: Mapping[str, str] | None = None,
    rows: int | None = None,
) -> None:
    """Write linear values (rows, columns, channels) as OpenEXR, 32-bit floats, ZIP without loss.

    Channels named by `spectral_channels` make it a spectral image [Fichet, Pacanowski & Wilkie
    2021]. The file keeps its channels by name, so readers may find them in another order. Equal
    values give equal bytes. `rows` as of `write_png`.

    **Raises:** `ValueError` for another shape or suffix, and for names that stand twice or not once
    a channel.
    """
    check_suffix(path, (".exr",))
    if len(set(channels)) != len(channels):
        raise ValueError(f"{path}: a channel name stands twice")
    attributes = {"Software": "irisjax", "compression": "zip"}
    if any(_SPECTRAL.fullmatch(name) for name in channels):
        attributes["spectralLayoutVersion"] = "1.0"
    bands = (
        _pixels(band, len(channels)).astype(np.float32)
        for band in ([image] if rows is None else image)
    )
    _write(path, bands, rows, channels, attributes | dict(metadata or {}))


def encode_png(path: str | Path, encoded, *, bits: int = 8, remark: str = "") -> tuple[bytes, int]:
    """The bytes that `write_png` writes, and how many pixels were clipped; `path` is only named in
    errors.
    """
    return _bytes(path, lambda there: write_png(there, encoded, bits=bits, remark=remark))


def encode_exr(
    path: str | Path,
    image,
    channels: Sequence[str] = ("R", "G", "B"),
    metadata: Mapping[str, str] | None = None,
) -> bytes:
    """The bytes that `write_exr` writes; `path` is only named in errors."""
    return _bytes(path, lambda there: write_exr(there, image, channels, metadata))[0]


def _bytes(path: str | Path, write: Callable[[Path], T]) -> tuple[bytes, T]:
    with tempfile.TemporaryDirectory() as folder:
        there = Path(folder, Path(path).name)
        try:
            found = write(there)
        except ValueError as error:
            raise ValueError(str(error).replace(str(there), str(path))) from None
        return there.read_bytes(), found


def spectral_channels(wavelengths: Iterable[float], layer: str = "S0") -> tuple[str, ...]:
    """Channel names of a spectral image, such as S0.550,0nm [Fichet, Pacanowski & Wilkie 2021].

    Layer `"S0"` (to `"S3"`, Stokes components) is for radiance, `"T"` for reflectance; wavelengths
    in nm.
    """
    if layer not in ("S0", "S1", "S2", "S3", "T"):
        raise ValueError(f"unknown layer {layer!r}; known: S0, S1, S2, S3, T")
    numbers = (np.format_float_positional(w, trim="0") for w in np.asarray(wavelengths, np.float64))
    return tuple(f"{layer}.{number.replace('.', ',')}nm" for number in numbers)


def read_environment(path: str | Path) -> Environment:
    """A latitude-longitude panorama, twice as wide as high, as an `Environment`; PNG and JPEG are
    decoded.

    Values are taken as linear sRGB. **Raises:** as `read_image`, and `ValueError` for other
    pictures.
    """
    image = read_image(path, decode=True)
    rows, columns = image.pixels.shape[:2]
    if columns != 2 * rows:
        raise ValueError(
            f"{path}: a latitude-longitude map is twice as wide as high, this is {columns} × {rows}"
        )
    if not {"R", "G", "B"} <= set(image.channels):
        raise ValueError(
            f"{path}: an environment needs the channels R, G, B, found {', '.join(image.channels)}"
        )
    rgb = image.pixels[..., [image.channels.index(c) for c in "RGB"]]
    try:
        return Environment(rgb)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def to_steps(path: str | Path, encoded, bits: int) -> tuple[np.ndarray, int]:
    """Encoded values (rows, columns, 3) as whole numbers of 8 or 16 bits, and how many pixels were
    clipped.

    **Raises:** as `write_png`.
    """
    values = _pixels(encoded, 3)
    if bits not in (8, 16):
        raise ValueError(f"a PNG has 8 or 16 bits, got {bits}")
    if not np.isfinite(values).all():
        raise ValueError(
            f"{path}: {int((~np.isfinite(values)).any(-1).sum())} pixels are not finite"
        )
    most = 2**bits - 1
    steps = np.rint(values.astype(np.float64) * most)
    clipped = int(((steps < 0) | (steps > most)).any(-1).sum())
    return np.clip(steps, 0, most).astype(np.uint8 if bits == 8 else np.uint16), clipped


def _write(
    path: str | Path,
    bands: Iterator[np.ndarray],
    rows: int | None,
    channels: Sequence[str],
    attributes: Mapping[str, str],
) -> None:
    check_writable(path)
    import OpenImageIO as oiio

    first = next(bands)
    rows = len(first) if rows is None else rows
    spec = oiio.ImageSpec(first.shape[1], rows, len(channels), _TYPES[first.dtype.name])
    spec.channelnames = tuple(channels)
    spec.attribute("DateTime", "")  # left to itself, OpenEXR's writer stamps the hour
    for name, value in attributes.items():
        spec.attribute(name, value)
    with replacing(path) as temporary:
        file = oiio.ImageOutput.create(
            Path(path).suffix[1:].lower()
        )  # by kind: the temporary name says nothing
        if not (file and file.open(str(temporary), spec)):
            raise ValueError(f"{path}: {first_line(file.geterror() if file else oiio.geterror())}")
        done = 0
        try:
            for band in itertools.chain([first], bands):
                if done + band.shape[0] > rows or band.shape[1:] != first.shape[1:]:
                    raise ValueError(f"{path}: a band of {band.shape} after {done} of {rows} rows")
                if not file.write_scanlines(done, done + band.shape[0], 0, band):
                    raise ValueError(f"{path}: {first_line(file.geterror())}")
                done += band.shape[0]
        finally:
            closed = file.close()
        if done != rows or not closed:
            raise ValueError(
                f"{path}: "
                f"{first_line(file.geterror()) if done == rows else f'{done} of {rows} rows'}"
            )


def _pixels(image, channels: int) -> np.ndarray:
    values = np.ascontiguousarray(image)
    if values.ndim != 3 or values.shape[2] != channels or 0 in values.shape:
        raise ValueError(f"a picture has the shape (rows, columns, {channels}), got {values.shape}")
    return values
