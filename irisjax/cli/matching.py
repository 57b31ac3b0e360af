"""`irisjax paint --match`: a recipe fitted to a given eye, and further coats painted on top."""

import json
import os
import posixpath
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from irisjax.cli.files import png_of
from irisjax.cli.options import tell
from irisjax.io.recipes import Recipe
from irisjax.io.targets import Target
from irisjax.measure.colour import srgb_encode
from irisjax.ocularist.coats import LIMBUS
from irisjax.ocularist.matching import match, retouch
from irisjax.ocularist.painting import painted
from irisjax.ocularist.plan import difference, rolled, texture_of
from irisjax.ocularist.recipes import EYE_COLOURS, coats

RETOUCHES = 6
"""Coats that follow a target's pattern, by default."""
MATCH, DIFFERENCES, RETOUCH = "match.png", "match.json", "retouch-"
"""Files of a match, and the beginning of the names of its coats' scans."""
_STEPS = 300  # evaluations of the search at most
_TYPE = "detail"


class Matched(NamedTuple):
    """A recipe, pictures of its coats that are scans by their files, contents of files to write
    beside it, and lines to print.
    """

    recipe: Recipe
    scans: dict[str, np.ndarray]
    files: dict[str, bytes]
    messages: list[str]


def nearest_colour(target: Target, seed: int) -> Recipe:
    """The default coats of the colour of eye that differs least from the target, unfitted."""
    left = {}
    for colour in EYE_COLOURS:
        recipe = Recipe(coats(_TYPE, colour, seed=seed), pupil_radius=target.pupil * LIMBUS)
        eye = recipe.eye()
        painting = painted(recipe.coats, recipe.mixer(), eye, size=128)
        seen = texture_of(painting, eye, target.known.shape)
        left[difference(seen, target.texture, target.known).mean] = recipe
    return left[min(left)]


def matched(
    target: Target, recipe: Recipe, folder: Path, *, count: int, size: int, seed: int
) -> Matched:
    """Match a recipe to a target, with `count` coats on top whose scans go to `folder`."""
    recipe = recipe._replace(pupil_radius=target.pupil * LIMBUS)
    eye, mixer, scans, known = recipe.eye(), recipe.mixer(), recipe.scans(), target.known
    key, there = jax.random.key(seed), os.path.relpath(folder, recipe.folder)
    given = mixer, eye, target.texture
    same = {"scans": scans, "size": size}
    fitted = match(recipe.coats, *given, known, **same, max_steps=_STEPS, key=key)
    if not fitted.converged:
        tell(f"the match was stopped after {fitted.steps} steps")
    prefix = posixpath.normpath(posixpath.join(Path(there).as_posix(), RETOUCH))
    # Hidden texels have the mean of their radius, and are painted so.
    more = retouch(fitted.recipes, *given, count=count, prefix=prefix, **same)
    whole = recipe._replace(coats=(*fitted.recipes, *more.recipes))
    seen = [
        texture_of(painted(some, mixer, eye, size=size, scans=more.scans), eye, known.shape)
        for some in (fitted.recipes, whole.coats)
    ]
    last = difference(seen[1], target.texture, known)
    steps = {"before": fitted.before, "matched": fitted.after, "retouched": last}
    measure = {"measure": "CIE 1976 dE*ab, D65"}
    summary = {
        "target": target.name,
        "colour_difference": {name: d._asdict() | measure for name, d in steps.items()},
        "steps": fitted.steps,
        "converged": fitted.converged,
    }
    remark = "painted by irisjax to match a target"
    pictures = {
        posixpath.basename(name): np.repeat(grey[..., None], 3, 2)
        for name, grey in more.scans.items()
        if name not in scans
    }
    flat = [_flat(texture, eye, size) for texture in (target.texture, *seen)]
    pictures[MATCH] = np.concatenate(flat, 1)
    files = {name: png_of(folder / name, pixels, remark) for name, pixels in pictures.items()}
    files[DIFFERENCES] = (json.dumps(summary, indent=1) + "\n").encode()
    words = "as it was", "matched", f"with {len(more.recipes)} coats on top"
    said = "; ".join(
        f"{w} {d.mean:.1f} ({d.q95:.1f})" for w, d in zip(words, steps.values(), strict=True)
    )
    message = f"mean colour difference (95 % below), CIE 1976, flat and in plain light: {said}"
    return Matched(whole, more.scans, files, [message])


def _flat(texture, eye, size: int) -> np.ndarray:
    """A polar texture as the iris laid flat, encoded."""
    row, column, on = rolled(texture.shape[:2], eye, size)
    return np.where(on[..., None], np.asarray(srgb_encode(texture))[row, column], 0)
