"""`IrisMaps` in files: one OpenEXR, a channel for each map.

Rows are angles, from +x towards +y, columns radii from the pupil's edge to the root, as in
`IrisMaps`. Maps are quantities (mm, shares), not colours, and need more than 8 or 16 bits.
"""

import dataclasses
from pathlib import Path

import numpy as np

from irisjax.io.images import encode_exr, read_image
from irisjax.io.tables import naming, write_atomically
from irisjax.tissue.maps import IrisMaps

RESIDUAL = tuple(f"residual.{name}" for name in "RGB")
MAP_NAMES = tuple(f.name for f in dataclasses.fields(IrisMaps) if f.name != "residual")
"""Channel names of a file of maps, beside `RESIDUAL`."""

_PACKED = {"R": "relief", "G": "abl_depth", "B": "stroma_depth", "A": "freckles"}


def read_maps(path: str | Path) -> IrisMaps:
    """Read maps from an EXR whose channels are named as fields of `IrisMaps` (see `write_maps`).

    An RGB or RGBA file is read in F09's packing [F09 Section 6]: R relief, G depth of the ABL, B of
    the stroma (all mm), A freckles (0 to 1). `ValueError` for other channels, for values that no
    iris has and for a broken file.
    """
    with naming(path):
        if Path(path).suffix.lower() != ".exr":
            raise ValueError("a file of maps must end in .exr")
        image = read_image(path)
        channels = dict(zip(image.channels, np.moveaxis(image.pixels, -1, 0), strict=True))
        if set(channels) in ({"R", "G", "B"}, {"R", "G", "B", "A"}):
            channels = {_PACKED[name]: values for name, values in channels.items()}
        colours = [channels.pop(name) for name in RESIDUAL] if RESIDUAL[0] in channels else []
        if unknown := ", ".join(repr(name) for name in channels if name not in MAP_NAMES):
            known = f"{', '.join(MAP_NAMES)}, {', '.join(RESIDUAL)}, or exactly R, G, B[, A]"
            raise ValueError(f"unknown channel {unknown}; maps have channels among {known}")
        if colours:
            channels["residual"] = np.stack(colours, -1)
        return IrisMaps(**channels)


def write_maps(path: str | Path, maps: IrisMaps) -> None:
    """Write the maps that are present as an EXR of 32-bit floats."""
    write_atomically(path, encode_maps(path, maps))


def encode_maps(path: str | Path, maps: IrisMaps) -> bytes:
    """The bytes that `write_maps` writes; `path` is only named in errors."""
    present = maps.present()
    if not present:
        raise ValueError(f"{path}: there are no maps to write")
    comment = "rows angles, columns radii from the pupil; mm, freckles 0 to 1, others relative"
    if "residual" in present:
        colours = np.moveaxis(np.asarray(present.pop("residual")), -1, 0)
        present |= zip(RESIDUAL, colours, strict=True)
    image = np.stack(list(present.values()), axis=-1)
    return encode_exr(path, image, tuple(present), {"comments": f"maps of an iris: {comment}"})
