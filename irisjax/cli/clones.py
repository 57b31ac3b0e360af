"""`irisjax clone --batch`: a folder for each photograph, a table and a contact sheet."""

import os
from collections.abc import Callable, Collection
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
from irisjax.cli.engine import LostPiece, Workers, describe_fault, run_pieces
from irisjax.cli.many import DOUBTFUL, FAILED, OK, EyeRow, EyeTable
from irisjax.cli.options import dashed
from irisjax.io.camera import RAW
from irisjax.io.clones import OVERLAY
from irisjax.io.eye_colours import COLOUR_FILES, CONTACT_SHEET, encode_contact_sheet
from irisjax.io.photographs import HEIF, PHOTOGRAPHS
from irisjax.numerics.streams import key_of
from irisjax.photo import clone as cloning
from irisjax.photo.doubts import doubtful_outlines
from irisjax.photo.eye_colour import EyeColour, colours_of
from irisjax.photo.pigments import CONCENTRATIONS
from irisjax.plot.beside import Later, here

_FIRST_COLUMNS = ("file", "status", "doubts")
_ENDS = "", "_low", "_high"  # of the names of a value's and its interval's columns
_SINGLE_OPTIONS = ("limbus", "pupil", "second", "maps", "freckles", "visible")  # of one photograph
_SHEET_PICTURES = "side_by_side.png", COLOUR_FILES[1], OVERLAY  # of a folder, the best first


def clone_many(
    source: Path,
    picture: ClonePicture,
    model: CloneModel,
    results: CloneResults,
    draw: Callable[..., Later],
    workers: Workers,
) -> int:
    """Clone all photographs of a folder or pattern, or measure their colours, each into its own
    folder, with `clones.csv` and a contact sheet; `workers` share the work. Return the exit status,
    3 if one failed.
    """
    if typed := [dashed(name) for name in _SINGLE_OPTIONS if name in picture.typed]:
        raise ValueError(f"--batch does not go with {', '.join(typed)}: they are of one photograph")
    photographs = _find_photographs(source)
    target = results.output / "clones.csv"
    table = EyeTable(tuple(photographs), _FIRST_COLUMNS, "photograph", target)
    table.begin(results.resume, results.overwrite)
    # A new folder must not be that of an earlier run's photograph.
    before = {name for name, row in table.rows.items() if row["status"] != FAILED}
    cloned = [name for name in table.order if name in photographs or name in before]
    names = _folder_names(table.order) | _folder_names(cloned)
    for name in before - photographs.keys():  # by what was beside it in its own run
        names[name] = name if (results.output / name).exists() else Path(name).stem
    folders = {name: results.output / folder for name, folder in names.items()}
    table.redo(lambda row: (folders[row["file"]] / results.summary).exists())
    # A process that draws figures cannot be handed to other workers.
    shared = None if workers.in_other_processes else draw
    pieces = {
        name: (photographs[name], picture, model, results, folders[name], shared)
        for name in table.left()
    }
    with table.progress() as bar:
        for name, result in run_pieces(_clone_one, pieces, workers):
            if isinstance(result, LostPiece):
                result = _first_cells(name, FAILED, result.reason)
            table.add({name: result})
            bar.set_description("photographs", refresh=False)
            bar.update()
    labels = {f"{name}: {table.rows[name]['status']}": folders[name] for name in table.order}
    pictures = {
        label: next(filter(Path.exists, (folder / name for name in _SHEET_PICTURES)), None)
        for label, folder in labels.items()
    }
    io.write_together({results.output / CONTACT_SHEET: encode_contact_sheet(pictures)})
    print(f"written: {target}, {results.output / CONTACT_SHEET}")
    return table.conclude()


def _clone_one(
    path: Path,
    picture: ClonePicture,
    model: CloneModel,
    results: CloneResults,
    folder: Path,
    draw: Callable[..., Later] | None,
) -> EyeRow:
    (folder / results.summary).unlink(missing_ok=True)  # marks a photograph that is done
    try:
        run = run_clone(path, picture, model, results, folder, draw or here, True)
        return _row(path.name, run, key_of(model.seed))
    except Exception as error:
        # An error in one photograph, even a fault of the program, must not end a long run: it is
        # written into the row. IRISJAX_DEBUG raises it.
        if os.environ.get("IRISJAX_DEBUG") and not isinstance(error, ValueError | OSError):
            raise
        return _first_cells(path.name, FAILED, describe_fault(error))


def _find_photographs(source: Path) -> dict[str, Path]:
    """Find photographs, by the names of their files."""
    suffixes = (*PHOTOGRAPHS, *HEIF, *RAW)
    candidates = source.iterdir() if source.is_dir() else source.parent.glob(source.name)
    paths = sorted(
        p for p in candidates if p.suffix.lower() in suffixes and p.name != CONTACT_SHEET
    )
    if not paths:
        reason = f"names end in {', '.join((*PHOTOGRAPHS, *HEIF))}, or as of camera raw"
        if not (source.exists() or "*" in source.name):
            reason = "there is no such folder"
        raise ValueError(f"{source}: no photographs there: {reason}")
    return {path.name: path for path in paths}


def _folder_names(names: Collection[str]) -> dict[str, str]:
    """Name a folder for each file, with the file's suffix where several differ in nothing else."""
    stems = [Path(name).stem for name in names]
    return {n: s if stems.count(s) == 1 else n for n, s in zip(names, stems, strict=True)}


def _first_cells(*cells: str) -> EyeRow:
    return dict(zip(_FIRST_COLUMNS, cells, strict=True))


def _row(name: str, run: CloneRun, key: jax.Array) -> EyeRow:
    stage, doubts = run.found, run.doubts
    sentences = "; ".join(doubt.sentence for doubt in doubts)
    cells: dict[str, object] = {}
    for outline in ("limbus", "pupil"):
        ellipse = getattr(stage.boundaries, outline)
        cells[f"{outline}_confidence"] = getattr(stage.boundaries, f"{outline}_confidence")
        numbers = *ellipse.centre, *ellipse.semi_axes, np.degrees(ellipse.angle)
        parts = (f"{outline}_{part}" for part in ("x", "y", "a", "b", "deg"))
        cells |= zip(parts, numbers, strict=True)
    cells |= _colour_cells(_find_colours(run, key))
    if isinstance(stage, cloning.Sampled) and not pigments_withheld(stage, doubts):
        for pigment in CONCENTRATIONS:
            e = stage.posterior.estimates[pigment]
            values = e.median, e.low, e.high
            cells |= zip((f"{pigment}{end}" for end in _ENDS), values, strict=True)
    if isinstance(stage, cloning.Coloured) and (melanin := stage.abl_melanin()) is not None:
        cells |= zip((f"texels_abl_melanin{end}" for end in _ENDS), melanin, strict=True)
    row = _first_cells(name, DOUBTFUL if doubts else OK, sentences)
    return row | {column: f"{value:.5g}" for column, value in cells.items()}


def _find_colours(run: CloneRun, key: jax.Array) -> EyeColour | None:
    """Return an eye's colours, or measure those of a clone; `None` if that is impossible."""
    if run.colours is not None or doubtful_outlines(run.found):
        return run.colours
    try:
        return colours_of(run.found, key=key)[0]
    except ValueError:  # for example, the white of the eye is not visible
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
            columns = (f"{start}_{component}{end}" for end in _ENDS)
            cells |= zip(columns, values, strict=True)
        cells[f"{start}_share"] = region.share
    return cells
