"""`irisjax clone --batch`: a folder for each photograph, a table and a contact sheet."""

import dataclasses
import os
from collections.abc import Callable, Iterable
from pathlib import Path

import jax
import numpy as np

from irisjax import io
from irisjax.cli.clone import (
    CloneModel,
    ClonePicture,
    CloneResults,
    CloneRun,
    pigments_withheld,
    run_clone,
)
from irisjax.cli.engine import Lost, Workers, each, fault_of
from irisjax.cli.many import DOUBTFUL, FAILED, OK, EyeRow, EyeTable
from irisjax.cli.options import dashed
from irisjax.io.camera import RAW
from irisjax.io.clones import OVERLAY
from irisjax.io.eye_colours import COLOUR_FILES, CONTACT_SHEET, encode_contact_sheet
from irisjax.io.photographs import HEIF, PHOTOGRAPHS
from irisjax.photo import clone as cloning
from irisjax.photo.doubts import doubtful_outlines
from irisjax.photo.eye_colour import EyeColour, colours_of
from irisjax.photo.pigments import CONCENTRATIONS
from irisjax.plot.beside import Later, here

_FIRST = ("file", "status", "doubts")
_OF_ONE = "limbus", "pupil", "second", "maps", "freckles", "visible"  # options of one photograph
_SHOWN = "side_by_side.png", COLOUR_FILES[1], OVERLAY  # pictures of a folder, the best first


def clone_many(
    source: Path,
    picture: ClonePicture,
    model: CloneModel,
    results: CloneResults,
    draw: Callable[..., Later],
    workers: Workers,
) -> int:
    """Clone all photographs of a folder or pattern, or measure their colours, each into a folder of
    its own, with `clones.csv` and a contact sheet; `workers` share the work. The exit status: 3
    where one failed.
    """
    if typed := [dashed(name) for name in _OF_ONE if name in picture.typed]:
        raise ValueError(f"--batch does not go with {', '.join(typed)}: they are of one photograph")
    photographs = _photographs(source)
    folders = {name: results.output / folder for name, folder in _folders(photographs).items()}
    target = results.output / "clones.csv"
    table = EyeTable(tuple(photographs), _FIRST, "photograph", target)

    def done(row: EyeRow) -> bool:
        folder = folders.get(row["file"])
        return folder is not None and (folder / results.summary).exists()

    table.begin(results.resume, results.overwrite, done)
    shared = None if workers.elsewhere else draw  # what draws beside this process stays with it
    pieces = {
        name: (photographs[name], picture, model, results, folders[name], shared)
        for name in table.left()
    }
    with table.progress() as bar:
        for name, found in each(_cloned, pieces, workers):
            row = _first(name, FAILED, found.why) if isinstance(found, Lost) else found
            table.add({name: row})
            bar.set_description("photographs", refresh=False)
            bar.update()
    labels = {f"{name}: {table.rows[name]['status']}": folders[name] for name in photographs}
    shown = {
        words: next(filter(Path.exists, (folder / name for name in _SHOWN)), None)
        for words, folder in labels.items()
    }
    io.write_together({results.output / CONTACT_SHEET: encode_contact_sheet(shown)})
    print(f"written: {target}, {results.output / CONTACT_SHEET}")
    return table.conclude()


def _cloned(
    path: Path,
    picture: ClonePicture,
    model: CloneModel,
    results: CloneResults,
    folder: Path,
    draw: Callable[..., Later] | None,
) -> EyeRow:
    """Clone a photograph; its row."""
    (folder / results.summary).unlink(missing_ok=True)  # it is not done
    one = dataclasses.replace(picture, photograph=path)
    try:
        made = run_clone(path, one, model, results, folder, draw or here, True)
        return _row(path.name, made, jax.random.key(model.seed))
    except Exception as error:
        # A fault of one photograph, even of the program, must not end a night's run. The row tells
        # it; IRISJAX_DEBUG raises it.
        if os.environ.get("IRISJAX_DEBUG") and not isinstance(error, ValueError | OSError):
            raise
        return _first(path.name, FAILED, fault_of(error))


def _photographs(source: Path) -> dict[str, Path]:
    """Photographs by the names of their files."""
    suffixes = (*PHOTOGRAPHS, *HEIF, *RAW)
    inside = source.iterdir() if source.is_dir() else source.parent.glob(source.name)
    found = sorted(p for p in inside if p.suffix.lower() in suffixes and p.name != CONTACT_SHEET)
    if not found:
        why = f"names end in {', '.join((*PHOTOGRAPHS, *HEIF))}, or as of camera raw"
        if not (source.exists() or "*" in source.name):
            why = "there is no such folder"
        raise ValueError(f"{source}: no photographs there: {why}")
    return {path.name: path for path in found}


def _folders(names: Iterable[str]) -> dict[str, str]:
    """A folder for each file, with its suffix where several files differ in nothing else."""
    stems = [Path(name).stem for name in names]
    return {n: s if stems.count(s) == 1 else n for n, s in zip(names, stems, strict=True)}


def _first(*cells: str) -> EyeRow:
    return dict(zip(_FIRST, cells, strict=True))


def _row(name: str, made: CloneRun, key: jax.Array) -> EyeRow:
    found, doubts = made.found, made.doubts
    said = "; ".join(doubt.sentence for doubt in doubts)
    cells: dict[str, object] = {}
    for outline in ("limbus", "pupil"):
        ellipse = getattr(found.boundaries, outline)
        cells[f"{outline}_confidence"] = getattr(found.boundaries, f"{outline}_confidence")
        numbers = *ellipse.centre, *ellipse.semi_axes, np.degrees(ellipse.angle)
        parts = (f"{outline}_{part}" for part in ("x", "y", "a", "b", "deg"))
        cells |= zip(parts, numbers, strict=True)
    cells |= _colour_cells(_colours(made, key))
    if isinstance(found, cloning.Sampled) and not pigments_withheld(found, doubts):
        for pigment in CONCENTRATIONS:
            e = found.posterior.estimates[pigment]
            cells |= {pigment: e.median, f"{pigment}_low": e.low, f"{pigment}_high": e.high}
    row = _first(name, DOUBTFUL if doubts else OK, said)
    return row | {column: f"{value:.5g}" for column, value in cells.items()}


def _colours(made: CloneRun, key: jax.Array) -> EyeColour | None:
    """An eye's colours, of a clone too where they can be measured."""
    if made.colours is not None or doubtful_outlines(made.found):
        return made.colours
    try:
        return colours_of(made.found, key=key)[0]
    except ValueError:  # no white is seen, for example
        return None


def _colour_cells(colours: EyeColour | None) -> dict[str, object]:
    """Columns of L*a*b* with the ends of their intervals."""
    if colours is None:
        return {}
    named = dict(colours.regions) | {f"dominant {i}": r for i, r in enumerate(colours.dominant, 1)}
    cells: dict[str, object] = {}
    for name, region in named.items():
        start = name.replace(" ", "_")
        for component, *values in zip("Lab", region.lab, region.low, region.high, strict=True):
            columns = (f"{start}_{component}{end}" for end in ("", "_low", "_high"))
            cells |= zip(columns, values, strict=True)
        cells[f"{start}_share"] = region.share
    return cells
