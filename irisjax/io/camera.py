"""The focal length in Exif, and raw files of cameras."""

import contextlib
import math
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from io import BytesIO
from pathlib import Path

import numpy as np

RAW = (
    *(".dng", ".nef", ".nrw", ".cr2", ".cr3", ".crw", ".arw", ".sr2", ".raf", ".orf", ".rw2"),
    *(".pef", ".srw", ".rwl", ".iiq", ".3fr", ".fff", ".mrw", ".x3f", ".kdc", ".erf"),
)
"""Kinds of raw file that LibRaw reads."""

_LONGEST = 1e5  # focal length in pixels that Exif is believed
_DIAGONAL = math.hypot(36, 24)  # mm, of 35 mm film [CIPA DCG-001]
_PER_MM = {2: 1 / 25.4, 3: 0.1, 4: 1.0, 5: 1000.0}  # Exif's units of the focal plane's resolution


def focal_px(exif: Mapping[str, float], shape: tuple[int, int], notes: list[str]) -> float | None:
    """Return the focal length in pixels of a picture, `None` if Exif has no credible one.

    It follows from `FocalLengthIn35mmFilm` by the diagonals of picture and film, else from
    `FocalLength` (mm) and `FocalPlaneXResolution`; both are scaled from `PixelXDimension` to the
    picture's pixels.

    Args:
        exif: Numbers of Exif by their names.
        shape: Rows and columns as the file stores them.
        notes: Gets sentences on how the focal length was found.
    """
    tags = defaultdict(float, {k: v for k, v in exif.items() if math.isfinite(v)})
    extent, scale = _exposed_size(tags, shape, notes)
    by_film = tags["FocalLengthIn35mmFilm"] / _DIAGONAL * math.hypot(*extent) * scale
    per_mm = _PER_MM.get(int(tags.get("FocalPlaneResolutionUnit", 2)), 0.0)
    by_plane = tags["FocalLength"] * tags["FocalPlaneXResolution"] * per_mm * scale
    estimates = {"the 35 mm equivalent": by_film, "the focal plane's resolution": by_plane}
    for source in [s for s, value in estimates.items() if not 0 < value <= _LONGEST]:
        if value := estimates.pop(source):
            notes.append(f"A focal length of {value:.3g} pixels from {source} is ignored.")
    if not estimates:
        return None
    if len(estimates) == 2 and not 0.9 < by_plane / by_film < 1.1:
        notes.append(
            f"Exif contradicts itself on the focal length: {by_film:.0f} pixels from the 35 mm "
            f"equivalent (taken), {by_plane:.0f} from the focal plane's resolution."
        )
    source, value = next(iter(estimates.items()))
    notes.append(f"Focal length: {value:.0f} pixels, from {source} in Exif.")
    return value


def _exposed_size(
    tags: Mapping[str, float], shape: tuple[int, int], notes: list[str]
) -> tuple[list[int], float]:
    """Return the sides of the picture as it was taken, pixels, and its scale since then."""
    now = sorted(shape)
    size = sorted(int(tags.get(f"Pixel{axis}Dimension", 0)) for axis in "XY")
    if size[0] < 1 or size == now:
        return now, 1.0
    small, large = (n / t for n, t in zip(now, size, strict=True))
    sizes = f"{size[1]} × {size[0]} pixels to {now[1]} × {now[0]}"
    if max(abs(n - t * large) for n, t in zip(now, size, strict=True)) <= 2:
        notes.append(f"Exif states that the picture was resized from {sizes}.")
        return size, large
    if max(small, large) <= 1:
        notes.append(f"Exif states {sizes}: the picture is taken as a full-size detail.")
        return size, 1.0
    notes.append(f"Exif's size does not fit the picture ({sizes}) and is ignored.")
    return now, 1.0


