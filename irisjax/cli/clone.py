"""`irisjax clone`: a photograph of an eye in, an iris with error bars out."""

import sys
import time
from collections.abc import Callable
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import jax
import typer
from tqdm import tqdm

from irisjax import io
from irisjax.cli.clone_options import CloneModel, ClonePicture, CloneResults, settings_of
from irisjax.cli.clone_report import report, tell
from irisjax.cli.compiled import kept_tables
from irisjax.cli.files import check_folder
from irisjax.cli.options import Group, grouped
from irisjax.io.clone_folders import PHOTOGRAPH, encode_photograph
from irisjax.io.clones import CLONE_FILES, files_of
from irisjax.io.photographs import read_photograph
from irisjax.photo import clone as cloning
from irisjax.photo.clone import PictureDifference, compare_with_photograph
from irisjax.photo.doubts import doubtful_outlines, doubts_of, per_cent
from irisjax.plot.beside import Later, beside, here

_NOT_SURE = 3
_FIGURES = "side_by_side.png", "differences.png", "luminance.png"


@grouped
def clone_command(picture: ClonePicture, model: CloneModel, results: CloneResults) -> None:
    """Clone an iris from a photograph: outlines, the iris laid flat, thickness, pigments.

    For example: irisjax clone eye.jpg -o clone_eye

    Exit status: 0; 3 with warnings if an outline is doubtful (give --limbus and
    --pupil), a stage fails (the results of those before it are written), the model
    does not follow the photograph, or the chain is not long enough; 2 for wrong
    input.
    """
    folder = results.output
    check_folder(folder, "clone.json", "a clone", results.overwrite)
    given, settings = picture.given(), settings_of(picture, model)
    photograph = read_photograph(picture.photograph)
    timings: dict[str, float] = {}
    wanted = cloning.STAGES[: cloning.STAGES.index(results.stop_after) + 1]
    drawing = beside() if "pigments" in wanted else nullcontext(here)
    with drawing as draw:
        with _progress(len(wanted), timings) as stage:
            run = cloning.clone_eye(
                photograph,
                settings,
                given,
                last=results.stop_after,
                stage=stage,
                tables=kept_tables,
                key=jax.random.key(model.seed),
            )
            found, both, drawn, failed = next(run), None, None, ()
            try:
                # No stage follows a doubtful outline.
                for known in () if doubtful_outlines(found) else run:
                    found = known
                    if both is None and isinstance(known, cloning.Fitted):  # before the posterior
                        both = compare_with_photograph(known)
                        drawn = _begun(known, both, draw)
            except ValueError as error:
                if not isinstance(found, cloning.Shaped):
                    raise
                stage_name = wanted[len(timings)]
                failed = (f"{stage_name}: {error}; the stages before it are written",)
        for note in photograph.notes:
            tell(f"{picture.photograph}: {note}")
        words = {**_words(picture), **_words(model)}
        doubts = doubts_of(found, None if both is None else both.rms) + failed
        files = files_of(found, words, timings, both, doubts)
        if both is not None and drawn is not None:
            print(f"difference of the pictures, RMS: {per_cent(both.rms)} % (R, G, B)")
            files |= {name: later() for name, later in drawn.items()}
            files[PHOTOGRAPH] = encode_photograph(both.photograph)
    folder.mkdir(parents=True, exist_ok=True)
    io.write_together({folder / name: data for name, data in files.items()})
    for name in {*CLONE_FILES, *_FIGURES, PHOTOGRAPH} - set(files):  # of an earlier, longer run
        (folder / name).unlink(missing_ok=True)
    report(found, picture.cross_polarised, folder, doubts)
    raise typer.Exit(_NOT_SURE if doubts else 0)


@contextmanager
def _progress(stages: int, timings: dict[str, float]):
    """Show a progress bar, and make a context that records the seconds of a stage."""
    with tqdm(total=stages, unit="stage", disable=not sys.stderr.isatty()) as bar:

        @contextmanager
        def stage(name: str):
            bar.set_description(name)
            begin = time.perf_counter()
            yield
            timings[name] = time.perf_counter() - begin
            bar.update()

        yield stage


def _words(group: Group) -> dict[str, Any]:
    return {n: str(v) if isinstance(v, Path) else v for n, v in vars(group).items() if n != "typed"}


def _begun(
    found: cloning.Fitted, both: PictureDifference, draw: Callable[..., Later]
) -> dict[str, Later]:
    """Begin to draw the figures."""
    eye = found.scene().eye
    radius = float(0.5 * (eye.pupil_radius + eye.iris_radius))
    return {
        "side_by_side.png": draw("side_by_side", both.photograph, both.rendered),
        "differences.png": draw("differences", both.photograph, both.rendered, both.clear),
        "luminance.png": draw("luminance_profile", *both.arc(found, radius), radius),
    }
