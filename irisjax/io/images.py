"""Pictures in and out: OpenEXR and Radiance for linear values, PNG and JPEG for encoded ones."""

import itertools
import re
import tempfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from irisjax.io.tables import first_line, naming, replacing
from irisjax.measure.colour import srgb_decode
from irisjax.numerics.checks import check_known
from irisjax.render.environment import Environment

READABLE = (".exr", ".hdr", ".png", ".jpg", ".jpeg")
"""Kinds of picture that can be read."""

_PNG, _LAST = b"\x89PNG\r\n\x1a\n", b"IEND"  # signature and last chunk
_COMPRESSION = 3  # level of PNG: in 0.4 of the time of the usual 6, for a sixth more bytes
_Check = Callable[[Any], None]
_SPECTRAL = re.compile(r"(S[0-3]|T)\.\d+(,\d+)?nm")


class Image(NamedTuple):
    """A picture from a file, float32 (rows, columns, channels), its top row first.

    Attributes:
        linear: Whether pixels are proportional to light, or encoded with sRGB's transfer function
            and in [0, 1].
        metadata: Texts of the file's header.
    """

    pixels: np.ndarray
    linear: bool
    channels: tuple[str, ...]
    metadata: dict[str, str]


def read_image(path: str | Path, *, decode: bool = False) -> Image:
    """Read a picture, the first one of a file of several.

    The orientation that a camera recorded is applied; embedded colour profiles are not. With
    `decode` sRGB's transfer function is inverted for PNG and JPEG, not for alpha. `ValueError` for
    an unknown suffix or a broken file.
    """
    pixels, spec, _ = decode_file(path, READABLE, integers=False)
    linear = Path(path).suffix.lower() in (".exr", ".hdr")
    if decode and not linear:
        colours = [i for i, name in enumerate(spec.channelnames) if name != "A"]
        pixels[..., colours] = srgb_decode(pixels[..., colours])
    metadata = {a.name: a.value for a in spec.extra_attribs if isinstance(a.value, str)}
    return Image(pixels, linear or decode, tuple(spec.channelnames), metadata)


def write_png(
    path: str | Path, encoded: Any, *, bits: int = 8, remark: str = "", rows: int | None = None
) -> int:
    """Write sRGB-encoded values in [0, 1] as a PNG, rounded to the nearest step. Equal values give
    equal bytes.

    Args:
        path: The file.
        encoded: Values (rows, columns, 3); with `rows`, an iterator of bands from the top to the
            bottom, each written as it comes.
        bits: 8 or 16.
        remark: The file's description.
        rows: Total number of rows of the bands.

    Returns:
        The number of clipped pixels: those with a component beyond [0, 1] by more than half a step.

    Raises:
        ValueError: for another shape, suffix or number of bits and for values that are not finite.
    """
    clipped = 0

    def steps() -> Iterator[np.ndarray]:
        nonlocal clipped
        for band in [encoded] if rows is None else encoded:
            values, out = to_steps(band, bits)
            clipped += out
            yield values

    attributes: dict[str, str | int] = {"ImageDescription": remark} if remark else {}
    attributes |= {"Software": "irisjax", "oiio:ColorSpace": "srgb_rec709_scene"}
    attributes["png:compressionLevel"] = _COMPRESSION
    _write(path, ".png", steps(), rows, ("R", "G", "B"), attributes)
    return clipped


def write_exr(
    path: str | Path,
    image: Any,
    channels: Sequence[str] = ("R", "G", "B"),
    metadata: Mapping[str, str] | None = None,
    rows: int | None = None,
) -> None:
    """Write linear values as OpenEXR: 32-bit floats, lossless ZIP. Equal values give equal bytes.

    Args:
        path: The file.
        image: Values (rows, columns, channels), or bands as for `write_png`.
        channels: Names of the channels; readers may find them in another order. Those of
            `spectral_channels` make it a spectral image [Fichet, Pacanowski & Wilkie 2021].
        metadata: Texts of the file's header.
        rows: As for `write_png`.

    Raises:
        ValueError: for another shape or suffix, and unless each channel has one name.
    """
    if len(set(channels)) != len(channels):
        raise ValueError(f"{path}: a channel name appears twice")
    attributes = {"Software": "irisjax", "compression": "zip"}
    if any(_SPECTRAL.fullmatch(name) for name in channels):
        attributes["spectralLayoutVersion"] = "1.0"
    whole = [image] if rows is None else image
    bands = (_pixels(band, len(channels)).astype(np.float32) for band in whole)
    _write(path, ".exr", bands, rows, channels, attributes | dict(metadata or {}))