def develop(
    path: str | Path, check: Callable[[int, int], None]
) -> tuple[np.ndarray, np.ndarray, dict[str, float], list[str]]:
    """Read a raw file by LibRaw: camera's white balance, 16 bits, no brightening, held upright;
    `check(rows, columns)` may refuse the size before colours are filled in.

    Returns:
        Linear values on sRGB's primaries, 1 being the sensor's white level; the pixels that a
        photosite at its white level takes part in; numbers by their names in Exif; notes.
    """
    with open(path, "rb"):  # the system's word on files that are missing or forbidden
        pass
    try:
        import rawpy
    except ImportError:
        need = "camera raw files need rawpy: install irisjax[raw] (pip install rawpy)"
        raise ValueError(need) from None
    try:
        with rawpy.imread(str(path)) as raw:
            check(raw.sizes.height, raw.sizes.width)
            sensor = _at_white_level(raw)
            pixels = raw.postprocess(
                gamma=(1, 1),
                no_auto_bright=True,
                use_camera_wb=True,
                output_bps=16,
                output_color=rawpy.ColorSpace.sRGB,
                highlight_mode=rawpy.HighlightMode.Clip,
            )
            notes, flip, exif = [], raw.sizes.flip, _exif_of(path, raw)
            if not any(raw.camera_whitebalance):
                notes.append("The file has no white balance of the camera: LibRaw's own is taken.")
    except rawpy.LibRawError as error:
        message = error.args[0] if error.args else ""
        reason = message.decode() if isinstance(message, bytes) else error
        raise ValueError(f"not a raw file that can be read ({reason})") from None
    # LibRaw's codes, in quarter turns to the left.
    sensor = np.rot90(sensor, {3: 2, 5: 1, 6: 3}.get(flip, 0))
    linear = pixels.astype(np.float32) / np.float32(65535)
    if linear.shape[2] == 1:
        linear = np.repeat(linear, 3, 2)
    saturated: np.ndarray = np.asarray((pixels >= 0.995 * 65535).any(2))
    if sensor.shape == saturated.shape:  # it is not on sensors set askew
        saturated = np.logical_or(saturated, sensor)
    return linear, saturated, exif, notes


@contextlib.contextmanager
def quietly() -> Iterator[None]:
    """Suppress failures and warnings of Pillow, where only a note or a focal length is lost."""
    with warnings.catch_warnings(), contextlib.suppress(Exception):
        warnings.simplefilter("ignore")
        yield


def _at_white_level(raw) -> np.ndarray:
    """Pixels whose colours are filled in from a photosite, of the nine around, nearly at white."""
    from scipy.ndimage import maximum_filter

    values = raw.raw_image_visible
    black = np.asarray(raw.black_level_per_channel, np.float32)
    white = np.full(4, raw.white_level, np.float32)
    levels = raw.camera_white_level_per_channel
    if levels is not None and all(levels):
        white = np.minimum(white, np.asarray(levels, np.float32))
    limit = black + np.float32(0.995) * (white - black)
    if values.ndim == 3:
        n = values.shape[2]
        return (values >= limit[:n]).any(2)
    return maximum_filter(values >= limit[raw.raw_colors_visible], 3)


def _exif_of(path, raw) -> dict[str, float]:
    """Read Exif's numbers of the file if its layout is that of TIFF, else of its preview."""
    import rawpy
    from PIL import Image

    tags: dict[str, float] = {}
    with quietly():
        exif = Image.Exif()
        with open(path, "rb") as file:
            exif.load_from_fp(file)
            tags = _numbers(exif)
    if "FocalLength" not in tags:
        with quietly():
            preview = raw.extract_thumb()
            if preview.format == rawpy.ThumbFormat.JPEG:
                tags = _numbers(Image.open(BytesIO(preview.data)).getexif())
                # The preview is smaller than the picture that the numbers are about.
                tags = {k: v for k, v in tags.items() if not k.endswith("Dimension")}
    if raw.other.focal_length:
        tags.setdefault("FocalLength", float(raw.other.focal_length))
    return tags


def _numbers(exif) -> dict[str, float]:
    from PIL.ExifTags import IFD, TAGS

    numbers = {}
    for tag, value in exif.get_ifd(IFD.Exif).items():
        with contextlib.suppress(TypeError, ValueError):
            numbers[TAGS.get(tag, "")] = float(value)
    return numbers
