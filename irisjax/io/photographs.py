"""Photographs of all kinds, cameras' raw files too, as pixels in proportion to light."""

import importlib
import tempfile
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from irisjax.io.camera import RAW, develop, focal_px, quietly
from irisjax.io.images import decode_file
from irisjax.io.profiles import profile_to_linear, srgb_to_linear
from irisjax.io.tables import naming
from irisjax.measure.colour import srgb_encode
from irisjax.photo.photograph import Photograph

if TYPE_CHECKING:
    import OpenImageIO

PHOTOGRAPHS = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".exr", ".webp")
"""Suffixes of photographs that can be read besides `camera.RAW` and `HEIF`."""
HEIF = (".heic", ".heif")
"""Suffixes of telephones' photographs, which need `pillow_heif`."""
MOST_PIXELS, LEAST_SIDE = 100_000_000, 64
"""Most pixels of a picture, and least number along its shorter side."""

_SATURATED = 0.995  # of the largest value a file can hold
_SMALL = 1e-3  # negative values of this size are a resampling filter's or a sensor's noise
_BRIGHT = 0.995  # share of a linear file's pixels that are darker than what is set to 1
_MOST = 1e4  # brighter pixels are a sensor's or a renderer's faults
_UNITS = 0.3, 3.0  # within which that is left as it is
_ROWS = 256
_ENCODINGS = ("", "srgb_rec709_scene", "srgb_rec709_display", "sRGB", "lin_rec709_scene")


def read_photograph(path: str | Path) -> Photograph:
    """Read a photograph; pixels are linear float32 on sRGB's primaries, upright according to Exif.

    JPEG, PNG, WebP, HEIC and TIFF of 8 or 16 bits are decoded by their embedded ICC profile, or
    else as sRGB. HEIC needs `pillow_heif` (`irisjax[heic]`).
    OpenEXR, and TIFF of floating point, are taken as linear; they have no largest value, so none of
    their pixels counts as saturated. If their brightest pixels are far from 1, all are divided by
    these. Camera raw files need `rawpy` (`irisjax[raw]`) and get the camera's white balance. Of a
    file with several pictures the first is read. Transparency is ignored. The notes of the result
    name every assumption. Colours outside sRGB have negative components.

    Raises:
        ValueError: For another suffix, a broken or truncated file, more than `MOST_PIXELS` pixels
            or fewer than `LEAST_SIDE` along a side, CMYK, layered channels, values that are not
            finite, raw files without `rawpy` and HEIC without `pillow_heif`.
        OSError: If the file cannot be opened.
    """
    suffix, name = Path(path).suffix.lower(), Path(path).name
    if suffix in HEIF:
        with naming(path), tempfile.TemporaryDirectory() as folder:
            file = _as_png(path, Path(folder))
            return read_photograph(file)._replace(name=name)
    if suffix not in (*RAW, *PHOTOGRAPHS):
        kinds = f"{', '.join((*PHOTOGRAPHS, *HEIF))}, or of camera raw in {' '.join(RAW)}"
        raise ValueError(f"{path}: a photograph's name must end in {kinds}")
    with naming(path):
        if suffix in RAW:
            pixels, saturated, exif, notes = develop(path, _check_size)
            size, grey = saturated.shape, _is_grey(pixels)
        else:
            values, spec, more = decode_file(path, PHOTOGRAPHS, integers=True, check=_check)
            size, exif, notes = (spec.height, spec.width), _exif(spec), []
            if more or _several(path, suffix):
                notes.append("The file holds several pictures: the first is read.")
            values = _colours(values, spec, notes)
            pixels = _linear(values, spec, notes)
            if values.dtype.kind == "f":
                pixels = values = _to_unit(pixels, notes)
            grey, saturated = _is_grey(values), np.zeros(pixels.shape[:2], bool)
            if values.dtype.kind == "u":
                saturated = _any(values >= _SATURATED * np.iinfo(values.dtype).max)
    focal = focal_px(exif, size, notes)
    _settle_negatives(pixels, notes)
    return Photograph(pixels, saturated, grey, focal, name, tuple(notes))


def _as_png(path: str | Path, folder: Path) -> Path:
    """Write a HEIC file as a PNG with its profile and Exif."""
    with open(path, "rb"):  # the system's word on files that are missing or forbidden
        pass
    try:
        # The module is imported by its name, so that types are checked alike with and without it.
        pillow_heif: Any = importlib.import_module("pillow_heif")
    except ImportError:
        need = "HEIC needs pillow_heif: install irisjax[heic] (pip install pillow-heif), or convert"
        raise ValueError(f"{need} the photograph to JPEG") from None
    try:
        image = pillow_heif.open_heif(path).to_pillow()
    except (ValueError, OSError, RuntimeError) as error:
        raise ValueError(f"not a picture that can be read ({error})") from None
    png = folder / "photograph.png"
    metadata = {n: image.info[n] for n in ("icc_profile", "exif") if image.info.get(n)}
    image.convert("RGB").save(png, compress_level=1, **metadata)
    return png


def _check(spec: "OpenImageIO.ImageSpec") -> None:
    _check_size(spec.height, spec.width)
    spaces = (spec.get_string_attribute(f"{kind}:ColorSpace") for kind in ("tiff", "jpeg"))
    if space := next((space for space in spaces if space in ("CMYK", "YCCK")), None):
        raise ValueError(f"a {space} picture for printing; convert it to RGB first")
    if spec.deep or spec.depth > 1:
        raise ValueError("a picture with values in depth; a photograph has one a pixel")
    if str(spec.format) not in ("uint8", "uint16", "half", "float", "double"):
        raise ValueError(f"values are {spec.format}; read are 8 and 16 bits and floats")
    if (colours := _colour_channels(spec)) != ["R", "G", "B"] and len(colours) != 1:
        names = ", ".join(spec.channelnames)
        raise ValueError(f"a photograph has the channels R, G, B or one of grey, this has {names}")