def encode_png(name: str | Path, encoded: Any, **options: Any) -> tuple[bytes, int]:
    """The bytes that `write_png` writes with these options, and the number of clipped pixels."""
    return _bytes(name, lambda path: write_png(path, encoded, **options))


def encode_exr(name: str | Path, image: Any, *options: Any, **more: Any) -> bytes:
    """The bytes that `write_exr` writes with these options."""
    return _bytes(name, lambda path: write_exr(path, image, *options, **more))[0]


def _bytes(name: str | Path, write: Callable[[Path], Any]) -> tuple[bytes, Any]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, Path(name).name)
        try:
            result = write(path)
        except ValueError as error:
            raise ValueError(str(error).replace(str(path), str(name))) from None
        return path.read_bytes(), result


def spectral_channels(wavelengths: Iterable[float], layer: str = "S0") -> tuple[str, ...]:
    """Channel names of a spectral image, such as S0.550,0nm [Fichet, Pacanowski & Wilkie 2021], of
    wavelengths in nm and the layers `"S0"` (to `"S3"`, Stokes components) for radiance, `"T"` for
    reflectance.
    """
    check_known("layer", layer, ("S0", "S1", "S2", "S3", "T"))
    numbers = (np.format_float_positional(w, trim="0") for w in np.asarray(wavelengths, np.float64))
    return tuple(f"{layer}.{number.replace('.', ',')}nm" for number in numbers)


def read_environment(path: str | Path) -> Environment:
    """Read a latitude-longitude panorama, twice as wide as high, of linear or encoded sRGB."""
    image = read_image(path, decode=True)
    rows, columns = image.pixels.shape[:2]
    if columns != 2 * rows:
        message = f"is twice as wide as high, this is {columns} × {rows}"
        raise ValueError(f"{path}: a latitude-longitude map {message}")
    if not {"R", "G", "B"} <= set(image.channels):
        names = ", ".join(image.channels)
        raise ValueError(f"{path}: an environment needs the channels R, G, B, found {names}")
    with naming(path):
        return Environment(image.pixels[..., [image.channels.index(c) for c in "RGB"]])


def to_steps(encoded: Any, bits: int) -> tuple[np.ndarray, int]:
    """Encoded values as whole numbers of 8 or 16 bits, and the number of clipped pixels."""
    values = _pixels(encoded, 3)
    if bits not in (8, 16):
        raise ValueError(f"a PNG has 8 or 16 bits, got {bits}")
    if not np.isfinite(values).all():
        raise ValueError(f"{(~np.isfinite(values)).any(-1).sum()} pixels are not finite")
    most = 2**bits - 1
    steps = np.rint(values.astype(np.float64) * most)
    clipped = int(((steps < 0) | (steps > most)).any(-1).sum())
    return np.clip(steps, 0, most).astype(np.uint8 if bits == 8 else np.uint16), clipped


