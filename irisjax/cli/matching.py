"""`irisjax paint --match`: a recipe brought close to a given eye, further coats painted on top."""

import json
import os
import posixpath
import sys
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from tqdm import tqdm

from irisjax.cli.files import png_of
from irisjax.cli.painted_files import DIFFERENCES, MATCH, RETOUCH
from irisjax.io.recipes import Recipe
from irisjax.io.targets import Target
from irisjax.measure.colour import srgb_encode
from irisjax.ocularist.coats import LIMBUS
from irisjax.ocularist.easel import painted
from irisjax.ocularist.matching import Match, match
from irisjax.ocularist.plan import Difference, difference, rolled, texture_of
from irisjax.ocularist.recipes import COLOURS, coats
from irisjax.ocularist.retouching import retouched

RETOUCHES = 6
"""Coats that follow a target's pattern, by default."""
_STEPS = 300  # of the search at most
_TYPE = "detail"


class Matched(NamedTuple):
    """A recipe that was matched: `scans` of its retouching coats by their files, the `files` to
    write beside it, and what to say of it.
    """

    recipe: Recipe
    scans: dict[str, np.ndarray]
    files: dict[str, bytes]
    said: list[str]


def nearest_colour(target: Target, seed: int) -> Recipe:
    """The default coats of the colour of eye that differs least as it is."""
    left = {}
    for colour in COLOURS:
        recipe = Recipe(coats(_TYPE, colour, seed=seed), pupil_radius=target.pupil * LIMBUS)
        eye = recipe.eye()
        painting = painted(recipe.coats, recipe.mixer(), eye, size=128)
        seen = texture_of(painting, eye, target.known.shape)
        left[difference(seen, target.texture, target.known).mean] = recipe
    return left[min(left)]


def matched(
    target: Target, recipe: Recipe, folder: Path, *, count: int, size: int, seed: int
) -> Matched:
    """A recipe matched, and `count` coats on top whose scans go to `folder`."""
    recipe = recipe._replace(pupil_radius=target.pupil * LIMBUS)
    eye, mixer, scans = recipe.eye(), recipe.mixer(), recipe.scans()
    known = target.known
    with tqdm(total=2, desc="matching", disable=not sys.stderr.isatty()) as bar:
        fitted = match(
            recipe.coats,
            mixer,
            eye,
            target.texture,
            known,
            scans=scans,
            size=size,
            max_steps=_STEPS,
            key=jax.random.key(seed),
        )
        bar.update()
        there = os.path.relpath(folder, recipe.folder)
        prefix = posixpath.normpath(posixpath.join(Path(there).as_posix(), RETOUCH))
        # What is hidden holds its radius's mean, and is painted so.
        more = retouched(
            fitted.recipes,
            mixer,
            eye,
            target.texture,
            count=count,
            prefix=prefix,
            scans=scans,
            size=size,
        )
        bar.update()
    if not fitted.converged:
        print(f"irisjax: the match was stopped after {fitted.steps} steps", file=sys.stderr)
    whole = recipe._replace(coats=(*fitted.recipes, *more.recipes))
    seen = [
        texture_of(painted(some, mixer, eye, size=size, scans=more.scans), eye, known.shape)
        for some in (fitted.recipes, whole.coats)
    ]
    last = difference(seen[1], target.texture, known)
    remark = "painted by irisjax to match a target"
    flat = [_flat(texture, eye, size) for texture in (target.texture, *seen)]
    files = {
        posixpath.basename(name): png_of(folder / name, np.repeat(grey[..., None], 3, 2), remark)
        for name, grey in more.scans.items()
        if name not in scans
    }
    files[MATCH] = png_of(folder / MATCH, np.concatenate(flat, 1), remark)
    files[DIFFERENCES] = _summary(target, fitted, last)
    steps = (
        ("as it was", fitted.before),
        ("matched", fitted.after),
        (f"with {len(more.recipes)} coats on top", last),
    )
    said = "; ".join(f"{name} {d.mean:.1f} ({d.most:.1f})" for name, d in steps)
    return Matched(
        whole,
        more.scans,
        files,
        [f"mean colour difference (95 % below), CIE 1976, flat and in plain light: {said}"],
    )


def _summary(target: Target, fitted: Match, last: Difference) -> bytes:
    steps = {"before": fitted.before, "matched": fitted.after, "retouched": last}
    found = {
        "target": target.name,
        "colour_difference": {
            name: {"mean": d.mean, "q95": d.most, "measure": "CIE 1976 dE*ab, D65"}
            for name, d in steps.items()
        },
        "steps": fitted.steps,
        "converged": fitted.converged,
    }
    return (json.dumps(found, indent=1) + "\n").encode()


def _flat(texture, eye, size: int) -> np.ndarray:
    """A polar texture as the iris laid flat, encoded."""
    row, column, on = rolled(texture, eye, size)
    return np.where(on[..., None], np.asarray(srgb_encode(texture))[row, column], 0)