def _check_size(rows: int, columns: int) -> None:
    size = f"{columns} × {rows} pixels"
    if rows * columns > MOST_PIXELS:
        raise ValueError(f"{size} are more than {MOST_PIXELS / 1e6:.0f} million; make it smaller")
    if min(rows, columns) < LEAST_SIDE:
        raise ValueError(f"{size}; a photograph has at least {LEAST_SIDE} along each side")


def _colour_channels(spec: "OpenImageIO.ImageSpec") -> list[str]:
    names = list(spec.channelnames)
    return ["R", "G", "B"] if {"R", "G", "B"} <= set(names) else [n for n in names if n != "A"]


def _colours(values: np.ndarray, spec: "OpenImageIO.ImageSpec", notes: list[str]) -> np.ndarray:
    """Values without alpha; a note is added if there was some."""
    names = list(spec.channelnames)
    if "A" in names:
        most = np.iinfo(values.dtype).max if values.dtype.kind == "u" else 1
        if (values[..., names.index("A")] < most).any():
            notes.append("Transparency is left out: colours are as opaque pixels would have them.")
    indices = [names.index(name) for name in _colour_channels(spec)]
    in_order = indices == list(range(len(names)))
    return values if in_order else np.ascontiguousarray(values[..., indices])


def _linear(values: np.ndarray, spec: "OpenImageIO.ImageSpec", notes: list[str]) -> np.ndarray:
    profile = spec.getattribute("ICCProfile")
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        count = int(_any(~np.isfinite(values)).sum())
        raise ValueError(f"{count} pixels are not finite (infinite or not a number)")
    if profile is not None and len(profile):
        pixels, name = profile_to_linear(values, np.asarray(profile, np.uint8).tobytes())
        notes.append(f"Colours by the embedded profile: {name}.")
        return pixels
    if values.dtype.kind == "f":
        pixels, note = values, "Linear values on sRGB's primaries are assumed"
        if spec.getattribute("chromaticities") is not None:
            note += "; the file's own are not used"
    else:
        pixels, note = srgb_to_linear(values), "Encoded as sRGB: the file has no colour profile"
        encoding = spec.get_string_attribute("oiio:ColorSpace")
        if spec.get_int_attribute("Exif:ColorSpace", 1) != 1:
            note = "Read as sRGB, for want of a colour profile; Exif says that the colour space is "
            note += "another (Adobe RGB in most cameras), so colours may be too dull"
        elif encoding not in _ENCODINGS:
            note = f"Read as sRGB; the file says {encoding}"
    notes.append(f"{note}.")
    return np.repeat(pixels, 3, 2) if pixels.shape[2] == 1 else pixels


def _to_unit(pixels: np.ndarray, notes: list[str]) -> np.ndarray:
    """Linear values near 1, whatever their unit was."""
    brightest = pixels.max(-1)
    if brightest.max() <= 0:
        raise ValueError("no pixel is brighter than 0")
    bright = float(np.quantile(brightest, _BRIGHT))
    if bright > 0 and not _UNITS[0] <= bright <= _UNITS[1]:
        notes.append(f"All values are divided by {bright:.4g}, so that the brightest are about 1.")
        pixels, brightest = (np.asarray(v / bright, np.float32) for v in (pixels, brightest))
    if count := int((brightest > _MOST).sum()):
        notes.append(f"{count} pixels are brighter than {_MOST:g}: they are set to that.")
        pixels = np.minimum(pixels, np.float32(_MOST))
    return pixels


def _settle_negatives(pixels: np.ndarray, notes: list[str]) -> None:
    """Set small negative values to 0, in place; larger ones are colours outside sRGB and stay."""
    if pixels.min() >= 0:
        return
    small = (pixels < 0) & (pixels >= -_SMALL)
    if count := int(small.sum()):
        pixels[small] = 0
        notes.append(f"{count} values between {-_SMALL} and 0 are set to 0.")
    if count := int(_any(pixels < 0).sum()):
        notes.append(f"{count} pixels have negative components (colours beyond sRGB); they stay.")


def _any(of: np.ndarray) -> np.ndarray:
    """Reduce over the channels: NumPy's own reduction over three is five times slower."""
    return reduce(np.logical_or, np.moveaxis(of, -1, 0))


def _is_grey(values: np.ndarray) -> bool:
    """Whether the channels are equal, within a step of 8 bits, everywhere."""
    if values.shape[2] == 1:
        return True
    step = 1 if values.dtype == np.uint8 else 257 if values.dtype == np.uint16 else 1 / 255
    for i in range(0, len(values), _ROWS):
        band = values[i : i + _ROWS]
        if band.dtype.kind == "f":
            band = np.asarray(srgb_encode(band))
        channels = np.moveaxis(band, -1, 0)
        if (reduce(np.maximum, channels) - reduce(np.minimum, channels)).max() > step:
            return False
    return True


def _several(path: str | Path, suffix: str) -> bool:
    """Whether a PNG is animated or a JPEG has more pictures, which OpenImageIO does not report."""
    if suffix in (".exr", ".tif", ".tiff"):
        return False
    from PIL import Image

    with quietly(), Image.open(path) as image:
        return getattr(image, "n_frames", 1) > 1
    return False


def _exif(spec: "OpenImageIO.ImageSpec") -> dict[str, float]:
    # OpenImageIO turns rational numbers into one.
    return {
        attribute.name[5:]: spec.get_float_attribute(attribute.name, 0.0)
        for attribute in spec.extra_attribs
        if attribute.name.startswith("Exif:") and not isinstance(attribute.value, str)
    }
