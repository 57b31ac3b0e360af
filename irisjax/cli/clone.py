"""`irisjax clone`: a photograph of an eye in, an iris with error bars out."""

import sys
import time
from collections.abc import Callable
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from tqdm import tqdm

from irisjax import io
from irisjax.cli.cache import cores, kept_tables
from irisjax.cli.clone_report import doubtful, report, say
from irisjax.cli.files import check_folder
from irisjax.cli.options import SEED_HELP, Group, grouped, name_of, number, option, read_seed, whole
from irisjax.cli.scenes import lamps
from irisjax.io.clone_folders import PHOTOGRAPH, encode_photograph
from irisjax.io.clones import FILES, files_of
from irisjax.io.photographs import read_photograph
from irisjax.numerics.checks import Range, check_range
from irisjax.photo import clone as cloning
from irisjax.photo.ellipse import Ellipse
from irisjax.photo.picture import compare
from irisjax.plot.beside import Later, beside, here
from irisjax.render.environment import Environment
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.separable import Separable

_NOT_SURE = 3
_PROCESSES = {"ilit-2006": Separable, "depth-resolved": RadiativeIntegrator}
_FIGURES = "side_by_side.png", "differences.png", "luminance.png"


@dataclass(frozen=True, kw_only=True)
class Picture(Group):
    """The photograph and what is known of it."""

    PANEL = "Photograph"

    photograph: Annotated[
        Path,
        typer.Argument(
            metavar="PHOTO", help="JPEG, PNG, TIFF, EXR or camera raw", show_default=False
        ),
    ]
    focal_px: Annotated[
        float | None,
        option(parse=number(), metavar="pixels", help="focal length; default: the file's own"),
    ] = None
    limbus: Annotated[
        str | None,
        option(
            metavar="X,Y,A,B,DEG",
            help="outline of the cornea, in place of the one that is found: centre (column, row), "
            "semi-axes (pixels), angle of the larger one from the right towards the top",
        ),
    ] = None
    pupil: Annotated[
        str | None, option(metavar="X,Y,A,B,DEG", help="the same of the pupil as it appears")
    ] = None
    tilt_azimuth: Annotated[
        float | None,
        option(
            parse=number(-360, 360),
            metavar="degrees",
            help="side of the eye on which the camera stands, from the picture's right to its top; "
            "default: told from the pupil",
        ),
    ] = None
    light: Annotated[
        list[str] | None,
        option(
            metavar="POLAR,AZIMUTH[,E]",
            help="as of render, E its irradiance; repeatable; default: told from the highlights on "
            "the cornea",
        ),
    ] = None
    environment: Annotated[
        str | None,
        option(metavar="FILE|uniform", help="latitude-longitude panorama, or light from all round"),
    ] = None
    cross_polarised: Annotated[
        bool,
        option("--cross-polarised", metavar="", help="the photograph was taken through polarisers"),
    ] = False
    second: Annotated[
        Path | None,
        option(
            metavar="FILE",
            help="of the same eye, best through crossed polarisers: without highlights it shows "
            "the texture; light and pigments are told from PHOTO",
        ),
    ] = None
    maps: Annotated[
        Path | None,
        option(metavar="FILE.exr", help="thickness, in place of what the texture tells: maps.exr"),
    ] = None
    freckles: Annotated[
        Path | None,
        option(metavar="FILE.png", help="mask in place of freckles.png, white where a freckle is"),
    ] = None


@dataclass(frozen=True, kw_only=True)
class Model(Group):
    """How the eye is modelled."""

    PANEL = "Model"

    media: Annotated[str, name_of("what light crosses before the iris", *cloning.MEDIA)] = (
        "cornea-aqueous"
    )
    iris_depth: Annotated[
        float,
        option(parse=number(2.5, 8), metavar="mm", help="of the iris behind the cornea, 2.5 to 8"),
    ] = 3.6
    beta: Annotated[
        float | None,
        option(
            parse=number(0, 5),
            metavar="mm",
            help="thickness by F09's Eq. 7, which has 0.35; default: by the model's response",
        ),
    ] = None
    deconvolution: Annotated[
        float,
        option(
            parse=number(0, 2),
            metavar="mm",
            help="with --beta: width of the blur by scattering, 0 to 2",
        ),
    ] = 0.5
    relief: Annotated[
        float,
        option(
            parse=number(0, 1),
            metavar="share",
            help="of the stroma's unevenness that stands out towards the cornea, 0 to 1; in light "
            "eyes its shading is taken off",
        ),
    ] = 0.0
    method: Annotated[
        str, name_of("search for the pigments; simplex is F09's", *cloning.METHODS)
    ] = "least-squares"
    process: Annotated[str, name_of("light in the iris", *_PROCESSES)] = "ilit-2006"
    max_steps: Annotated[
        int, option(parse=whole(150, 100_000), metavar="count", help="of the posterior's chain")
    ] = 8000
    seed: Annotated[int, option(parse=read_seed, metavar="number", help=SEED_HELP + "files")] = 0


