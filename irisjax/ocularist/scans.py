"""Opacity maps from an artist's own painted layers, scanned  [L03 Section 3.2]."""

import numpy as np
from PIL import Image

from irisjax.numerics.checks import Range, check_range, check_whole
from irisjax.ocularist.component import SIZES
from irisjax.ocularist.strokes import Opacity
from irisjax.render.environment import LUMINANCE

_GREY = Range(0.0, 1.0)


def scan(picture: np.ndarray, size: int) -> Opacity:
    """Opacity = 1 − grey value of a scan: black paint on white paper, row 0 at the top.

    **Arguments:**

    - `picture`: encoded values as a file has them, 8 or 16 bits or floats in [0, 1], of shape
        (n, n) or (n, n, channels): grey, grey and alpha, RGB, or RGB and alpha. The outer edge of
        the iris touches its four sides. Grey is the luminance of the values as they are, not
        decoded; what alpha leaves clear is paper.
    - `size`: texels along a side of the map; others are averaged, or interpolated (bicubic).

    **Raises:** `ValueError` for a picture that is not square, of other numbers, not finite or out
    of range, and for a size out of range.
    """
    check_whole("size", size, *SIZES)
    given = np.asarray(picture)
    if given.ndim not in (2, 3) or (given.ndim == 3 and given.shape[2] not in (1, 2, 3, 4)):
        raise ValueError(f"a scan has shape {given.shape}; need (n, n), or (n, n, 1 to 4 channels)")
    rows, columns = given.shape[:2]
    if rows != columns or rows < 2:
        raise ValueError(
            f"a scan is {columns} × {rows} pixels; it must be square, the outer edge of the iris "
            f"touching its four sides"
        )
    if given.dtype in (np.uint8, np.uint16):
        values = given.astype(np.float32) / np.iinfo(given.dtype).max
    elif np.issubdtype(given.dtype, np.floating):
        check_range("grey value of a scan", given, _GREY)
        values = given.astype(np.float32)
    else:
        raise ValueError(f"a scan of {given.dtype} values; need 8 or 16 bits, or floats in {_GREY}")
    opacity = 1 - _grey(values)
    if rows != size:
        filtered = Image.fromarray(opacity).resize((size, size), Image.Resampling.BICUBIC)
        opacity = np.asarray(filtered)
    return np.clip(opacity, 0, 1).astype(np.float32)


def _grey(values: np.ndarray) -> np.ndarray:
    """Of white paper under what a picture's alpha leaves."""
    if values.ndim == 2:
        return values
    colour, alpha = (
        (values[..., :-1], values[..., -1]) if values.shape[2] in (2, 4) else (values, 1)
    )
    grey = colour @ np.asarray(LUMINANCE, np.float32) if colour.shape[2] == 3 else colour[..., 0]
    return 1 - alpha * (1 - grey)