def decode_file(
    path: str | Path, suffixes: tuple[str, ...], *, integers: bool, check: _Check | None = None
) -> tuple[np.ndarray, Any, bool]:
    """Decode the first picture of a file, turned upright: values, the header of the picture before
    it was turned, and whether there are more.

    With `integers`, files of 8 and 16 bits give uint8 and uint16; all others give float32, whole
    numbers scaled to [0, 1]. `check` may refuse a header, OpenImageIO's `ImageSpec`.
    """
    with naming(path):
        check_image_suffix(path, suffixes)
        with open(path, "rb") as opened:  # raises for files that are missing or forbidden
            _check_png(opened)
        import OpenImageIO as oiio

        hints = oiio.ImageSpec()
        hints.attribute("oiio:UnassociatedAlpha", 1)  # else colours come multiplied by alpha
        file = oiio.ImageInput.open(str(path), hints)
        if file is None:
            raise ValueError(f"not a picture that can be read ({first_line(oiio.geterror())})")
        try:
            spec = file.spec()
            if check is not None:
                check(spec)
            kind = str(spec.format)
            kind = kind if integers and kind in ("uint8", "uint16") else "float"
            values = file.read_image(kind)
            message = file.geterror()  # a truncated JPEG has values as well as an error
            if values is None or message:
                raise ValueError(f"the picture is broken ({first_line(message)})")
            several = file.seek_subimage(1, 0)
        finally:
            file.close()
    pixels = np.asarray(values).reshape(spec.height, spec.width, spec.nchannels)
    orientation = spec.get_int_attribute("Orientation", 1)
    pixels = pixels.swapaxes(0, 1) if orientation in (5, 6, 7, 8) else pixels
    pixels = pixels[::-1] if orientation in (3, 4, 7, 8) else pixels
    pixels = pixels[:, ::-1] if orientation in (2, 3, 6, 7) else pixels
    return np.ascontiguousarray(pixels), spec, several


def check_image_suffix(path: str | Path, suffixes: tuple[str, ...]) -> None:
    """Raise `ValueError` for a name that ends in none of `suffixes`."""
    if Path(path).suffix.lower() not in suffixes:
        raise ValueError(f"a picture's name must end in {' or '.join(suffixes)}")


def _write(
    path: str | Path,
    suffix: str,
    bands: Iterator[np.ndarray],
    rows: int | None,
    channels: Sequence[str],
    attributes: Mapping[str, str | int],
) -> None:
    with naming(path):
        check_image_suffix(path, (suffix,))
        import OpenImageIO as oiio

        first = next(bands)
        rows = len(first) if rows is None else rows
        # OpenImageIO makes half-precision values of "float32".
        kind = "float" if suffix == ".exr" else first.dtype.name
        spec = oiio.ImageSpec(first.shape[1], rows, len(channels), kind)
        spec.channelnames = tuple(channels)
        spec.attribute("DateTime", "")  # otherwise OpenEXR's writer adds the time
        for name, value in attributes.items():
            spec.attribute(name, value)
        with replacing(path) as temporary:
            # The format is named, since the temporary file's name does not show it.
            file, done = oiio.ImageOutput.create(suffix[1:]), 0
            if not (file and file.open(str(temporary), spec)):
                raise ValueError(first_line(file.geterror() if file else oiio.geterror()))
            try:
                for band in itertools.chain([first], bands):
                    if done + len(band) > rows or band.shape[1:] != first.shape[1:]:
                        raise ValueError(f"a band of {band.shape} after {done} of {rows} rows")
                    if not file.write_scanlines(done, done + len(band), 0, band):
                        raise ValueError(first_line(file.geterror()))
                    done += len(band)
            finally:
                closed = file.close()
            if done != rows:
                raise ValueError(f"{done} of {rows} rows")
            if not closed:
                raise ValueError(first_line(file.geterror()))


def _pixels(image: Any, channels: int) -> np.ndarray:
    values = np.ascontiguousarray(image)
    if values.ndim != 3 or values.shape[2] != channels or 0 in values.shape:
        raise ValueError(f"a picture has the shape (rows, columns, {channels}), got {values.shape}")
    return values


def _check_png(file: BinaryIO) -> None:
    """Raise `ValueError` for a fault in a PNG's chunks, of which libpng would print a line."""
    kind = b"" if file.read(len(_PNG)) == _PNG else _LAST
    while kind != _LAST:
        head = file.read(8)
        count, kind = int.from_bytes(head[:4]), head[4:]
        body, sum_ = file.read(count), file.read(4)
        if len(head + body + sum_) < count + 12:
            raise ValueError("the picture is broken (the file ends in the middle)")
        # A capital marks a critical chunk; libpng ignores faults of the others as well.
        if kind[:1].isupper() and zlib.crc32(kind + body) != int.from_bytes(sum_):
            part = kind.decode("latin-1")
            raise ValueError(f"the picture is broken (its part {part!r} is damaged)")