@dataclass(frozen=True, kw_only=True)
class Results(Group):
    """Where it goes."""

    PANEL = "Files"

    output: Annotated[Path, option("-o", "--output", metavar="DIR", help="folder for the clone")]
    stop_after: Annotated[str, name_of("last stage", *cloning.STAGES)] = "posterior"
    overwrite: Annotated[
        bool, option("--overwrite", metavar="", help="replace a clone in that folder")
    ] = False


@grouped
def clone(picture: Picture, model: Model, results: Results) -> None:
    """An iris from a photograph: outlines, the iris laid flat, thickness, pigments.

    For example: irisjax clone eye.jpg -o clone_eye

    Exit status: 0; 3 where an outline is doubtful (give --limbus and --pupil) or
    the chain is not long enough (raise --max-steps); 2 for wrong input.
    """
    folder = results.output
    check_folder(folder, "clone.json", "a clone", results.overwrite)
    check_range("--focal-px", picture.focal_px, Range(10, 1e6, "pixels"))
    given = _given(picture)
    settings = cloning.Settings(
        model.media,
        model.iris_depth,
        picture.focal_px,
        None if picture.tilt_azimuth is None else float(np.radians(picture.tilt_azimuth)),
        sigma=model.deconvolution,
        beta=model.beta,
        relief=model.relief,
        method=model.method,
        integrator=_PROCESSES[model.process](),
        steps=model.max_steps,
        seed=model.seed,
    )
    photograph = read_photograph(picture.photograph)
    timings: dict[str, float] = {}
    wanted = cloning.STAGES[: cloning.STAGES.index(results.stop_after) + 1]
    drawing = beside() if "pigments" in wanted else nullcontext(here)
    with drawing as draw:
        with _progress(len(wanted), timings) as stage:
            run = cloning.clone(
                photograph,
                settings,
                given,
                last=results.stop_after,
                stage=stage,
                tables=kept_tables,
            )
            found, drawn = next(run), None
            # On a doubtful outline nothing is built.
            for known in () if doubtful(found) else run:
                found = known
                if drawn is None and known.fit is not None:  # while the posterior is sampled
                    drawn = _pictures(known, draw)
        for note in photograph.notes:
            say(f"{picture.photograph}: {note}")
        words = {**_words(picture), **_words(model)}
        files = files_of(found, words, timings)
        if drawn is not None:
            files |= drawn()
    folder.mkdir(parents=True, exist_ok=True)
    io.write_together({folder / name: data for name, data in files.items()})
    for name in {*FILES, *_FIGURES, PHOTOGRAPH} - set(files):  # of a clone that came further
        (folder / name).unlink(missing_ok=True)
    sure = report(found, picture.cross_polarised, folder)
    raise typer.Exit(0 if sure else _NOT_SURE)


@contextmanager
def _progress(stages: int, timings: dict[str, float]):
    """A bar of the stages; what is entered with a stage's name keeps its time."""
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


def _given(picture: Picture) -> cloning.Given:
    lights = lamps(picture.light) if picture.light else None
    around = None
    if picture.environment == "uniform":
        around = Environment.uniform()
    elif picture.environment is not None:
        around = io.read_environment(picture.environment)
    mask = None
    if picture.freckles is not None:
        mask = io.read_image(picture.freckles).pixels[..., 0] > 0.5
    return cloning.Given(
        limbus=_outline("--limbus", picture.limbus),
        pupil=_outline("--pupil", picture.pupil),
        lights=lights,
        environment=around,
        freckles=mask,
        maps=None if picture.maps is None else io.read_maps(picture.maps),
        second=None if picture.second is None else read_photograph(picture.second),
    )


def _outline(name: str, text: str | None) -> Ellipse | None:
    if text is None:
        return None
    try:
        x, y, a, b, degrees = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{name} {text!r}: write X,Y,A,B,DEG, five numbers") from None
    if not (a >= b > 0 and np.isfinite([x, y, a, b, degrees]).all()):
        raise ValueError(f"{name} {text!r}: the semi-axes must be A >= B > 0")
    return Ellipse((x, y), (a, b), float(np.radians(degrees)))


def _pictures(found: cloning.Clone, draw: Callable[..., Later]) -> Callable[[], dict[str, bytes]]:
    """Begin the pictures; what is returned waits for them and says how far they are apart."""
    both = compare(found, cores())
    eye = found.scene().eye
    radius = float(0.5 * (eye.pupil_radius + eye.iris_radius))
    begun = {
        "side_by_side.png": draw("side_by_side", both.photograph, both.rendered),
        "differences.png": draw("differences", both.photograph, both.rendered, both.clear),
        "luminance.png": draw("luminance_profile", *both.arc(found, radius), radius),
    }

    def written() -> dict[str, bytes]:
        rms = ", ".join(f"{100 * r:.1f}" for r in both.rms)
        print(f"difference of the pictures, RMS: {rms} % (R, G, B)")
        made = {name: later() for name, later in begun.items()}
        return made | {PHOTOGRAPH: encode_photograph(both.photograph)}

    return written
