"""A photograph beside its rendering: one picture made of both."""

import numpy as np
from jaxtyping import UInt8

RgbPicture = UInt8[np.ndarray, "_ _ 3"]
"""sRGB, 8 bits, rows and columns of any number: two pictures need not agree."""
_LINE = 255
_PER_LINE = 400  # columns of the picture for each column of the line


def wiped(photograph: RgbPicture, rendered: RgbPicture, share: float) -> RgbPicture:
    """Columns of the photograph on the left up to `share` of the width, the rendering on the right,
    a thin white line between them; 0 and 1 show one of them alone.

    Raises:
        ValueError: The pictures have different sizes, or the share is not in 0 to 1.
    """
    if photograph.shape != rendered.shape:
        (rows, columns, _), (height, width, _) = photograph.shape, rendered.shape
        raise ValueError(
            f"the photograph has {columns} x {rows} pixels, the rendering {width} x {height}"
        )
    if not 0 <= share <= 1:
        raise ValueError(f"photograph = {share:g}: must be from 0 to 1, the share of the width")
    columns = rendered.shape[1]
    edge = round(share * columns)
    both = np.concatenate([photograph[:, :edge], rendered[:, edge:]], axis=1)
    if 0 < edge < columns:
        thick = max(1, round(columns / _PER_LINE))
        start = max(edge - (thick + 1) // 2, 0)
        both[:, start : start + thick] = _LINE
    return both


def resized(picture: RgbPicture, size: tuple[int, int]) -> RgbPicture:
    """The picture at another (width, height), each pixel the mean of what it covers, to one
    level; the same picture for its own size.

    Raises:
        ValueError: The sides are in another proportion, by more than rounding.
    """
    height, width = picture.shape[:2]
    if size == (width, height):
        return picture
    if abs(size[0] * height - size[1] * width) > max(width, height):
        raise ValueError(
            f"{size[0]}x{size[1]}: the photograph has {width}x{height} pixels, sides must be in "
            "that proportion"
        )
    from PIL import Image

    return np.array(Image.fromarray(picture).resize(size, Image.Resampling.BOX), np.uint8)
