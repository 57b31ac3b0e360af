"""Files in and out: tables with headers, measured spectra, posteriors, pictures, movies, scenes,
meshes.
"""

import importlib
from typing import TYPE_CHECKING

from irisjax._lazy import modules_of
from irisjax.io.measured import Measured as Measured
from irisjax.io.measured import Reading as Reading
from irisjax.io.measured import read_eyes as read_eyes
from irisjax.io.measured import read_measured as read_measured
from irisjax.io.tables import Table as Table
from irisjax.io.tables import check_writable as check_writable
from irisjax.io.tables import format_table as format_table
from irisjax.io.tables import is_device as is_device
from irisjax.io.tables import read_header as read_header
from irisjax.io.tables import read_table as read_table
from irisjax.io.tables import write_atomically as write_atomically
from irisjax.io.tables import write_together as write_together

if TYPE_CHECKING:
    from irisjax.io.illumination import tables_of as tables_of
    from irisjax.io.images import Image as Image
    from irisjax.io.images import read_environment as read_environment
    from irisjax.io.images import read_image as read_image
    from irisjax.io.images import spectral_channels as spectral_channels
    from irisjax.io.images import write_exr as write_exr
    from irisjax.io.images import write_png as write_png
    from irisjax.io.maps import read_maps as read_maps
    from irisjax.io.maps import write_maps as write_maps
    from irisjax.io.movies import check_movie as check_movie
    from irisjax.io.movies import first_file as first_file
    from irisjax.io.movies import write_movie as write_movie
    from irisjax.io.photographs import read_photograph as read_photograph
    from irisjax.io.posterior import write_posterior as write_posterior
    from irisjax.io.scenes import SceneFile as SceneFile
    from irisjax.io.scenes import parse_scene as parse_scene
    from irisjax.io.scenes import read_scene as read_scene

# Spectra need none of these: they load when first used.
_LATER = {
    "illumination": ("tables_of",),
    "images": (
        "Image",
        "read_environment",
        "read_image",
        "spectral_channels",
        "write_exr",
        "write_png",
    ),
    "maps": ("read_maps", "write_maps"),
    "movies": ("check_movie", "first_file", "write_movie"),
    "photographs": ("read_photograph",),
    "posterior": ("write_posterior",),
    "scenes": ("SceneFile", "parse_scene", "read_scene"),
}


def __getattr__(name: str):
    for module, names in _LATER.items():
        if name in names:
            return getattr(importlib.import_module(f"irisjax.io.{module}"), name)
    return modules_of(__name__)(name)
