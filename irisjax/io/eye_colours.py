"""Files of an eye's colours, and a sheet of many eyes."""

import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from irisjax.io.clones import OVERLAY, overlay_of, summary_of
from irisjax.io.images import encode_png
from irisjax.io.sections import json_of
from irisjax.photo.clone import Outlined
from irisjax.photo.doubts import Doubt
from irisjax.photo.eye_colour import RINGS, EyeColour, RegionColour
from irisjax.photo.masks import Part
from irisjax.photo.overlay import draw_colours

COLOUR_FILES = "colour.json", "colour.png"
"""Names of the files that `colour_files` writes beside the outlines."""
CONTACT_SHEET = "contact_sheet.jpg"
"""Name of the sheet of many eyes."""
_TILE, _LEAST, _AT_FULL_SIZE = 480, 120, 30  # px across a picture of the sheet; eyes shown so large
_ASPECT = 0.58  # of a picture's place
_LABEL = 16  # px of its letters


def colour_files(
    outlined: Outlined,
    measured: tuple[EyeColour, Part] | None,
    settings: Mapping[str, object],
    doubts: Sequence[Doubt],
) -> dict[str, bytes]:
    """Return the files, by name, of an eye's colours and the part of the photograph in which they
    were measured (`None` if its outlines are doubtful), with options of the command.
    """
    summary = summary_of(outlined, settings, {}, doubts)
    files = {OVERLAY: overlay_of(outlined)}
    if measured is not None:
        colours, part = measured
        summary |= _colours(colours)
        picture = draw_colours(colours, part, part.moved(outlined.boundaries.pupil))
        remark = f"colours by irisjax of {outlined.photograph.name}, L*a*b* under D65"
        files[COLOUR_FILES[1]] = encode_png(COLOUR_FILES[1], picture, remark=remark)[0]
    return {COLOUR_FILES[0]: json_of(summary, 6), **files}


def encode_contact_sheet(pictures: Mapping[str, Path | None]) -> bytes:
    """Return the bytes of a JPEG with pictures by their labels; `None` leaves a place empty."""
    count = max(len(pictures), 1)
    wide = round(min(_TILE, max(_LEAST, _TILE * math.sqrt(_AT_FULL_SIZE / count))))
    high, columns = round(_ASPECT * wide), max(1, round(math.sqrt(1.2 * count)))
    step, label = (wide + 8, high + _LABEL + 14), ImageFont.load_default(_LABEL * wide / _TILE + 4)
    size = columns * step[0], -(-count // columns) * step[1]
    sheet = Image.new("RGB", size, (255, 255, 255))
    draw = ImageDraw.Draw(sheet)
    for number, (words, path) in enumerate(pictures.items()):
        left, top = number % columns * step[0], number // columns * step[1]
        if path is not None:
            with Image.open(path) as image:
                small = image.convert("RGB")
                small.thumbnail((wide, high))
                sheet.paste(small, (left, top))
        while len(words) > 4 and draw.textlength(words, label) > wide:
            words = f"{words[: len(words) - 4]}..."
        draw.text((left, top + high + 2), words, (0, 0, 0), label)
    buffer = io.BytesIO()
    sheet.save(buffer, "JPEG", quality=88)
    return buffer.getvalue()


def _colours(colours: EyeColour) -> dict[str, object]:
    """Entries of `colour.json`."""
    regions = {
        name: _region(region) | ({"borders": RINGS[name]} if name in RINGS else {})
        for name, region in colours.regions.items()
    }
    fields: dict[str, object] = {
        "space": "CIE 1976 L*a*b*, D65, 2 degree observer; relative to a perfect white",
        "regions": regions,
        "dominant": [_region(region) for region in colours.dominant],
        "white": {
            "linear_srgb": colours.white.sides,
            "pixels": int(colours.white.pixels.sum()),
            "burnt_share": colours.white.burnt,
        },
        "reflections_linear_srgb": colours.veil,
    }
    if colours.difference is not None:
        ends = ("lab", "q2.5", "q97.5")
        differences = dict(zip(ends, np.asarray(colours.difference), strict=True))
        fields["pupillary_minus_ciliary"] = differences
    return fields


def _region(region: RegionColour) -> dict[str, object]:
    return {
        "lab": region.lab,
        "q2.5": region.low,
        "q97.5": region.high,
        "srgb": region.srgb,
        "share": region.share,
    }
