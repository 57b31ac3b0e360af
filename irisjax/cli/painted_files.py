"""The folder of a painted eye: what an artist's own pictures in it are spared, and what goes of an
eye that was replaced.
"""

import itertools
import os
from collections.abc import Iterable
from pathlib import Path

from irisjax.export.coats import FORMATS
from irisjax.io.recipes import Recipe
from irisjax.io.tissue_of_paint import MAPS, SCENE
from irisjax.ocularist.components import COMPONENTS
from irisjax.ocularist.easel import SCAN

COATS, MESHES, TISSUE = "coats", "meshes", "tissue"
"""Folders of a painted eye."""
MATCH, DIFFERENCES, RETOUCH = "match.png", "match.json", "retouch-"
"""What a match leaves beside it: files, and how the names of its coats' scans begin."""
_COATS = tuple(f"[0-9]*_{component}" for component in (*COMPONENTS, SCAN))
_OF_MESHES = (*FORMATS, "mtl", "png")
_OF_AN_EYE = (
    MATCH,
    DIFFERENCES,
    f"{RETOUCH}[0-9]*.png",
    *(f"{COATS}/{name}.png" for name in _COATS),
    f"{TISSUE}/{MAPS}",
    f"{TISSUE}/{SCENE}",
    *(
        f"{MESHES}/{name}.{suffix}"
        for name, suffix in itertools.product((*_COATS, "cornea", "white"), _OF_MESHES)
    ),
)


def check_spared(recipe: Recipe, written: Iterable[Path]) -> None:
    """Raise `ValueError` where files to be `written` are pictures or paints that the recipe needs.

    The files as it was used could not be painted from again, and an artist's own scan was lost.
    """
    places = {os.path.realpath(path): path for path in written}
    for path in _needed(recipe):
        if path in places:
            raise ValueError(
                f"{places[path]}: the recipe paints with this file, which would be overwritten; "
                "give another folder"
            )


def remove_left_over(folder: Path, recipe: Recipe, written: Iterable[Path]) -> None:
    """Remove what an eye that was replaced left in its folder: by its name one of the command's
    files, neither `written` now nor needed by the recipe as it was used.
    """
    kept = {os.path.realpath(path) for path in written} | _needed(recipe)
    for pattern in _OF_AN_EYE:
        for path in folder.glob(pattern):
            if os.path.realpath(path) not in kept:
                path.unlink()
    for name in (COATS, MESHES, TISSUE):
        if (folder / name).is_dir() and not any((folder / name).iterdir()):
            (folder / name).rmdir()


def _needed(recipe: Recipe) -> set[str]:
    names = recipe.scan_files() | ({recipe.paints} if recipe.paints is not None else set())
    return {os.path.realpath(recipe.folder / name) for name in names}
